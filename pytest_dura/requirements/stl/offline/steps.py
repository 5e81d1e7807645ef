"""The steps that a formula is computed by, each from a frame and the arrays of its inputs."""

from __future__ import annotations

import numpy as np

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.requirements.stl.language.nodes import (
    Arithmetic,
    ArithmeticOperator,
    ComparisonOperator,
    Function,
    FunctionName,
)
from pytest_dura.requirements.stl.language.rendering import node_text
from pytest_dura.requirements.stl.offline import windows
from pytest_dura.requirements.stl.offline.columns import Frame, first_not_finite
from pytest_dura.requirements.stl.offline.windows import Array

ARITHMETIC: dict[ArithmeticOperator, np.ufunc] = {
    "+": np.add,
    "-": np.subtract,
    "*": np.multiply,
    "/": np.divide,
    "pow": np.power,
}
FUNCTIONS: dict[FunctionName, np.ufunc] = {"abs": np.abs, "sqrt": np.sqrt, "exp": np.exp}


def column(frame: Frame, name: str) -> Array:
    """The samples of a signal."""
    return frame.columns[name]


def constant(_frame: Frame, value: np.float64) -> np.float64:
    """A number: a scalar, which fits any column."""
    return value


def arithmetic(frame: Frame, left: Array, right: Array, node: Arithmetic) -> Array:
    """Two expressions joined, refused where the result is not finite."""
    return _finite(frame, ARITHMETIC[node.operator](left, right), node)


def function(frame: Frame, operand: Array, node: Function) -> Array:
    """A function of an expression, refused where the result is not finite."""
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


def margin(frame: Frame, left: Array, right: Array, operator: ComparisonOperator) -> Array:
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


def truth(_frame: Frame, margins: Array, on_bound: bool) -> Array:
    """+1 where a comparison holds and -1 elsewhere; ``on_bound`` is its truth at margin zero."""
    holds = margins >= 0 if on_bound else margins > 0
    return np.where(holds, 1.0, -1.0)


def negation(_frame: Frame, values: Array) -> Array:
    """The margin of the opposite."""
    return -values


def joined(_frame: Frame, left: Array, right: Array, join: np.ufunc) -> Array:
    """The lesser or the greater of two margins."""
    found: Array = join(left, right)
    return found


def everywhere(frame: Frame, value: float) -> Array:
    """The same value at each sample."""
    return np.full(frame.shape, value)


def sliding(frame: Frame, values: Array, join: np.ufunc, first: int, last: int) -> Array:
    """See ``windows.sliding``."""
    return windows.sliding(join, frame.ended(values, neutral(join)), first, last)


def sliding_past(_frame: Frame, values: Array, join: np.ufunc, first: int, last: int) -> Array:
    """See ``windows.sliding_past``."""
    return windows.sliding_past(join, values, first, last)


def running(frame: Frame, values: Array, join: np.ufunc) -> Array:
    """See ``windows.running``."""
    return windows.running(join, frame.ended(values, neutral(join)))


def running_past(_frame: Frame, values: Array, join: np.ufunc) -> Array:
    """See ``windows.running_past``."""
    return windows.running_past(join, values)


def until(frame: Frame, left: Array, right: Array, first: int, last: int | None) -> Array:
    """See ``windows.until``; nothing holds behind the end, whatever the left side is there."""
    return windows.until(left, frame.ended(right, -np.inf), first, last)


def since(_frame: Frame, left: Array, right: Array, first: int, last: int | None) -> Array:
    """See ``windows.since``."""
    return windows.since(left, right, first, last)


def until_beyond(_frame: Frame, known: Array, least: Array, last: int | None) -> Array:
    """Greatest value of ``until`` if its right side may hold behind the end.

    Args:
        known: Its value as far as the trace goes.
        least: Minimum of the left side from each sample to the end.
        last: Last sample of the window, ``None`` for one without end.
    """
    cut = 0 if last is None else max(known.shape[-1] - last, 0)
    found: Array = known.copy()
    np.maximum(known[..., cut:], least[..., cut:], out=found[..., cut:])
    return found


def open_tail(_frame: Frame, values: Array, last: int, unknown: float) -> Array:
    """See ``windows.open_tail``."""
    return windows.open_tail(values, last, unknown)


def following(frame: Frame, values: Array, end: float) -> Array:
    """See ``windows.following``."""
    return windows.following(frame.ended(values, end), end)


def preceding(_frame: Frame, values: Array, start: float) -> Array:
    """See ``windows.preceding``."""
    return windows.preceding(values, start)


def neutral(join: np.ufunc) -> float:
    """What changes neither a minimum nor a maximum: the value of an empty window."""
    return np.inf if join is np.minimum else -np.inf
