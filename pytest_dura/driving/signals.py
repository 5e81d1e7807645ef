"""Signals of an episode, computed once and vectorised over all its ticks.

Units are SI. ``gap`` and ``ttc`` saturate at their caps, also on an empty road.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.state import Percept, Tick
from pytest_dura.driving import geometry
from pytest_dura.driving.bodies import CAR_LENGTH, CAR_WIDTH, VX, VY, BodyList
from pytest_dura.driving.junction import ARM_LENGTH

GAP_CAP = 50.0
"""m; farther objects do not matter at these speeds."""
TTC_CAP = 10.0
"""s; later contacts do not matter."""

Floats = NDArray[np.float64]

NAMES = (
    "gap", "ttc", "speed", "acceleration", "jerk", "lateral_acceleration", "lateral_jerk",
    "progress", "in_conflict_zone", "collided", "struck", "struck_standing", "cleared",
    "command_error", "background_crashes",
)  # fmt: skip


def truth_signals(ticks: Sequence[Tick], exit_at: float, dt: float) -> dict[str, Floats]:
    """Ground-truth signals, each of shape ``(len(ticks),)``."""
    ego = np.array([tick.truth["ego"] for tick in ticks], dtype=float)
    x, y, heading, speed, acceleration, commanded, yaw_rate, s, _ = ego.T
    contact = np.array([tick.truth["contact"] for tick in ticks], dtype=float)
    gap, ttc = proximity(
        np.stack([x, y, heading, speed * np.cos(heading), speed * np.sin(heading)], axis=1),
        [tick.truth["bodies"] for tick in ticks],
    )
    lateral = speed * yaw_rate
    collided = contact > 0
    half = CAR_LENGTH / 2
    return {
        "gap": np.where(collided, 0.0, gap),
        "ttc": np.where(collided, 0.0, ttc),
        "speed": speed,
        "acceleration": acceleration,
        "jerk": np.diff(acceleration, prepend=acceleration[:1]) / dt,
        "lateral_acceleration": lateral,
        "lateral_jerk": np.diff(lateral, prepend=lateral[:1]) / dt,
        "progress": s - s[0],
        "in_conflict_zone": ((s + half > ARM_LENGTH) & (s - half < exit_at)).astype(float),
        "collided": collided.astype(float),
        "struck": (contact >= 2).astype(float),
        "struck_standing": (contact == 3).astype(float),
        "cleared": np.maximum.accumulate((s - half >= exit_at).astype(float)),
        "command_error": np.abs(acceleration - commanded),
        "background_crashes": np.array([t.truth["background_crashes"] for t in ticks], float),
    }


def percept_signals(percepts: Sequence[Percept]) -> dict[str, Floats]:
    """The same as perceived: from localisation, odometry and lidar."""
    poses = np.array([percept["localisation"] for percept in percepts], dtype=float)
    speed = np.array([percept["odometry"].speed for percept in percepts], dtype=float)
    x, y, heading = poses.T
    gap, ttc = proximity(
        np.stack([x, y, heading, speed * np.cos(heading), speed * np.sin(heading)], axis=1),
        [percept["lidar"] for percept in percepts],
    )
    return {"gap": gap, "ttc": ttc, "speed": speed}


def proximity(ego: Floats, bodies: Sequence[BodyList]) -> tuple[Floats, Floats]:
    """Gap to the nearest object and least time to collision at each tick.

    Args:
        ego: ``x, y, heading, vx, vy`` per tick, shape ``(ticks, 5)``.
        bodies: The objects at each tick.
    """
    gap, ttc = np.full(len(ego), GAP_CAP), np.full(len(ego), TTC_CAP)
    counts = [len(at_tick) for at_tick in bodies]
    if not sum(counts):
        return gap, ttc
    others = np.concatenate([at_tick.data for at_tick in bodies])
    owner = np.repeat(np.arange(len(ego)), counts)
    mine = ego[owner]
    # Farther objects can neither be within the cap of the gap nor be met before that of the time.
    closing = TTC_CAP * np.hypot(others[:, VX] - mine[:, 3], others[:, VY] - mine[:, 4])
    apart = np.hypot(others[:, 0] - mine[:, 0], others[:, 1] - mine[:, 1])
    near = apart < np.maximum(GAP_CAP, closing) + 10.0
    others, mine, owner = others[near], mine[near], owner[near]
    size = np.broadcast_to([CAR_LENGTH, CAR_WIDTH], (len(mine), 2))
    box = np.concatenate([mine[:, :3], size], axis=1)
    other_box = others[:, [0, 1, 2, 5, 6]]
    np.minimum.at(gap, owner, geometry.gap(box, other_box))
    times = geometry.time_to_collision(
        box, mine[:, 3:5], other_box, others[:, VX : VY + 1], TTC_CAP
    )
    np.minimum.at(ttc, owner, times)
    return gap, ttc
