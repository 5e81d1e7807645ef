"""A formula as a list of array operations, with common parts computed once.

The same formula is wanted in several modes: as far as the trace goes, at least, at most, and as
truth. They differ only where the trace ends, so that most of their steps are the same ones. A step
is computed when a value that needs it is asked for, and then kept for the trace.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from pytest_dura.requirements.stl.language.nodes import (
    FUTURE,
    Arithmetic,
    Boolean,
    Comparison,
    Constant,
    Expression,
    Function,
    Node,
    Not,
    Step,
    Temporal,
    TemporalPair,
    Window,
    walk,
)
from pytest_dura.requirements.stl.offline import steps


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
    """The steps of one formula; they grow with the modes that are asked for.

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
        """Where the values of a part of the formula are found, shape ``(..., n)``."""
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
                one = stack.pop()
                if one not in needed:
                    needed.add(one)
                    stack.extend(self._steps[one][1])
            # A step's inputs were added before it.
            order = [(one, self._steps[one]) for one in sorted(needed)]
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
            inputs_causal = all(self._causal[one] for one in inputs)
            self._causal.append(inputs_causal and kernel not in _AHEAD)
        return slot

    def _compiled(self, node: Node, mode: Mode) -> int:
        if isinstance(node, Comparison):
            return self._comparison(node, mode)
        if isinstance(node, Not):
            return self._add(steps.negation, self.slot(node.operand, mode.flipped()))
        if isinstance(node, Boolean):
            return self._boolean(node, mode)
        if isinstance(node, Temporal):
            return self._temporal(node, mode)
        if isinstance(node, TemporalPair):
            return self._pair(node, mode)
        return self._step(node, mode)

    def _comparison(self, node: Comparison, mode: Mode) -> int:
        sides = self._expression(node.left), self._expression(node.right)
        found = self._add(steps.margin, *sides, options=(node.operator,))
        if mode.truth:
            on_bound = node.operator in (">=", "<=", "==")
            return self._add(steps.truth, found, options=(on_bound,))
        return found

    def _expression(self, node: Expression) -> int:
        if isinstance(node, Arithmetic):
            sides = self._expression(node.left), self._expression(node.right)
            return self._add(steps.arithmetic, *sides, options=(node,))
        if isinstance(node, Function):
            return self._add(steps.function, self._expression(node.operand), options=(node,))
        if isinstance(node, Constant):
            return self._add(steps.constant, options=(np.float64(node.value),))
        return self._add(steps.column, options=(node.name,))

    def _boolean(self, node: Boolean, mode: Mode) -> int:
        left, right = self.slot(node.left, mode), self.slot(node.right, mode)
        if node.operator == "and":
            return self._join(np.minimum, left, right)
        if node.operator == "or":
            return self._join(np.maximum, left, right)
        not_left = self._add(steps.negation, self.slot(node.left, mode.flipped()))
        if node.operator == "implies":
            return self._join(np.maximum, not_left, right)
        not_right = self._add(steps.negation, self.slot(node.right, mode.flipped()))
        if node.operator == "iff":
            forth = self._join(np.maximum, not_left, right)
            return self._join(np.minimum, forth, self._join(np.maximum, not_right, left))
        only_left = self._join(np.minimum, left, not_right)
        return self._join(np.maximum, only_left, self._join(np.minimum, right, not_left))

    def _join(self, join: np.ufunc, left: int, right: int) -> int:
        return self._add(steps.joined, left, right, options=(join,))

    def _temporal(self, node: Temporal, mode: Mode) -> int:
        join = np.minimum if node.operator in ("always", "historically") else np.maximum
        ahead = node.operator in FUTURE
        # An unknown sample shows where it can pull the minimum down or the maximum up.
        shows = ahead and mode.unknown == -steps.neutral(join)
        if node.window is None:
            if shows and mode.open_end:
                return self._add(steps.everywhere, options=(mode.unknown,))
            kernel = steps.running if ahead else steps.running_past
            return self._add(kernel, self.slot(node.operand, mode), options=(join,))
        first, last = self.samples(node.window)
        sliding = steps.sliding if ahead else steps.sliding_past
        operand = self.slot(node.operand, mode)
        found = self._add(sliding, operand, options=(join, first, last))
        if shows and last > 0:
            return self._add(steps.open_tail, found, options=(last, mode.unknown))
        return found

    def _pair(self, node: TemporalPair, mode: Mode) -> int:
        left, right = self.slot(node.left, mode), self.slot(node.right, mode)
        bounds: tuple[int, int | None] = (0, None)
        if node.window is not None:
            bounds = self.samples(node.window)
        if node.operator == "since":
            return self._add(steps.since, left, right, options=bounds)
        found = self._add(steps.until, left, right, options=bounds)
        last = bounds[1]
        if mode.unknown == math.inf and (mode.open_end if last is None else last > 0):
            least = self._add(steps.running, left, options=(np.minimum,))
            return self._add(steps.until_beyond, found, least, options=(last,))
        return found

    def _step(self, node: Step, mode: Mode) -> int:
        operand = self.slot(node.operand, mode)
        if node.operator in ("next", "strong_next"):
            end = math.inf if node.operator == "next" else -math.inf
            end = end if mode.unknown is None else mode.unknown
            return self._add(steps.following, operand, options=(end,))
        if node.operator in ("prev", "strong_prev"):
            start = math.inf if node.operator == "prev" else -math.inf
            return self._add(steps.preceding, operand, options=(start,))
        negated = self._add(steps.negation, self.slot(node.operand, mode.flipped()))
        # Before the trace nothing was: neither the formula nor, for fall, its opposite.
        if node.operator == "rise":
            before = self._add(steps.preceding, negated, options=(math.inf,))
            return self._join(np.minimum, before, operand)
        before = self._add(steps.preceding, operand, options=(math.inf,))
        return self._join(np.minimum, before, negated)


def _depends_on_the_end(node: Node, open_end: bool) -> bool:
    """Whether the formula looks behind the last sample, and may see something there."""
    for one in walk(node):
        if isinstance(one, Step) and one.operator in FUTURE:
            return True
        if isinstance(one, (Temporal, TemporalPair)):
            sees = open_end or one.window is not None
            if sees and one.operator in FUTURE:
                return True
    return False


_AHEAD = (
    steps.everywhere,
    steps.sliding,
    steps.running,
    steps.until,
    steps.until_beyond,
    steps.open_tail,
    steps.following,
)
