"""Windows over samples: the checked columns of a trace, and temporal operators on arrays.

Shape ``(..., n)``, samples along the last axis. Every kernel sees what the trace has: a window that
reaches past an end is cut there, and an empty one gives -inf for "at some sample" and +inf for "at
all samples". Windows are counted in samples, both ends included. None changes its input. Those
named for the past are the mirrored ones.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.requirements.stl.formula import Formula, unknown_signal

Array: TypeAlias = NDArray[np.float64]


def sliding(values: Array, join: np.ufunc, first: int, last: int) -> Array:
    """Minimum or maximum over the samples ``t + first .. t + last``.

    Windows are doubled until they are wide enough: ``log2(last - first)`` passes over the array.

    Args:
        values: Shape ``(..., n)``.
        join: ``np.minimum`` or ``np.maximum``.
        first: First sample of the window, at least 0.
        last: Last one, at least ``first``.
    """
    size = values.shape[-1]
    empty = np.inf if join is np.minimum else -np.inf
    if first >= size:
        return np.full_like(values, empty)
    result = np.full_like(values, empty) if first else values.copy()
    inside = result[..., : size - first]
    if first:
        inside[...] = values[..., first:]
    width, target = 1, min(last - first + 1, size - first)
    while width < target:
        # Windows may overlap, as the minimum of a sample with itself is the sample.
        shift = min(width, target - width)
        head = inside[..., :-shift]
        join(head, inside[..., shift:], out=head)
        width += shift
    return result


def sliding_past(values: Array, join: np.ufunc, first: int, last: int) -> Array:
    """Minimum or maximum over the samples ``t - last .. t - first``."""
    result: Array = sliding(values[..., ::-1], join, first, last)[..., ::-1]
    return result


def running(values: Array, join: np.ufunc) -> Array:
    """Minimum or maximum over this sample and all later ones."""
    result: Array = join.accumulate(values[..., ::-1], axis=-1)[..., ::-1]
    return result


def running_past(values: Array, join: np.ufunc) -> Array:
    """Minimum or maximum over this sample and all earlier ones."""
    result: Array = join.accumulate(values, axis=-1)
    return result


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
    target = size - first if last is None else min(last - first + 1, size - first)
    while width < target:
        shift = min(width, target - width)
        head = best[..., :-shift]
        np.maximum(head, np.minimum(least[..., :-shift], best[..., shift:]), out=head)
        head = least[..., :-shift]
        np.minimum(head, least[..., shift:], out=head)
        width += shift
    if not first:
        return best
    result = np.full_like(right, -np.inf)
    before = sliding(left, np.minimum, 0, first - 1)
    np.minimum(best, before[..., :-first], out=result[..., :-first])
    return result


def since(left: Array, right: Array, first: int = 0, last: int | None = None) -> Array:
    """The best sample of ``t - last .. t - first`` for ``right``, with ``left`` at all after it."""
    result: Array = until(left[..., ::-1], right[..., ::-1], first, last)[..., ::-1]
    return result


def following(values: Array, end: float) -> Array:
    """The next sample's value, and ``end`` at the last sample."""
    result = np.empty_like(values)
    result[..., :-1] = values[..., 1:]
    result[..., -1] = end
    return result


def preceding(values: Array, start: float) -> Array:
    """The previous sample's value, and ``start`` at the first sample."""
    result = np.empty_like(values)
    result[..., 1:] = values[..., :-1]
    result[..., 0] = start
    return result


def open_tail(values: Array, last: int, unknown: float) -> Array:
    """A copy with ``unknown`` wherever the window up to ``t + last`` leaves the trace."""
    result: Array = values.copy()
    result[..., max(values.shape[-1] - last, 0) :] = unknown
    return result


@dataclass(slots=True, eq=False)
class Frame:
    """One trace, or several of them in rows.

    Args:
        columns: Finite samples by signal, shape ``shape``.
        shape: ``(n,)`` or ``(traces, n)``.
        time_step: Seconds from sample to sample.
        times: Seconds of each sample, shape ``(n,)``; ``None`` if they begin at zero.
        rows: Number of the trace in each row, or ``None`` if they are numbered as they stand.
    """

    columns: Mapping[str, Array]
    shape: tuple[int, ...]
    time_step: float
    times: Array | None = None
    rows: NDArray[np.intp] | None = None

    def place(self, index: tuple[int, ...]) -> str:
        """Time, and trace, of a sample, for messages."""
        tick = index[-1]
        time = tick * self.time_step if self.times is None else self.times[tick]
        if len(index) == 1:
            return f"at t = {time:.2f} s"
        trace = index[0] if self.rows is None else self.rows[index[0]]
        return f"at t = {time:.2f} s of trace {trace}"

    def refuse_not_finite(self) -> None:
        """Refuse infinite samples and those that are no number.

        Raises:
            ConfigurationError: For the first of them.
        """
        for name, column in self.columns.items():
            if not np.isfinite(column).all():
                index = first_not_finite(column)
                raise ConfigurationError(
                    f"the signal {name!r} is not finite {self.place(index)}",
                    found=float(column[index]),
                    expected="finite samples",
                    remedy="let the simulator saturate the signal at a declared cap",
                )


def first_not_finite(values: Array) -> tuple[int, ...]:
    """Index of the first sample that is not finite."""
    return tuple(int(index) for index in np.argwhere(~np.isfinite(values))[0])


def arrays(
    names: Iterable[str], columns: Mapping[str, ArrayLike], formula: Formula
) -> dict[str, Array]:
    """The columns that a formula reads, as arrays.

    Args:
        names: The signals it reads.
        columns: Samples by signal.
        formula: The formula, for messages.

    Raises:
        ConfigurationError: For an unknown signal, and for anything that is no array of numbers.
    """
    samples: dict[str, Array] = {}
    for name in names:
        if name not in columns:
            raise unknown_signal(name, columns, str(formula), None)
        try:
            samples[name] = np.asarray(columns[name], dtype=float)
        except (TypeError, ValueError) as error:
            raise ConfigurationError(
                f"the signal {name!r} is no array of numbers: {error}",
                found=columns[name],
                expected="one number per sample",
            ) from error
    return samples


def empty_trace(found: str) -> ConfigurationError:
    """The error for a trace without samples."""
    return ConfigurationError(
        "an empty trace cannot be judged",
        found=found,
        expected="at least one sample",
        remedy="check that the episode ran",
    )


def other_length(
    name: str, shape: tuple[int, ...], expected: tuple[int, ...]
) -> ConfigurationError:
    """The error for a column of another length than the rest."""
    return ConfigurationError(
        f"the signal {name!r} and the time have different lengths",
        found=f"{shape} and {expected}",
        expected="one value per sample",
    )
