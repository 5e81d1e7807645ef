"""Signals of which a trace does not know each sample: their bounds, and those of expressions.

Beside such a signal ``gap`` a trace has the columns ``least.gap`` and ``greatest.gap``: at each
sample the value lies between them, and where they are NaN it may be anything. A formula is then
evaluated on intervals: it is satisfied, or violated, if every choice of values says so. Where a
signal stands in a formula twice, the choices are made apart, so that the interval may be wider than
what the signal allows, and never narrower.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any

import numpy as np

from pytest_dura.requirements.stl.windows import Array, Frame

LEAST, GREATEST = "least.", "greatest."
"""Prefixes of the columns with the bounds of a signal."""


def uncertain_signals(names: Iterable[str], columns: Collection[str]) -> frozenset[str]:
    """The signals of which a trace has bounds."""
    return frozenset(name for name in names if LEAST + name in columns)


def with_bounds(names: Iterable[str], columns: Mapping[str, Any]) -> dict[str, Any]:
    """The columns of some signals, each with those of its bounds where it has any."""
    chosen = {name: columns[name] for name in names}
    for name in uncertain_signals(chosen, columns):
        chosen |= {prefix + name: columns[prefix + name] for prefix in (LEAST, GREATEST)}
    return chosen


def known_share(names: Iterable[str], columns: Mapping[str, Any]) -> float:
    """The share of samples at which every one of the signals has bounds."""
    known = [np.isfinite(np.asarray(columns[LEAST + name], dtype=float)) for name in names]
    return float(np.mean(np.logical_and.reduce(known)))


def bound_column(frame: Frame, name: str, greatest: bool) -> Array:
    """A bound of a signal, infinite where nothing is known of it."""
    bounds = frame.columns[(GREATEST if greatest else LEAST) + name]
    return np.where(np.isnan(bounds), np.inf if greatest else -np.inf, bounds)


def _outward(values: Any, greatest: bool) -> Array:
    """Values, infinite where the bounds of the operands leave them open."""
    open_: Array = np.where(np.isnan(values), np.inf if greatest else -np.inf, values)
    return open_


def _add(a: Array, b: Array, c: Array, d: Array, greatest: bool) -> Array:
    return _outward(b + d if greatest else a + c, greatest)


def _subtract(a: Array, b: Array, c: Array, d: Array, greatest: bool) -> Array:
    return _outward(b - c if greatest else a - d, greatest)


def _subtract_left(a: Array, b: Array, c: Array, d: Array, greatest: bool) -> Array:
    return _subtract(c, d, a, b, greatest)


def _corners(corners: list[Any], greatest: bool) -> Array:
    """The extreme of products or quotients; 0 times what is unbounded is 0."""
    join = np.maximum if greatest else np.minimum
    filled = [np.where(np.isnan(corner), 0.0, corner) for corner in corners]
    extreme: Array = join(join(filled[0], filled[1]), join(filled[2], filled[3]))
    return extreme


def _multiply(a: Array, b: Array, c: Array, d: Array, greatest: bool) -> Array:
    return _corners([a * c, a * d, b * c, b * d], greatest)


def _divide(a: Array, b: Array, c: Array, d: Array, greatest: bool) -> Array:
    quotients = _corners([a / c, a / d, b / c, b / d], greatest)
    open_: Array = np.where((c <= 0) & (d >= 0), np.inf if greatest else -np.inf, quotients)
    return open_


def _magnitude(a: Array, b: Array, greatest: bool) -> Array:
    if greatest:
        largest: Array = np.maximum(np.abs(a), np.abs(b))
        return largest
    least: Array = np.maximum(np.maximum(a, -b), 0.0)
    return least


def _power(a: Array, b: Array, c: Array, d: Array, greatest: bool) -> Array:
    """A power; of an exponent that is not one whole number of at least 1 nothing is known."""
    exponents = np.unique(np.concatenate([np.ravel(c), np.ravel(d)]))
    exponent = exponents[0] if len(exponents) == 1 else np.nan
    if not (exponent >= 1 and exponent == int(exponent)):
        known = (a == b) & (c == d)
        return _outward(np.where(known, np.power(a, c), np.nan), greatest)
    if exponent % 2:
        return np.power(b if greatest else a, exponent)
    return np.power(_magnitude(a, b, greatest), exponent)


def _root(a: Array, b: Array, greatest: bool) -> Array:
    return _outward(np.sqrt(b if greatest else a), greatest)


def _exponential(a: Array, b: Array, greatest: bool) -> Array:
    return np.asarray(np.exp(b if greatest else a))


def _distance(a: Array, b: Array, c: Array, d: Array, greatest: bool) -> Array:
    lower, upper = _subtract(a, b, c, d, False), _subtract(a, b, c, d, True)
    return _magnitude(lower, upper, greatest)


def _nearness(a: Array, b: Array, c: Array, d: Array, greatest: bool) -> Array:
    return -_distance(a, b, c, d, not greatest)


BOUNDS: Mapping[str, Callable[..., Array]] = {
    ">": _subtract,
    ">=": _subtract,
    "<": _subtract_left,
    "<=": _subtract_left,
    "==": _nearness,
    "!=": _distance,
    "+": _add,
    "-": _subtract,
    "*": _multiply,
    "/": _divide,
    "pow": _power,
    "abs": _magnitude,
    "sqrt": _root,
    "exp": _exponential,
}
"""A bound of an operator's value, or of a comparison's margin, from the least and the greatest
value of each operand, and whether the greatest is meant."""
