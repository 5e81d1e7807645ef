"""Visibility: which bodies others hide, seen from above.

A body is seen if some straight line from the viewer's footprint to its own passes no body between.
Lines run from centre and corners to centre and corners, so that who sees is seen. What is low or
narrow hides no object: people, cyclists, cones and kerb islands.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pytest_dura.driving.bodies import CAR_LENGTH, CAR_WIDTH, HEADING, LENGTH, WIDTH, BodyList, X, Y

Floats = NDArray[np.float64]

HIDES = 1.5
"""m; a body hides others if it is at least as long and as wide: cars, vans and hedges."""
_POINTS = np.array([[0, 0], [1, 1], [1, -1], [-1, -1], [-1, 1]], dtype=float) / 2.0
_TOUCH = 1e-9


def visible(viewer: Floats, bodies: BodyList) -> BodyList:
    """The bodies that a viewer sees past the others.

    Args:
        viewer: Its box ``x, y, heading, length, width``, which hides no object.
        bodies: Everybody else.
    """
    boxes = bodies.data[:, [X, Y, HEADING, LENGTH, WIDTH]]
    hiding = (boxes[:, 3] >= HIDES) & (boxes[:, 4] >= HIDES)
    if not hiding.any():
        return bodies
    return bodies.rows([row for row in range(len(boxes)) if is_seen(viewer, boxes, row, hiding)])


def is_seen(viewer: Floats, boxes: Floats, row: int, hiding: NDArray[np.bool_]) -> bool:
    """Whether a viewer sees one of some bodies past those that hide.

    Args:
        viewer: Its box, shape ``(5,)``.
        boxes: Of the bodies, shape ``(n, 5)``.
        row: Which of them is looked at.
        hiding: Which of them hide others.
    """
    between = hiding.copy()
    between[row] = False
    eyes, points = _points(viewer), _points(boxes[row])
    starts = np.repeat(eyes, len(points), axis=0)
    ends = np.tile(points, (len(eyes), 1))
    return bool((~_passes(starts, ends, boxes[between]).any(axis=1)).any())


def ego_box(ego: Any) -> Floats:
    """The box of an ego's state."""
    return np.array([ego.x, ego.y, ego.heading, CAR_LENGTH, CAR_WIDTH])


def _points(box: Floats) -> Floats:
    """Centre and corners of a box, shape ``(5, 2)``."""
    c, s = np.cos(box[2]), np.sin(box[2])
    local = _POINTS * box[3:5]
    points: Floats = box[:2] + local @ np.array([[c, s], [-s, c]])
    return points


def _passes(starts: Floats, ends: Floats, boxes: Floats) -> NDArray[np.bool_]:
    """Whether each line passes through each box, not along its edge; shape ``(lines, boxes)``."""
    c, s = np.cos(boxes[:, 2]), np.sin(boxes[:, 2])
    axes = np.stack([np.stack([c, s], axis=-1), np.stack([-s, c], axis=-1)], axis=1)
    begin = np.einsum("bkd,lbd->lbk", axes, starts[:, None] - boxes[None, :, :2])
    along = np.einsum("bkd,ld->lbk", axes, ends - starts)
    half = boxes[None, :, 3:5] / 2.0 - _TOUCH
    moving = np.abs(along) > _TOUCH
    rate = np.where(moving, along, 1.0)
    first, second = (-half - begin) / rate, (half - begin) / rate
    beside = ~moving & (np.abs(begin) >= half)
    enter = np.where(moving, np.minimum(first, second), np.where(beside, np.inf, -np.inf))
    leave = np.where(moving, np.maximum(first, second), np.inf)
    inside = np.minimum(leave.min(axis=2), 1.0) - np.maximum(enter.max(axis=2), 0.0)
    passes: NDArray[np.bool_] = inside > _TOUCH
    return passes
