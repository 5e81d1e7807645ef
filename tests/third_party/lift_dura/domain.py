"""The domain: a lift that goes up a shaft, its controller, and a slipping encoder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from pytest_dura import (
    Action,
    ActionError,
    Channel,
    Domain,
    Episode,
    FaultPart,
    Generator,
    GeneratorView,
    Measure,
    Moment,
    Proposal,
    Signal,
    Simulator,
    Tick,
)
from pytest_dura.faults import NumberFault
from pytest_dura.faults.parts import Span

TOP = 10.0
"""Height of the shaft's end in m."""


class Shaft(BaseModel):
    """World of a lift."""

    model_config = ConfigDict(extra="forbid")

    floor: float = Field(8.0, gt=0, lt=TOP, description="Where it is called to, in m.")
    start: float = Field(0.0, ge=0, lt=TOP, description="Where it stands at first, in m.")


def arrival_time(episode: Episode) -> float | None:
    """Seconds until it arrived."""
    arrived = np.flatnonzero(episode.signal("arrived") > 0.5)
    return float(episode.time[arrived[0]]) if len(arrived) else None


def overrun(episode: Episode) -> bool:
    """Whether it went half a metre too far."""
    return bool(episode.signal("height").max() > 4.5)


class Lift(Simulator):
    """A lift in a shaft; the action is its speed in m/s."""

    measures = (
        Measure(
            "arrival_time",
            heading="arrival",
            meaning="time until it arrived, over the runs that did",
            function=arrival_time,
            shown="mean",
            unit="s",
            signals=("arrived",),
        ),
        Measure(
            "overrun",
            heading="over",
            meaning="runs half a metre too far",
            function=overrun,
            shown="share",
            signals=("height",),
            severity="grave",
        ),
    )

    @staticmethod
    def check_scenario(world: Mapping[str, Any]) -> dict[str, Any]:
        """Return the world with its defaults."""
        return Shaft.model_validate(dict(world)).model_dump()

    def reset(self, scenario: Mapping[str, Any], seed: int) -> Tick:
        """Begin where the world says."""
        shaft = Shaft.model_validate(scenario["world"])
        self._floor, self._height, self._index = shaft.floor, shaft.start, 0
        return self._tick()

    def step(self, action: Any) -> Tick:
        """Move for a time step, to the shaft's end at most."""
        self._height = min(TOP, self._height + action * self.time_step)
        self._index += 1
        return self._tick()

    def signals(self, ticks: Sequence[Tick]) -> dict[str, Any]:
        """``height`` in m, and ``arrived``."""
        height = np.array([tick.truth["height"] for tick in ticks])
        return {"height": height, "arrived": (height >= self._floor).astype(float)}

    def check_action(self, action: Any) -> float:
        """Return a speed."""
        if not isinstance(action, float):
            raise ActionError("a lift takes a speed, a float")
        return action

    def fallback_action(self) -> float:
        """Stand."""
        return 0.0

    def _tick(self) -> Tick:
        return Tick(
            index=self._index,
            time=self._index * self.time_step,
            truth={"height": self._height},
            channels={"encoder": {"height": self._height, "floor": self._floor}},
        )


class Steady(Generator):
    """Goes up at 1 m/s until the encoder shows the floor."""

    def propose(self, view: GeneratorView) -> Proposal:
        """Propose to go on, or to stand."""
        encoder = view.percept["encoder"]
        left = encoder["floor"] - encoder["height"]
        return Proposal(1.0 if left > 0.0 else 0.0, account={"left": left})


class SlipParameters(FaultPart):
    """Size of the slip."""

    metres: Annotated[float, Span(0.0, 5.0)] = Field(3.0, description="In m; 0 is the identity.")


class Slip(NumberFault):
    """The encoder slipped: it shows ``metres`` too little."""

    parameters: SlipParameters = SlipParameters()

    def changed(self, value: Any, moment: Moment) -> Any:
        """Return what the encoder shows."""
        return value - self.parameters.metres


LIFT = Domain(
    name="lift",
    roles={"generator": "steady"},
    world=Shaft,
    signals=(
        Signal("height", "m", "of the cabin's floor above the lowest one"),
        Signal("arrived", "0 or 1", "at the floor it was called to, or above"),
    ),
    percept_signals=(),
    proposal_signals=(),
    actions=(Action("speed", "m/s", "upwards"),),
    channels={
        "encoder": Channel(
            "numbers",
            ("height", "floor"),
            units=("m", "m"),
            frame="shaft: upwards from the lowest floor",
            meaning="where it is, and where it was called to",
        )
    },
    fault_targets={"number": "encoder.height"},
)
