"""Routes across a road: places as arc lengths, and where two routes conflict."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.percepts import sealed
from pytest_dura.driving.roads import Arm, Curve, Road, Turn

Floats = NDArray[np.float64]

_SPACING = 0.5
_CONFLICT_WIDTH = 3.0
"""Centre lines nearer than this conflict: a car's width and half a metre on each side."""
_BEYOND = 5.0
"""m behind the junction in which two routes to one arm still conflict."""
_CROSSING = 0.9
"""Sine of the least angle at which a road crosses another; at a smaller one it joins it."""
_OTHER_ROAD = 0.5
"""Sine of the least angle between two roads that are not one and the same."""


class Crossing(NamedTuple):
    """An arm that crosses the ego's lane, prolonged straight on, and goes first.

    Args:
        arm: Where the others come from.
        x: Where the middle of the arm, prolonged, meets the ego's lane.
        y: The same southwards.
        foot: The point of the ego's lane that is nearest to the centre, x and y.
        at: ``s`` of the foot.
        sine: Of the angle from the ego's course to theirs; positive if they come from the left.
        cosine: Of the same angle.
    """

    arm: Arm
    x: float
    y: float
    foot: tuple[float, float]
    at: float
    sine: float
    cosine: float


class Route:
    """A route from one arm to another; made by :func:`route_between`.

    ``s`` is metres along it, 0 where the arm begins; ``stop_line`` is the ``s`` of the stop line.

    Args:
        road: Whose arms these are.
        origin: Number of the arm on which it comes.
        destination: Number of the arm on which it leaves.

    ``arm`` and ``leaves`` are these two arms, ``curve`` is the way between their stop lines.
    """

    def __init__(self, road: Road, origin: int, destination: int) -> None:
        self.road, self.origin, self.destination = road, origin, destination
        self.arm, self.leaves = road.arms[origin], road.arms[destination]
        self.curve: Curve = road.curve(origin, destination)
        self._sign = math.copysign(1.0, self.curve.turned)
        self._first = self.stop_line + self.curve.lead
        self._last = self._first + self.curve.length

    def __reduce__(self) -> tuple[Callable[[Road, int, int], Route], tuple[Road, int, int]]:
        """Copies are the same object: cars on one route are recognised by identity."""
        return route_between, (self.road, self.origin, self.destination)

    def __repr__(self) -> str:
        return f"Route({self.road.name}, {self.arm.name}, {self.leaves.name})"

    @cached_property
    def turn(self) -> Turn:
        """What a driver calls it."""
        return self.road.turn(self.origin, self.destination)

    @cached_property
    def stop_line(self) -> float:
        """``s`` of the stop line."""
        return self.arm.length

    @cached_property
    def inside(self) -> float:
        """Metres from stop line to exit."""
        return self.curve.lead + self.curve.length + self.curve.tail

    @cached_property
    def exit(self) -> float:
        """``s`` at which it has crossed the junction."""
        return self.stop_line + self.inside

    @cached_property
    def length(self) -> float:
        """Metres from beginning to end."""
        return self.exit + self.leaves.length

    @cached_property
    def priority(self) -> int:
        """Right of way: the greater goes first."""
        return self.road.priority(self.origin, self.destination)

    @cached_property
    def number(self) -> int:
        """Its place in ``routes_of(road)``."""
        before = sum(len(self.road.destinations(origin)) for origin in range(self.origin))
        return before + self.road.destinations(self.origin).index(self.destination)

    @cached_property
    def grid(self) -> Floats:
        """Sampled ``s, x, y, heading`` every half metre, shape ``(n, 4)``."""
        curve, stop_line = self.curve, self.arm.stop_line
        s = np.append(np.arange(0.0, self.length, _SPACING), self.length)
        t = np.clip((s - self._first) / curve.length, 0.0, 1.0)
        before, after = np.minimum(s, self._first), np.maximum(s - self._last, 0.0)
        # In the frame of the south arm: driving up (towards -y) right of the middle, then turning.
        angle = curve.turned * t
        if not curve.turned:
            dx, dy = np.zeros_like(t), -curve.length * t
        else:
            dx = np.sign(angle) * curve.radius * (1 - np.cos(angle))
            dy = -curve.radius * np.abs(np.sin(angle))
        heading = -math.pi / 2 + angle
        x = self.arm.offset + dx + after * np.cos(heading)
        y = stop_line + self.stop_line - before + dy + after * np.sin(heading)
        turn = self.arm.angle
        c, sn = math.cos(turn), math.sin(turn)
        grid: Floats = np.stack([s, c * x - sn * y, sn * x + c * y, heading + turn], axis=1)
        return sealed(grid)

    def pose(self, s: Floats | float) -> tuple[Floats, Floats, Floats]:
        """The x, y and heading at ``s``, of any shape."""
        along, *columns = self.grid.T
        x, y, heading = (np.asarray(np.interp(s, along, column)) for column in columns)
        return x, y, heading

    def points(self, s: Floats) -> Floats:
        """The x and y at ``s``, of shape ``(*s.shape, 2)``; quicker than ``pose``."""
        scaled = np.minimum(np.maximum(s * (1.0 / _SPACING), 0.0), len(self.grid) - 2.0)
        index = scaled.astype(np.intp)
        start, step = self._segments
        points: Floats = start[index] + (scaled - index)[..., None] * step[index]
        return points

    @cached_property
    def _segments(self) -> tuple[Floats, Floats]:
        start = np.ascontiguousarray(self.grid[:, 1:3])
        step = np.diff(start, axis=0, append=start[-1:])
        return sealed(start), sealed(step)

    def project(self, x: float, y: float) -> tuple[float, float]:
        """``s`` of the nearest point and the signed lateral offset (right of it positive)."""
        c, sn, begins, offset, arc = self._frame
        u, v = c * x - sn * y, sn * x + c * y
        if arc is None or (v >= arc.v and not arc.sharp):
            return begins - v, u - offset
        end_u, end_v, ex, ey = arc.end_u, arc.end_v, arc.ex, arc.ey
        past, beside = (u - end_u) * ex + (v - end_v) * ey, (v - end_v) * ex - (u - end_u) * ey
        if v >= arc.v and (past < 0.0 or abs(u - offset) <= abs(beside)):
            return begins - v, u - offset
        if past >= 0.0:
            return self._last + past, beside
        sign, radius = self._sign, self.curve.radius
        angle = math.atan2(arc.v - v, (arc.u - u) * sign)
        distance = math.hypot(u - arc.u, v - arc.v)
        return self._first + radius * min(angle, arc.turned), (radius - distance) * sign

    @cached_property
    def _frame(self) -> tuple[float, float, float, float, _Arc | None]:
        """Turn to its arm's frame (cosine, sine); metres to the centre; lane's middle; the arc."""
        arm, curve = self.arm, self.curve
        turn = -arm.angle
        frame = math.cos(turn), math.sin(turn), arm.length + arm.stop_line, arm.offset
        if not curve.turned:
            return (*frame, None)
        ex, ey = self._leaving
        u, v = arm.offset + self._sign * curve.radius, arm.stop_line - curve.lead
        end_u = u + self._sign * curve.radius * ey
        end_v = v - self._sign * curve.radius * ex
        turned = abs(curve.turned)
        sharp = turned > math.pi / 2 + 1e-9
        return (*frame, _Arc(u, v, end_u, end_v, ex, ey, turned, sharp))

    @cached_property
    def _leaving(self) -> tuple[float, float]:
        """Unit vector along which it leaves, in the frame of the southern arm."""
        turned = self.curve.turned
        ex, ey = math.sin(turned), -math.cos(turned)
        nearest = round(ex), round(ey)
        exact = abs(ex - nearest[0]) + abs(ey - nearest[1]) < 1e-12
        return (float(nearest[0]), float(nearest[1])) if exact else (ex, ey)

    def point(self, s: float) -> tuple[float, float]:
        """The x and y at a single ``s``, as ``points`` has them, in plain arithmetic."""
        last = len(self._corners) - 2
        scaled = min(max(s * (1.0 / _SPACING), 0.0), float(last))
        index = int(scaled)
        share = scaled - index
        x, y, dx, dy = self._corners[index]
        return x + share * dx, y + share * dy

    def trail(self, ways: Sequence[float]) -> list[tuple[float, float]]:
        """``point`` of several ``s``, without a call for each."""
        corners, points = self._corners, []
        last = len(corners) - 2.0
        for s in ways:
            scaled = s * (1.0 / _SPACING)
            if scaled < 0.0:
                scaled = 0.0
            elif scaled > last:
                scaled = last
            index = int(scaled)
            share = scaled - index
            x, y, dx, dy = corners[index]
            points.append((x + share * dx, y + share * dy))
        return points

    @cached_property
    def _corners(self) -> tuple[tuple[float, ...], ...]:
        start, step = self._segments
        return tuple((*a, *b) for a, b in zip(start.tolist(), step.tolist(), strict=True))

    def heading_at(self, s: float) -> float:
        """The heading of ``pose(s)``, exact and quicker."""
        share = min(max((s - self._first) / self.curve.length, 0.0), 1.0)
        return self._begins + self.curve.turned * share

    def sampled_heading(self, s: float) -> float:
        """The heading of ``pose(s)``, to the last bit, in plain arithmetic."""
        along, headings = self._samples
        if s <= along[0] or s >= along[-1]:
            return headings[0] if s <= along[0] else headings[-1]
        before = bisect_right(along, s) - 1
        first, second = headings[before], headings[before + 1]
        slope = (second - first) / (along[before + 1] - along[before])
        return slope * (s - along[before]) + first

    @cached_property
    def _samples(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        return tuple(self.grid[:, 0].tolist()), tuple(self.grid[:, 3].tolist())

    @cached_property
    def _begins(self) -> float:
        """The heading at its beginning, in rad."""
        return self.arm.angle - math.pi / 2

    def project_all(self, points: Floats) -> tuple[Floats, Floats, Floats]:
        """``project`` of many points, shape ``(n, 2)``, and the route's heading beside each."""
        _, _, begins, offset, arc = self._frame
        turn = self.arm.angle
        c, sn = math.cos(turn), math.sin(turn)
        u, v = c * points[:, 0] + sn * points[:, 1], c * points[:, 1] - sn * points[:, 0]
        s, lateral = begins - v, u - offset
        if arc is None:
            return s, lateral, np.full(len(points), turn - math.pi / 2)
        sign, radius = self._sign, self.curve.radius
        past = (u - arc.end_u) * arc.ex + (v - arc.end_v) * arc.ey
        after = (v - arc.end_v) * arc.ex - (u - arc.end_u) * arc.ey
        behind = v < arc.v
        if arc.sharp:
            behind |= (past >= 0.0) & (np.abs(after) < np.abs(lateral))
        turning, leaving = behind & (past < 0.0), behind & (past >= 0.0)
        angle = np.minimum(np.arctan2(arc.v - v, (arc.u - u) * sign), arc.turned)
        s = np.where(turning, self._first + radius * angle, np.where(leaving, self._last + past, s))
        beside = (radius - np.hypot(u - arc.u, v - arc.v)) * sign
        lateral = np.where(turning, beside, np.where(leaving, after, lateral))
        turned = sign * np.where(turning, angle, np.where(leaving, arc.turned, 0.0))
        return s, lateral, turned + (turn - math.pi / 2)


class _Arc(NamedTuple):
    """The arc of a route in its arm's frame: centre, end, unit vector at its end, and angle.

    ``sharp`` is one of more than a quarter, after which the route comes back beside its beginning.
    """

    u: float
    v: float
    end_u: float
    end_v: float
    ex: float
    ey: float
    turned: float
    sharp: bool


@cache
def route_between(road: Road, origin: int, destination: int) -> Route:
    """The Route object from one arm to another, the same at each call.

    The cache is part of its meaning: cars on one route are recognised by identity.
    """
    made = Route(road, origin, destination)
    # It is part of percepts, which must not change: all that it caches is computed beforehand.
    for thing in (made, road, *road.arms):
        for name, member in vars(type(thing)).items():
            if isinstance(member, cached_property):
                getattr(thing, name)
    return made


def route_by_turn(road: Road, origin: int, turn: str) -> Route:
    """The route from an arm by a turn.

    Raises:
        ConfigurationError: If the turn leaves the road, or leads to more than one arm.
    """
    return route_between(road, origin, road.destination(origin, turn))


@cache
def routes_of(road: Road) -> tuple[Route, ...]:
    """All routes of a road, by arm, from the left to the right."""
    return tuple(
        route_between(road, origin, destination)
        for origin in range(len(road.arms))
        for destination in road.destinations(origin)
    )


@cache
def conflict(a: Route, b: Route) -> tuple[float, float, float, float] | None:
    """Conflict of routes from different arms: ``s`` from and to on ``a``, then on ``b``."""
    if a.origin == b.origin:
        return None
    grid_a, grid_b = a.grid, b.grid
    # Behind the junction two routes to one arm are the same lane: that is following, not conflict.
    part_a = grid_a[(grid_a[:, 0] >= a.stop_line) & (grid_a[:, 0] <= a.exit + _BEYOND)]
    part_b = grid_b[(grid_b[:, 0] >= b.stop_line) & (grid_b[:, 0] <= b.exit + _BEYOND)]
    distance = np.hypot(*(part_a[:, None, 1:3] - part_b[None, :, 1:3]).transpose(2, 0, 1))
    near_a, near_b = np.nonzero(distance < _CONFLICT_WIDTH)
    if not len(near_a):
        return None
    s_a, s_b = part_a[near_a, 0], part_b[near_b, 0]
    return float(s_a.min()), float(s_a.max()), float(s_b.min()), float(s_b.max())


@cache
def crossings(route: Route) -> tuple[Crossing, ...]:
    """The arms with priority whose road crosses a route's lane, prolonged straight on."""
    own, crossed = route.arm, []
    course = own.inward
    foot = own.offset * own.right[0], own.offset * own.right[1]
    for arm in (route.road.arms[number] for number in _others(route)):
        dx, dy = arm.inward
        sine, cosine = course[0] * dy - course[1] * dx, course[0] * dx + course[1] * dy
        if arm.priority > own.priority and abs(sine) >= _CROSSING:
            # So many metres beyond the foot, its own lane meets the middle of the arm.
            beyond = (foot[1] * dx - foot[0] * dy) / sine
            x, y = foot[0] + beyond * course[0], foot[1] + beyond * course[1]
            at = route.stop_line + own.stop_line
            crossed.append(Crossing(arm, x, y, foot, at, sine, cosine))
    return tuple(crossed)


@cache
def joined(route: Route) -> tuple[tuple[Route, tuple[float, float, float, float]], ...]:
    """Routes with right of way that come against a route, or join it at a small angle.

    Each with the :func:`conflict` between the two; for each arm, the one that turns least.
    """
    road, crossing = route.road, {crossing.arm.name for crossing in crossings(route)}
    joining = []
    for number in _others(route):
        if road.names[number] in crossing:
            continue
        ways = sorted(road.destinations(number), key=lambda way: abs(road.turned(number, way)))
        for way in (route_between(road, number, destination) for destination in ways):
            meeting = conflict(route, way)
            if meeting is not None and way.priority > route.priority:
                joining.append((way, meeting))
                break
    return tuple(joining)


@cache
def other_roads(route: Route) -> tuple[Arm, ...]:
    """The arms that are not of a route's own road, straight on."""
    x, y = route.arm.inward
    arms = (route.road.arms[number] for number in _others(route))
    return tuple(arm for arm in arms if abs(x * arm.inward[1] - y * arm.inward[0]) >= _OTHER_ROAD)


def _others(route: Route) -> list[int]:
    """The arms from which other traffic can come."""
    return [
        number
        for number in range(len(route.road.arms))
        if number != route.origin and route.road.destinations(number)
    ]
