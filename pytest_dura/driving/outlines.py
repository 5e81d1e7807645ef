"""Outlines of a road: where its kerbs, markings and stop lines are, for pictures and the player."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.simulator import Line
from pytest_dura.driving.roads import Road, Vector

_FLAT = 135.0
"""Degrees between two arms from which on the kerb between them is straight."""


@cache
def corners(road: Road) -> tuple[tuple[Vector, float], ...]:
    """Centre and radius of the kerbs that round the corners between two arms.

    Where the arms are far apart there is no corner: see :func:`flat_sides`.
    """
    rounded = (_kerb(road, a, b) for a, b in road.neighbours())
    return tuple(kerb for kerb in rounded if kerb is not None)


@cache
def flat_sides(road: Road) -> tuple[tuple[Vector, Vector], ...]:
    """The ends of the kerbs between two arms that have no corner."""
    return tuple(_mouths(road, a, b) for a, b in road.neighbours() if _kerb(road, a, b) is None)


@cache
def lines(road: Road) -> tuple[Line, ...]:
    """Edges, centre lines and stop lines, as the player draws them."""
    following = dict(road.neighbours())
    drawn = []
    for number, arm in enumerate(road.arms):
        near, far = arm.stop_line, arm.end
        left = 0.0 if arm.lanes == "in" else -arm.lane_width
        right = 0.0 if arm.lanes == "out" else arm.lane_width
        drawn += [
            _line("edge", arm.place(near, left), arm.place(far, left)),
            _line("edge", arm.place(near, right), arm.place(far, right)),
            _line("edge", *_mouths(road, number, following[number])),
        ]
        if arm.lanes == "both":
            drawn.append(_line("marking", arm.place(near, 0.0), arm.place(far, 0.0)))
        if arm.lanes != "out":
            drawn.append(_line("stop_line", arm.place(near, 0.0), arm.place(near, right)))
    return tuple(drawn)


def _line(kind: str, start: Vector, end: Vector) -> Line:
    points: NDArray[np.float32] = np.array([start, end], np.float32)
    return Line(kind, points)


def _mouths(road: Road, a: int, b: int) -> tuple[Vector, Vector]:
    """Where the kerbs between two arms that follow each other, counter-clockwise, begin and end."""
    first, second = road.arms[a], road.arms[b]
    return (
        first.place(first.stop_line, first.lane_width),
        second.place(second.stop_line, -second.lane_width),
    )


def _kerb(road: Road, a: int, b: int) -> tuple[Vector, float] | None:
    """Centre and radius of the kerb between two arms that follow each other."""
    first, second = road.arms[a], road.arms[b]
    apart = (first.bearing - second.bearing) % 360.0
    if apart > _FLAT or len(road.arms) < 3:
        return None
    angle = math.radians(apart)
    edge, other = first.lane_width, second.lane_width
    # Along each arm, where the two edges meet; from there the tangents to the kerb are equal.
    meet = (other + edge * math.cos(angle)) / math.sin(angle)
    meet_second = (edge + other * math.cos(angle)) / math.sin(angle)
    tangent = min(first.stop_line - meet, second.stop_line - meet_second)
    radius = round(tangent * math.tan(angle / 2.0), 9)
    return first.place(round(meet + tangent, 9), edge + radius), radius
