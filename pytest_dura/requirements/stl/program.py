"""A formula as a list of array operations, with common parts computed once.

A formula is evaluated in several modes: as far as the trace goes, at least, at most, and as truth.
They differ only where the trace ends, and share most of their steps. A step is computed when a
value first depends on it, once for each trace.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property, lru_cache
from threading import RLock
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.requirements.stl import windows
from pytest_dura.requirements.stl.formula import (
    FUTURE,
    ON_BOUND,
    Arithmetic,
    Boolean,
    Comparison,
    Constant,
    Expression,
    Formula,
    Function,
    Node,
    Not,
    Signal,
    Step,
    Temporal,
    TemporalPair,
    Window,
    check_time_step,
    children,
    conjuncts,
    in_samples,
    node_text,
    operator_of,
    walk,
)
from pytest_dura.requirements.stl.uncertainty import BOUNDS, bound_column
from pytest_dura.requirements.stl.windows import Array, Frame, first_not_finite

_FRAME = -1
"""Slot of the frame, for steps that need more than values."""


def _column(frame: Frame, name: str) -> Array:
    return frame.columns[name]


def _everywhere(value: Array | float, frame: Frame) -> Array:
    return np.full(frame.shape, value)


def _finite(values: Array, frame: Frame, node: Arithmetic | Function) -> Array:
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


def _truth(margins: Array, on_bound: bool) -> Array:
    """+1 where a comparison holds and -1 elsewhere; ``on_bound`` is its truth at margin zero.

    The difference of two distinct numbers is never zero (IEEE 754), and never NaN for finite ones.
    """
    holds = margins >= 0 if on_bound else margins > 0
    return np.where(holds, 1.0, -1.0)


def _until_beyond(known: Array, least: Array, last: int | None) -> Array:
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


def _looks_ahead(kernel: Callable[..., Any]) -> bool:
    """Whether a value of the kernel may depend on later samples."""
    ahead = (windows.sliding, windows.running, windows.until, windows.open_tail, windows.following)
    return kernel in (*ahead, _everywhere, _until_beyond)


def _empty_window_value(join: np.ufunc) -> float:
    """What changes neither a minimum nor a maximum: the value of an empty window."""
    return np.inf if join is np.minimum else -np.inf


class Mode(NamedTuple):
    """What to compute of a formula.

    Args:
        unknown: What samples behind the end of the trace count as: -inf gives the least value that
            they allow, +inf the greatest. ``None`` cuts windows at the end instead. Of an uncertain
            signal +inf takes the greatest margins that its bounds allow, all else the least.
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
"""What to carry out, the slots of its inputs, and its options behind them."""


class Program:
    """The steps of one formula, compiled mode by mode as they are needed, by threads in turn.

    Args:
        root: The formula.
        time_step: Seconds from sample to sample, ``None`` for a trace of one sample.
        uncertain: Signals of which the trace has bounds, and not each sample.
    """

    def __init__(
        self, root: Node, time_step: float | None, uncertain: frozenset[str] = frozenset()
    ) -> None:
        self.root = root
        self.uncertain = uncertain
        self._time_step = time_step
        self._steps: list[Operation] = []
        self._causal: list[bool] = []
        self._numbers: dict[Operation, int] = {}
        self._slots: dict[tuple[int, Mode], int] = {}
        self._orders: dict[int, list[tuple[int, Operation]]] = {}
        self._lock = RLock()

    def slot(self, node: Node, mode: Mode) -> int:
        """Number of the step that computes a part of the formula, shape ``(..., n)``."""
        # By identity, as hashing a tree takes long; the root keeps its parts alive.
        key = (id(node), mode)
        slot = self._slots.get(key)
        if slot is not None:
            return slot
        with self._lock:
            depends = _depends_on_the_end(node, mode.open_end) or self.is_uncertain(node)
            if mode.unknown is not None and not depends:
                slot = self.slot(node, Mode(truth=mode.truth))
            else:
                slot = self._compiled(node, mode)
            self._slots[key] = slot
            return slot

    def samples(self, window: Window) -> tuple[int, int]:
        """First and last sample of a window, relative to the sample at hand."""
        if self._time_step is None:  # any other sample is outside of a trace of one
            return int(window.start > 0), int(window.end > 0)
        return in_samples(window, self._time_step)

    def order(self, slot: int) -> list[tuple[int, Operation]]:
        """The steps to carry out for the values of one slot, which comes last."""
        order = self._orders.get(slot)
        if order is None:
            needed = {_FRAME}
            stack = [slot]
            while stack:
                step = stack.pop()
                if step not in needed:
                    needed.add(step)
                    stack.extend(self._steps[step][1])
            # A step's inputs were added before it.
            order = [(step, self._steps[step]) for step in sorted(needed - {_FRAME})]
            self._orders[slot] = order
        return order

    def is_causal(self, slot: int) -> bool:
        """Whether its value at a sample does not depend on later samples."""
        return slot != _FRAME and self._causal[slot]

    def _add(self, kernel: Callable[..., Any], *inputs: int, options: tuple[Any, ...] = ()) -> int:
        step = (kernel, inputs, options)
        slot = self._numbers.get(step)
        if slot is None:
            slot = self._numbers[step] = len(self._steps)
            self._steps.append(step)
            causal = all(self._causal[slot] for slot in inputs if slot != _FRAME)
            self._causal.append(causal and not _looks_ahead(kernel))
        return slot

    def _expression(self, node: Expression) -> int:
        if isinstance(node, Signal):
            return self._add(_column, _FRAME, options=(node.name,))
        if isinstance(node, Constant):
            return self._add(np.float64, options=(node.value,))
        operands = (self._expression(operand) for operand in children(node))
        value = self._add(operator_of(node).compute, *operands)
        return self._add(_finite, value, _FRAME, options=(node,))

    def is_uncertain(self, node: Node | Expression) -> bool:
        """Whether a part reads a signal of which the trace has bounds alone."""
        return bool(self.uncertain) and any(
            isinstance(part, Signal) and part.name in self.uncertain for part in walk(node)
        )

    def _bounds(self, node: Expression | Comparison) -> tuple[int, int]:
        """Slots of the least and the greatest value of an expression, or of a margin."""
        if isinstance(node, Signal) and node.name in self.uncertain:
            least, greatest = (
                self._add(bound_column, _FRAME, options=(node.name, greatest))
                for greatest in (False, True)
            )
            return least, greatest
        if not isinstance(node, Comparison) and not self.is_uncertain(node):
            value = self._expression(node)
            return value, value
        inputs = [slot for operand in children(node) for slot in self._bounds(operand)]
        kernel = BOUNDS[operator_of(node).name]
        least, greatest = (
            self._add(kernel, *inputs, options=(greatest,)) for greatest in (False, True)
        )
        return least, greatest

    def _margins(self, node: Comparison, mode: Mode) -> int:
        if self.is_uncertain(node):
            return self._bounds(node)[mode.unknown == math.inf]
        sides = self._expression(node.left), self._expression(node.right)
        return self._add(operator_of(node).compute, *sides)

    def _compiled(self, node: Node, mode: Mode) -> int:
        if isinstance(node, Comparison):
            margins = self._margins(node, mode)
            if not any(isinstance(part, Signal) for part in walk(node)):
                margins = self._add(_everywhere, margins, _FRAME)
            truth = (node.operator in ON_BOUND,)
            return self._add(_truth, margins, options=truth) if mode.truth else margins
        if isinstance(node, Not):
            return self._negated(node.operand, mode)
        if isinstance(node, Boolean):
            return self._boolean(node, mode)
        if isinstance(node, Temporal):
            return self._temporal(node, mode)
        return self._pair(node, mode) if isinstance(node, TemporalPair) else self._step(node, mode)

    def _negated(self, node: Node, mode: Mode) -> int:
        return self._add(operator.neg, self.slot(node, mode.flipped()))

    def _boolean(self, node: Boolean, mode: Mode) -> int:
        add, least, greatest = self._add, np.minimum, np.maximum
        left, right = self.slot(node.left, mode), self.slot(node.right, mode)
        if node.operator == "and":
            return add(least, left, right)
        if node.operator == "or":
            return add(greatest, left, right)
        not_left = self._negated(node.left, mode)
        if node.operator == "implies":
            return add(greatest, not_left, right)
        not_right = self._negated(node.right, mode)
        if node.operator == "iff":
            return add(least, add(greatest, not_left, right), add(greatest, not_right, left))
        return add(greatest, add(least, left, not_right), add(least, right, not_left))

    def _temporal(self, node: Temporal, mode: Mode) -> int:
        join = np.minimum if node.operator in ("always", "historically") else np.maximum
        neutral = _empty_window_value(join)
        operand = self.slot(node.operand, mode)
        if node.operator not in FUTURE:
            if node.window is None:
                return self._running_past(node, operand, mode, join)
            bounds = self.samples(node.window)
            return self._add(windows.sliding_past, operand, options=(join, *bounds))
        # An unknown sample shows where it can pull the minimum down or the maximum up.
        shows = mode.unknown == -neutral
        if node.window is None and shows and mode.open_end:
            unknown = self._add(np.float64, options=(mode.unknown,))
            return self._add(_everywhere, unknown, _FRAME)
        if node.window is None:
            return self._add(windows.running, operand, options=(join,))
        first, last = self.samples(node.window)
        windowed = self._add(windows.sliding, operand, options=(join, first, last))
        if shows and last > 0:
            return self._add(windows.open_tail, windowed, options=(last, mode.unknown))
        return windowed

    def _running_past(self, node: Temporal, operand: int, mode: Mode, join: np.ufunc) -> int:  # noqa: ARG002 - streams need them
        return self._add(windows.running_past, operand, options=(join,))

    def _since(self, node: TemporalPair, left: int, right: int, mode: Mode) -> int:  # noqa: ARG002 - streams need them
        return self._add(windows.since, left, right, options=(0, None))

    def _pair(self, node: TemporalPair, mode: Mode) -> int:
        left, right = self.slot(node.left, mode), self.slot(node.right, mode)
        bounds: tuple[int, int | None] = (0, None)
        if node.window is not None:
            bounds = self.samples(node.window)
        if node.operator == "since" and node.window is None:
            return self._since(node, left, right, mode)
        if node.operator == "since":
            return self._add(windows.since, left, right, options=bounds)
        until = self._add(windows.until, left, right, options=bounds)
        last = bounds[1]
        if mode.unknown == math.inf and (mode.open_end if last is None else last > 0):
            least = self._add(windows.running, left, options=(np.minimum,))
            return self._add(_until_beyond, until, least, options=(last,))
        return until

    def _step(self, node: Step, mode: Mode) -> int:
        operand = self.slot(node.operand, mode)
        # Where there is no neighbour the weak operators hold, and the strong ones do not.
        edge = -math.inf if node.operator.startswith("strong_") else math.inf
        if node.operator in FUTURE:
            edge = edge if mode.unknown is None else mode.unknown
            return self._add(windows.following, operand, options=(edge,))
        if node.operator in ("prev", "strong_prev"):
            return self._add(windows.preceding, operand, options=(edge,))
        # Before the trace nothing was: neither the formula nor, for fall, its opposite.
        before, now = self._negated(node.operand, mode), operand
        if node.operator == "fall":
            before, now = now, before
        return self._add(np.minimum, self._add(windows.preceding, before, options=(math.inf,)), now)


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


class Values:
    """The values of a program on one frame, each computed at its first use.

    The caller suppresses floating-point warnings: results that are not finite are refused.
    """

    def __init__(self, program: Program, frame: Frame, known: dict[int, Any] | None = None) -> None:
        self.frame = frame
        self._program = program
        self._known: dict[int, Any] = {_FRAME: frame, **(known or {})}

    def __getitem__(self, slot: int) -> Array:
        known = self._known
        if slot not in known:
            for step, (kernel, inputs, options) in self._program.order(slot):
                if step not in known:
                    known[step] = kernel(*[known[i] for i in inputs], *options)
        values: Array = known[slot]
        return values

    def prefixes(self) -> Callable[[int], Values]:
        """A function of a length: the values on so many first samples, with those known already."""
        program, frame = self._program, self.frame
        known = [
            (slot, values)
            for slot, values in self._known.items()
            if program.is_causal(slot) and np.ndim(values)
        ]

        def prefix(size: int) -> Values:
            columns = {name: column[..., :size] for name, column in frame.columns.items()}
            shorter = replace(frame, columns=columns, shape=(*frame.shape[:-1], size))
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
        self.program = program
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

    @cached_property
    def is_uncertain(self) -> bool:
        """Whether the part reads a signal of which the trace has bounds alone."""
        return self.program.is_uncertain(self.node)

    @property
    def is_minimum(self) -> bool:
        """Whether the part is an ``always``."""
        return self._join is np.minimum

    def at_start(self, values: Values, mode: Mode) -> tuple[float, int | None]:
        """Value at the first sample, and for always and eventually the sample that has it."""
        inner = values[self.program.slot(self._inner, mode)]
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

    def __init__(
        self, formula: Formula, time_step: float | None, uncertain: frozenset[str] = frozenset()
    ) -> None:
        self.formula = formula
        self.signals = tuple(formula.signals)
        self.program = Program(formula.root, time_step, uncertain)
        self.conjuncts = tuple(Conjunct(node, self.program) for node in conjuncts(formula.root))
        self.has_implication = any(
            isinstance(node, Boolean) and node.operator == "implies" for node in walk(formula.root)
        )


@lru_cache(maxsize=512)
def plan_of(
    formula: Formula, time_step: float | None, uncertain: frozenset[str] = frozenset()
) -> Plan:
    """The plan of a formula; ``time_step=None`` is for a trace of one sample.

    ``uncertain`` names the signals of which a trace has bounds, and not each sample.

    Raises:
        ConfigurationError: For a window that is no multiple of the time step.
    """
    if time_step is not None:
        check_time_step(formula, time_step)
    return Plan(formula, time_step, uncertain)
