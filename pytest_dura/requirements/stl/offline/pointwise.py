"""Comparisons at one sample, in plain arithmetic: for a single one that is quicker than arrays."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping
from operator import itemgetter
from typing import TypeAlias

import numpy as np

from pytest_dura.requirements.stl.language.nodes import (
    Arithmetic,
    ArithmeticOperator,
    Comparison,
    ComparisonOperator,
    Constant,
    Expression,
    Function,
    FunctionName,
    Signal,
)
from pytest_dura.requirements.stl.online.streams import Value

Samples: TypeAlias = Mapping[str, float]
"""The finite value of each signal."""


class NotFiniteError(Exception):
    """An expression without a finite value at the sample at hand."""

    def __init__(self, node: Arithmetic | Function, value: float) -> None:
        super().__init__(f"{node} is {value}")
        self.node, self.value = node, value


def comparison(node: Comparison) -> Callable[[Samples], Value]:
    """Margin and truth of a comparison, as a function of the samples.

    The function raises :class:`NotFiniteError`.
    """
    left, right = expression(node.left), expression(node.right)
    margin, on_bound = _MARGINS[node.operator], node.operator in (">=", "<=", "==")

    def compared(samples: Samples) -> Value:
        found = margin(left(samples), right(samples))
        return found, found > 0.0 or (on_bound and found == 0.0)

    return compared


def expression(node: Expression) -> Callable[[Samples], float]:
    """An expression as a function of the samples, which raises :class:`NotFiniteError`."""
    if isinstance(node, Signal):
        return itemgetter(node.name)
    if isinstance(node, Constant):
        value = node.value
        return lambda _samples: value
    if isinstance(node, Function):
        operand, function = expression(node.operand), _FUNCTIONS[node.name]
        return _finite(node, lambda samples: function(operand(samples)))
    left, right = expression(node.left), expression(node.right)
    join = _ARITHMETIC[node.operator]
    return _finite(node, lambda samples: join(left(samples), right(samples)))


def _finite(
    node: Arithmetic | Function, compute: Callable[[Samples], float]
) -> Callable[[Samples], float]:
    def computed(samples: Samples) -> float:
        try:
            found = compute(samples)
        except (ZeroDivisionError, ValueError):  # x / 0 and sqrt(-1)
            found = math.nan
        if not math.isfinite(found):
            raise NotFiniteError(node, found)
        return found

    return computed


# What every computer rounds alike is done in plain floats. For the rest numpy is asked, so that a
# monitor computes what a requirement does.
def _power(base: float, exponent: float) -> float:
    with np.errstate(all="ignore"):
        return float(np.power(base, exponent))


def _exponential(exponent: float) -> float:
    with np.errstate(all="ignore"):
        return float(np.exp(exponent))


_ARITHMETIC: dict[ArithmeticOperator, Callable[[float, float], float]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
    "pow": _power,
}
_FUNCTIONS: dict[FunctionName, Callable[[float], float]] = {
    "abs": math.fabs,
    "sqrt": math.sqrt,
    "exp": _exponential,
}
_MARGINS: dict[ComparisonOperator, Callable[[float, float], float]] = {
    ">": operator.sub,
    ">=": operator.sub,
    "<": lambda left, right: right - left,
    "<=": lambda left, right: right - left,
    "==": lambda left, right: -abs(left - right),
    "!=": lambda left, right: abs(left - right),
}
