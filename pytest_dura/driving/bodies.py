"""Objects on the road: bodies with stable ids, kept as columns, and the geometry of their boxes.

Overlap, gap and time to collision of oriented boxes are vectorised over an episode. A box is a row
``x, y, heading, length, width`` of an array of shape ``(n, 5)``; two arrays pair row by row.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.percepts import sealed
from pytest_dura.driving.lanes import Route

X, Y, HEADING, VX, VY, LENGTH, WIDTH = range(7)
COLUMNS = 7

CAR_LENGTH, CAR_WIDTH, PEDESTRIAN_SIZE = 5.0, 2.0, 0.6
CYCLIST_LENGTH = 1.8

Floats = NDArray[np.float64]


class Body(NamedTuple):
    """One object: metres, radians, metres per second; x east, y south as highway-env has it."""

    id: str
    x: float
    y: float
    heading: float
    vx: float
    vy: float
    length: float
    width: float

    @property
    def is_pedestrian(self) -> bool:
        """Whether it has a pedestrian's size; sensors report sizes, not classes."""
        return self.length < 1.0


class BodyList(Sequence[Body]):
    """Bodies as ids and one read-only array.

    Args:
        ids: One id per row, such as ``V3`` or ``P1``.
        data: Shape ``(n, 7)``: x, y, heading, vx, vy, length, width.
        numbers: The same rows as plain numbers, where they are at hand.
    """

    __slots__ = ("_made_beside", "_made_numbers", "data", "ids")

    def __init__(
        self,
        ids: tuple[str, ...],
        data: Floats,
        numbers: tuple[tuple[float, ...], ...] | None = None,
    ) -> None:
        self.ids = ids
        self.data = sealed(data)
        self._made_numbers = numbers
        self._made_beside: tuple[Any, tuple[tuple[float, float], ...]] = None, ()

    @classmethod
    def of(cls, bodies: Sequence[Body]) -> BodyList:
        """The list of single bodies."""
        rows = [body[1:] for body in bodies]
        return cls(tuple(body.id for body in bodies), np.array(rows, float).reshape(-1, COLUMNS))

    def __len__(self) -> int:
        return len(self.ids)

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            return BodyList(self.ids[index], self.data[index])
        return Body(self.ids[index], *self.numbers[index])

    def __iter__(self) -> Iterator[Body]:
        for body_id, row in zip(self.ids, self.numbers, strict=True):
            yield Body(body_id, *row)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, BodyList):
            return NotImplemented
        return self.ids == other.ids and np.array_equal(self.data, other.data)

    __hash__ = None  # type: ignore[assignment]  # compared by value

    def __copy__(self) -> BodyList:
        """The same bodies, for another array in place of ``data``: nothing made of this one."""
        return BodyList(self.ids, self.data)

    @property
    def numbers(self) -> tuple[tuple[float, ...], ...]:
        """The rows of ``data`` as plain numbers, made at first use."""
        if self._made_numbers is None:
            self._made_numbers = tuple(map(tuple, self.data.tolist()))
        return self._made_numbers

    def beside(self, route: Route) -> tuple[tuple[float, float], ...]:
        """``route.project`` of each body; the result for the last route is kept."""
        known_route, projections = self._made_beside
        if known_route is not route:
            project = route.project
            projections = tuple([project(row[0], row[1]) for row in self.numbers])
            self._made_beside = route, projections
        return projections

    def __repr__(self) -> str:
        return f"BodyList({', '.join(map(str, self.ids))})"

    def get(self, body_id: str) -> Body | None:
        """The body with this id, or ``None``."""
        return self[self.ids.index(body_id)] if body_id in self.ids else None

    def rows(self, chosen: Sequence[int]) -> BodyList:
        """The bodies of some rows, in that order; the very list if these are all of them."""
        if list(chosen) == list(range(len(self.ids))):
            return self
        return BodyList(tuple(self.ids[row] for row in chosen), self.data[list(chosen), :])

    def with_body(self, body: Body) -> BodyList:
        """The list with this body added, or put in the place of the one with its id."""
        row = np.array(body[1:], float)
        if body.id in self.ids:
            data = self.data.copy()
            data[self.ids.index(body.id)] = row
            return BodyList(self.ids, data)
        return BodyList((*self.ids, body.id), np.vstack([self.data, row]))


NO_BODIES = BodyList((), np.empty((0, COLUMNS)))

_SIGNS = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]], dtype=float) / 2.0


def _box_axes(heading: Floats) -> Floats:
    """Unit vectors along and across, shape ``(n, 2, 2)``: ``[:, 0]`` points ahead."""
    axes: Floats = np.empty((len(heading), 2, 2))
    axes[:, 0, 0] = axes[:, 1, 1] = np.cos(heading)
    axes[:, 0, 1] = sine = np.sin(heading)
    axes[:, 1, 0] = -sine
    return axes


def _corners(boxes: Floats, along: Floats) -> Floats:
    """Corner points of boxes with these axes, shape ``(n, 4, 2)``."""
    local = _SIGNS * boxes[:, None, 3:5]
    return boxes[:, None, :2] + local @ along


def _point_to_box(points: Floats, boxes: Floats, along: Floats) -> Floats:
    """Squared distance from each of ``(n, 4, 2)`` points to its box, 0 inside; shape ``(n, 4)``."""
    local = (points - boxes[:, None, :2]) @ np.swapaxes(along, -1, -2)
    outside = np.maximum(np.abs(local) - boxes[:, None, 3:5] / 2.0, 0.0)
    squared: Floats = (outside**2).sum(-1)
    return squared


def _separations(
    a: Floats, axes_a: Floats, b: Floats, axes_b: Floats
) -> tuple[Floats, Floats, Floats]:
    """Offset, reach and axes for the separating-axis test on the four face normals.

    Returns the projected centre offset and the sum of projected half extents, each ``(n, 4)``,
    and the axes ``(n, 4, 2)``.
    """
    normals = np.concatenate([axes_a, axes_b], axis=1)
    offset = np.einsum("nkd,nd->nk", normals, b[:, :2] - a[:, :2])
    half_a = np.abs(normals @ np.swapaxes(axes_a, -1, -2)) @ (a[:, 3:5, None] / 2.0)
    half_b = np.abs(normals @ np.swapaxes(axes_b, -1, -2)) @ (b[:, 3:5, None] / 2.0)
    reach: Floats = (half_a + half_b)[..., 0]
    return offset, reach, normals


def boxes_overlap(a: Floats, b: Floats) -> NDArray[np.bool_]:
    """Whether the boxes of each pair touch or overlap; shape ``(n,)``."""
    offset, reach, _ = _separations(a, _box_axes(a[:, 2]), b, _box_axes(b[:, 2]))
    touching: NDArray[np.bool_] = np.all(np.abs(offset) <= reach, axis=1)
    return touching


def box_gap(a: Floats, b: Floats) -> Floats:
    """Distance between footprints in metres, 0 on contact; shape ``(n,)``.

    Of two disjoint convex polygons, a corner of one realises the distance.
    """
    axes_a, axes_b = _box_axes(a[:, 2]), _box_axes(b[:, 2])
    nearest = np.minimum(
        _point_to_box(_corners(a, axes_a), b, axes_b).min(axis=1),
        _point_to_box(_corners(b, axes_b), a, axes_a).min(axis=1),
    )
    offset, reach, _ = _separations(a, axes_a, b, axes_b)
    return np.where(np.all(np.abs(offset) <= reach, axis=1), 0.0, np.sqrt(nearest))


def box_time_to_collision(
    a: Floats, velocity_a: Floats, b: Floats, velocity_b: Floats, cap: float
) -> Floats:
    """Seconds until contact if both keep velocity and heading, at most ``cap``; shape ``(n,)``.

    Swept separating-axis test: contact begins when the last axis closes, if none reopens before.
    Velocities have shape ``(n, 2)``.
    """
    offset, reach, normals = _separations(a, _box_axes(a[:, 2]), b, _box_axes(b[:, 2]))
    closing = np.einsum("nkd,nd->nk", normals, velocity_b - velocity_a)
    moving = np.abs(closing) > 1e-9
    rate = np.where(moving, closing, 1.0)
    first, second = (-reach - offset) / rate, (reach - offset) / rate
    apart = ~moving & (np.abs(offset) > reach)
    enter = np.where(moving, np.minimum(first, second), np.where(apart, np.inf, -np.inf))
    leave = np.where(moving, np.maximum(first, second), np.inf)
    begin, end = enter.max(axis=1), leave.min(axis=1)
    meets = (begin <= end) & (end >= 0.0)
    return np.where(meets, np.clip(begin, 0.0, cap), cap)


GAP_CAP = 50.0
"""m; farther objects do not matter at these speeds."""
TTC_CAP = 10.0
"""s; later contacts do not matter."""
_ROUNDING = 1e-6


def proximity(
    ego: Floats, bodies: Sequence[BodyList], size: tuple[float, float] = (CAR_LENGTH, CAR_WIDTH)
) -> tuple[Floats, Floats]:
    """Gap to the nearest object and least time to collision at each tick.

    Args:
        ego: ``x, y, heading, vx, vy`` per tick, shape ``(ticks, 5)``.
        bodies: The objects at each tick.
        size: Length and width of the ego.
    """
    gap, ttc = np.full(len(ego), GAP_CAP), np.full(len(ego), TTC_CAP)
    counts = [len(at_tick.ids) for at_tick in bodies]
    if not sum(counts):
        return gap, ttc
    others = np.concatenate([at_tick.data for at_tick in bodies])
    owner = np.repeat(np.arange(len(ego)), counts)
    mine = ego[owner]
    offset = others[:, :2] - mine[:, :2]
    motion = others[:, VX : VY + 1] - mine[:, 3:5]
    apart = np.hypot(offset[:, 0], offset[:, 1])
    # Most pairs are ruled out by the circles around the boxes.
    circles = math.hypot(*size) / 2 + np.hypot(others[:, LENGTH], others[:, WIDTH]) / 2 + _ROUNDING
    bound = np.full(len(ego), GAP_CAP)
    np.minimum.at(bound, owner, apart)
    nearest = apart - circles <= bound[owner]
    gaps = box_gap(_ego_boxes(mine[nearest], size), _boxes(others[nearest]))
    np.minimum.at(gap, owner[nearest], gaps)
    squared = np.maximum((motion * motion).sum(axis=1), _ROUNDING)
    time = np.clip(-(offset * motion).sum(axis=1) / squared, 0.0, TTC_CAP)[:, None]
    meeting = np.hypot(*(offset + time * motion).T) <= circles
    mine, others, owner = mine[meeting], others[meeting], owner[meeting]
    times = box_time_to_collision(
        _ego_boxes(mine, size), mine[:, 3:5], _boxes(others), others[:, VX : VY + 1], TTC_CAP
    )
    np.minimum.at(ttc, owner, times)
    return gap, ttc


def _ego_boxes(states: Floats, size: tuple[float, float]) -> Floats:
    boxes = np.empty((len(states), 5))
    boxes[:, :3] = states[:, :3]
    boxes[:, 3:] = size
    return boxes


def _boxes(bodies: Floats) -> Floats:
    return bodies[:, [X, Y, HEADING, LENGTH, WIDTH]]


_NARROWEST_CAR = 1.3
"""m; a bicycle is 0.7 m wide, the narrowest cars 1.4 m."""


def kind_by_size(length: float | None, width: float | None) -> str | None:
    """Class of an object by its size: sensors report sizes, not classes.

    An object longer than a pedestrian and narrower than a car is an obstacle, such as a row of
    cones or a kerb island.
    """
    if length is None:
        return None
    if length < 1.0:
        return "pedestrian"
    return "obstacle" if width is not None and width < _NARROWEST_CAR else "car"
