"""Formulas that hold whatever the signals are: they judge nothing, and are refused.

Comparisons are read over the real numbers: ``left - right`` becomes a polynomial whose variables
are signals, and functions, quotients and powers of them. Comparisons of one polynomial with several
numbers share its value, different polynomials vary freely, and what stands under an operator of
time holds always if its operand does, and else may hold or not. So each formula that is refused
holds for all signals; one that holds for all signals for a deeper reason is not refused. Where the
ranges of signals are known, the same is shown of all signals within them.
"""

from __future__ import annotations

import itertools
import math
import operator
from collections.abc import Callable, Iterable, Mapping, Sequence
from fractions import Fraction
from functools import lru_cache
from typing import Any, NamedTuple, TypeAlias

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

Ranges: TypeAlias = "tuple[tuple[str, float, float], ...]"
"""Name, least and greatest value of signals; infinite where there is none."""

_MAX_TERMS = 64
_MAX_BITS = 256
"""Length of the numbers in a polynomial; powers of powers would make them ever longer."""
_MAX_STEPS = 200_000
"""Nodes that are evaluated for one formula, which takes some tenths of a second."""
_CONSTANT: Monomial = ()


class _Compared(NamedTuple):
    """A comparison of a polynomial without a constant with a number."""

    polynomial: tuple[tuple[Monomial, Fraction], ...]
    operator: str
    number: Fraction


_Holds: TypeAlias = "Callable[[Sequence[Any]], bool]"
"""Truth of a formula at a sample, given the values of what it rests on, in their order."""


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
def holds_always(node: Node, ranges: Ranges = ()) -> bool:
    """Whether a formula is shown to hold for all signals.

    Args:
        node: The formula.
        ranges: Least and greatest value of some signals, which have no others.
    """
    variables: dict[object, tuple[int, set[Fraction]]] = {}
    holds = _compiled(node, variables, ranges)
    known = {name: (low, high) for name, low, high in ranges}
    choices = [_samples(variable, numbers, known) for variable, (_, numbers) in variables.items()]
    assignments = math.prod(map(len, choices))
    if assignments * sum(1 for _ in walk(node)) > _MAX_STEPS:
        return False
    return all(map(holds, itertools.product(*choices)))


def _compiled(
    node: Node, variables: dict[object, tuple[int, set[Fraction]]], ranges: Ranges
) -> _Holds:
    """Make the function that says whether a formula holds, and gather what that rests on.

    Args:
        node: The formula.
        variables: Filled with polynomials, each with its place among the values and the numbers
            that it is compared to, and with subformulas whose truth may vary.
        ranges: As of :func:`holds_always`.
    """
    if isinstance(node, Comparison):
        compared = _compared(node)
        if compared is None:
            return _varying(node, variables)
        compare, number = _COMPARE[compared.operator], compared.number
        if not compared.polynomial:
            known = compare(Fraction(0), number)
            return lambda _: known
        place, numbers = variables.setdefault(compared.polynomial, (len(variables), set()))
        numbers.add(number)
        return lambda values: compare(values[place], number)
    if isinstance(node, Not):
        operand = _compiled(node.operand, variables, ranges)
        return lambda values: not operand(values)
    if isinstance(node, Boolean):
        join = _JOIN[node.operator]
        left, right = (_compiled(each, variables, ranges) for each in (node.left, node.right))
        return lambda values: join(left(values), right(values))
    in_time = _truth_in_time(node, ranges)
    return _varying(node, variables) if in_time is None else lambda _: in_time


def _varying(node: Node, variables: dict[object, tuple[int, set[Fraction]]]) -> _Holds:
    place, _ = variables.setdefault(node, (len(variables), set()))
    return lambda values: bool(values[place])


def _samples(
    variable: object, numbers: Iterable[Fraction], known: Mapping[str, tuple[float, float]]
) -> list[Any]:
    """A value from each part of a variable's range in which no comparison changes its truth."""
    if not isinstance(variable, tuple):
        return [False, True]
    low, high = _range(dict(variable), known)
    ends = sorted({*numbers, *(Fraction(end) for end in (low, high) if math.isfinite(end))})
    between = [(left + right) / 2 for left, right in itertools.pairwise(ends)]
    points = [ends[0] - 1, *ends, *between, ends[-1] + 1]
    return [point for point in points if low <= point <= high]


_COMPARE: Mapping[str, Callable[[Any, Any], bool]] = {
    ">": operator.gt,
    ">=": operator.ge,
    "<": operator.lt,
    "<=": operator.le,
    "==": operator.eq,
    "!=": operator.ne,
}
_JOIN: Mapping[str, Callable[[bool, bool], bool]] = {
    "and": lambda left, right: left and right,
    "or": lambda left, right: left or right,
    "implies": lambda left, right: not left or right,
    "iff": operator.eq,
    "xor": operator.ne,
}


def _truth_in_time(node: Temporal | TemporalPair | Step, ranges: Ranges) -> bool | None:
    """Truth of an operator of time whose operand holds always or never; ``None`` if it may vary.

    A window that begins later may lie beyond an end of the trace.
    """
    if isinstance(node, Step):
        return None
    begins_here = node.window is None or node.window.start == 0
    if isinstance(node, TemporalPair):
        return True if begins_here and holds_always(node.right, ranges) else None
    for_all = node.operator in ("always", "historically")
    if (for_all or begins_here) and holds_always(node.operand, ranges):
        return True
    if (not for_all or begins_here) and holds_always(Not(node.operand), ranges):
        return False
    return None


@lru_cache(maxsize=1024)
def _compared(node: Comparison) -> _Compared | None:
    """The comparison as that of a polynomial with a number; ``None`` for one that is too long."""
    difference = _polynomial(Arithmetic("-", node.left, node.right))
    if difference is None:
        return None
    number = -difference.pop(_CONSTANT, Fraction(0))
    if number == 0 and _is_never_negative(node.left) and node.right == Constant(0.0):
        # Multiplied out, `(x - y) * (x - y)` no longer shows that it is a square.
        square = ((((node.left, 2),), Fraction(1)),)
        return _Compared(square, node.operator, number)
    # One sign for `x - y > 0` and `y - x < 0`.
    order = sorted(difference.items(), key=lambda term: _monomial_text(term[0]))
    operator = node.operator
    if order and order[0][1] < 0:
        order, number = [(monomial, -factor) for monomial, factor in order], -number
        operator = {">": "<", ">=": "<=", "<": ">", "<=": ">="}.get(operator, operator)  # type: ignore[assignment]
    return _Compared(tuple(order), operator, number)


def number_of(node: Comparison) -> tuple[str, float] | None:
    """Name of a signal and the number that a comparison amounts to; ``None`` for any other one.

    ``speed * 3.6 < 50`` and ``50 > speed * 3.6`` amount to 13.9 of ``speed``.
    """
    compared = _compared(node)
    if compared is None or len(compared.polynomial) != 1:
        return None
    monomial, factor = compared.polynomial[0]
    (variable, exponent), *others = monomial
    if isinstance(variable, Function) and variable.name == "abs":
        variable = variable.operand
    if others or exponent != 1 or not isinstance(variable, Signal):
        return None
    return variable.name, float(compared.number / factor)


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
    if not (_is_short(left) and _is_short(right)):
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
    if len(left) * len(right) > _MAX_TERMS or not (_is_short(left) and _is_short(right)):
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


def _is_short(polynomial: Polynomial) -> bool:
    """Whether all numbers in a polynomial are short enough to go on with it."""
    return all(
        max(factor.numerator.bit_length(), factor.denominator.bit_length()) <= _MAX_BITS
        for factor in polynomial.values()
    )


def _range(
    polynomial: Polynomial, known: Mapping[str, tuple[float, float]]
) -> tuple[Fraction | float, Fraction | float]:
    """The least and the greatest value that a polynomial without a constant may have."""
    low: Fraction | float = Fraction(0)
    high: Fraction | float = Fraction(0)
    for monomial, factor in polynomial.items():
        ends = [_times_end(factor, end) for end in _range_of(monomial, known)]
        low, high = low + min(ends), high + max(ends)
    return low, high


def _times_end(factor: Fraction, end: float) -> Fraction | float:
    """A factor times the end of a range, exactly; infinite for no end."""
    return factor * Fraction(end) if math.isfinite(end) else end if factor > 0 else -end


def _range_of(monomial: Monomial, known: Mapping[str, tuple[float, float]]) -> tuple[float, float]:
    """The range of a product of powers: of one signal where it is known, else of its sign."""
    (variable, exponent), *others = monomial
    if not others and exponent == 1 and isinstance(variable, Signal) and variable.name in known:
        return known[variable.name]
    positive = all(
        exponent % 2 == 0  # a square, as a function is never negative
        or isinstance(variable, Function)
        or (isinstance(variable, Signal) and known.get(variable.name, (-1.0,))[0] >= 0)
        for variable, exponent in monomial
    )
    return (0.0 if positive else -math.inf), math.inf


def _is_never_negative(node: Expression) -> bool:
    """Whether an expression is written as a square, a function, or a sum or product of such."""
    if isinstance(node, Constant):
        return node.value >= 0
    if isinstance(node, Function):
        return True
    if not isinstance(node, Arithmetic):
        return False
    if node.operator == "pow" and node.right in (Constant(2.0), Constant(4.0)):
        return True
    if node.operator == "*" and node.left == node.right:
        return True
    both = _is_never_negative(node.left) and _is_never_negative(node.right)
    return node.operator in ("+", "*") and both
