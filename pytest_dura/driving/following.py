"""Who drives ahead of the ego on its own path, and whether the ego keeps a safe distance.

The safe distance is the longitudinal one of Responsibility-Sensitive Safety (Shalev-Shwartz,
Shammah and Shashua, "On a Formal Model of Safe and Scalable Self-driving Cars", 2017, lemma 2).
That a car which cuts in leaves the ego some time to restore it is rule R_G1 of Maierhofer,
Rettinger, Mayer and Althoff, "Formalization of Interstate Traffic Rules in Temporal Logic" (2020).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
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
from pytest_dura.driving.junction import Route
from pytest_dura.driving.maneuvers import MAX_ACCELERATION, MAX_BRAKING

Floats = NDArray[np.float64]

LEADER_CAP = 50.0
"""m; farther leaders do not matter at these speeds, and an empty lane counts as this far."""
RESPONSE = 0.5
"""s from a leader's braking to the ego's: a tick to sense, a tick to act, a fifth of a second to
build the brake up, and a tenth in reserve."""
SURE_BRAKING = 6.43
"""m/s2 that the ego is sure to brake with: what UN Regulation 13-H asks of every passenger car."""
LEADER_BRAKING = MAX_BRAKING
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


def leaders(route: Route, s: Floats, bodies: Sequence[BodyList]) -> Leaders:
    """The leaders of an ego at ``s`` of its route, shape ``(ticks,)``, among the bodies of a tick.

    A leader is a car whose footprint reaches into the ego's path ahead and that points along it.
    """
    gap, speed, ids = np.full(len(s), LEADER_CAP), np.zeros(len(s)), [""] * len(s)
    counts = np.array([len(at_tick) for at_tick in bodies])
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
    reached = speed + RESPONSE * MAX_ACCELERATION
    ego = speed * RESPONSE + MAX_ACCELERATION * RESPONSE**2 / 2 + reached**2 / (2 * SURE_BRAKING)
    leader = np.maximum(leader_speed, 0.0) ** 2 / (2 * LEADER_BRAKING)
    return np.maximum(ego - leader, 0.0)


def following_margin(found: Leaders, speed: Floats, collided: Floats, dt: float) -> Floats:
    """Metres by which the ego is farther from its leader than the safe distance.

    ``LEADER_CAP`` without a leader. Of a car that is nearer than that when it first becomes the
    leader, the ego is not to blame: until the distance is safe for the first time, or
    ``CUT_IN_GRACE`` is over, the margin is not below 0. Contact is excused by nothing.
    """
    has_leader = found.gap < LEADER_CAP
    margin = np.where(has_leader, found.gap - safe_distance(speed, found.speed), LEADER_CAP)
    unsafe = has_leader & (margin < 0.0)
    grace, seen = round(CUT_IN_GRACE / dt), {""}
    for tick, leader in enumerate(found.ids):
        if leader in seen:
            continue
        seen.add(leader)
        end = tick
        while end < min(tick + grace, len(speed)) and unsafe[end] and found.ids[end] == leader:
            end += 1
        margin[tick:end] = np.where(collided[tick:end] > 0.5, margin[tick:end], 0.0)
    return np.minimum(margin, LEADER_CAP)
