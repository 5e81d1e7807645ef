"""Times of prompts: to collision, and facts of who will be on the ego's lane when the ego is there.

All are reckoned from the percept alone, and are whole statements of kinematics: everybody keeps
speed and heading, which they need not do.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from pytest_dura.driving.bodies import CAR_LENGTH, CAR_WIDTH, Body, BodyList, box_time_to_collision
from pytest_dura.driving.conflicts import LATER, Conflict, launched
from pytest_dura.driving.sensors import Pose
from pytest_dura.llm.driving.readings import Row, rounded

MOST_CONFLICTS = 8
"""Conflicts that are shown, the soonest ones."""


def complete(rows: Sequence[Row]) -> BodyList:
    """The objects all of whose numbers are known; the id of each is the number of its row."""
    return BodyList.of([
        Body(str(number), *row) for number, row in enumerate(rows) if None not in row  # type: ignore[arg-type] # checked
    ])  # fmt: skip


def times_to_collision(bodies: BodyList, pose: Pose, speed: float) -> dict[str, float]:
    """Seconds until the footprints of ego and each object touch, by id, at most :data:`LATER`.

    Boxes that keep velocity and heading: as the measure ``threat_ids_miss_nearest`` and the
    signal ``ttc`` reckon it.

    Args:
        bodies: The objects.
        pose: Of the ego.
        speed: Of the ego, in m/s.
    """
    if not len(bodies):
        return {}
    x, y, heading = pose
    box = np.tile([x, y, heading, CAR_LENGTH, CAR_WIDTH], (len(bodies), 1))
    velocity = np.tile([speed * math.cos(heading), speed * math.sin(heading)], (len(bodies), 1))
    data = bodies.data
    times = box_time_to_collision(box, velocity, data[:, [0, 1, 2, 5, 6]], data[:, 3:5], LATER)
    return dict(zip(bodies.ids, times.tolist(), strict=True))


def conflict_facts(conflict: Conflict, name: str, speed: float, limit: float) -> dict[str, Any]:
    """Facts of a conflict: where, when the object is there, and when the ego would be.

    Args:
        conflict: The conflict.
        name: As the id is shown.
        speed: Of the ego, in m/s.
        limit: Of the road, in m/s.
    """
    return {
        "id": name,
        "at": rounded(conflict.begins),
        "along": rounded(conflict.along),
        "comes": rounded(conflict.comes),
        "leaves": rounded(conflict.leaves),
        "you_come": rounded(launched(conflict.begins, speed, limit)),
        "you_leave": rounded(launched(conflict.ends, speed, limit)),
    }
