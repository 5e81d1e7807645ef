"""A person with an insulin pump: Bergman's minimal model, a glucose sensor, and the domain."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from pytest_dura import Action, ActionError, Channel, Domain, Signal, Simulator, Tick

BASAL_GLUCOSE, BASAL_INSULIN = 110.0, 15.0  # mg/dL, mU/L
P1, P2, P3 = 0.01, 0.025, 1.3e-5  # 1/min, 1/min, L/(mU min2)
CLEARANCE, VOLUME = 0.09, 12.0  # 1/min, L
BASAL_RATE = CLEARANCE * BASAL_INSULIN * VOLUME  # mU/min, that keeps glucose where it is
DIGESTION = 0.05  # 1/min
STEP = 60.0  # s, of the integration


class World(BaseModel):
    """What a scenario says of the person and the day."""

    model_config = ConfigDict(extra="forbid")
    glucose: float = Field(120.0, gt=40, lt=400, description="At the beginning, in mg/dL.")
    meal: float = Field(150.0, ge=0, description="By which it would raise glucose, in mg/dL.")
    meal_at: float = Field(3600.0, ge=0, description="When the meal begins, in s.")


class Pump(NamedTuple):
    """The action: mU of insulin per minute. Faults act on `command.rate`."""

    rate: float


class Monitor(NamedTuple):
    """The sensor under the skin. Faults act on `cgm.glucose`."""

    glucose: float


class Person(Simulator):
    """Integrates glucose, insulin and the remote action of insulin, minute by minute."""

    @classmethod
    def check_scenario(cls, world: Mapping[str, Any]) -> dict[str, Any]:
        """Return the scenario's `world` with its defaults."""
        return World.model_validate(dict(world)).model_dump()

    def reset(self, scenario: Mapping[str, Any], seed: int) -> Tick:
        """Begin a day."""
        del seed
        self._world = scenario["world"]
        self._glucose = self._world["glucose"]
        self._action, self._insulin, self._index = 0.0, BASAL_INSULIN, 0
        return self._tick()

    def step(self, action: Pump) -> Tick:
        """Go on by a time step."""
        for part in range(round(self.time_step / STEP)):
            since = (self._index * self.time_step + part * STEP - self._world["meal_at"]) / 60.0
            eaten = DIGESTION * self._world["meal"] * np.exp(-DIGESTION * since) * (since >= 0.0)
            minutes = STEP / 60.0
            glucose = P1 * (BASAL_GLUCOSE - self._glucose) - self._action * self._glucose + eaten
            remote = P3 * (self._insulin - BASAL_INSULIN) - P2 * self._action
            insulin = action.rate / VOLUME - CLEARANCE * self._insulin
            self._glucose = max(float(self._glucose + minutes * glucose), 10.0)
            self._action += minutes * remote
            self._insulin += minutes * insulin
        self._index += 1
        return self._tick()

    def check_action(self, action: object) -> Pump:
        """Refuse what the pump cannot deliver."""
        if not isinstance(action, Pump) or not 0.0 <= action.rate <= 100.0:
            raise ActionError(f"the pump takes a Pump of 0 to 100 mU/min, and no {action!r}")
        return action

    def fallback_action(self) -> Pump:
        """Deliver the basal rate where nothing valid is proposed."""
        return Pump(BASAL_RATE)

    def signals(self, ticks: Sequence[Tick]) -> dict[str, NDArray[Any]]:
        """Return what requirements read: the truth."""
        return {name: np.array([tick.truth[name] for tick in ticks])
                for name in ("glucose", "insulin")}  # fmt: skip

    def _tick(self) -> Tick:
        truth = {"glucose": self._glucose, "insulin": self._insulin}
        channels = {"cgm": Monitor(min(max(self._glucose, 40.0), 400.0))}
        return Tick(self._index, self._index * self.time_step, truth, channels)


INSULIN = Domain(
    name="insulin",
    roles={"generator": "insulin_controller:Controller"},
    world=World,
    signals=(
        Signal("glucose", "mg/dL", "in the blood"),
        Signal("insulin", "mU/L", "in the plasma"),
    ),
    actions=(Action("rate", "mU/min", "of the pump", 0.0, 100.0),),
    channels={
        "cgm": Channel(
            "numbers",
            ("glucose",),
            units=("mg/dL",),
            meaning="a continuous glucose monitor",
            ranges=((40.0, 400.0),),
            errors=(9.0,),
        )
    },
    fault_targets={"number": "cgm.glucose", "any": "cgm", "command": "command.rate"},
)
