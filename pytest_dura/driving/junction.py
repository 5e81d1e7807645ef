"""The four-way junction: routes as arc lengths, and where two routes conflict.

Geometry of highway-env's intersection: arms 0 south, 1 west, 2 north, 3 east; x east, y south;
lanes 4 m wide, arms 100 m long, stop lines 11 m from the centre. The east-west road has priority.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.state import sealed

Floats = NDArray[np.float64]

ARMS = ("south", "west", "north", "east")
TURNS = ("left", "straight", "right")
ARM_LENGTH = 100.0
STOP_LINE = 11.0
"""Metres from the centre to a stop line; the square between them is the conflict zone."""
LANE_OFFSET = 2.0
RIGHT_RADIUS, LEFT_RADIUS = 9.0, 13.0
SPEED_LIMIT = 10.0
_SPACING = 0.5
_CONFLICT_WIDTH = 3.0
"""Centre lines nearer than this conflict: a car's width and half a metre on each side."""


@dataclass(frozen=True)
class Route:
    """A route from one arm to another.

    ``s`` is metres along it, 0 where the arm begins, 100 at the stop line.
    """

    origin: int
    turn: str

    @cached_property
    def destination(self) -> int:
        """The arm on which it leaves."""
        return (self.origin + {"left": 1, "straight": 2, "right": 3}[self.turn]) % 4

    @cached_property
    def inside(self) -> float:
        """Metres from stop line to exit."""
        quarter = math.pi / 2.0
        return {"left": LEFT_RADIUS * quarter, "straight": 2 * STOP_LINE,
                "right": RIGHT_RADIUS * quarter}[self.turn]  # fmt: skip

    @cached_property
    def exit(self) -> float:
        """``s`` at which it has crossed the junction."""
        return ARM_LENGTH + self.inside

    @cached_property
    def length(self) -> float:
        """Metres from beginning to end."""
        return self.exit + ARM_LENGTH

    @cached_property
    def priority(self) -> int:
        """Right of way, as in highway-env: 3 and 2 east-west, 1 and 0 north-south; left is less."""
        return (3 if self.origin % 2 else 1) - (self.turn == "left")

    @cached_property
    def number(self) -> int:
        """Its place in ``all_routes()``."""
        return 3 * self.origin + TURNS.index(self.turn)

    def __reduce__(self) -> tuple[Callable[[int, str], Route], tuple[int, str]]:
        """Copies are the same object: cars on one route are recognised by identity."""
        return route, (self.origin, self.turn)

    @cached_property
    def grid(self) -> Floats:
        """Sampled ``s, x, y, heading`` every half metre, shape ``(n, 4)``."""
        s = np.append(np.arange(0.0, self.length, _SPACING), self.length)
        t = np.clip((s - ARM_LENGTH) / self.inside, 0.0, 1.0)
        before, after = np.minimum(s, ARM_LENGTH), np.maximum(s - self.exit, 0.0)
        # In the frame of the south arm: driving up (towards -y) on x = 2, then turning.
        angle = {"left": -1.0, "straight": 0.0, "right": 1.0}[self.turn] * math.pi / 2 * t
        if self.turn == "straight":
            dx, dy = np.zeros_like(t), -2 * STOP_LINE * t
        else:
            radius = LEFT_RADIUS if self.turn == "left" else RIGHT_RADIUS
            dx = np.sign(angle) * radius * (1 - np.cos(angle))
            dy = -radius * np.abs(np.sin(angle))
        heading = -math.pi / 2 + angle
        x = LANE_OFFSET + dx + after * np.cos(heading)
        y = STOP_LINE + ARM_LENGTH - before + dy + after * np.sin(heading)
        turn = self.origin * math.pi / 2
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
        c, sn, straight = self._frame
        u, v = c * x - sn * y, sn * x + c * y
        if straight or v >= STOP_LINE:
            return ARM_LENGTH + STOP_LINE - v, u - LANE_OFFSET
        sign = 1.0 if self.turn == "right" else -1.0
        radius = RIGHT_RADIUS if self.turn == "right" else LEFT_RADIUS
        centre_x = LANE_OFFSET + sign * radius
        past = (u - centre_x) * sign
        if past >= 0.0:
            return self.exit + past, (v - (STOP_LINE - radius)) * sign
        angle = math.atan2(STOP_LINE - v, -past)
        distance = math.hypot(u - centre_x, v - STOP_LINE)
        return ARM_LENGTH + radius * angle, (radius - distance) * sign

    @cached_property
    def _frame(self) -> tuple[float, float, bool]:
        """Cosine and sine of the turn that brings its arm to the south; whether it is straight."""
        turn = -self.origin * math.pi / 2
        return math.cos(turn), math.sin(turn), self.turn == "straight"

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
        turned = {"left": -1.0, "straight": 0.0, "right": 1.0}[self.turn] * math.pi / 2
        share = min(max((s - ARM_LENGTH) / self.inside, 0.0), 1.0)
        return (self.origin - 1) * math.pi / 2 + turned * share

    def project_all(self, points: Floats) -> tuple[Floats, Floats, Floats]:
        """``project`` of many points, shape ``(n, 2)``, and the route's heading beside each."""
        turn = self.origin * math.pi / 2
        c, sn = math.cos(turn), math.sin(turn)
        u, v = c * points[:, 0] + sn * points[:, 1], c * points[:, 1] - sn * points[:, 0]
        s, lateral = ARM_LENGTH + STOP_LINE - v, u - LANE_OFFSET
        if self.turn == "straight":
            return s, lateral, np.full(len(points), turn - math.pi / 2)
        sign = 1.0 if self.turn == "right" else -1.0
        radius = RIGHT_RADIUS if self.turn == "right" else LEFT_RADIUS
        past = (u - (LANE_OFFSET + sign * radius)) * sign
        turning, leaving = (v < STOP_LINE) & (past < 0.0), (v < STOP_LINE) & (past >= 0.0)
        angle = np.arctan2(STOP_LINE - v, -past)
        s = np.where(turning, ARM_LENGTH + radius * angle, np.where(leaving, self.exit + past, s))
        beside = (radius - np.hypot(past, v - STOP_LINE)) * sign
        after = (v - (STOP_LINE - radius)) * sign
        lateral = np.where(turning, beside, np.where(leaving, after, lateral))
        turned = sign * np.where(turning, angle, np.where(leaving, math.pi / 2, 0.0))
        return s, lateral, turned + (turn - math.pi / 2)


@cache
def route(origin: int, turn: str) -> Route:
    """The Route object of this origin and turn, the same at each call.

    The cache is part of its meaning: cars on one route are recognised by identity.
    """
    made = Route(origin, turn)
    # Its cached properties are filled before it is part of a percept, which must not change.
    made.point(made.project(0.0, made.length)[0])
    assert (made.number, made.priority, made.destination) >= (0, 0, 0)
    return made


def all_routes() -> list[Route]:
    """The twelve routes."""
    return [route(origin, turn) for origin in range(4) for turn in TURNS]


@cache
def conflict(a: Route, b: Route) -> tuple[float, float, float, float] | None:
    """Conflict of routes from different arms: ``s`` from and to on ``a``, then on ``b``."""
    if a.origin == b.origin:
        return None
    grid_a, grid_b = a.grid, b.grid
    # Behind the junction two routes to one arm are the same lane: that is following, not conflict.
    part_a = grid_a[(grid_a[:, 0] >= ARM_LENGTH) & (grid_a[:, 0] <= a.exit + 5.0)]
    part_b = grid_b[(grid_b[:, 0] >= ARM_LENGTH) & (grid_b[:, 0] <= b.exit + 5.0)]
    distance = np.hypot(*(part_a[:, None, 1:3] - part_b[None, :, 1:3]).transpose(2, 0, 1))
    near_a, near_b = np.nonzero(distance < _CONFLICT_WIDTH)
    if not len(near_a):
        return None
    s_a, s_b = part_a[near_a, 0], part_b[near_b, 0]
    return float(s_a.min()), float(s_a.max()), float(s_b.min()), float(s_b.max())
