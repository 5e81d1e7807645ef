"""Whether the ego gave way: what its entry into the junction demanded of cars with priority.

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

from pytest_dura.driving.bodies import CAR_LENGTH, VX, VY, BodyList
from pytest_dura.driving.following import RESPONSE
from pytest_dura.driving.junction import ARM_LENGTH, SPEED_LIMIT, Route, all_routes, conflict
from pytest_dura.driving.maneuvers import COMFORT_BRAKING, MAX_BRAKING

Floats = NDArray[np.float64]

CAP = 10.0
"""s; later arrivals do not matter, and nobody with priority counts as this late."""
BRAKING_CAP = 10.0
"""m/s2; more braking than any car has is asked of who cannot stop any more."""
REACTION = 0.4
"""s after the ego's entry at which the other begins to brake."""
HEADWAY = 1.0
"""s that the other is to keep behind the ego; conflicts of less count as serious (Allen, Shin and
Cooper, "Analysis of Traffic Conflicts and Collisions", 1978)."""
DECISION = SPEED_LIMIT * RESPONSE + SPEED_LIMIT**2 / (2 * COMFORT_BRAKING)
"""m before its stop line at which an ego that means to stop there begins to brake."""
_HALF = CAR_LENGTH / 2
_WAITING = 0.5
"""m/s; slower cars stand, for whatever reason, and are not on their way."""

NOT_A_CAR = -1
"""Route number of what has no route."""


class RightOfWay(NamedTuple):
    """Right of way at each tick, shape ``(ticks,)`` each.

    ``arrival`` is the seconds until the next car with priority would reach the conflict at constant
    speed, while the ego has to decide (from ``DECISION`` metres before its stop line on) or is in
    its way. ``braking`` (m/s2) and ``gap_time`` (s) are the worst of all cars with priority that
    reach the conflict after the ego, from the tick at which the ego crosses the line until it has
    left the conflict.
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
    """What the ego owed to cars with priority, and what its entry demanded of them.

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
    found = RightOfWay(np.full(len(s), CAP), np.zeros(len(s)), np.full(len(s), CAP))
    data = np.concatenate([at_tick.data for at_tick in bodies])
    counts = [len(at_tick) for at_tick in bodies]
    numbers = np.fromiter(chain.from_iterable(routes), int, len(data))
    owner = np.repeat(np.arange(len(s)), counts)
    names = list(chain.from_iterable(at_tick.ids for at_tick in bodies))
    for other in all_routes():
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
        concerned = (s + _HALF > ARM_LENGTH - DECISION) & (s - _HALF <= ends)
        time, at = distance[coming] / speeds[coming], owner[rows[coming]]
        np.minimum.at(found.arrival, at, np.where(concerned[at], np.minimum(time, CAP), CAP))
        cars = _Cars(owner[rows], [names[row] for row in rows.tolist()], distance, speeds)
        stay = _stay(s, speed, begins, ends)
        if stay is not None:
            _demand(found, stay, cars, dt)
    return found


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


def _stay(s: Floats, speed: Floats, begins: float, ends: float) -> _Stay | None:
    inside = np.flatnonzero((s + _HALF >= begins) & (s - _HALF <= ends))
    if not len(inside):
        return None
    enters, last = int(inside[0]), int(inside[-1])
    line = int(np.argmax(s + _HALF > ARM_LENGTH))
    stops = s + _HALF + speed**2 / (2 * MAX_BRAKING) <= begins
    decides = int(np.flatnonzero(stops[: enters + 1]).max(initial=line))
    return _Stay(line, max(line, decides), enters, last + 1 if last + 1 < len(s) else None)


def _demand(found: RightOfWay, stay: _Stay, cars: _Cars, dt: float) -> None:
    """Add what the ego's entry into one conflict demanded of the cars that came after it."""
    after = {name for name, (distance, _) in cars.at(stay.enters).items() if distance > 0.0}
    during = slice(stay.line, stay.leaves)
    for tick in (stay.line, stay.decides):
        left = math.inf if stay.leaves is None else (stay.leaves - tick) * dt
        for name, (distance, speed) in cars.at(tick).items():
            if name in after and speed > _WAITING:
                time = max(min(distance / speed - left, CAP), -CAP)
                demanded = demanded_braking(distance, speed, left)
                found.braking[during] = np.maximum(found.braking[during], demanded)
                found.gap_time[during] = np.minimum(found.gap_time[during], time)


def demanded_braking(distance: float, speed: float, left: float) -> float:
    """Least constant braking in m/s2 that brings a car no sooner to the conflict than it may.

    Args:
        distance: Metres from its front to the conflict.
        speed: Its speed in m/s.
        left: Seconds until the ego has left the conflict; infinite if it never does.
    """
    room, time = distance - speed * REACTION, left + HEADWAY - REACTION
    if speed * time <= room:
        return 0.0
    if room <= 0.0:
        return BRAKING_CAP
    stopping = speed * speed / (2.0 * room)
    if speed * time >= 2.0 * room:
        return min(stopping, BRAKING_CAP)
    return min(2.0 * (speed * time - room) / (time * time), BRAKING_CAP)
