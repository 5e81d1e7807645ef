"""A formula as a list of array operations, with common parts computed once.

A formula is evaluated in several modes: as far as the trace goes, at least, at most, and as truth.
They differ only where the trace ends, and share most of their steps. A step is computed when a
value first depends on it, once for each trace.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property, lru_cache
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.requirements.stl import windows
from pytest_dura.requirements.stl.formula import (
    FUTURE,
    Arithmetic,
    ArithmeticOperator,
    Boolean,
    Comparison,
    ComparisonOperator,
    Constant,
    Expression,
    Formula,
    Function,
    FunctionName,
    Node,
    Not,
    Step,
    Temporal,
    TemporalPair,
    Window,
    check_time_step,
    conjuncts,
    node_text,
    walk,
)
from pytest_dura.requirements.stl.windows import Array, Frame, first_not_finite

_ARITHMETIC: dict[ArithmeticOperator, np.ufunc] = {
    "+": np.add,
    "-": np.subtract,
    "*": np.multiply,
    "/": np.divide,
    "pow": np.power,
}
FUNCTIONS: dict[FunctionName, np.ufunc] = {"abs": np.abs, "sqrt": np.sqrt, "exp": np.exp}


def _column_step(frame: Frame, name: str) -> Array:
    return frame.columns[name]


def _constant_step(_frame: Frame, value: np.float64) -> np.float64:
    return value


def _arithmetic_step(frame: Frame, left: Array, right: Array, node: Arithmetic) -> Array:
    return _finite(frame, _ARITHMETIC[node.operator](left, right), node)


def _function_step(frame: Frame, operand: Array, node: Function) -> Array:
    return _finite(frame, FUNCTIONS[node.name](operand), node)


def _finite(frame: Frame, values: Array, node: Arithmetic | Function) -> Array:
    if not np.isfinite(values).all():
        whole = np.broadcast_to(values, frame.shape)
        index = first_not_finite(whole)
        raise ConfigurationError(
            f"the expression `{node_text(node)}` is not finite {frame.place(index)}",
            found=float(whole[index]),
            expected="finite values",
            remedy="guard it, as by a signal that the simulator saturates at a declared cap",
        )
    return values


def _margin_step(frame: Frame, left: Array, right: Array, operator: ComparisonOperator) -> Array:
    """How far a comparison is from its bound, positive where it holds.

    The difference of two distinct numbers is never zero (IEEE 754), and never NaN for finite ones.
    """
    difference = right - left if operator[0] == "<" else left - right
    if operator == "==":
        difference = -np.abs(difference)
    elif operator == "!=":
        difference = np.abs(difference)
    if np.ndim(difference) == 0:  # two constants
        return np.full(frame.shape, difference)
    return difference


def _truth_step(_frame: Frame, margins: Array, on_bound: bool) -> Array:
    """+1 where a comparison holds and -1 elsewhere; ``on_bound`` is its truth at margin zero."""
    holds = margins >= 0 if on_bound else margins > 0
    return np.where(holds, 1.0, -1.0)


def _negation_step(_frame: Frame, values: Array) -> Array:
    return -values


def _joined_step(_frame: Frame, left: Array, right: Array, join: np.ufunc) -> Array:
    joined: Array = join(left, right)
    return joined


def _everywhere_step(frame: Frame, value: float) -> Array:
    return np.full(frame.shape, value)


def _sliding_step(frame: Frame, values: Array, join: np.ufunc, first: int, last: int) -> Array:
    return windows.sliding(join, frame.ended(values, _empty_window_value(join)), first, last)


def _sliding_past_step(
    _frame: Frame, values: Array, join: np.ufunc, first: int, last: int
) -> Array:
    return windows.sliding_past(join, values, first, last)


def _running_step(frame: Frame, values: Array, join: np.ufunc) -> Array:
    return windows.running(join, frame.ended(values, _empty_window_value(join)))


def _running_past_step(_frame: Frame, values: Array, join: np.ufunc) -> Array:
    return windows.running_past(join, values)


def _until_step(frame: Frame, left: Array, right: Array, first: int, last: int | None) -> Array:
    """See ``windows.until``; nothing holds behind the end, whatever the left side is there."""
    return windows.until(left, frame.ended(right, -np.inf), first, last)


def _since_step(_frame: Frame, left: Array, right: Array, first: int, last: int | None) -> Array:
    return windows.since(left, right, first, last)


def _until_beyond_step(_frame: Frame, known: Array, least: Array, last: int | None) -> Array:
    """Greatest value of ``until`` if its right side may hold behind the end.

    Args:
        known: Its value as far as the trace goes.
        least: Minimum of the left side from each sample to the end.
        last: Last sample of the window, ``None`` for one without end.
    """
    cut = 0 if last is None else max(known.shape[-1] - last, 0)
    values: Array = known.copy()
    np.maximum(known[..., cut:], least[..., cut:], out=values[..., cut:])
    return values


def _open_tail_step(_frame: Frame, values: Array, last: int, unknown: float) -> Array:
    return windows.open_tail(values, last, unknown)


def _following_step(frame: Frame, values: Array, end: float) -> Array:
    return windows.following(frame.ended(values, end), end)


def _preceding_step(_frame: Frame, values: Array, start: float) -> Array:
    return windows.preceding(values, start)


def _empty_window_value(join: np.ufunc) -> float:
    """What changes neither a minimum nor a maximum: the value of an empty window."""
    return np.inf if join is np.minimum else -np.inf


class Mode(NamedTuple):
    """What to compute of a formula.

    Args:
        unknown: What samples behind the end of the trace count as: -inf gives the least value that
            they allow, +inf the greatest. ``None`` cuts windows at the end instead.
        open_end: Whether further samples may follow, for operators without a window.
        truth: Whether comparisons count as +1 or -1 and not by their margin.
    """

    unknown: float | None = None
    open_end: bool = False
    truth: bool = False

    def flipped(self) -> Mode:
        """The mode of what is negated: its greatest value gives the least of the negation."""
        return self if self.unknown is None else self._replace(unknown=-self.unknown)


TRUNCATED = Mode()

Operation: TypeAlias = tuple[Callable[..., Any], tuple[int, ...], tuple[Any, ...]]
"""What to carry out, the slots of its inputs, and its options."""


class Program:
    """The steps of one formula, compiled mode by mode as they are needed.

    Args:
        root: The formula.
        time_step: Seconds from sample to sample, ``None`` for a trace of one sample.
    """

    def __init__(self, root: Node, time_step: float | None) -> None:
        self.root = root
        self._time_step = time_step
        self._steps: list[Operation] = []
        self._causal: list[bool] = []
        self._numbers: dict[Operation, int] = {}
        self._slots: dict[tuple[int, Mode], int] = {}
        self._orders: dict[int, list[tuple[int, Operation]]] = {}

    def slot(self, node: Node, mode: Mode) -> int:
        """Number of the step that computes a part of the formula, shape ``(..., n)``."""
        # By identity, as hashing a tree takes long; the root keeps its parts alive.
        key = (id(node), mode)
        slot = self._slots.get(key)
        if slot is None:
            if mode.unknown is not None and not _depends_on_the_end(node, mode.open_end):
                slot = self.slot(node, Mode(truth=mode.truth))
            else:
                slot = self._compiled(node, mode)
            self._slots[key] = slot
        return slot

    def samples(self, window: Window) -> tuple[int, int]:
        """First and last sample of a window, relative to the sample at hand."""
        if self._time_step is None:  # any other sample is outside of a trace of one
            return int(window.start > 0), int(window.end > 0)
        return round(window.start / self._time_step), round(window.end / self._time_step)

    def order(self, slot: int) -> list[tuple[int, Operation]]:
        """The steps to carry out for the values of one slot, which comes last."""
        order = self._orders.get(slot)
        if order is None:
            needed: set[int] = set()
            stack = [slot]
            while stack:
                step = stack.pop()
                if step not in needed:
                    needed.add(step)
                    stack.extend(self._steps[step][1])
            # A step's inputs were added before it.
            order = [(step, self._steps[step]) for step in sorted(needed)]
            self._orders[slot] = order
        return order

    def is_causal(self, slot: int) -> bool:
        """Whether its value at a sample does not depend on later samples."""
        return self._causal[slot]

    def _add(self, kernel: Callable[..., Any], *inputs: int, options: tuple[Any, ...] = ()) -> int:
        operation = (kernel, inputs, options)
        slot = self._numbers.get(operation)
        if slot is None:
            slot = self._numbers[operation] = len(self._steps)
            self._steps.append(operation)
            inputs_causal = all(self._causal[slot] for slot in inputs)
            self._causal.append(inputs_causal and kernel not in _AHEAD)
        return slot

    def _compiled(self, node: Node, mode: Mode) -> int:
        if isinstance(node, Comparison):
            return self._comparison(node, mode)
        if isinstance(node, Not):
            return self._add(_negation_step, self.slot(node.operand, mode.flipped()))
        if isinstance(node, Boolean):
            return self._boolean(node, mode)
        if isinstance(node, Temporal):
            return self._temporal(node, mode)
        if isinstance(node, TemporalPair):
            return self._pair(node, mode)
        return self._step(node, mode)

    def _comparison(self, node: Comparison, mode: Mode) -> int:
        sides = self._expression(node.left), self._expression(node.right)
        margins = self._add(_margin_step, *sides, options=(node.operator,))
        if mode.truth:
            on_bound = node.operator in (">=", "<=", "==")
            return self._add(_truth_step, margins, options=(on_bound,))
        return margins

    def _expression(self, node: Expression) -> int:
        if isinstance(node, Arithmetic):
            sides = self._expression(node.left), self._expression(node.right)
            return self._add(_arithmetic_step, *sides, options=(node,))
        if isinstance(node, Function):
            return self._add(_function_step, self._expression(node.operand), options=(node,))
        if isinstance(node, Constant):
            return self._add(_constant_step, options=(np.float64(node.value),))
        return self._add(_column_step, options=(node.name,))

    def _boolean(self, node: Boolean, mode: Mode) -> int:
        left, right = self.slot(node.left, mode), self.slot(node.right, mode)
        if node.operator == "and":
            return self._join(np.minimum, left, right)
        if node.operator == "or":
            return self._join(np.maximum, left, right)
        not_left = self._add(_negation_step, self.slot(node.left, mode.flipped()))
        if node.operator == "implies":
            return self._join(np.maximum, not_left, right)
        not_right = self._add(_negation_step, self.slot(node.right, mode.flipped()))
        if node.operator == "iff":
            forth = self._join(np.maximum, not_left, right)
            return self._join(np.minimum, forth, self._join(np.maximum, not_right, left))
        only_left = self._join(np.minimum, left, not_right)
        return self._join(np.maximum, only_left, self._join(np.minimum, right, not_left))

    def _join(self, join: np.ufunc, left: int, right: int) -> int:
        return self._add(_joined_step, left, right, options=(join,))

    def _temporal(self, node: Temporal, mode: Mode) -> int:
        join = np.minimum if node.operator in ("always", "historically") else np.maximum
        ahead = node.operator in FUTURE
        # An unknown sample shows where it can pull the minimum down or the maximum up.
        shows = ahead and mode.unknown == -_empty_window_value(join)
        if node.window is None:
            if shows and mode.open_end:
                return self._add(_everywhere_step, options=(mode.unknown,))
            kernel = _running_step if ahead else _running_past_step
            return self._add(kernel, self.slot(node.operand, mode), options=(join,))
        first, last = self.samples(node.window)
        sliding = _sliding_step if ahead else _sliding_past_step
        operand = self.slot(node.operand, mode)
        windowed = self._add(sliding, operand, options=(join, first, last))
        if shows and last > 0:
            return self._add(_open_tail_step, windowed, options=(last, mode.unknown))
        return windowed

    def _pair(self, node: TemporalPair, mode: Mode) -> int:
        left, right = self.slot(node.left, mode), self.slot(node.right, mode)
        bounds: tuple[int, int | None] = (0, None)
        if node.window is not None:
            bounds = self.samples(node.window)
        if node.operator == "since":
            return self._add(_since_step, left, right, options=bounds)
        until = self._add(_until_step, left, right, options=bounds)
        last = bounds[1]
        if mode.unknown == math.inf and (mode.open_end if last is None else last > 0):
            least = self._add(_running_step, left, options=(np.minimum,))
            return self._add(_until_beyond_step, until, least, options=(last,))
        return until

    def _step(self, node: Step, mode: Mode) -> int:
        operand = self.slot(node.operand, mode)
        if node.operator in ("next", "strong_next"):
            end = math.inf if node.operator == "next" else -math.inf
            end = end if mode.unknown is None else mode.unknown
            return self._add(_following_step, operand, options=(end,))
        if node.operator in ("prev", "strong_prev"):
            start = math.inf if node.operator == "prev" else -math.inf
            return self._add(_preceding_step, operand, options=(start,))
        negated = self._add(_negation_step, self.slot(node.operand, mode.flipped()))
        # Before the trace nothing was: neither the formula nor, for fall, its opposite.
        if node.operator == "rise":
            before = self._add(_preceding_step, negated, options=(math.inf,))
            return self._join(np.minimum, before, operand)
        before = self._add(_preceding_step, operand, options=(math.inf,))
        return self._join(np.minimum, before, negated)


def _depends_on_the_end(node: Node, open_end: bool) -> bool:
    """Whether the formula looks behind the last sample, and may see something there."""
    for part in walk(node):
        if isinstance(part, Step) and part.operator in FUTURE:
            return True
        if isinstance(part, (Temporal, TemporalPair)):
            sees = open_end or part.window is not None
            if sees and part.operator in FUTURE:
                return True
    return False


_AHEAD = (
    _everywhere_step,
    _sliding_step,
    _running_step,
    _until_step,
    _until_beyond_step,
    _open_tail_step,
    _following_step,
)


class Values:
    """The values of a program on one frame, each computed at its first use.

    The caller suppresses floating-point warnings: results that are not finite are refused.
    """

    def __init__(self, program: Program, frame: Frame, known: dict[int, Any] | None = None) -> None:
        self.frame = frame
        self._program = program
        self._known: dict[int, Any] = known or {}

    def __getitem__(self, slot: int) -> Array:
        known = self._known
        if slot not in known:
            frame = self.frame
            for step, (kernel, inputs, options) in self._program.order(slot):
                if step not in known:
                    known[step] = kernel(frame, *[known[i] for i in inputs], *options)
        values: Array = known[slot]
        return values

    def prefixes(self) -> Callable[[int], Values]:
        """A function of a length: the values on so many first samples, with those known already."""
        program, frame = self._program, self.frame
        known = [
            (slot, values)
            for slot, values in self._known.items()
            if np.ndim(values) and program.is_causal(slot)
        ]

        def prefix(size: int) -> Values:
            columns = {name: column[..., :size] for name, column in frame.columns.items()}
            shape = (*frame.shape[:-1], size)
            shorter = Frame(columns, shape, frame.time_step, frame.times)
            cut = {slot: values[..., :size] for slot, values in known}
            return Values(program, shorter, cut)

        return prefix


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
        """Value at the first sample, and for always and eventually the sample that has it."""
        inner = values[self._program.slot(self._inner, mode)]
        if self._join is None:
            return float(inner[0]), None
        size = len(inner)
        first, last, cut = 0, size - 1, mode.open_end
        if self._window is not None:
            first, last = self._window
            cut = last >= size
        if first >= size:
            value, index = _empty_window_value(self._join), size - 1
        else:
            seen = inner[first : last + 1]
            index = first + int(seen.argmin() if self.is_minimum else seen.argmax())
            value = float(inner[index])
        if cut and mode.unknown is not None:
            value = float(self._join(value, mode.unknown))
        return value, index


class Plan:
    """A formula, compiled for one time step.

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


@lru_cache(maxsize=512)
def plan_of(formula: Formula, time_step: float | None) -> Plan:
    """The plan of a formula; ``time_step=None`` is for a trace of one sample.

    Raises:
        ConfigurationError: For a window that is no multiple of the time step.
    """
    if time_step is not None:
        check_time_step(formula, time_step)
    return Plan(formula, time_step)
