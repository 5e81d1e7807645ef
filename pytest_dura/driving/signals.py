"""Signals of an episode, vectorised over its ticks, and those of a single percept.

:func:`percept_at` gives the values of :func:`percept_signals` at one tick, in plain arithmetic: for
the few bodies of a junction that is several times quicker than arrays.

Units are SI. What has no value on an empty road saturates at a declared cap there: ``gap``,
``ttc``, ``leader_gap``, ``following_margin``, ``priority_arrival`` and ``gap_time``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.percepts import Percept
from pytest_dura.core.state import Tick
from pytest_dura.driving.bodies import CAR_LENGTH, CAR_WIDTH, GAP_CAP, TTC_CAP, proximity
from pytest_dura.driving.criticality import Encounters, criticality
from pytest_dura.driving.lanes import Route
from pytest_dura.driving.percepts import (
    all_objects,
    implausible_values,
    own_pose,
    own_speed,
    plausible_objects,
)
from pytest_dura.driving.scene import ego_of
from pytest_dura.driving.traffic_rules import (
    LEADER_CAP,
    SAME_DIRECTION,
    find_leaders,
    following_margin,
    right_of_way,
)

_EGO_CIRCLE = math.hypot(CAR_LENGTH, CAR_WIDTH) / 2
_PARALLEL = 1e-9
_RESERVE = 1e-6
"""m; bounds are not taken to the last bit."""
_BESIDE = CAR_WIDTH / 2 + 1e-6


class _Box(NamedTuple):
    """Centre, cosine and sine of the heading, half length and half width."""

    x: float
    y: float
    c: float
    s: float
    length: float
    width: float


def percept_at(percept: Percept) -> dict[str, float]:
    """The signals :data:`PERCEPT_NAMES` of one percept, by name.

    Needs the channels localisation, odometry, map and lidar. Where these report implausible values,
    the distances are unknown, and each is 0.
    """
    (x, y, heading), speed, way, s = ego_of(percept)
    if implausible_values(percept):
        return {"gap": 0.0, "ttc": 0.0, "leader_gap": 0.0, "speed": speed}
    ego = _box(x, y, heading, CAR_LENGTH, CAR_WIDTH)
    vx, vy = speed * ego.c, speed * ego.s
    bodies = plausible_objects(percept)
    ttc, leader_gap = TTC_CAP, LEADER_CAP
    apart: list[tuple[float, tuple[float, ...]]] = []
    for row, (at, lateral) in zip(bodies.numbers, bodies.beside(way.route), strict=True):
        bx, by, _, bvx, bvy, length, width = row
        dx, dy, dvx, dvy = bx - x, by - y, bvx - vx, bvy - vy
        circles = _circles(length, width)
        apart.append((math.hypot(dx, dy) - circles, row))
        # Most are not on the path, however they are turned.
        if length > 1.0 and at > s and abs(lateral) < _BESIDE + (length + width) / 2:
            leader_gap = min(leader_gap, _ahead(way.route, s, _body(row), at, lateral))
        nearing, reach = -(dx * dvx + dy * dvy), circles + _RESERVE
        if nearing > 0.0:
            time = min(nearing / max(dvx * dvx + dvy * dvy, 1e-6), TTC_CAP)
            dx, dy = dx + time * dvx, dy + time * dvy
        if dx * dx + dy * dy <= reach * reach:
            ttc = min(ttc, _time_to_collision(ego, _body(row), dvx, dvy))
    return {"gap": _least_gap(ego, apart), "ttc": ttc, "leader_gap": leader_gap, "speed": speed}


def _least_gap(ego: _Box, apart: list[tuple[float, tuple[float, ...]]]) -> float:
    """The least gap; bodies come in the order of their lower bounds, so that most are skipped."""
    apart.sort()
    gap = GAP_CAP
    for bound, row in apart:
        if bound - _RESERVE >= gap:
            break
        body = _body(row)
        if bound <= _RESERVE and _touch(ego, body):
            return 0.0
        gap = min(gap, math.sqrt(min(_corner_to_box(ego, body), _corner_to_box(body, ego))))
    return gap


@lru_cache(maxsize=1024)  # bodies have few sizes
def _circles(length: float, width: float) -> float:
    """Radii of the circles around the ego and around a body, together."""
    return _EGO_CIRCLE + math.hypot(length, width) / 2


def _body(row: tuple[float, ...]) -> _Box:
    x, y, heading, _, _, length, width = row
    return _box(x, y, heading, length, width)


def _box(x: float, y: float, heading: float, length: float, width: float) -> _Box:
    return _Box(x, y, math.cos(heading), math.sin(heading), length / 2, width / 2)


def _ahead(route: Route, s: float, body: _Box, at: float, lateral: float) -> float:
    """Metres between bumpers if the body is a leader of an ego at ``s``, else the cap."""
    path = route.heading_at(at)
    c, sn = math.cos(path), math.sin(path)
    along, across = body.c * c + body.s * sn, abs(body.s * c - body.c * sn)
    half_width = CAR_WIDTH / 2 + body.width * abs(along) + body.length * across
    if along <= SAME_DIRECTION or abs(lateral) >= half_width:
        return LEADER_CAP
    distance = at - s - CAR_LENGTH / 2 - body.length * abs(along) - body.width * across
    return max(distance, 0.0)


def _projections(a: _Box, b: _Box) -> list[tuple[float, float, float, float]]:
    """For the four face normals: x and y of it, offset of the centres and reach of the boxes."""
    dx, dy = b.x - a.x, b.y - a.y
    c, s = abs(a.c * b.c + a.s * b.s), abs(a.c * b.s - a.s * b.c)
    return [
        (a.c, a.s, a.c * dx + a.s * dy, a.length + b.length * c + b.width * s),
        (-a.s, a.c, a.c * dy - a.s * dx, a.width + b.length * s + b.width * c),
        (b.c, b.s, b.c * dx + b.s * dy, b.length + a.length * c + a.width * s),
        (-b.s, b.c, b.c * dy - b.s * dx, b.width + a.length * s + a.width * c),
    ]


def _touch(a: _Box, b: _Box) -> bool:
    """``bodies.boxes_overlap`` of one pair."""
    return all(abs(offset) <= reach for _, _, offset, reach in _projections(a, b))


def _corner_to_box(a: _Box, b: _Box) -> float:
    """Least squared distance from a corner of ``a`` to the box ``b``."""
    x, y, a_c, a_s, half_length, half_width = a
    b_x, b_y, b_c, b_s, b_length, b_width = b
    dx, dy = x - b_x, y - b_y
    u, v = b_c * dx + b_s * dy, b_c * dy - b_s * dx
    c, s = a_c * b_c + a_s * b_s, a_s * b_c - a_c * b_s
    least = math.inf
    for length in (half_length, -half_length):
        for width in (half_width, -half_width):
            along = abs(u + length * c - width * s) - b_length
            across = abs(v + length * s + width * c) - b_width
            squared = along * along if along > 0.0 else 0.0
            if across > 0.0:
                squared += across * across
            if squared < least:  # noqa: PLR1730 - a call to min would cost as much again
                least = squared
    return least


def _time_to_collision(a: _Box, b: _Box, vx: float, vy: float) -> float:
    """``bodies.box_time_to_collision`` of a pair; velocity is of ``b`` against ``a``."""
    begin, end = -math.inf, math.inf
    for x, y, offset, reach in _projections(a, b):
        closing = x * vx + y * vy
        if abs(closing) <= _PARALLEL:
            if abs(offset) > reach:
                return TTC_CAP
            continue
        first, second = (-reach - offset) / closing, (reach - offset) / closing
        begin, end = max(begin, min(first, second)), min(end, max(first, second))
    if begin > end or end < 0.0:
        return TTC_CAP
    return min(max(begin, 0.0), TTC_CAP)


Floats = NDArray[np.float64]

NAMES = (
    "gap", "ttc", "leader_gap", "following_margin", "priority_arrival", "priority_braking",
    "gap_time", "speed", "acceleration", "jerk", "lateral_acceleration", "lateral_jerk",
    "progress", "in_conflict_zone", "collided", "struck", "struck_standing", "cleared",
    "command_error", "background_crashes", "time_headway", "drac", "required_deceleration", "pet",
    "near_misses",
)  # fmt: skip
"""The ground-truth signals."""

HINDSIGHT = frozenset({"priority_braking", "gap_time", "pet"})
"""Signals that are known once the ego, or who comes after it, has left the conflict; until then it
counts as never."""

PERCEPT_NAMES = ("gap", "ttc", "leader_gap", "speed")
"""The signals of percepts; an episode stores them as ``percept.gap`` and so on."""


def truth_signals(ticks: Sequence[Tick], route: Route, dt: float) -> dict[str, Floats]:
    """Ground-truth signals of an ego on a route, each of shape ``(len(ticks),)``."""
    ego = np.array([tick.truth["ego"] for tick in ticks], dtype=float)
    x, y, heading, speed, acceleration, commanded, yaw_rate, s, _ = ego.T
    contact = np.array([tick.truth["contact"] for tick in ticks], dtype=float)
    bodies = [tick.truth["bodies"] for tick in ticks]
    gap, ttc = proximity(_moving(x, y, heading, speed), bodies)
    leader = find_leaders(route, s, bodies)
    routes = [tick.truth["routes"] for tick in ticks]
    priority = right_of_way(route, s, speed, bodies, routes, dt=dt)
    lateral = speed * yaw_rate
    met = Encounters(_moving(x, y, heading, speed), bodies, dt)
    collided = (contact > 0).astype(float)
    half = CAR_LENGTH / 2
    return {
        "gap": np.where(collided, 0.0, gap),
        "ttc": np.where(collided, 0.0, ttc),
        "leader_gap": leader.gap,
        "following_margin": following_margin(leader, speed, collided, dt),
        "priority_arrival": priority.arrival,
        "priority_braking": priority.braking,
        "gap_time": priority.gap_time,
        "speed": speed,
        "acceleration": acceleration,
        "jerk": np.diff(acceleration, prepend=acceleration[:1]) / dt,
        "lateral_acceleration": lateral,
        "lateral_jerk": np.diff(lateral, prepend=lateral[:1]) / dt,
        "progress": s - s[0],
        "in_conflict_zone": ((s + half > route.stop_line) & (s - half < route.exit)).astype(float),
        "collided": collided,
        "struck": (contact >= 2).astype(float),
        "struck_standing": (contact == 3).astype(float),
        "cleared": np.maximum.accumulate((s - half >= route.exit).astype(float)),
        "command_error": np.abs(acceleration - commanded),
        "background_crashes": np.array([t.truth["background_crashes"] for t in ticks], float),
        **criticality(met, leader.gap, leader.speed),
    }


def encounters(ticks: Sequence[Tick], dt: float) -> Encounters:
    """The ego and the objects around it at some ticks."""
    rows = [tick.truth["ego"] for tick in ticks]
    x, y, heading, speed = np.array([each[:4] for each in rows], dtype=float).T
    return Encounters(_moving(x, y, heading, speed), [tick.truth["bodies"] for tick in ticks], dt)


def percept_signals(percepts: Sequence[Percept]) -> dict[str, Floats]:
    """The signals :data:`PERCEPT_NAMES`, each of shape ``(len(percepts),)``.

    Where a percept has implausible values (``percepts.implausible_values``), the distances and the
    time to collision are 0.
    """
    poses = np.array([own_pose(percept) for percept in percepts], dtype=float)
    speed = np.array([own_speed(percept) for percept in percepts], dtype=float)
    bodies, unknown = all_objects(percepts)
    x, y, heading = poses.T
    gap, ttc = proximity(_moving(x, y, heading, speed), bodies)
    route = percepts[0]["map"].route
    s, _, _ = route.project_all(poses[:, :2])
    leader_gap = find_leaders(route, s, bodies).gap
    for column in (gap, ttc, leader_gap):
        column[unknown] = 0.0
    return {"gap": gap, "ttc": ttc, "leader_gap": leader_gap, "speed": speed}


def _moving(x: Floats, y: Floats, heading: Floats, speed: Floats) -> Floats:
    """``x, y, heading, vx, vy`` of an ego that moves along its heading."""
    return np.stack([x, y, heading, speed * np.cos(heading), speed * np.sin(heading)], axis=1)
