"""Temporal operators on arrays of robustness: shape ``(..., n)``, samples along the last axis.

Every kernel sees what the trace has: a window that reaches past an end is cut there, and an empty
one gives -inf for "at some sample" and +inf for "at all samples". Windows are counted in samples,
both ends included. None changes its input. Those named for the past are the mirrored ones.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]


def sliding(join: np.ufunc, values: Array, first: int, last: int) -> Array:
    """Minimum or maximum over the samples ``t + first .. t + last``.

    Windows are doubled until they are wide enough: ``log2(last - first)`` passes over the array.

    Args:
        join: ``np.minimum`` or ``np.maximum``.
        values: Shape ``(..., n)``.
        first: First sample of the window, at least 0.
        last: Last one, at least ``first``.
    """
    size = values.shape[-1]
    empty = np.inf if join is np.minimum else -np.inf
    if first >= size:
        return np.full_like(values, empty)
    found = np.full_like(values, empty) if first else values.copy()
    kept = found[..., : size - first]
    if first:
        kept[...] = values[..., first:]
    width, wanted = 1, min(last - first + 1, size - first)
    while width < wanted:
        # Windows may overlap, as the minimum of a sample with itself is the sample.
        shift = min(width, wanted - width)
        head = kept[..., :-shift]
        join(head, kept[..., shift:], out=head)
        width += shift
    return found


def sliding_past(join: np.ufunc, values: Array, first: int, last: int) -> Array:
    """Minimum or maximum over the samples ``t - last .. t - first``."""
    found: Array = sliding(join, values[..., ::-1], first, last)[..., ::-1]
    return found


def running(join: np.ufunc, values: Array) -> Array:
    """Minimum or maximum over this sample and all later ones."""
    found: Array = join.accumulate(values[..., ::-1], axis=-1)[..., ::-1]
    return found


def running_past(join: np.ufunc, values: Array) -> Array:
    """Minimum or maximum over this sample and all earlier ones."""
    found: Array = join.accumulate(values, axis=-1)
    return found


def until(left: Array, right: Array, first: int = 0, last: int | None = None) -> Array:
    """The best sample of ``t + first .. t + last`` for ``right``, with ``left`` at all before it.

    The value is the maximum over ``u`` in the window of ``right[u]`` and of ``left`` over
    ``t .. u - 1``, whichever is less. ``last=None`` is the end of the trace. A window of ``w``
    samples maps what follows it, ``y``, to ``max(best, min(least, y))``; two such maps compose to
    another, so that windows double as in ``sliding``.
    """
    size = right.shape[-1]
    if first >= size:
        return np.full_like(right, -np.inf)
    best: Array = right[..., first:].copy()
    least: Array = left[..., first:].copy()
    width = 1
    wanted = size - first if last is None else min(last - first + 1, size - first)
    while width < wanted:
        shift = min(width, wanted - width)
        head = best[..., :-shift]
        np.maximum(head, np.minimum(least[..., :-shift], best[..., shift:]), out=head)
        head = least[..., :-shift]
        np.minimum(head, least[..., shift:], out=head)
        width += shift
    if not first:
        return best
    found = np.full_like(right, -np.inf)
    before = sliding(np.minimum, left, 0, first - 1)
    np.minimum(best, before[..., :-first], out=found[..., :-first])
    return found


def since(left: Array, right: Array, first: int = 0, last: int | None = None) -> Array:
    """The best sample of ``t - last .. t - first`` for ``right``, with ``left`` at all after it."""
    found: Array = until(left[..., ::-1], right[..., ::-1], first, last)[..., ::-1]
    return found


def following(values: Array, end: float) -> Array:
    """The next sample's value, and ``end`` at the last sample."""
    found = np.empty_like(values)
    found[..., :-1] = values[..., 1:]
    found[..., -1] = end
    return found


def preceding(values: Array, start: float) -> Array:
    """The previous sample's value, and ``start`` at the first sample."""
    found = np.empty_like(values)
    found[..., 1:] = values[..., :-1]
    found[..., 0] = start
    return found


def open_tail(values: Array, last: int, unknown: float) -> Array:
    """A copy with ``unknown`` wherever the window up to ``t + last`` leaves the trace."""
    found: Array = values.copy()
    found[..., max(values.shape[-1] - last, 0) :] = unknown
    return found
