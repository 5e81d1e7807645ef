"""Chance: at which ticks something happens that has the same probability at each of them."""

from __future__ import annotations

from bisect import bisect_left

import numpy as np

BLOCK = 256
"""Ticks that are drawn at once."""


class Chance:
    """One draw per tick from one stream, made in advance.

    Whether it happens at a tick rests on the tick's index alone, so that it does not matter at
    which ticks somebody asks.

    Args:
        probability: Of its happening at a tick.
        rng: The stream; nobody else may draw from it.
    """

    __slots__ = ("_drawn", "_hits", "_probability", "_rng")

    def __init__(self, probability: float, rng: np.random.Generator) -> None:
        self._probability, self._rng = probability, rng
        self._hits: list[int] = []
        self._drawn = 0

    def happens(self, tick: int) -> bool:
        """Whether it happens at this tick, counted from 0."""
        return self.next(tick) == tick

    def next(self, tick: int) -> int:
        """The first tick from this one on at which it happens, or to which nothing is known yet."""
        while self._drawn <= tick:
            hits = np.flatnonzero(self._rng.random(BLOCK) < self._probability)
            self._hits += (hits + self._drawn).tolist()
            self._drawn += BLOCK
        place = bisect_left(self._hits, tick)
        return self._hits[place] if place < len(self._hits) else self._drawn
