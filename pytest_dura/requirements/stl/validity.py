"""Formulas that hold whatever the signals are: they judge nothing, and are refused.

Comparisons are read over the real numbers: ``left - right`` becomes a polynomial whose variables
are signals, and functions, quotients and powers of them. Comparisons of one polynomial with several
numbers share its value, different polynomials vary freely, and what stands under an operator of
time holds always if its operand does, and else may hold or not. So each formula that is refused
holds for all signals; one that holds for all signals for a deeper reason is not refused.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping
from fractions import Fraction
from functools import lru_cache
from typing import NamedTuple, TypeAlias

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.requirements.stl.formula import (
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
    marked,
    node_text,
    walk,
)

Monomial: TypeAlias = "tuple[tuple[Expression, int], ...]"
"""Variables with their exponents, in the order of their texts; empty for the number 1."""
Polynomial: TypeAlias = "dict[Monomial, Fraction]"
"""Monomials with their factors, none of which is 0."""

_MAX_TERMS = 64
_MAX_ASSIGNMENTS = 4096
_CONSTANT: Monomial = ()


class _Compared(NamedTuple):
    """A comparison of a polynomial without a constant with a number."""

    polynomial: tuple[tuple[Monomial, Fraction], ...]
    operator: str
    number: Fraction


_Assignment: TypeAlias = "Mapping[object, Fraction | float | bool]"
"""Values of polynomials, and whether subformulas under operators of time hold."""


def falsifiable_or_refuse(formula: Formula) -> None:
    """Refuse a formula that no signal can make false.

    Raises:
        ConfigurationError: For such a formula, with a mark under its first signal.
    """
    if not holds_always(formula.root):
        return
    position = min(node.position for node in walk(formula.root) if isinstance(node, Signal))
    raise ConfigurationError(
        f"the formula holds whatever the signals are{marked(formula.text, position)}",
        found=node_text(formula.root),
        expected="a formula that an episode can violate",
        remedy="compare different signals, or a signal with a bound, as in `always (gap > 0)`",
    )


@lru_cache(maxsize=1024)
def holds_always(node: Node) -> bool:
    """Whether a formula is shown to hold for all signals."""
    variables: dict[object, set[Fraction]] = {}
    _collect(node, variables)
    choices = [_samples(variable, numbers) for variable, numbers in variables.items()]
    if math.prod(map(len, choices)) > _MAX_ASSIGNMENTS:
        return False
    return all(
        _holds(node, dict(zip(variables, values, strict=True)))
        for values in itertools.product(*choices)
    )


def _collect(node: Node, variables: dict[object, set[Fraction]]) -> None:
    """Gather what a formula's truth at one sample rests on, with the numbers it is compared to."""
    if isinstance(node, Comparison):
        compared = _compared(node)
        if compared is None:
            variables.setdefault(node, set())
        elif compared.polynomial:
            variables.setdefault(compared.polynomial, set()).add(compared.number)
    elif isinstance(node, Not):
        _collect(node.operand, variables)
    elif isinstance(node, Boolean):
        _collect(node.left, variables)
        _collect(node.right, variables)
    elif _truth_in_time(node) is None:
        variables.setdefault(node, set())


def _samples(variable: object, numbers: Iterable[Fraction]) -> list[Fraction | float | bool]:
    """A value from each part of a variable's range in which no comparison changes its truth."""
    if not isinstance(variable, tuple):
        return [False, True]
    low, high = _range(dict(variable))
    ends = sorted({*numbers, *(Fraction(end) for end in (low, high) if math.isfinite(end))})
    between = [(left + right) / 2 for left, right in itertools.pairwise(ends)]
    points = [ends[0] - 1, *ends, *between, ends[-1] + 1]
    return [point for point in points if low <= point <= high]


def _holds(node: Node, assignment: _Assignment) -> bool:
    """Whether a formula holds at a sample, given what its truth rests on."""
    if isinstance(node, Comparison):
        compared = _compared(node)
        if compared is None:
            return bool(assignment[node])
        value = assignment[compared.polynomial] if compared.polynomial else Fraction(0)
        return _compare(compared.operator, value, compared.number)
    if isinstance(node, Not):
        return not _holds(node.operand, assignment)
    if isinstance(node, Boolean):
        left, right = _holds(node.left, assignment), _holds(node.right, assignment)
        return {
            "and": left and right,
            "or": left or right,
            "implies": not left or right,
            "iff": left == right,
            "xor": left != right,
        }[node.operator]
    known = _truth_in_time(node)
    return bool(assignment[node]) if known is None else known


def _compare(operator: str, value: Fraction | float, number: Fraction) -> bool:
    return {
        ">": value > number,
        ">=": value >= number,
        "<": value < number,
        "<=": value <= number,
        "==": value == number,
        "!=": value != number,
    }[operator]


def _truth_in_time(node: Temporal | TemporalPair | Step) -> bool | None:
    """Truth of an operator of time whose operand holds always or never; ``None`` if it may vary.

    A window that begins later may lie beyond an end of the trace.
    """
    if isinstance(node, Step):
        return None
    begins_here = node.window is None or node.window.start == 0
    if isinstance(node, TemporalPair):
        return True if begins_here and holds_always(node.right) else None
    for_all = node.operator in ("always", "historically")
    if (for_all or begins_here) and holds_always(node.operand):
        return True
    if (not for_all or begins_here) and holds_always(Not(node.operand)):
        return False
    return None


@lru_cache(maxsize=1024)
def _compared(node: Comparison) -> _Compared | None:
    """The comparison as that of a polynomial with a number; ``None`` for one that is too long."""
    difference = _polynomial(Arithmetic("-", node.left, node.right))
    if difference is None:
        return None
    number = -difference.pop(_CONSTANT, Fraction(0))
    # One sign for `x - y > 0` and `y - x < 0`.
    order = sorted(difference.items(), key=lambda term: _monomial_text(term[0]))
    operator = node.operator
    if order and order[0][1] < 0:
        order, number = [(monomial, -factor) for monomial, factor in order], -number
        operator = {">": "<", ">=": "<=", "<": ">", "<=": ">="}.get(operator, operator)  # type: ignore[assignment]
    return _Compared(tuple(order), operator, number)


def _monomial_text(monomial: Monomial) -> str:
    return "*".join(f"{node_text(variable)}^{exponent}" for variable, exponent in monomial)


def _polynomial(  # noqa: PLR0911 - one for each kind of expression
    node: Expression,
) -> Polynomial | None:
    """The expression as a polynomial; ``None`` for one that has too many terms."""
    if isinstance(node, Constant):
        return _without_zeros({_CONSTANT: Fraction(node.value)})
    if not isinstance(node, Arithmetic):
        return {((node, 1),): Fraction(1)}
    left, right = _polynomial(node.left), _polynomial(node.right)
    if left is None or right is None:
        return None
    if node.operator in ("+", "-"):
        sign = 1 if node.operator == "+" else -1
        return _sum([*left.items(), *((term, sign * factor) for term, factor in right.items())])
    if node.operator == "*":
        return _product(left, right)
    number = right[_CONSTANT] if right.keys() == {_CONSTANT} else None
    if node.operator == "/" and number is not None:
        return _product(left, {_CONSTANT: 1 / number})
    if node.operator == "pow" and number in (2, 3, 4):
        square = _product(left, left)
        higher = {2: {_CONSTANT: Fraction(1)}, 3: left, 4: square}[int(number)]
        return None if square is None or higher is None else _product(square, higher)
    return {((node, 1),): Fraction(1)}


def _product(left: Polynomial, right: Polynomial) -> Polynomial | None:
    if len(left) * len(right) > _MAX_TERMS:
        return None
    return _sum(
        (_times(one, other), factor * more)
        for one, factor in left.items()
        for other, more in right.items()
    )


def _times(left: Monomial, right: Monomial) -> Monomial:
    exponents = dict(left)
    for variable, exponent in right:
        exponents[variable] = exponents.get(variable, 0) + exponent
    return tuple(sorted(exponents.items(), key=lambda factor: node_text(factor[0])))


def _sum(terms: Iterable[tuple[Monomial, Fraction]]) -> Polynomial:
    total: Polynomial = {}
    for monomial, factor in terms:
        total[monomial] = total.get(monomial, Fraction(0)) + factor
    return _without_zeros(total)


def _without_zeros(polynomial: Polynomial) -> Polynomial:
    return {monomial: factor for monomial, factor in polynomial.items() if factor}


def _range(polynomial: Polynomial) -> tuple[float, float]:
    """The least and the greatest value that a polynomial without a constant may have."""
    low, high = 0.0, 0.0
    for monomial, factor in polynomial.items():
        if not all(_is_square(*power) for power in monomial):
            return -math.inf, math.inf
        low, high = (low, math.inf) if factor > 0 else (-math.inf, high)
    return low, high


def _is_square(variable: Expression, exponent: int) -> bool:
    """Whether a power is never negative."""
    return exponent % 2 == 0 or isinstance(variable, Function)
