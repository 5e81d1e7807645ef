"""Prompts on which templates are tried when they are loaded."""

from __future__ import annotations

from typing import Any

import numpy as np

from pytest_dura.core.state import PastDecision
from pytest_dura.driving.bodies import CAR_LENGTH, CAR_WIDTH, Body, BodyList
from pytest_dura.driving.faults.signs import POSTER
from pytest_dura.driving.junction import route
from pytest_dura.driving.maneuvers import Command, Maneuver
from pytest_dura.driving.sensors import Imu, Odometry, Pose, Sign, route_map, signs
from pytest_dura.llm.driving.blocks import percept_prompt
from pytest_dura.llm.driving.images import VIEWS
from pytest_dura.llm.prompts.prompt import Prompt


def probes() -> tuple[Prompt, ...]:
    """One with every block, at each place of the ego; and one where nothing is known."""
    done = PastDecision(0.5, Command(Maneuver.YIELD), "a car", Command(Maneuver.WAIT), "recovery")
    failed = PastDecision(0.7, None, "", None, "fallback")
    first = PastDecision(0.0, "x", "", "x", "proposal")
    full = [
        percept_prompt(
            _percept(along), (done, failed), images=tuple(VIEWS), now=1.0, last=done,
            feedback=("too close",) * 9,
        )
        for along in (60.0, 110.0, 160.0)
    ]  # fmt: skip
    bare = percept_prompt({}, (failed,), images=tuple(VIEWS), last=first, feedback=("",))
    return (*full, bare)


def _percept(along: float) -> dict[str, Any]:
    """All channels, the ego so many metres along the route from south to north."""
    own = route(0, "straight")
    x, y, heading = (float(value) for value in own.pose(along))
    car = Body("V1", x - 8.0, y - 8.0, 0.0, 8.0, 0.0, CAR_LENGTH, CAR_WIDTH)
    broken = Body("V2", x, y + 9.0, np.nan, np.nan, np.nan, np.nan, np.nan)
    crowd = [car._replace(id=f"P{i}", y=y + 9.0 + i, length=0.6) for i in range(15)]
    sign = Sign(POSTER, along + 20.0, "road works")
    return {
        "lidar": BodyList.of([car, broken, *crowd]),
        "radar": np.array([[11.3, 0.8, -3.0], [30.0, 0.0, np.nan]]),
        **dict.fromkeys(VIEWS, np.zeros((8, 8, 3), np.uint8)),
        "imu": Imu(0.1, 0.0, 0.0, heading),
        "odometry": Odometry(8.0),
        "localisation": Pose(x, y, heading),
        "map": route_map(own),
        "controls": (*signs(own, "red"), sign),
    }
