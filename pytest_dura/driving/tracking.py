"""What successive percepts say together: displacements, newcomers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pytest_dura.driving.bodies import BodyList

Floats = NDArray[np.float64]


class Tracker:
    """Matches the bodies of one tick to those of the tick before, by id."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._index: int | None = None
        self._previous: BodyList | None = None
        self._current: BodyList | None = None

    def update(self, index: int, bodies: BodyList) -> None:
        """The bodies at a tick; a second call within the tick changes nothing."""
        if index == self._index:
            return
        self._index, self._previous, self._current = index, self._current, bodies

    def matched(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Rows of the current list, and of the previous one, that are the same body."""
        before, now = self._previous, self._current
        if before is None or now is None:
            return np.empty(0, np.intp), np.empty(0, np.intp)
        if before.ids == now.ids:
            rows = np.arange(len(now.ids))
            return rows, rows
        place = {body_id: row for row, body_id in enumerate(before.ids)}
        pairs = [(row, place[i]) for row, i in enumerate(now.ids) if i in place]
        table = np.array(pairs, dtype=np.intp).reshape(-1, 2)
        return table[:, 0], table[:, 1]

    def displacement(self) -> tuple[NDArray[np.intp], Floats]:
        """Rows of the current list and how far those bodies have moved, ``(k, 2)`` in metres."""
        now, before = self.matched()
        if not len(now) or self._current is None or self._previous is None:
            return now, np.empty((0, 2))
        return now, self._current.data[now, :2] - self._previous.data[before, :2]

    def newcomers(self) -> list[int]:
        """Rows of the current list that were not there a tick before; none at the first tick."""
        if self._previous is None or self._current is None:
            return []
        if self._previous.ids == self._current.ids:
            return []
        known = set(self._previous.ids)
        return [row for row, body_id in enumerate(self._current.ids) if body_id not in known]
