"""The textbook semantics of STL on sampled traces, sample by sample, as slow as it is plain.

Windows are whole numbers of samples and are cut at the first and the last sample: the least of no
samples is plus infinity, the greatest minus infinity. Robustness and satisfaction are two separate
recursions, so that neither can hide an error of the other.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from pytest_dura.requirements import (
    Arithmetic,
    Boolean,
    Comparison,
    Constant,
    Expression,
    Node,
    Not,
    Signal,
    Step,
    Temporal,
    TemporalPair,
)

Trace = Mapping[str, Sequence[float]]

_ARITHMETIC: dict[str, Callable[[float, float], float]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
    "pow": math.pow,
}
_COMPARE: dict[str, Callable[[float, float], bool]] = {
    ">": operator.gt,
    ">=": operator.ge,
    "<": operator.lt,
    "<=": operator.le,
    "==": operator.eq,
    "!=": operator.ne,
}
_MARGIN: dict[str, Callable[[float, float], float]] = {
    ">": lambda a, b: a - b,
    ">=": lambda a, b: a - b,
    "<": lambda a, b: b - a,
    "<=": lambda a, b: b - a,
    "==": lambda a, b: -abs(a - b),
    "!=": lambda a, b: abs(a - b),
}
_FUNCTIONS: dict[str, Callable[[float], float]] = {"abs": abs, "sqrt": math.sqrt, "exp": math.exp}


def robustness(node: Node, trace: Trace, time_step: float) -> list[float]:
    """Margin at each sample."""
    size = _size(trace)
    return [_margin(node, trace, time_step, at, size) for at in range(size)]


def satisfaction(node: Node, trace: Trace, time_step: float) -> list[bool]:
    """Whether the formula holds at each sample."""
    size = _size(trace)
    return [_holds(node, trace, time_step, at, size) for at in range(size)]


def _size(trace: Trace) -> int:
    return len(next(iter(trace.values())))


def value(expression: Expression, trace: Trace, at: int) -> float:
    """The expression's value at one sample."""
    if isinstance(expression, Signal):
        return float(trace[expression.name][at])
    if isinstance(expression, Constant):
        return expression.value
    if isinstance(expression, Arithmetic):
        left, right = value(expression.left, trace, at), value(expression.right, trace, at)
        return _ARITHMETIC[expression.operator](left, right)
    return _FUNCTIONS[expression.name](value(expression.operand, trace, at))


def samples(node: Temporal | TemporalPair, at: int, size: int, step: float) -> list[int]:
    """Samples in the operator's window, nearest first, cut at the ends of the trace."""
    first, last = 0, size
    if node.window is not None:
        first, last = round(node.window.start / step), round(node.window.end / step)
    direction = 1 if node.operator in ("always", "eventually", "until") else -1
    reached = [at + direction * offset for offset in range(first, min(last, size) + 1)]
    return [one for one in reached if 0 <= one < size]


def _margin(node: Node, trace: Trace, step: float, at: int, size: int) -> float:
    def of(part: Node, when: int) -> float:
        return _margin(part, trace, step, when, size)

    if isinstance(node, Comparison):
        return _MARGIN[node.operator](value(node.left, trace, at), value(node.right, trace, at))
    if isinstance(node, Not):
        return -of(node.operand, at)
    if isinstance(node, Boolean):
        return _joined(node.operator, of(node.left, at), of(node.right, at))
    if isinstance(node, Temporal):
        found = [of(node.operand, one) for one in samples(node, at, size, step)]
        least = node.operator in ("always", "historically")
        return min(found, default=math.inf) if least else max(found, default=-math.inf)
    if isinstance(node, TemporalPair):
        return max(
            (
                min([of(node.right, one), *(of(node.left, k) for k in _between(node, at, one))])
                for one in samples(node, at, size, step)
            ),
            default=-math.inf,
        )
    ends = (at == 0, at == size - 1)
    return float(_step(node, at, ends, of, (math.inf, -math.inf, operator.neg)))


def _joined(name: str, left: float, right: float) -> float:
    both = min(max(-left, right), max(-right, left))
    return {
        "and": min(left, right),
        "or": max(left, right),
        "implies": max(-left, right),
        "iff": both,
        "xor": -both,
    }[name]


def _holds(node: Node, trace: Trace, step: float, at: int, size: int) -> bool:
    def of(part: Node, when: int) -> bool:
        return _holds(part, trace, step, when, size)

    if isinstance(node, Comparison):
        return _COMPARE[node.operator](value(node.left, trace, at), value(node.right, trace, at))
    if isinstance(node, Not):
        return not of(node.operand, at)
    if isinstance(node, Boolean):
        left, right = of(node.left, at), of(node.right, at)
        return {
            "and": left and right,
            "or": left or right,
            "implies": not left or right,
            "iff": left == right,
            "xor": left != right,
        }[node.operator]
    if isinstance(node, Temporal):
        found = [of(node.operand, one) for one in samples(node, at, size, step)]
        return all(found) if node.operator in ("always", "historically") else any(found)
    if isinstance(node, TemporalPair):
        return any(
            of(node.right, one) and all(of(node.left, k) for k in _between(node, at, one))
            for one in samples(node, at, size, step)
        )
    ends = (at == 0, at == size - 1)
    return bool(_step(node, at, ends, of, (True, False, operator.not_)))


def _between(node: TemporalPair, at: int, right: int) -> range:
    """From the sample at hand up to, and without, the one where the right side is read."""
    return range(at, right) if node.operator == "until" else range(right + 1, at + 1)


def _step(
    node: Step,
    at: int,
    ends: tuple[bool, bool],
    of: Callable[[Node, int], Any],
    algebra: tuple[Any, Any, Callable[[Any], Any]],
) -> Any:
    """The operators of one step, over margins or over truth values: top, bottom and negation.

    ``ends`` tells whether the sample is the first, and whether it is the last.
    """
    (first, last), (top, bottom, negate) = ends, algebra
    if node.operator in ("next", "strong_next"):
        missing = top if node.operator == "next" else bottom
        return missing if last else of(node.operand, at + 1)
    if node.operator in ("prev", "strong_prev"):
        missing = top if node.operator == "prev" else bottom
        return missing if first else of(node.operand, at - 1)
    # Before the trace nothing rose or fell yet: the first sample counts as a change to its value.
    now = of(node.operand, at)
    if node.operator == "rise":
        return min(negate(bottom if first else of(node.operand, at - 1)), now)
    return min(top if first else of(node.operand, at - 1), negate(now))
