"""SafetyMonitor: predicted separation, following distance and right of way for the proposal.

The least of ``prediction.separations``, the same to the last bit, in plain arithmetic: of a few
bodies nearly all instants are ruled out by the distance between centres alone, and what is left is
too little for arrays to pay.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from pytest_dura.core.roles import Assessed, Assessment, RoleContext, SafetyMonitor
from pytest_dura.core.state import RoleView
from pytest_dura.driving import prediction
from pytest_dura.driving.bodies import LENGTH, VX, VY, WIDTH
from pytest_dura.driving.maneuvers import MAX_BRAKING, acceleration_for, braking_distance
from pytest_dura.driving.percepts import implausible_values
from pytest_dura.driving.prediction import (
    DISC_OFFSETS,
    EGO_OFFSETS,
    EGO_RADIUS,
    Predictor,
    driven,
    near,
)
from pytest_dura.driving.roles.performance import STANDING
from pytest_dura.driving.scene import Scene, crossing, time_to_cover

Point = tuple[float, float]
Row = tuple[float, ...]

_BACK, _UNUSED, _AHEAD = EGO_OFFSETS.tolist()
_SHARES: list[float] = DISC_OFFSETS.tolist()
_RESERVE = 1e-6
"""m; bounds are not taken to the last bit."""


class Nearest(NamedTuple):
    """The least separation in m, negative on overlap, and the id of the body that has it."""

    separation: float
    body: str


def nearest(
    predictor: Predictor, scene: Scene, acceleration: float, dt: float, cap: float
) -> Nearest | None:
    """The body that comes nearest, of those that the predictor has observed.

    Args:
        predictor: For how long to look ahead, in which steps, and who turns.
        scene: Where the ego begins.
        acceleration: Of the ego, in m/s2.
        dt: Seconds per tick.
        cap: Separations of more metres do not matter.

    Returns:
        ``None`` where no object is within reach, or surely none within the cap.
    """
    bodies, times = scene.bodies, predictor.steps
    within = near(bodies, scene.x, scene.y, scene.speed, predictor.horizon)
    if not within:
        return None
    ids, numbers, point = bodies.ids, bodies.numbers, scene.route.point
    turning = predictor.rates([ids[row] for row in within], dt)
    rates = turning or [0.0] * len(within)
    ways = [scene.s + step for step in driven(scene.speed, acceleration, times, scene.limit)]
    egos = scene.route.trail(ways)
    bounds = []
    for number, row in enumerate(within):
        bounds += _bounds(
            number, _squares(numbers[row], times, rates[number], egos), numbers[row], cap
        )
    if not bounds:
        return None
    bounds.sort()
    best, nearest_number = math.inf, 0
    straight: dict[int, list[Point]] = {}
    for bound, number, at in bounds:
        if bound > best:
            break
        s, body = ways[at], numbers[within[number]]
        own = point(s + _BACK), egos[at], point(s + _AHEAD)
        if turning is None:
            now = straight.get(number)
            if now is None:
                now = straight[number] = _discs_now(body)
            dx, dy = times[at] * body[VX], times[at] * body[VY]
            others = [(x + dx, y + dy) for x, y in now]
        else:
            others = _discs_turned(body, times[at], turning[number])
        # Root and difference keep the order: the least is that of the least square.
        apart = math.sqrt(_least_square(own, others)) - _radii(body[LENGTH], body[WIDTH])
        if apart < best or (apart == best and number < nearest_number):
            best, nearest_number = apart, number
    return Nearest(best, ids[within[nearest_number]])


def _bounds(
    number: int, squares: Sequence[float], row: Row, cap: float
) -> list[tuple[float, int, int]]:
    """Below the separation at each instant that matters; with the body's number and the instant's.

    It is at least the distance of the centres less what the discs reach beyond them.
    """
    span = _span(row[LENGTH], row[WIDTH])
    reach = (cap + span) ** 2
    return [
        (math.sqrt(squared) - span, number, at)
        for at, squared in enumerate(squares)
        if squared < reach
    ]


def _squares(row: Row, times: Sequence[float], rate: float, egos: Sequence[Point]) -> list[float]:
    """Squared distance of the centres at each instant, but for rounding."""
    x, y, _, vx, vy, _, _ = row
    squares = []
    if not rate:
        for time, (own_x, own_y) in zip(times, egos, strict=True):
            dx, dy = own_x - x - time * vx, own_y - y - time * vy
            squares.append(dx * dx + dy * dy)
        return squares
    half = rate / 2.0
    for time, (own_x, own_y) in zip(times, egos, strict=True):
        c, s = math.cos(time * half), math.sin(time * half)
        dx = own_x - x - time * (c * vx - s * vy)
        dy = own_y - y - time * (s * vx + c * vy)
        squares.append(dx * dx + dy * dy)
    return squares


def _discs_now(row: Row) -> list[Point]:
    """The centres of a body's discs, as ``prediction.moving`` has them where no body turns.

    NumPy's sine and cosine are not those of ``math`` to the last bit.
    """
    x, y, heading, _, _, length, _ = row
    c, s = float(np.cos(heading)), float(np.sin(heading))
    reaches = [length * share for share in _SHARES]
    return [(x + c * reach, y + s * reach) for reach in reaches]


def _discs_turned(row: Row, time: float, rate: float) -> list[Point]:
    """The centres after some time, as ``prediction.moving`` has them where a body turns."""
    x, y, heading, vx, vy, length, _ = row
    turned = time * rate
    c, s = float(np.cos(turned / 2.0)), float(np.sin(turned / 2.0))
    x, y = x + time * (c * vx - s * vy), y + time * (s * vx + c * vy)
    c, s = float(np.cos(heading + turned)), float(np.sin(heading + turned))
    reaches = [length * share for share in _SHARES]
    return [(x + c * reach, y + s * reach) for reach in reaches]


def _least_square(some: Sequence[Point], others: Sequence[Point]) -> float:
    least = math.inf
    for x, y in some:
        for other_x, other_y in others:
            dx, dy = x - other_x, y - other_y
            squared = dx * dx + dy * dy
            if squared < least:  # noqa: PLR1730 - a call to min would cost as much again
                least = squared
    return least


@lru_cache(maxsize=1024)  # bodies have few sizes
def _radii(length: float, width: float) -> float:
    """Radii of a disc of the ego and a disc of a body, together; see ``prediction.radii``."""
    return EGO_RADIUS + float(np.hypot(length / 6.0, width / 2.0))


@lru_cache(maxsize=1024)
def _span(length: float, width: float) -> float:
    """Metres that the discs of ego and body reach beyond their centres at most, together."""
    return (5.0 + length) / 3.0 + _radii(length, width) + _RESERVE


SEPARATION_CAP = 10.0
"""m; the score saturates here."""

ENTRY = 0.5
"""Seconds after which a proposal that could not stop before the stop line any more is held to the
right of way."""


class SeparationMonitor(SafetyMonitor):
    """Assesses whether the proposed command, kept up for a while, comes too near to a body.

    Args:
        horizon: Seconds that are predicted.
        unsafe: Predicted separation in m below which the proposal is unsafe.
        warning: The same for a warning.
        reaction: Seconds before the ego can answer a braking leader.

    A proposal to go on standing is no more than a warning: who comes near then, comes by itself.

    The score is the least predicted separation in m. What it cannot judge is unsafe, with a score
    of 0 at most: a percept with an own pose or speed that cannot be, or with such numbers of an
    object that may be near.
    """

    def __init__(
        self, horizon: float = 2.0, unsafe: float = 0.3, warning: float = 1.0, reaction: float = 0.3
    ) -> None:
        self.horizon, self.unsafe, self.warning, self.reaction = horizon, unsafe, warning, reaction
        self._predictor = prediction.Predictor(horizon, 0.25)

    def reset(self, context: RoleContext) -> None:
        """Forget the bodies seen."""
        self._predictor.reset()

    def run(self, view: RoleView) -> Assessment:
        """The worst of separation, following distance and right of way."""
        scene = Scene.of(view.percept)
        self._predictor.observe(view.index, scene.bodies)
        if view.proposal is None:
            return Assessment(Assessed.SAFE, SEPARATION_CAP)
        acceleration = acceleration_for(
            view.proposal.action, scene.speed, scene.to_stop_line, scene.limit
        )
        separation, who = self._separation(scene, acceleration, view.dt)
        reasons, verdict = [], Assessed.SAFE
        doubts = implausible_values(view.percept)
        if doubts:
            verdict, separation = Assessed.UNSAFE, min(separation, 0.0)
            reasons += [f"cannot judge: {doubt.subject} {doubt.detail}" for doubt in doubts]
        elif separation < self.warning:
            # To refuse a proposal to go on standing would be in vain: no brake makes it safer.
            stands = scene.speed < STANDING and acceleration <= 0.0
            unsafe = separation < self.unsafe and not stands
            verdict = Assessed.UNSAFE if unsafe else Assessed.WARNING
            reasons.append(f"comes within {max(separation, 0.0):.1f} m of {who}")
        following = self._following(scene, acceleration)
        if following is not None:
            verdict = Assessed.UNSAFE
            reasons.append(following)
        taken = self._right_of_way(scene, acceleration)
        if taken is not None:
            verdict = Assessed.UNSAFE
            reasons.append(taken)
        return Assessment(verdict, separation, tuple(reasons))

    def _separation(self, scene: Scene, acceleration: float, dt: float) -> tuple[float, str]:
        # A body beyond the cap and the warning's distance appears in no reason.
        cap = max(SEPARATION_CAP, self.warning)
        apart, who = nearest(self._predictor, scene, acceleration, dt, cap) or (SEPARATION_CAP, "")
        return min(apart, SEPARATION_CAP), who

    def _following(self, scene: Scene, acceleration: float) -> str | None:
        """Reason, if the ego could not stop behind a leader that brakes as hard as it can."""
        leader = scene.leader()
        if leader is None or acceleration <= -0.9 * MAX_BRAKING:
            return None
        speed = max(scene.speed + acceleration * self.reaction, 0.0)
        needed = scene.speed * self.reaction + braking_distance(speed, MAX_BRAKING)
        needed -= braking_distance(max(leader.speed, 0.0), MAX_BRAKING)
        if scene.speed > 0.5 and leader.distance < needed:
            distance = max(leader.distance, 0.0)
            return f"follows {leader.body.id} at {distance:.1f} m, needs {needed:.1f} m"
        return None

    def _right_of_way(self, scene: Scene, acceleration: float) -> str | None:
        """Reason, if the proposal enters the junction in front of a car that must then brake."""
        to_line = scene.to_stop_line
        if scene.entered or braking_distance(scene.speed, MAX_BRAKING) > to_line:
            return None
        # A proposal after which the ego can still stop before the line takes no right of way.
        reached = max(scene.speed + acceleration * ENTRY, 0.0)
        (driven,) = prediction.driven(scene.speed, acceleration, (ENTRY,), scene.limit)
        if driven + braking_distance(reached, MAX_BRAKING) < to_line:
            return None
        through = scene.exit - scene.s
        clears = time_to_cover(through, scene.speed, max(acceleration, 1.5), scene.limit)
        for other in crossing(scene):
            if other.speed > 1.0 and 0.0 < other.distance < other.speed * clears:
                return f"takes the right of way of {other.body.id}"
        return None
