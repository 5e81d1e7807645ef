"""Measures of criticality: how near the ego came to a collision, of a simulation or of a log.

All are functions of poses and velocities, vectorised over the ticks and over the objects:

- ``time_headway``: time until the ego's front is where its leader's rear is now, at the ego's speed
  (time gap of ISO 15622; Vogel, "A comparison of headway and time to collision as safety
  indicators", 2003).
- ``drac``: deceleration rate to avoid a crash with a leader that keeps its speed, (v - v_l)^2 / 2d
  (Cooper and Ferguson, "Traffic studies at T-junctions", 1976; Archer, "Indicators for traffic
  safety assessment and prediction", 2005, names 3.35 m/s2 as the limit).
- ``required_deceleration``: least constant braking with which the ego stays behind all that
  crosses, leads or nears its straight path, where the others keep their velocity (a_long,req of
  Westhofen and others, "Criticality Metrics for Automated Driving", 2023).
- ``pet``: post-encroachment time, from when the first of two has left a place until the other
  reaches it (Allen, Shin and Cooper, "Analysis of traffic conflicts and collisions", 1978).
- near misses: an object of which the time to collision falls below 1.5 s, without contact
  (van der Horst, "A time-based analysis of road user behaviour in normal and critical encounters",
  1990; Hayward, "Near miss determination through use of a scale of danger", 1972).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from pytest_dura.driving.bodies import (
    CAR_LENGTH,
    CAR_WIDTH,
    COLUMNS,
    HEADING,
    LENGTH,
    TTC_CAP,
    VX,
    VY,
    WIDTH,
    BodyList,
    X,
    Y,
    box_gap,
    box_time_to_collision,
    boxes_overlap,
)
from pytest_dura.driving.traffic_rules import LEADER_CAP, SAME_DIRECTION

Floats = NDArray[np.float64]
Size = tuple[float, float]

HEADWAY_CAP = 10.0
"""s; a longer headway does not matter, and no leader, or an ego that stands, counts as this one."""
DECELERATION_CAP = 10.0
"""m/s2; a car cannot brake harder, so that what needs more cannot be avoided by braking."""
PET_CAP = 5.0
"""s; what passes a place later than that does not matter."""
NEAR = 1.5
"""s of the time to collision below which an object is nearly hit."""
_ANEW = 1.0
"""s after a near miss, within which the same object is still that near miss."""
_LEAP = 5.0
"""m beyond its velocity that an object does not move from one tick to the next."""
_CREEPING = 0.1
"""m/s; who is slower stands."""
_BRAKED = 2.0 * TTC_CAP
"""s; braking to the speed of a leader takes twice the time to collision with it."""
_PARALLEL = 1e-9
_LAGS_AT_ONCE = 10
"""Ticks that one call of NumPy compares: a call costs as much as some hundred pairs."""
_BOX = [X, Y, HEADING, LENGTH, WIDTH]


@dataclass(frozen=True)
class NearMiss:
    """An object that was nearly hit.

    Args:
        body: Its id.
        first: Tick at which its time to collision fell below :data:`NEAR`.
        end: Tick at which it was above that again, or the object was gone.
        ttc: Least time to collision between these, in s.
        gap: Least distance between the footprints, in m.
    """

    body: str
    first: int
    end: int
    ttc: float
    gap: float


class Encounters:
    """An ego and the objects around it, tick by tick.

    Args:
        ego: ``x, y, heading, vx, vy`` at each tick, shape ``(ticks, 5)``.
        bodies: The objects at each tick.
        dt: Seconds per tick.
        size: Length and width of the ego, in m.
    """

    def __init__(
        self,
        ego: Floats,
        bodies: Sequence[BodyList],
        dt: float,
        size: Size = (CAR_LENGTH, CAR_WIDTH),
    ) -> None:
        self.ego, self.dt, self._size = ego, dt, size
        columns: dict[str, int] = {}
        places = [[columns.setdefault(name, len(columns)) for name in each.ids] for each in bodies]
        self.ids = tuple(columns)
        self._owner = np.repeat(np.arange(len(ego)), [len(each.ids) for each in bodies])
        self._column = np.array([place for row in places for place in row], dtype=np.int64)
        given = [each.data for each in bodies if each.ids]
        self._others: Floats = np.concatenate(given) if given else np.empty((0, COLUMNS))

    def required_deceleration(self) -> Floats:
        """Greatest braking that any object asks of the ego, at most :data:`DECELERATION_CAP`."""
        needed = np.zeros(len(self.ego))
        each = braking_to_stay_behind(self.ego[self._owner], self._others, self._size)
        np.maximum.at(needed, self._owner, each)
        return needed

    def pet(self) -> Floats:
        """Least post-encroachment time of the place where the ego is, at most :data:`PET_CAP`.

        It counts for objects whose course there crosses the ego's at more than 45 degrees, and is a
        whole number of ticks: 0 is contact.
        """
        ticks, count = len(self.ego), len(self.ids)
        pet = np.full((ticks, count), PET_CAP)
        if not count:
            return np.full(ticks, PET_CAP)
        dense = np.full((ticks, count, COLUMNS), np.nan)
        dense[self._owner, self._column] = self._others
        mine = self._boxes()
        circles = math.hypot(*self._size) / 2 + np.hypot(dense[..., LENGTH], dense[..., WIDTH]) / 2
        lags = min(int(PET_CAP / self.dt), ticks)
        # Places, and squared reaches of contact, from so many ticks before on; NaN where absent.
        padded = np.full((3, ticks + 2 * lags, count), np.nan)
        padded[:, lags : lags + ticks] = dense[..., X], dense[..., Y], circles * circles
        shifted = sliding_window_view(padded, ticks, axis=1)
        for first in range(0, lags, _LAGS_AT_ONCE):
            several = min(_LAGS_AT_ONCE, lags - first)
            not_met = (pet == PET_CAP).T
            for begin in (lags + first, lags - first - several + 1):
                x, y, reach = shifted[:, begin : begin + several]
                dx, dy = x - mine[:, 0], y - mine[:, 1]
                near = (dx * dx + dy * dy <= reach) & not_met
                shifts, places, rows = np.nonzero(near)
                if not len(rows):
                    continue
                shifts += begin - lags
                others, own = dense[rows + shifts, places], mine[rows]
                crossing = np.cos(others[:, HEADING] - own[:, 2]) < SAME_DIRECTION
                met = np.flatnonzero(crossing)
                met = met[boxes_overlap(own[met], others[met][:, _BOX])]
                later = np.abs(shifts[met]) * self.dt
                np.minimum.at(pet, (rows[met], places[met]), later)
        least: Floats = pet.min(axis=1)
        return least

    def near_misses(self) -> list[NearMiss]:
        """List the near misses in the order of their ends.

        An object that comes near again within a second is the same near miss; one that is touched
        meanwhile is a collision, and one that is still near at the end is neither yet. An id that
        was gone, or leapt farther than it moves, is another object from then on.
        """
        pairs, times = self._near_pairs()
        found: list[NearMiss] = []
        anew = _ANEW / self.dt - 1e-9
        for place in np.unique(self._column[pairs]).tolist():
            own = pairs[self._column[pairs] == place]
            ticks, ttc = self._owner[own], times[self._column[pairs] == place]
            changes = self._changes(place)
            changed = np.searchsorted(changes, ticks, "right")
            cuts = np.flatnonzero((np.diff(ticks) > 1) | (np.diff(changed) > 0)) + 1
            last, actor = -math.inf, -1
            for stretch in np.split(np.arange(len(ticks)), cuts):
                first, end = int(ticks[stretch[0]]), int(ticks[stretch[-1]]) + 1
                apart = first - last >= anew or int(changed[stretch[0]]) != actor
                last, actor = end, int(changed[stretch[0]])
                if end >= len(self.ego) or not apart:
                    continue
                rows = own[stretch]
                gaps = box_gap(self._boxes()[self._owner[rows]], self._others[rows][:, _BOX])
                if gaps.min() > 0.0:
                    least = float(ttc[stretch].min()), float(gaps.min())
                    found.append(NearMiss(self.ids[place], first, end, *least))
        return sorted(found, key=lambda each: (each.end, each.body))

    def _changes(self, place: int) -> NDArray[np.int64]:
        """Ticks from which on an id is another object than before."""
        own = np.flatnonzero(self._column == place)
        ticks, rows = self._owner[own], self._others[own]
        steps = np.diff(ticks)
        speeds = (rows[1:, VX : VY + 1] + rows[:-1, VX : VY + 1]) / 2
        moved = rows[1:, :2] - rows[:-1, :2] - speeds * self.dt
        leaps = np.hypot(moved[:, 0], moved[:, 1]) > _LEAP
        return ticks[1:][(steps > 1) | leaps]

    def _near_pairs(self) -> tuple[NDArray[np.int64], Floats]:
        """Rows of the pairs whose time to collision is below :data:`NEAR`, and these times."""
        mine, others = self.ego[self._owner], self._others
        offset, motion = others[:, :2] - mine[:, :2], others[:, VX : VY + 1] - mine[:, 3:5]
        circles = math.hypot(*self._size) / 2 + np.hypot(others[:, LENGTH], others[:, WIDTH]) / 2
        reach = circles + NEAR * np.hypot(motion[:, 0], motion[:, 1])
        rows = np.flatnonzero((offset * offset).sum(axis=1) <= reach * reach)
        mine, others = mine[rows], others[rows]
        times = box_time_to_collision(
            self._boxes()[self._owner[rows]], mine[:, 3:5],
            others[:, _BOX], others[:, VX : VY + 1], TTC_CAP,
        )  # fmt: skip
        return rows[times < NEAR], times[times < NEAR]

    def _boxes(self) -> Floats:
        boxes = np.empty((len(self.ego), 5))
        boxes[:, :3], boxes[:, 3:] = self.ego[:, :3], self._size
        return boxes


def braking_to_stay_behind(ego: Floats, others: Floats, size: Size) -> Floats:
    """Least constant braking with which an ego stays behind an object, for each pair, in m/s2.

    The ego brakes along its heading until it stands, the other keeps its velocity, both for twice
    ``TTC_CAP``; footprints are taken along and across the ego. It is 0 where they do not meet
    within ``TTC_CAP`` at constant velocity, or the other comes from behind, and at most
    :data:`DECELERATION_CAP`.

    Args:
        ego: ``x, y, heading, vx, vy``, shape ``(pairs, 5)``.
        others: Rows of :class:`BodyList`, shape ``(pairs, 7)``.
        size: Length and width of the ego, in m.
    """
    c, s = np.cos(ego[:, 2]), np.sin(ego[:, 2])
    dx, dy = others[:, X] - ego[:, 0], others[:, Y] - ego[:, 1]
    ahead, aside = c * dx + s * dy, c * dy - s * dx
    speed, drift = c * ego[:, 3] + s * ego[:, 4], c * ego[:, 4] - s * ego[:, 3]
    along = c * others[:, VX] + s * others[:, VY]
    across = c * others[:, VY] - s * others[:, VX] - drift
    turned = others[:, HEADING] - ego[:, 2]
    cosine, sine = np.abs(np.cos(turned)), np.abs(np.sin(turned))
    half = (others[:, LENGTH] * cosine + others[:, WIDTH] * sine + size[0]) / 2
    beside = (others[:, LENGTH] * sine + others[:, WIDTH] * cosine + size[1]) / 2
    begin, end = _interval(aside, across, beside)
    closing = speed - along
    meets, parts = _interval(-ahead, closing, half)
    begin, end = np.maximum(begin, 0.0), np.minimum(end, _BRAKED)
    hit = np.maximum(begin, meets) < np.minimum(np.minimum(end, TTC_CAP), parts)
    hit &= (speed > _CREEPING) & (ahead > 0.0)
    room = ahead - half
    with np.errstate(divide="ignore", invalid="ignore"):
        # Braking to the other's speed takes this long: then they are nearest to each other.
        nearest = np.where((closing > 0.0) & (room > 0.0), 2.0 * room / closing, 0.0)
        at = np.where(along < 0.0, end, np.minimum(np.maximum(nearest, begin), end))
        left = room + along * at
        stands = 2.0 * left <= speed * at
        needed = np.where(
            stands, speed * speed / (2.0 * left), 2.0 * (speed * at - left) / (at * at)
        )
    needed = np.where(left > 0.0, np.minimum(needed, DECELERATION_CAP), DECELERATION_CAP)
    return np.where(hit, np.maximum(needed, 0.0), 0.0)


def _interval(offset: Floats, rate: Floats, reach: Floats) -> tuple[Floats, Floats]:
    """From when to when ``offset + rate * t`` is within the reach; empty as ``(inf, -inf)``."""
    moving = np.abs(rate) > _PARALLEL
    divisor = np.where(moving, rate, 1.0)
    first, second = (-reach - offset) / divisor, (reach - offset) / divisor
    always = ~moving & (np.abs(offset) < reach)
    begin = np.where(moving, np.minimum(first, second), np.where(always, -np.inf, np.inf))
    return begin, np.where(moving, np.maximum(first, second), -begin)


def time_headway(leader_gap: Floats, speed: Floats) -> Floats:
    """Seconds to the place of the leader's rear, at most :data:`HEADWAY_CAP`."""
    has_leader = (leader_gap < LEADER_CAP) & (speed > _CREEPING)
    headway = leader_gap / np.where(has_leader, speed, 1.0)
    return np.where(has_leader, np.minimum(headway, HEADWAY_CAP), HEADWAY_CAP)


def drac(leader_gap: Floats, speed: Floats, leader_speed: Floats) -> Floats:
    """Deceleration in m/s2 that avoids a crash with the leader, up to :data:`DECELERATION_CAP`."""
    closing = np.where(leader_gap < LEADER_CAP, np.maximum(speed - leader_speed, 0.0), 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        needed = closing * closing / (2.0 * leader_gap)
    return np.where(closing > 0.0, np.minimum(needed, DECELERATION_CAP), 0.0)


def criticality(encounters: Encounters, leader_gap: Floats, leader_speed: Floats) -> dict[str, Any]:
    """Make the signals of criticality by name, each of shape ``(ticks,)``.

    Args:
        encounters: The ego and the objects around it.
        leader_gap: Metres to the leader's rear, ``LEADER_CAP`` without one.
        leader_speed: Its speed along the ego's path.
    """
    ego = encounters.ego
    speed = np.cos(ego[:, 2]) * ego[:, 3] + np.sin(ego[:, 2]) * ego[:, 4]
    near = np.zeros(len(ego))
    for miss in encounters.near_misses():
        near[miss.end :] += 1.0
    return {
        "time_headway": time_headway(leader_gap, speed),
        "drac": drac(leader_gap, speed, leader_speed),
        "required_deceleration": encounters.required_deceleration(),
        "pet": encounters.pet(),
        "near_misses": near,
    }


def near_miss_events(encounters: Encounters) -> list[tuple[int, str, str, str]]:
    """Describe the near misses as events: tick, kind, object, and when and how near."""
    return [
        (
            miss.end,
            "near_miss",
            miss.body,
            (
                f"time to collision down to {miss.ttc:.2f} s, gap down to {miss.gap:.2f} m, "
                f"from {miss.first * encounters.dt:g} to {miss.end * encounters.dt:g} s"
            ),
        )
        for miss in encounters.near_misses()
    ]


@dataclass(frozen=True)
class Exposure:
    """Near misses of episodes, over what was driven.

    Args:
        near_misses: Their number.
        hours: Time of all episodes.
        kilometres: Way of the ego in them.
    """

    near_misses: int
    hours: float
    kilometres: float

    @property
    def per_hour(self) -> float:
        """Near misses in an hour; NaN without any time."""
        return self.near_misses / self.hours if self.hours > 0 else math.nan

    @property
    def per_kilometre(self) -> float:
        """Near misses in a kilometre; NaN of an ego that did not move."""
        return self.near_misses / self.kilometres if self.kilometres > 0 else math.nan


def exposure(episodes: Iterable[Any]) -> Exposure:
    """Sum up the near misses of episodes, simulated or recorded, with time and way.

    Args:
        episodes: Episodes with the signals ``near_misses`` and ``speed``.

    Raises:
        ConfigurationError: If one has no such signal.
    """
    count, seconds, metres = 0.0, 0.0, 0.0
    for episode in episodes:
        steps = np.diff(episode.time)
        count += episode.signal("near_misses")[-1]
        seconds += float(steps.sum())
        metres += float((np.abs(episode.signal("speed")[:-1]) * steps).sum())
    return Exposure(int(count), seconds / 3600.0, metres / 1000.0)
