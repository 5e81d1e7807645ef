"""Traffic rules measured: the leader and the safe distance to it, and whether the ego gave way.

The safe distance is the longitudinal one of Responsibility-Sensitive Safety (Shalev-Shwartz,
Shammah and Shashua, "On a Formal Model of Safe and Scalable Self-driving Cars", 2017, lemma 2).
That a car which cuts in leaves the ego some time to restore it is rule R_G1 of Maierhofer,
Rettinger, Mayer and Althoff, "Formalization of Interstate Traffic Rules in Temporal Logic" (2020).

To give way is not to compel drivers with priority to change their speed abruptly (Vienna Convention
on Road Traffic, article 1). Two measures say whether the ego did: the braking that its entry
demands of them, as UN Regulation 79 judges a lane change (paragraph 5.6.4.7: critical if the
approaching vehicle must decelerate by more than 3 m/s2, 0.4 s after its start), and the gap time
(Gettman and Head, "Surrogate Safety Measures from Traffic Simulation Models", 2003): when the other
would arrive at constant speed, counted from when the ego has left the point of conflict.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import chain
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pytest_dura.driving.bodies import (
    CAR_LENGTH,
    CAR_WIDTH,
    HEADING,
    LENGTH,
    VX,
    VY,
    WIDTH,
    BodyList,
)
from pytest_dura.driving.lanes import Route, conflict, routes_of
from pytest_dura.driving.maneuvers import COMFORT_BRAKING, MAX_ACCELERATION, MAX_BRAKING

Floats = NDArray[np.float64]

LEADER_CAP = 50.0
"""m; farther leaders do not matter at these speeds, and an empty lane counts as this far."""
_RESPONSE = 0.5
"""s from a leader's braking to the ego's: a tick to sense, a tick to act, a fifth of a second to
build the brake up, and a tenth in reserve."""
_SURE_BRAKING = 6.43
"""m/s2 that the ego is sure to brake with: what UN Regulation 13-H asks of every passenger car."""
_LEADER_BRAKING = MAX_BRAKING
"""m/s2 that a leader may brake with: all that a dry road gives."""
CUT_IN_GRACE = 4.0
"""s to restore the distance to a car that cut in: response, and a stop from the speed limit of
10 m/s at a comfortable 3 m/s2, rounded up."""
SAME_DIRECTION = math.cos(math.pi / 4)
"""Cosine of the angle to the path up to which a body drives along it; others cross or meet it."""


class Leaders(NamedTuple):
    """The nearest car ahead at each tick, shape ``(ticks,)``.

    Metres between bumpers along the path, at most ``LEADER_CAP``; speed along the path in m/s; id,
    empty where there is none.
    """

    gap: Floats
    speed: Floats
    ids: list[str]


def find_leaders(route: Route, s: Floats, bodies: Sequence[BodyList]) -> Leaders:
    """The leaders of an ego at ``s`` of its route, shape ``(ticks,)``, among the bodies of a tick.

    A leader is a car whose footprint reaches into the ego's path ahead and that points along it.
    """
    gap, speed, ids = np.full(len(s), LEADER_CAP), np.zeros(len(s)), [""] * len(s)
    counts = np.array([len(at_tick.ids) for at_tick in bodies])
    if not counts.sum():
        return Leaders(gap, speed, ids)
    others = np.concatenate([at_tick.data for at_tick in bodies])
    owner = np.repeat(np.arange(len(s)), counts)
    at, lateral, path = route.project_all(others[:, :2])
    turned = others[:, HEADING] - path
    c, sn = np.cos(turned), np.abs(np.sin(turned))
    half_length, half_width = others[:, LENGTH] / 2, others[:, WIDTH] / 2
    across = CAR_WIDTH / 2 + half_width * np.abs(c) + half_length * sn
    distance = at - s[owner] - CAR_LENGTH / 2 - half_length * np.abs(c) - half_width * sn
    rows = np.flatnonzero(
        (at > s[owner])
        & (np.abs(lateral) < across)
        & (c > SAME_DIRECTION)
        & (half_length > 0.5)
        & (distance < LEADER_CAP)
    )
    rows = rows[np.lexsort((distance[rows], owner[rows]))]
    ticks, first = np.unique(owner[rows], return_index=True)
    rows = rows[first]
    gap[ticks] = np.maximum(distance[rows], 0.0)
    path, moving = path[rows], others[rows]
    speed[ticks] = moving[:, VX] * np.cos(path) + moving[:, VY] * np.sin(path)
    starts = np.concatenate([[0], np.cumsum(counts)])
    for tick, row in zip(ticks.tolist(), rows.tolist(), strict=True):
        ids[tick] = bodies[tick].ids[row - starts[tick]]
    return Leaders(gap, speed, ids)


def safe_distance(speed: Floats, leader_speed: Floats) -> Floats:
    """Metres that keep the ego off a leader who brakes as hard as it can.

    The ego accelerates as hard as it can for the response time and then brakes as surely as it can.
    """
    reached = speed + _RESPONSE * MAX_ACCELERATION
    ego = speed * _RESPONSE + MAX_ACCELERATION * _RESPONSE**2 / 2 + reached**2 / (2 * _SURE_BRAKING)
    leader = np.maximum(leader_speed, 0.0) ** 2 / (2 * _LEADER_BRAKING)
    return np.maximum(ego - leader, 0.0)


def following_margin(leaders: Leaders, speed: Floats, collided: Floats, dt: float) -> Floats:
    """Metres by which the ego is farther from its leader than the safe distance.

    ``LEADER_CAP`` without a leader. Of a car that is nearer than that when it first becomes the
    leader, the ego is not to blame: until the distance is safe for the first time, or
    ``CUT_IN_GRACE`` is over, the margin is not below 0. Contact is excused by nothing.
    """
    has_leader = leaders.gap < LEADER_CAP
    margin = np.where(has_leader, leaders.gap - safe_distance(speed, leaders.speed), LEADER_CAP)
    unsafe = has_leader & (margin < 0.0)
    grace, seen = round(CUT_IN_GRACE / dt), {""}
    for tick, leader in enumerate(leaders.ids):
        if leader in seen:
            continue
        seen.add(leader)
        end = tick
        while end < min(tick + grace, len(speed)) and unsafe[end] and leaders.ids[end] == leader:
            end += 1
        margin[tick:end] = np.where(collided[tick:end] > 0.5, margin[tick:end], 0.0)
    return np.minimum(margin, LEADER_CAP)


CAP = 10.0
"""s; later arrivals do not matter, and no arrival with priority counts as this late."""
BRAKING_CAP = 10.0
"""m/s2; more braking than any car has is asked of who cannot stop any more."""
_REACTION = 0.4
"""s after the ego's entry at which the other begins to brake."""
_HEADWAY = 1.0
"""s that the other is to keep behind the ego; conflicts of less count as serious (Allen, Shin and
Cooper, "Analysis of Traffic Conflicts and Collisions", 1978)."""
_HALF = CAR_LENGTH / 2
_WAITING = 0.5
"""m/s; slower cars stand, for whatever reason, and are not on their way."""

NOT_A_CAR = -1
"""Route number of a body without a route."""


def decision_distance(limit: float) -> float:
    """Metres before its stop line at which an ego that means to stop there begins to brake.

    Args:
        limit: Speed limit of the road, in m/s.
    """
    return limit * _RESPONSE + limit**2 / (2 * COMFORT_BRAKING)


class RightOfWay(NamedTuple):
    """Right of way at each tick, shape ``(ticks,)`` each.

    ``arrival`` is the seconds until the next car with priority would reach the conflict at constant
    speed, while the ego has to decide (from :func:`decision_distance` before its stop line on) or
    is in its way. ``braking`` (m/s2) and ``gap_time`` (s) are the worst of all cars with priority
    that reach the conflict after the ego, from the tick at which the ego crosses the line until it
    has left the conflict.
    """

    arrival: Floats
    braking: Floats
    gap_time: Floats


def right_of_way(
    route: Route,
    s: Floats,
    speed: Floats,
    bodies: Sequence[BodyList],
    routes: Sequence[tuple[int, ...]],
    *,
    dt: float,
) -> RightOfWay:
    """Arrival of cars with priority, and the braking and gap time that the ego's entry left them.

    Braking and gap time are taken when the ego crosses its stop line, at which the others see it
    coming, and when it could last have stopped before the conflict, if that is later.

    Args:
        route: The ego's.
        s: Where the ego is on it.
        speed: The ego's.
        bodies: The others at each tick.
        routes: The number of each one's route, or ``NOT_A_CAR``.
        dt: Seconds between two ticks.
    """
    way = RightOfWay(np.full(len(s), CAP), np.zeros(len(s)), np.full(len(s), CAP))
    data = np.concatenate([at_tick.data for at_tick in bodies])
    counts = [len(at_tick) for at_tick in bodies]
    numbers = np.fromiter(chain.from_iterable(routes), int, len(data))
    owner = np.repeat(np.arange(len(s)), counts)
    names = list(chain.from_iterable(at_tick.ids for at_tick in bodies))
    decides = route.stop_line - decision_distance(route.road.speed_limit)
    for other in routes_of(route.road):
        meeting = conflict(route, other) if other.priority > route.priority else None
        rows = np.flatnonzero(numbers == other.number)
        if meeting is None or not len(rows):
            continue
        begins, ends, other_begins, _ = meeting
        if other.destination == route.destination:
            ends = begins  # behind the point where the lanes merge it is following
        distance = other_begins - _HALF - other.project_all(data[rows, :2])[0]
        speeds = np.hypot(data[rows, VX], data[rows, VY])
        coming = np.flatnonzero((distance > 0.0) & (speeds > _WAITING))
        concerned = (s + _HALF > decides) & (s - _HALF <= ends)
        time, at = distance[coming] / speeds[coming], owner[rows[coming]]
        np.minimum.at(way.arrival, at, np.where(concerned[at], np.minimum(time, CAP), CAP))
        cars = _Cars(owner[rows], [names[row] for row in rows.tolist()], distance, speeds)
        stay = _stay(s, speed, route.stop_line, begins, ends)
        if stay is not None:
            _demand(way, stay, cars, dt)
    return way


class _Cars(NamedTuple):
    """The cars on one route, one row for each at each tick; distances are to the conflict."""

    owner: NDArray[np.intp]
    ids: list[str]
    distance: Floats
    speed: Floats

    def at(self, tick: int) -> dict[str, tuple[float, float]]:
        """Distance and speed of each car at a tick."""
        first, last = np.searchsorted(self.owner, (tick, tick + 1)).tolist()
        return {
            self.ids[row]: (float(self.distance[row]), float(self.speed[row]))
            for row in range(first, last)
        }


class _Stay(NamedTuple):
    """Ticks of the ego's way through a conflict; ``leaves`` is ``None`` if it never does.

    ``decides`` is when it could last have stopped before the conflict, not before ``line``.
    """

    line: int
    decides: int
    enters: int
    leaves: int | None


def _stay(s: Floats, speed: Floats, stop_line: float, begins: float, ends: float) -> _Stay | None:
    inside = np.flatnonzero((s + _HALF >= begins) & (s - _HALF <= ends))
    if not len(inside):
        return None
    enters, last = int(inside[0]), int(inside[-1])
    line = int(np.argmax(s + _HALF > stop_line))
    stops = s + _HALF + speed**2 / (2 * MAX_BRAKING) <= begins
    decides = int(np.flatnonzero(stops[: enters + 1]).max(initial=line))
    return _Stay(line, max(line, decides), enters, last + 1 if last + 1 < len(s) else None)


def _demand(way: RightOfWay, stay: _Stay, cars: _Cars, dt: float) -> None:
    """Add what the ego's entry into one conflict demanded of the cars that came after it."""
    after = {name for name, (distance, _) in cars.at(stay.enters).items() if distance > 0.0}
    during = slice(stay.line, stay.leaves)
    for tick in (stay.line, stay.decides):
        left = math.inf if stay.leaves is None else (stay.leaves - tick) * dt
        for name, (distance, speed) in cars.at(tick).items():
            if name in after and speed > _WAITING:
                time = max(min(distance / speed - left, CAP), -CAP)
                demanded = demanded_braking(distance, speed, left)
                way.braking[during] = np.maximum(way.braking[during], demanded)
                way.gap_time[during] = np.minimum(way.gap_time[during], time)


def demanded_braking(distance: float, speed: float, left: float) -> float:
    """Least constant braking in m/s2 that brings a car no sooner to the conflict than it may.

    Args:
        distance: Metres from its front to the conflict.
        speed: Its speed in m/s.
        left: Seconds until the ego has left the conflict; infinite if it never does.
    """
    room, time = distance - speed * _REACTION, left + _HEADWAY - _REACTION
    if speed * time <= room:
        return 0.0
    if room <= 0.0:
        return BRAKING_CAP
    stopping = speed * speed / (2.0 * room)
    if speed * time >= 2.0 * room:
        return min(stopping, BRAKING_CAP)
    return min(2.0 * (speed * time - room) / (time * time), BRAKING_CAP)
