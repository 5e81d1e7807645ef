"""Formulas that look back, judged sample by sample while an episode runs."""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Mapping, Sequence
from operator import itemgetter
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.requirements.stl.language.checks import (
    check_time_step,
    in_samples,
    past_only_or_refuse,
)
from pytest_dura.requirements.stl.language.formula import Formula, marked
from pytest_dura.requirements.stl.language.nodes import (
    BooleanOperator,
    Comparison,
    Node,
    Not,
    Signal,
    Step,
    Temporal,
    TemporalPair,
    walk,
)
from pytest_dura.requirements.stl.language.rendering import node_text
from pytest_dura.requirements.stl.offline.pointwise import NotFiniteError, Samples, comparison
from pytest_dura.requirements.stl.online.streams import (
    BOTTOM,
    TOP,
    Delay,
    Running,
    Since,
    SinceWithin,
    Sliding,
    Value,
    negated,
)

Judged: TypeAlias = Callable[[Sequence[Value]], Value]
"""What a part of a formula is worth now, from the values of all comparisons."""


class Sample(NamedTuple):
    """What a formula says at one sample: its margin, and whether it holds."""

    robustness: float
    holds: bool


class OnlineFormula:
    """A formula that looks back, updated once per sample.

    After each update the robustness is that of ``robustness`` on the trace so far, at its last
    sample, and ``holds`` is the Boolean verdict, which on a margin of zero the sign cannot tell.
    The cost of an update does not grow with the trace, and not with a window's length either.
    Every temporal operator has a state of its own, equal ones as well.

    Args:
        formula: The formula.
        time_step: Seconds from sample to sample.
        what: Who judges by it, for the message that refuses a look ahead.

    Raises:
        ConfigurationError: For an operator that looks ahead, and for a window that is no multiple
            of the time step.
    """

    def __init__(self, formula: Formula, time_step: float, what: str = "an online monitor") -> None:
        past_only_or_refuse(formula, what)
        check_time_step(formula, time_step)
        self.formula, self.time_step = formula, time_step
        self._signals = formula.signals
        self.reset()

    def reset(self) -> None:
        """Begin a new trace."""
        self._index = 0
        self._comparisons: list[Callable[[Samples], Value]] = []
        self._root = self._judged(self.formula.root)

    def update(self, values: Mapping[str, float]) -> Sample:
        """Take the next sample; one that is refused leaves the state as it was.

        Args:
            values: By name, at least the signals of the formula.

        Raises:
            ConfigurationError: For a signal that is missing, or is no finite number, and for an
                expression that is not finite.
        """
        samples = self._read(values)
        # All that can fail comes first: what keeps a state sees a sample whole or not at all.
        try:
            found = self._root([compared(samples) for compared in self._comparisons])
        except NotFiniteError as error:
            raise self._not_finite(f"expression `{node_text(error.node)}`", error.value) from None
        self._index += 1
        return Sample(*found)

    def _read(self, values: Mapping[str, float]) -> Samples:
        samples = {}
        for name in self._signals:
            if name not in values:
                raise self._missing(name, values)
            value: Any = values[name]
            if type(value) is not float:
                value = self._number(name, value)
            if not math.isfinite(value):
                raise self._not_finite(f"signal {name!r}", value)
            samples[name] = value
        return samples

    def _number(self, name: str, value: Any) -> float:
        # A text has no `__float__`, although `float` would read it.
        if hasattr(value, "__float__") and np.ndim(value) == 0:
            return float(value)
        raise ConfigurationError(
            f"the signal {name!r} is no number {self._when()}",
            found=value,
            expected="one finite number per sample",
        )

    def _not_finite(self, what: str, value: float) -> ConfigurationError:
        return ConfigurationError(
            f"the {what} is not finite {self._when()}",
            found=value,
            expected="finite values",
            remedy="guard it, as by a signal that saturates at a declared cap",
        )

    def _missing(self, name: str, values: Mapping[str, float]) -> ConfigurationError:
        root = self.formula.root
        at = next(x.position for x in walk(root) if isinstance(x, Signal) and x.name == name)
        near = difflib.get_close_matches(name, list(values), n=1)
        return ConfigurationError(
            f"no signal {name!r} {self._when()}{marked(self.formula.text, at)}",
            found=name,
            expected="one of " + (", ".join(sorted(values)) or "no signals at all"),
            remedy=f"did you mean {near[0]!r}?" if near else "use a signal that is given",
        )

    def _when(self) -> str:
        return f"at t = {self._index * self.time_step:.2f} s"

    def _judged(self, node: Node) -> Judged:
        if isinstance(node, Comparison):
            self._comparisons.append(comparison(node))
            return itemgetter(len(self._comparisons) - 1)
        if isinstance(node, Not):
            operand = self._judged(node.operand)
            return lambda now: negated(operand(now))
        if isinstance(node, (Temporal, Step)):
            operand, stream = self._judged(node.operand), self._stream(node)
            return lambda now: stream(operand(now))
        left, right = self._judged(node.left), self._judged(node.right)
        join = self._since(node) if isinstance(node, TemporalPair) else _BOOLEAN[node.operator]
        return lambda now: join(left(now), right(now))

    def _stream(self, node: Temporal | Step) -> Callable[[Value], Value]:
        if isinstance(node, Temporal):
            least = node.operator == "historically"
            if node.window is None:
                return Running(least=least)
            return Sliding(*in_samples(node.window, self.time_step), least=least)
        if node.operator in ("prev", "strong_prev"):
            return Delay(1, TOP if node.operator == "prev" else BOTTOM)
        before = Delay(1, TOP)  # neither the operand nor, for fall, its opposite held before
        if node.operator == "rise":
            return lambda value: min(before(negated(value)), value)
        return lambda value: min(before(value), negated(value))

    def _since(self, node: TemporalPair) -> Callable[[Value, Value], Value]:
        if node.window is None:
            return Since()
        return SinceWithin(*in_samples(node.window, self.time_step))


def _implies(left: Value, right: Value) -> Value:
    return max(negated(left), right)


def _iff(left: Value, right: Value) -> Value:
    return min(_implies(left, right), _implies(right, left))


_BOOLEAN: dict[BooleanOperator, Callable[[Value, Value], Value]] = {
    "and": min,
    "or": max,
    "implies": _implies,
    "iff": _iff,
    "xor": lambda left, right: negated(_iff(left, right)),
}
