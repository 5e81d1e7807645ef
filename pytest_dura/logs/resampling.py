"""Samples of a signal at even distances, with bounds where they are not known.

Each sample of the log falls into the step of one sample of the episode. Where several do, or a
value was interpolated, the bounds are those of all of them, so that no recorded value is left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pytest_dura.logs.mapping import Method

Floats = NDArray[np.float64]
_ON_SAMPLE = 1e-6
"""Share of a step within which a sample counts as one of the episode's times."""
MISSING = 1.5
"""Times the usual distance of samples, beyond which samples are missing; below it they jitter."""


@dataclass
class Resampled:
    """A signal at even distances.

    Args:
        values: NaN where nothing is known.
        least: Least value that it may have; NaN where nothing is known.
        greatest: Greatest one.
        gaps: Seconds from and to, of stretches without samples.
        longest_gap: Seconds beyond which nothing is known between two samples.
    """

    values: Floats
    least: Floats
    greatest: Floats
    gaps: list[tuple[float, float]]
    longest_gap: float

    @property
    def is_certain(self) -> bool:
        """Whether each sample is one of the log's."""
        return bool((self.least == self.greatest).all())


def usual_step(time: Floats) -> float | None:
    """Return the usual distance of samples; ``None`` for a single one."""
    steps = np.diff(time)
    steps = steps[steps > 0]
    return float(np.median(steps)) if len(steps) else None


def places(time: Floats, step: float, method: Method) -> NDArray[np.int64]:
    """Number of the episode's sample into whose step each sample of the log falls."""
    ticks = time / step
    near = np.round(ticks)
    upward = np.ceil(ticks) if method == "hold" else np.floor(ticks + 0.5)
    return np.where(np.abs(ticks - near) <= _ON_SAMPLE, near, upward).astype(np.int64)


def resample(
    time: Floats,
    values: Floats,
    count: int,
    step: float,
    *,
    method: Method = "hold",
    longest_gap: float | None = None,
    rate_at_most: float | None = None,
    first: int = 0,
    until: float | None = None,
) -> Resampled:
    """Resample a signal.

    Args:
        time: Seconds of its samples, in order, at least one.
        values: Its values, finite.
        count: Samples to make.
        step: Seconds from one to the next.
        method: What holds between two samples.
        longest_gap: Seconds from sample to sample beyond which nothing is known between them.
        rate_at_most: Greatest change in a second.
        first: Number of the first sample to make, within the episode.
        until: Seconds up to which the log has no further sample of the signal; default: the last
            sample to make. Longer than the longest gap, nothing is known from the last one on.
    """
    usual = usual_step(time) or step
    longest = longest_gap or MISSING * usual
    slack = _ON_SAMPLE * step
    grid = (first + np.arange(count)) * step
    until = float(grid[-1]) if until is None else until
    near = np.round(time / step) * step
    time = np.where(np.abs(time - near) <= slack, near, time)
    before = np.searchsorted(time, grid + slack, "right") - 1
    left, right = np.clip(before, 0, None), np.clip(before + 1, None, len(time) - 1)
    if method == "linear":
        nominal = np.interp(grid, time, values)
    elif method == "nearest":
        nearer = np.abs(time[right] - grid) < np.abs(grid - time[left])
        nominal = values[np.where(nearer, right, left)]
    else:
        nominal = values[left]
    place = places(time, step, method) - first
    own = np.zeros(count, dtype=bool)
    inside = (place >= 0) & (place < count)
    own[place[inside]] = True
    distance = time[right] - time[left]
    outside = (before < 0) | (before >= len(time) - 1)
    distance = np.where(outside, np.where(before < 0, time[0], until - time[-1]), distance)
    unknown = ~own & (distance > longest + slack)
    least, greatest = nominal.copy(), nominal.copy()
    np.minimum.at(least, place[inside], values[inside])
    np.maximum.at(greatest, place[inside], values[inside])
    for column in (nominal, least, greatest):
        column[unknown] = np.nan
    if rate_at_most is not None and unknown.any():
        at = grid[unknown]
        reach_left = rate_at_most * np.abs(at - time[left[unknown]])
        reach_right = rate_at_most * np.abs(time[right[unknown]] - at)
        a, b = values[left[unknown]], values[right[unknown]]
        low, high = (
            np.maximum(a - reach_left, b - reach_right),
            np.minimum(a + reach_left, b + reach_right),
        )
        fits = low <= high  # else the log itself changes faster
        least[unknown], greatest[unknown] = (
            np.where(fits, low, np.nan),
            np.where(fits, high, np.nan),
        )
    steps = np.diff(time)
    gaps = [(float(time[i]), float(time[i + 1])) for i in np.flatnonzero(steps > longest + slack)]
    if not first and time[0] > longest + slack:
        gaps.insert(0, (0.0, float(time[0])))
    if until - time[-1] > longest + slack:
        gaps.append((float(time[-1]), until))
    return Resampled(nominal, least, greatest, gaps, longest)
