"""What successive percepts say together: displacements and newcomers."""

from __future__ import annotations

from pytest_dura.driving.bodies import BodyList

Place = tuple[float, float]


class Tracker:
    """Matches the bodies of one tick to those of the tick before, by id.

    Plain dictionaries: for the few bodies of a junction they are quicker than arrays.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._index: int | None = None
        self._previous: dict[str, Place] | None = None
        self._current: dict[str, Place] | None = None

    def update(self, index: int, bodies: BodyList) -> None:
        """The bodies at a tick; a second call within the tick changes nothing."""
        if index == self._index:
            return
        places = {
            i: (row[0], row[1]) for i, row in zip(bodies.ids, bodies.data.tolist(), strict=True)
        }
        self._index, self._previous, self._current = index, self._current, places

    def displacements(self) -> list[tuple[int, float, float]]:
        """Row in the current list and metres moved in x and y, of each body seen a tick before."""
        if self._previous is None or self._current is None:
            return []
        before = self._previous
        return [
            (row, x - before[i][0], y - before[i][1])
            for row, (i, (x, y)) in enumerate(self._current.items())
            if i in before
        ]

    def newcomers(self) -> list[int]:
        """Rows of the current list that were not there a tick before; none at the first tick."""
        if self._previous is None or self._current is None:
            return []
        return [row for row, i in enumerate(self._current) if i not in self._previous]
