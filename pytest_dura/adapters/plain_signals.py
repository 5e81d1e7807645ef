"""PlainSignals: simulators whose truth and channels are plain numbers, which are their signals."""

from __future__ import annotations

import math
from collections.abc import Sequence
from numbers import Real

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.percepts import Percept
from pytest_dura.core.simulator import Simulator
from pytest_dura.core.state import Tick


class PlainSignals(Simulator):
    """Simulator of which each number of truth and percept is a signal."""

    def signals(self, ticks: Sequence[Tick]) -> dict[str, NDArray[np.float64]]:
        """Return the ground-truth signals at each tick."""
        return {
            name: np.array([tick.truth[name] for tick in ticks], dtype=np.float64)
            for name in ticks[0].truth
        }

    def percept_signals(self, percepts: Sequence[Percept]) -> dict[str, NDArray[np.float64]]:
        """Return the channels that are plain numbers; NaN where a fault removed the value."""
        names = [name for name in percepts[0] if isinstance(percepts[0][name], Real)]
        columns = {name: [percept.get(name) for percept in percepts] for name in names}
        return {
            name: np.array([float(v) if isinstance(v, Real) else math.nan for v in column])
            for name, column in columns.items()
        }
