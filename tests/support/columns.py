"""A simulator that plays columns back, one row a tick: the world of tests about signals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pytest_dura import Generator, Proposal, Simulator, Tick
from pytest_dura.core import GeneratorView


class Columns(Simulator):
    """Its signals are the columns of the scenario's ``world``; the last row repeats."""

    def __init__(self, columns: Mapping[str, Sequence[float]] | None = None) -> None:
        self._columns = dict(columns or {})
        self.looks: list[int] = []
        """How many ticks there were whenever the signals were asked for."""

    def reset(self, scenario: Mapping[str, Any], seed: int) -> Tick:
        """The first row."""
        self._columns = dict(scenario.get("world", {})) or self._columns
        return self.tick(0)

    def step(self, action: Any) -> Tick:
        """The next row."""
        self._index += 1
        return self.tick(self._index)

    def tick(self, index: int) -> Tick:
        """The row of this number."""
        self._index = index
        row = {name: column[min(index, len(column) - 1)] for name, column in self._columns.items()}
        return Tick(index, index * self.time_step, row, {"clock": index * self.time_step})

    def signals(self, ticks: Sequence[Tick]) -> dict[str, NDArray[np.float64]]:
        """The columns."""
        self.looks.append(len(ticks))
        names = self._columns
        return {name: np.array([float(one.truth[name]) for one in ticks]) for name in names}

    def fallback_action(self) -> float:
        """Nothing."""
        return 0.0


class Idle(Generator):
    """Reads the clock and does nothing."""

    def propose(self, view: GeneratorView) -> Proposal:
        """Nothing."""
        view.percept["clock"]
        return Proposal(0.0)
