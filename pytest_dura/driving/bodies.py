"""Objects on the road with stable ids, kept as columns."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.state import sealed

if TYPE_CHECKING:
    from pytest_dura.driving.junction import Route


X, Y, HEADING, VX, VY, LENGTH, WIDTH = range(7)
COLUMNS = 7

CAR_LENGTH, CAR_WIDTH, PEDESTRIAN_SIZE = 5.0, 2.0, 0.6

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
        """From single bodies."""
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
        """The body with this id, if it is there."""
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
