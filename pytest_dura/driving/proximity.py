"""Gap and time to collision of an ego and all bodies around it, vectorised over an episode."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pytest_dura.driving import geometry
from pytest_dura.driving.bodies import (
    CAR_LENGTH,
    CAR_WIDTH,
    HEADING,
    LENGTH,
    VX,
    VY,
    WIDTH,
    BodyList,
    X,
    Y,
)

GAP_CAP = 50.0
"""m; farther objects do not matter at these speeds."""
TTC_CAP = 10.0
"""s; later contacts do not matter."""
_EGO_CIRCLE = math.hypot(CAR_LENGTH, CAR_WIDTH) / 2
_ROUNDING = 1e-6

Floats = NDArray[np.float64]


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
    offset = others[:, :2] - mine[:, :2]
    motion = others[:, VX : VY + 1] - mine[:, 3:5]
    apart = np.hypot(offset[:, 0], offset[:, 1])
    # Circles around the boxes tell which pairs need a closer look; most need none.
    circles = _EGO_CIRCLE + np.hypot(others[:, LENGTH], others[:, WIDTH]) / 2 + _ROUNDING
    bound = np.full(len(ego), GAP_CAP)
    np.minimum.at(bound, owner, apart)
    nearest = apart - circles <= bound[owner]
    np.minimum.at(
        gap, owner[nearest], geometry.gap(_ego_boxes(mine[nearest]), _boxes(others[nearest]))
    )
    squared = np.maximum((motion * motion).sum(axis=1), _ROUNDING)
    time = np.clip(-(offset * motion).sum(axis=1) / squared, 0.0, TTC_CAP)[:, None]
    meeting = np.hypot(*(offset + time * motion).T) <= circles
    mine, others, owner = mine[meeting], others[meeting], owner[meeting]
    times = geometry.time_to_collision(
        _ego_boxes(mine), mine[:, 3:5], _boxes(others), others[:, VX : VY + 1], TTC_CAP
    )
    np.minimum.at(ttc, owner, times)
    return gap, ttc


def _ego_boxes(states: Floats) -> Floats:
    boxes = np.empty((len(states), 5))
    boxes[:, :3] = states[:, :3]
    boxes[:, 3:] = CAR_LENGTH, CAR_WIDTH
    return boxes


def _boxes(bodies: Floats) -> Floats:
    return bodies[:, [X, Y, HEADING, LENGTH, WIDTH]]
