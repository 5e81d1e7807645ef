"""The tank of the tutorial, and the controller of `controller.c` in Python."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from pytest_dura import (
    Action,
    ActionError,
    Channel,
    Domain,
    Generator,
    Measure,
    Proposal,
    Signal,
    Simulator,
    Tick,
)


class World(BaseModel):
    model_config = ConfigDict(extra="forbid")
    drain: float = Field(0.4, ge=0, description="Share of the level that runs out in a second.")


class Pump(NamedTuple):
    inflow: float


def highest(episode):
    return float(episode.signal("level").max())


class Tank(Simulator):
    measures = (
        Measure(
            "highest", "highest", "greatest level", highest, "mean", unit="m", signals=("level",)
        ),
    )

    @classmethod
    def check_scenario(cls, world):
        return World.model_validate(dict(world)).model_dump()

    def reset(self, scenario, seed):
        self._drain = scenario["world"]["drain"]
        self._level, self._index = 1.0, 0
        return self._tick()

    def step(self, action):
        self._level += self.time_step * (action.inflow - self._drain * self._level)
        self._index += 1
        return self._tick()

    def check_action(self, action):
        if not isinstance(action, Pump):
            raise ActionError(f"the tank takes a Pump, and no {action!r}")
        super().check_action(tuple(action))
        return action

    def fallback_action(self):
        return Pump(0.0)

    def signals(self, ticks):
        return {"level": np.array([tick.truth["level"] for tick in ticks])}

    def _tick(self):
        truth, channels = {"level": self._level}, {"gauge": {"level": self._level}}
        return Tick(self._index, self._index * self.time_step, truth, channels)


class Fill(Generator):
    """The component that `controller.c` is, too."""

    def propose(self, view):
        inflow = 2.0 * (2.0 - view.percept["gauge"]["level"])
        return Proposal(
            Pump(min(max(inflow, 0.0), 1.0)), f"level {view.percept['gauge']['level']:.3f}"
        )


TANK = Domain(
    name="tank",
    roles={"generator": "tank:Fill"},
    world=World,
    signals=(Signal("level", "m", "above the bottom"),),
    actions=(Action("inflow", "m3/s", "of the pump", 0.0, 1.0),),
    channels={"gauge": Channel("numbers", ("level",), units=("m",))},
    fault_targets={"number": "gauge.level", "any": "gauge", "command": "command.inflow"},
)
