"""Flights of a multirotor: the domain, and a planner that flies straight on.

Places are from where it was put down: x north, y east, altitude upwards.
"""

from __future__ import annotations

import math

from pydantic import BaseModel, ConfigDict, Field

from pytest_dura.core.roles import Generator
from pytest_dura.core.state import GeneratorView, Proposal
from pytest_dura.domains import Action, Domain, Signal
from pytest_dura.faults.model import Channel

FASTEST = 15.0
"""m/s that may be commanded."""


class Flight(BaseModel):
    """What a scenario may say under ``world``."""

    model_config = ConfigDict(
        strict=True, extra="forbid", frozen=True, allow_inf_nan=False, use_attribute_docstrings=True
    )

    altitude: float = Field(default=5.0, gt=0)
    """Of start and goal, in m."""
    goal_x: float = 40.0
    """Where it is to fly, in m north of where it was put down."""
    goal_y: float = 0.0
    """See `goal_x`; east."""
    within: float = Field(default=2.0, gt=0)
    """m from the goal at which it is there."""
    wind_x: float = 0.0
    """m/s, northwards."""
    wind_y: float = 0.0
    """m/s, eastwards."""


class FlyThere(Generator):
    """Flies straight to the goal, and as fast as it can stop before what is ahead.

    Args:
        speed: At most, in m/s.
        braking: That it counts on, in m/s2.
        margin: That is left ahead when it stands, in m.
    """

    def __init__(self, *, speed: float = 5.0, braking: float = 2.0, margin: float = 3.0) -> None:
        self._speed, self._braking, self._margin = speed, braking, margin

    def propose(self, view: GeneratorView) -> Proposal:
        """Propose a velocity; without a measured position or distance, standing in the air."""
        at, ahead = view.percept.get("position"), view.percept.get("range")
        goal, still = view.percept["goal"], {"vx": 0.0, "vy": 0.0, "climb": 0.0}
        if at is None or ahead is None:
            return Proposal(still, "no position or distance is measured")
        x, y = goal["x"] - at["x"], goal["y"] - at["y"]
        away, free = math.hypot(x, y), min(ahead["ahead"] - self._margin, 1e3)
        if not all(map(math.isfinite, (away, free, at["altitude"]))):
            return Proposal(still, "what is measured is no number")
        fastest = math.sqrt(2.0 * self._braking * max(min(away, free), 0.0))
        share = min(self._speed, fastest) / max(away, 0.1)
        climb = min(max(goal["altitude"] - at["altitude"], -1.0), 1.0)
        return Proposal({"vx": share * x, "vy": share * y, "climb": climb}, f"{away:.1f} m to fly")


_FRAME = "from where it was put down: x north, y east, upwards"
MULTIROTOR = Domain(
    name="multirotor",
    roles={"generator": "fly_there"},
    world=Flight,
    signals=(
        Signal("x", "m", "north of where it was put down"),
        Signal("y", "m", "east of it"),
        Signal("altitude", "m", "above it"),
        Signal("speed", "m/s", "in all directions", least=0.0),
        Signal("ahead", "m", "to what is ahead, by the distance sensor before any fault"),
        Signal("to_goal", "m", "to the goal, seen from above", least=0.0),
        Signal("collided", "truth", "whether it has struck anything"),
    ),
    percept_signals=(Signal("ahead", "m", "to what is ahead"),),
    actions=tuple(
        Action(name, "m/s", meaning, -FASTEST, FASTEST)
        for name, meaning in (("vx", "northwards"), ("vy", "eastwards"), ("climb", "upwards"))
    ),
    channels={
        "position": Channel("numbers", ("x", "y", "altitude"), units=("m",) * 3, frame=_FRAME,
                            meaning="as AirSim's estimator has it"),
        "velocity": Channel("numbers", ("vx", "vy", "climb"), units=("m/s",) * 3, frame=_FRAME,
                            meaning="as AirSim's estimator has it"),
        "range": Channel("numbers", ("ahead",), units=("m",), meaning="a distance sensor"),
        "goal": Channel("numbers", ("x", "y", "altitude"), units=("m",) * 3, frame=_FRAME,
                        meaning="where it is to fly"),
    },
    fault_targets={"number": "range.ahead", "any": "range", "command": "command.vx"},
)  # fmt: skip
"""Flights of one multirotor to a place."""
