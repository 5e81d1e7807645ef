"""Boxes: where in a search space points violate, by cuts that separate most.

A box is made from the whole space: of all cuts at one coordinate, the side is kept that has the
greatest weighted relative accuracy, the share of points that it keeps times the growth of the share
of violating ones (Lavrac, Flach and Zupan, "Rule evaluation measures", ILP 1999). Where no side
stands out, the middle between two cuts may. Bounds that separate nothing are taken out, and the
next box is made for the violating points that are left.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

_PURE = 0.95
"""Share of violating points from which on a box is not cut any more."""
_LOSS = 0.02
"""Least growth of that share by a cut, and greatest loss by taking a bound out."""
_SPREADS, _SPREADS_OF_MIDDLE = 3.5, 5.0
"""Standard deviations by which violating points of a side, and of a middle, exceed what chance
alone would leave. There are more middles to choose from than sides."""
_LEAST, _LEAST_OF_MIDDLE = 3, 8
"""Violating points that a box has at least, and a middle: of fewer, chance puts some close together
in one of many coordinates. So of violations by chance middles bound hardly more regions than sides
do (100 points, 10 coordinates, 5 violations: 11 %; 150, 6, 15: 7 instead of 5 %)."""


@dataclass(frozen=True)
class Box:
    """An axis-parallel box in [0, 1].

    Args:
        low: Lower face of each coordinate.
        high: Upper face of each coordinate.
    """

    low: Floats
    high: Floats

    @classmethod
    def whole(cls, size: int) -> Box:
        """Return the whole space of some coordinates."""
        return cls(np.zeros(size), np.ones(size))

    @property
    def bounded(self) -> Flags:
        """Whether a coordinate is bounded at all, shape ``(size,)``."""
        return np.logical_or(self.low > 0.0, self.high < 1.0)

    @property
    def volume(self) -> float:
        """Share of the space that lies within."""
        return float(np.prod(self.high - self.low))

    def contains(self, points: Floats) -> Flags:
        """Whether points of shape ``(k, size)`` lie within, faces included."""
        inside: Flags = np.asarray(((points >= self.low) & (points <= self.high)).all(axis=1))
        return inside

    def opened(self, coordinate: int) -> Box:
        """Return the box without the bounds of a coordinate."""
        low, high = self.low.copy(), self.high.copy()
        low[coordinate], high[coordinate] = 0.0, 1.0
        return Box(low, high)

    def draw(self, rng: np.random.Generator, count: int) -> Floats:
        """Draw points evenly within."""
        drawn: Floats = rng.uniform(self.low, self.high, (count, len(self.low)))
        return drawn


def boxes(points: Floats, violating: Flags, most: int) -> Iterator[Box]:
    """Yield boxes in which points violate, the one with the most violating points first made.

    Args:
        points: Coordinates, shape ``(k, size)``.
        violating: Whether each violates.
        most: Boxes at most.
    """
    left = np.ones(len(points), bool)
    for _ in range(most):
        if np.count_nonzero(violating & left) < _LEAST:
            return
        box = _without_idle_bounds(_cut_out(points[left], violating[left]), points, violating)
        covered = box.contains(points) & violating & left
        if np.count_nonzero(covered) < _LEAST:
            return
        yield box
        left &= ~covered


def separation(box: Box, points: Floats, violating: Flags) -> Floats:
    """How much of the share of violating points each coordinate of a box brings, shape ``(size,)``.

    A coordinate that is not bounded has the gain of its best single cut, which is ranked behind all
    that are.
    """
    share = _share(violating[box.contains(points)])
    gains = np.empty(len(box.low))
    for coordinate in range(len(gains)):
        if box.bounded[coordinate]:
            without = violating[box.opened(coordinate).contains(points)]
            gains[coordinate] = 1.0 + share - _share(without)
        else:
            gains[coordinate] = _best_cut(points[:, coordinate], violating)
    return gains


def _best_cut(column: Floats, violating: Flags) -> float:
    """Return by how much the best cut of one coordinate lowers the Gini impurity."""
    order = np.argsort(column, kind="stable")
    hits = np.cumsum(violating[order])[:-1]
    total, size = int(violating.sum()), len(column)
    left = np.arange(1, size)
    distinct = np.diff(column[order]) > 0.0
    if not distinct.any():
        return 0.0
    below, above = hits / left, (total - hits) / (size - left)
    after = (left * below * (1.0 - below) + (size - left) * above * (1.0 - above)) / size
    overall = total / size
    return float(overall * (1.0 - overall) - after[distinct].min())


def _cut_out(points: Floats, violating: Flags) -> Box:
    """Cut at one coordinate after the other, as long as the share of violating points grows."""
    box = Box.whole(points.shape[1])
    while True:
        inside = box.contains(points)
        if _share(violating[inside]) >= _PURE:
            return box
        within, hits = points[inside], violating[inside]
        for part_of, spreads in ((_best_side, _SPREADS), (_best_middle, _SPREADS_OF_MIDDLE)):
            parts = [part_of(box, i, within, hits) for i in range(len(box.low))]
            gain, _, best = max(parts, key=lambda part: part[:2])
            if gain > 0.0 and _stands_out(hits, best.contains(within), spreads):
                box = best
                break
        else:
            return box


def _stands_out(violating: Flags, kept: Flags, spreads: float) -> bool:
    """Whether the points that are kept violate more often than chance alone would leave."""
    share, hits, part = _share(violating), violating[kept], float(kept.mean())
    spread = np.sqrt(len(hits) * share * (1.0 - share) * (1.0 - part))
    grows = _share(hits) >= share + _LOSS
    return bool(grows and hits.sum() - len(hits) * share >= spreads * spread)


def _best_side(
    box: Box, coordinate: int, points: Floats, violating: Flags
) -> tuple[float, int, Box]:
    """Return the accuracy of the best side of all cuts at a coordinate, and its box."""
    order = np.argsort(points[:, coordinate], kind="stable")
    column, hits = points[order, coordinate], np.cumsum(violating[order])
    size, total = len(column), int(hits[-1])
    below = np.arange(1, size)
    distinct = np.diff(column) > 0.0
    if not distinct.any():
        return 0.0, -coordinate, box
    share = total / size
    lower = np.where(distinct & (hits[:-1] >= _LEAST), hits[:-1] - share * below, 0.0)
    upper_hits, above = total - hits[:-1], size - below
    upper = np.where(distinct & (upper_hits >= _LEAST), upper_hits - share * above, 0.0)
    keeps_low = lower.max() >= upper.max()
    place = int(np.argmax(lower if keeps_low else upper))
    at = (column[place] + column[place + 1]) / 2.0
    low, high = box.low.copy(), box.high.copy()
    (high if keeps_low else low)[coordinate] = at
    return float(max(lower.max(), upper.max()) / size), -coordinate, Box(low, high)


def _best_middle(
    box: Box, coordinate: int, points: Floats, violating: Flags
) -> tuple[float, int, Box]:
    """Return the accuracy of the best part between two cuts at a coordinate, and its box."""
    order = np.argsort(points[:, coordinate], kind="stable")
    column, hits = points[order, coordinate], violating[order]
    size, share = len(column), _share(violating)
    # Excess of violating points before each place where a part may begin or end.
    excess = np.concatenate([[0.0], np.cumsum(hits - share)])
    edge = np.concatenate([[True], np.diff(column) > 0.0, [True]])
    least = np.minimum.accumulate(np.where(edge, excess, np.inf))
    gains = np.where(edge[1:], excess[1:] - least[:-1], -np.inf)
    end = int(np.argmax(gains)) + 1
    begin = int(np.argmin(np.where(edge, excess, np.inf)[:end]))
    if np.count_nonzero(hits[begin:end]) < _LEAST_OF_MIDDLE:
        return 0.0, -coordinate, box
    low, high = box.low.copy(), box.high.copy()
    if begin > 0:
        low[coordinate] = (column[begin - 1] + column[begin]) / 2.0
    if end < size:
        high[coordinate] = (column[end - 1] + column[end]) / 2.0
    return float(gains[end - 1] / size), -coordinate, Box(low, high)


def _without_idle_bounds(box: Box, points: Floats, violating: Flags) -> Box:
    """Take out bounds that separate nothing, those that separate least first."""
    while box.bounded.any():
        share = _share(violating[box.contains(points)])
        trials = []
        for coordinate in np.flatnonzero(box.bounded):
            opened = box.opened(int(coordinate))
            trials.append((_share(violating[opened.contains(points)]), int(coordinate), opened))
        best, _, opened = max(trials, key=lambda trial: trial[:2])
        if best < share - _LOSS:
            break
        box = opened
    return box


def _share(violating: Flags) -> float:
    return float(violating.mean()) if len(violating) else 0.0
