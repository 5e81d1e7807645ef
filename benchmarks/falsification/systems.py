"""A system: inputs in, signals out, and requirements on them; no simulator of ours takes part."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pytest_dura.requirements import parse, robustness_batch
from pytest_dura.search import Layout

Floats = NDArray[np.float64]
Signals = Mapping[str, Floats]


@dataclass(frozen=True)
class System:
    """Something that is searched.

    Args:
        layout: Of its inputs.
        simulate: Signals by name, each of shape ``(k, samples)``, at points of shape
            ``(k, layout.size)``.
        step: Seconds between samples.
        formulas: Requirements by name.
    """

    layout: Layout
    simulate: Callable[[Floats], Signals]
    step: float
    formulas: Mapping[str, str]

    def objective(self, name: str) -> Callable[[Floats], Floats]:
        """The robustness of a requirement at points, by our own evaluation."""
        formula = parse(self.formulas[name])

        def robustness(points: Floats) -> Floats:
            signals = self.simulate(points)
            traces = [
                {key: column[i] for key, column in signals.items() if key in formula.signals}
                for i in range(len(points))
            ]
            found = robustness_batch(formula, traces, self.step)
            return np.array([one[0] for one in found])

        return robustness
