"""Units of a draft: those of the signals that its check joins, and of the numbers it states."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping

from pytest_dura.core.loop_signals import TRUTH
from pytest_dura.drafts.asking import Draft
from pytest_dura.requirements.stl.formula import (
    Arithmetic,
    Comparison,
    Constant,
    Expression,
    Formula,
    Function,
    Signal,
    node_text,
    walk,
)
from pytest_dura.requirements.stl.validity import number_of

Dimension = Mapping[str, int]
"""Base units with their exponents; empty for a plain number."""
_FACTOR = re.compile(r"([^\d\s/*]+?)\^?(-?\d*)")


def wrong_units(draft: Draft, formula: Formula, units: Mapping[str, str]) -> Iterator[str]:
    """Yield what does not fit between stated bounds, the formula and the declared units.

    Args:
        draft: The draft, with the bounds that it states.
        formula: Its check.
        units: Of all signals that it may read.
    """
    yield from _joined_units(formula, units)
    compared: set[tuple[str, float]] = set()
    for node in walk(formula.root):
        if not isinstance(node, Comparison):
            continue
        for side, other in ((node.left, node.right), (node.right, node.left)):
            if (name := _alone(side)) and isinstance(other, Constant):
                compared.add((name, other.value))
                break
        else:
            if (known := number_of(node)) is not None:
                yield (
                    f"{node_text(node)} compares {known[0]} alone with a number in another form: "
                    f"write {known[0]} on one side and the number, in {units[known[0]]}, on the "
                    "other"
                )
    constants = {node.value for node in walk(formula.root) if isinstance(node, Constant)}
    for bound in draft.bounds:
        if bound.signal not in formula.signals:
            yield f"a bound is stated of {bound.signal!r}, which the check does not read"
        elif (unit := units[bound.signal]) != bound.unit and unit != TRUTH:
            yield f"the bound of {bound.signal} is stated in {bound.unit!r}, and its unit is {unit}"
        elif bound.value not in constants:
            yield f"a bound of {bound.value:g} {bound.unit} is stated, and the check has none"
    stated = {(bound.signal, bound.value) for bound in draft.bounds}
    for name, value in sorted(compared - stated):
        if units[name] != TRUTH and value != 0:
            yield f"the check compares {name} with {value:g}, and no bound states its unit"


def _alone(side: Expression) -> str:
    """Name of a signal that stands alone, or below ``abs``; empty for another expression."""
    if isinstance(side, Function) and side.name == "abs":
        side = side.operand
    return side.name if isinstance(side, Signal) else ""


def _joined_units(formula: Formula, units: Mapping[str, str]) -> Iterator[str]:
    """Yield sums, differences and comparisons of what has different units."""
    known = {name: _dimension(unit) for name, unit in units.items()}
    for node in walk(formula.root):
        if not isinstance(node, (Comparison, Arithmetic)) or node.operator in ("*", "/", "pow"):
            continue
        left, right = _of(node.left, known), _of(node.right, known)
        if left is None or right is None or left == right:
            continue
        joined = "is compared with" if isinstance(node, Comparison) else "is joined with"
        yield (
            f"{node_text(node.left)} in {_text(left)} {joined} {node_text(node.right)} in "
            f"{_text(right)}"
        )


def _of(node: Expression, known: Mapping[str, Dimension]) -> Dimension | None:
    """Dimension of an expression; ``None`` where a number in it may have any unit."""
    if isinstance(node, Signal):
        return known[node.name]
    if isinstance(node, Function):
        return _of(node.operand, known) if node.name == "abs" else None
    if isinstance(node, Constant):
        return None
    left, right = _of(node.left, known), _of(node.right, known)
    if node.operator in "+-":
        return right if left is None else left
    if left is None or right is None or node.operator == "pow":
        return None
    sign = 1 if node.operator == "*" else -1
    return _joined(left, right, sign)


def _joined(left: Dimension, right: Dimension, sign: int) -> Dimension:
    bases = dict.fromkeys([*left, *right])
    total = {base: left.get(base, 0) + sign * right.get(base, 0) for base in bases}
    return {base: exponent for base, exponent in total.items() if exponent}


def _dimension(unit: str) -> Dimension:
    """Read a unit such as ``m/s2``; one of another form is a base unit of its own."""
    if unit in ("1", TRUTH):
        return {}
    total: Counter[str] = Counter()
    sign = 1
    for part in re.split(r"([/*])", unit.replace(" ", "")):
        if part in "/*":
            sign = -1 if part == "/" else 1
            continue
        factor = _FACTOR.fullmatch(part)
        if factor is None:
            return {unit: 1}
        total[factor[1]] += sign * int(factor[2] or 1)
    return {base: exponent for base, exponent in total.items() if exponent}


def _text(dimension: Dimension) -> str:
    """A unit in words, such as ``m/s2``."""
    above = "*".join(
        f"{base}{each if each > 1 else ''}" for base, each in dimension.items() if each > 0
    )
    below = "".join(
        f"/{base}{-each if each < -1 else ''}" for base, each in dimension.items() if each < 0
    )
    return f"{above or '1'}{below}"
