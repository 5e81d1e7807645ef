"""Formulas made ready for evaluation, kept for the next trace."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from pytest_dura.requirements.stl.language.checks import check_time_step
from pytest_dura.requirements.stl.language.formula import Formula
from pytest_dura.requirements.stl.language.nodes import Boolean, Node, Temporal, conjuncts, walk
from pytest_dura.requirements.stl.language.rendering import node_text
from pytest_dura.requirements.stl.offline.program import Mode, Program
from pytest_dura.requirements.stl.offline.steps import neutral
from pytest_dura.requirements.stl.offline.values import Values

KEPT = 512


class Conjunct:
    """A part of the conjunction at a formula's root, judged at the first sample.

    Args:
        node: The part.
        program: The steps of the whole formula.
    """

    def __init__(self, node: Node, program: Program) -> None:
        self.node = node
        self._program = program
        self._join: np.ufunc | None = None
        self._inner = node
        self._window: tuple[int, int] | None = None
        if isinstance(node, Temporal) and node.operator in ("always", "eventually"):
            self._join = np.minimum if node.operator == "always" else np.maximum
            self._inner = node.operand
            if node.window is not None:
                self._window = program.samples(node.window)

    @cached_property
    def text(self) -> str:
        """The part as text."""
        return node_text(self.node)

    @property
    def is_minimum(self) -> bool:
        """Whether the part is an ``always``."""
        return self._join is np.minimum

    def at_start(self, values: Values, mode: Mode) -> tuple[float, int | None]:
        """Its value at the first sample, and for always and eventually where that is reached."""
        inner = values[self._program.slot(self._inner, mode)]
        if self._join is None:
            return float(inner[0]), None
        size = len(inner)
        first, last, cut = 0, size - 1, mode.open_end
        if self._window is not None:
            first, last = self._window
            cut = last >= size
        if first >= size:
            value, index = neutral(self._join), size - 1
        else:
            seen = inner[first : last + 1]
            index = first + int(seen.argmin() if self.is_minimum else seen.argmax())
            value = float(inner[index])
        if cut and mode.unknown is not None:
            value = float(self._join(value, mode.unknown))
        return value, index


class Plan:
    """What evaluation needs of a formula for one time step.

    Attributes:
        formula: The formula.
        signals: The signals it reads.
        program: Its steps.
        conjuncts: The parts of the conjunction at its root, or the root alone.
        has_implication: Whether it can be satisfied vacuously.
    """

    def __init__(self, formula: Formula, time_step: float | None) -> None:
        self.formula = formula
        self.signals = tuple(formula.signals)
        self.program = Program(formula.root, time_step)
        self.conjuncts = tuple(Conjunct(node, self.program) for node in conjuncts(formula.root))
        self.has_implication = any(
            isinstance(node, Boolean) and node.operator == "implies" for node in walk(formula.root)
        )


_plans: dict[tuple[int, float | None], Plan] = {}


def plan_of(formula: Formula, time_step: float | None) -> Plan:
    """The plan of a formula; ``time_step=None`` is for a trace of one sample.

    Raises:
        ConfigurationError: For a window that is no multiple of the time step.
    """
    # By identity, as hashing a tree takes as long as evaluating it. A plan keeps its formula
    # alive, so that no other one can have its id.
    key = (id(formula), time_step)
    plan = _plans.get(key)
    if plan is None:
        if time_step is not None:
            check_time_step(formula, time_step)
        if len(_plans) >= KEPT:
            _plans.clear()
        plan = _plans[key] = Plan(formula, time_step)
    return plan
