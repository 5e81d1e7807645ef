"""The samples that formulas are evaluated on, checked."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.requirements.stl.language.formula import Formula, unknown_signal
from pytest_dura.requirements.stl.offline.windows import Array


@dataclass(slots=True, eq=False)
class Frame:
    """One trace, or several of them in rows.

    Args:
        columns: Finite samples by signal, shape ``shape``.
        shape: ``(n,)`` or ``(traces, n)``.
        time_step: Seconds from sample to sample.
        times: Seconds of each sample, shape ``(n,)``; ``None`` if they begin at zero.
        beyond: True behind the end of the shorter rows, or ``None`` if all have ``n`` samples.
        rows: Number of the trace in each row, or ``None`` if they are numbered as they stand.
    """

    columns: Mapping[str, Array]
    shape: tuple[int, ...]
    time_step: float
    times: Array | None = None
    beyond: NDArray[np.bool_] | None = None
    rows: NDArray[np.intp] | None = None

    def ended(self, values: Array, neutral: float) -> Array:
        """The values, with ``neutral`` behind the end of each row."""
        return values if self.beyond is None else np.where(self.beyond, neutral, values)

    def place(self, index: tuple[int, ...]) -> str:
        """When a sample was, for messages."""
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
    return tuple(int(one) for one in np.argwhere(~np.isfinite(values))[0])


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
    found: dict[str, Array] = {}
    for name in names:
        if name not in columns:
            raise unknown_signal(name, columns, str(formula), None)
        try:
            found[name] = np.asarray(columns[name], dtype=float)
        except (TypeError, ValueError) as error:
            raise ConfigurationError(
                f"the signal {name!r} is no array of numbers: {error}",
                found=columns[name],
                expected="one number per sample",
            ) from error
    return found


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
