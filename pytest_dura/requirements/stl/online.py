"""Online monitoring: formulas that look back, judged sample by sample while an episode runs.

A value is a pair of margin and truth. Pairs are ordered by margin, then by truth; the truth of a
margin of zero depends on the comparison that gave it (``>=`` or ``>``), and elsewhere it is the
margin's sign. So the least of several pairs has the least margin and is true if all are, and the
greatest is true if one is: minimum and maximum carry the robustness and the Boolean verdict alike.

Each operator is called once per sample and in amortised constant time. What was before the first
sample is as in ``windows``: a window is cut there, and an empty one gives :data:`TOP` for "at all
samples" and :data:`BOTTOM` for "at some sample".
"""

from __future__ import annotations

import difflib
import math
import operator
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from operator import itemgetter
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.requirements.stl.formula import (
    ON_BOUND,
    BooleanOperator,
    Comparison,
    Constant,
    Expression,
    Formula,
    Node,
    Not,
    Signal,
    Step,
    Temporal,
    TemporalPair,
    check_time_step,
    children,
    in_samples,
    marked,
    node_text,
    operator_of,
    past_only_or_refuse,
    walk,
)

Value: TypeAlias = tuple[float, bool]
"""Margin, and whether it holds."""

TOP: Value = (math.inf, True)
BOTTOM: Value = (-math.inf, False)


def negated(value: Value) -> Value:
    """The value of the negated formula."""
    margin, holds = value
    return -margin, not holds


class Delay:
    """The value of some samples ago.

    Args:
        samples: How many; 0 gives the value itself.
        start: The value before the first sample.
    """

    def __init__(self, samples: int, start: Value) -> None:
        self._samples, self._start = samples, start
        self._held: deque[Value] = deque()

    def __call__(self, value: Value) -> Value:
        """Take the next value."""
        self._held.append(value)
        return self._held.popleft() if len(self._held) > self._samples else self._start


class Running:
    """The least, or the greatest, of all values so far."""

    def __init__(self, *, least: bool) -> None:
        self._join = min if least else max
        self._extreme = TOP if least else BOTTOM

    def __call__(self, value: Value) -> Value:
        """Take the next value."""
        self._extreme = self._join(self._extreme, value)
        return self._extreme


class Sliding:
    """The least, or the greatest, of the values from ``last`` to ``first`` samples ago.

    A queue holds the values that may still be an answer, the present one at its head: those with
    none at least as good behind them (Lemire, "Streaming maximum-minimum filter using no more than
    three comparisons per element", 2006). Each enters and leaves once.
    """

    def __init__(self, first: int, last: int, *, least: bool) -> None:
        self._delay = Delay(first, TOP if least else BOTTOM)
        self._covers = operator.le if least else operator.ge
        self._width = last - first + 1
        self._queue: deque[tuple[int, Value]] = deque()
        self._index = 0

    def __call__(self, value: Value) -> Value:
        """Take the next value."""
        queue, covers = self._queue, self._covers
        entering = self._delay(value)
        while queue and covers(entering, queue[-1][1]):
            queue.pop()
        queue.append((self._index, entering))
        if queue[0][0] <= self._index - self._width:
            queue.popleft()
        self._index += 1
        return queue[0][1]


class Since:
    """``left since right``: the best sample so far for ``right``, with ``left`` at all after it."""

    def __init__(self) -> None:
        self._best = BOTTOM

    def __call__(self, left: Value, right: Value) -> Value:
        """Take the next two values."""
        self._best = max(right, min(left, self._best))
        return self._best


class SinceWithin:
    """``since`` with a window: the sample for ``right`` lies ``last`` to ``first`` samples ago.

    ``p since[a:b] q`` is ``(once[a:b] q) and (p since[a:oo] q)``: if ``q`` held within the window,
    and ``p`` since some ``q`` before it, then ``p`` held since the ``q`` within it, too (Donzé,
    Ferrère, Maler, "Efficient Robust Monitoring for STL", 2013, lemma 3, mirrored). And ``p
    since[a:oo] q`` is ``p since q`` of ``a`` samples ago with ``p`` at all samples after that.
    Minimum and maximum distribute over each other, so that both hold for margins as for truth.
    """

    def __init__(self, first: int, last: int) -> None:
        self._since = Since()
        self._before_window = Delay(first, BOTTOM)
        self._left_since = Sliding(0, first - 1, least=True) if first else None
        self._within = Sliding(first, last, least=False)

    def __call__(self, left: Value, right: Value) -> Value:
        """Take the next two values."""
        before_window = self._before_window(self._since(left, right))
        left_since = TOP if self._left_since is None else self._left_since(left)
        return min(before_window, left_since, self._within(right))


Samples: TypeAlias = Mapping[str, float]
"""The finite value of each signal."""


class NotFiniteError(Exception):
    """An expression without a finite value at the sample at hand."""

    def __init__(self, node: Expression, value: float) -> None:
        super().__init__(f"{node} is {value}")
        self.node, self.value = node, value


def comparison(node: Comparison) -> Callable[[Samples], Value]:
    """Margin and truth of a comparison, as a function of the samples.

    The function raises :class:`NotFiniteError`.
    """
    left, right = expression(node.left), expression(node.right)
    margin = operator_of(node).compute
    on_bound = node.operator in ON_BOUND

    def compared(samples: Samples) -> Value:
        value = margin(left(samples), right(samples))
        return value, value > 0.0 or (on_bound and value == 0.0)

    return compared


def expression(node: Expression) -> Callable[[Samples], float]:
    """An expression as a function of the samples, which raises :class:`NotFiniteError`."""
    if isinstance(node, Signal):
        return itemgetter(node.name)
    if isinstance(node, Constant):
        constant = node.value
        return lambda _samples: constant
    operands = [expression(operand) for operand in children(node)]
    compute = operator_of(node).compute
    if isinstance(compute, np.ufunc):
        # Computed as for requirements; what only plain floats do, every computer rounds alike.
        compute = np.errstate(all="ignore")(compute)

    def computed(samples: Samples) -> float:
        try:
            value = compute(*[operand(samples) for operand in operands])
        except ZeroDivisionError:
            value = math.nan
        if not math.isfinite(value):
            raise NotFiniteError(node, float(value))
        return float(value)

    return computed


Judged: TypeAlias = Callable[[Sequence[Value]], Value]
"""A part of a formula: its value at this sample, from the values of all comparisons."""


class Sample(NamedTuple):
    """Value of a formula at one sample: its margin, and whether it holds."""

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
        what: The user of the formula, for the message that refuses operators that look ahead.

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
        # Everything that can fail comes first: operators with a state see a whole sample or none.
        try:
            root = self._root([compared(samples) for compared in self._comparisons])
        except NotFiniteError as error:
            raise self._not_finite(f"expression `{node_text(error.node)}`", error.value) from None
        self._index += 1
        return Sample(*root)

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
