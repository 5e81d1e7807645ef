"""Stamps of a log as seconds: their unit, and what is wrong with their order."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.errors import ConfigurationError

UNITS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
"""Nanoseconds of each unit of stamps."""
_EPOCH = (9 * 10**17, 5 * 10**18)
"""Nanoseconds from 1970 on within which stamps are taken as dates: 1998 to 2128."""
_LONGEST_STEP = 5.0
"""Seconds from sample to sample above which stamps are rather in a smaller unit."""
_LATE = 5
"""Samples in a row that may be stamped before an earlier one; more are a clock that was set."""
_LONGEST_JUMP = 3600.0
"""Seconds without a sample that are taken for a clock that was set, and not for a gap."""


@dataclass
class Clock:
    """Stamps of one topic.

    Args:
        origin: Nanoseconds of the first sample, from 1970 on if it is a date.
        seconds: Seconds from there, in the order of the log.
        unit: Unit of the stamps.
        notes: What was noticed, in words.
    """

    origin: int
    seconds: NDArray[np.float64]
    unit: str
    notes: list[str]

    @property
    def is_date(self) -> bool:
        """Whether the stamps are dates."""
        return _EPOCH[0] <= self.origin <= _EPOCH[1]


def clock_of(stamps: NDArray[Any], unit: str, topic: str, file: str) -> Clock:
    """Read stamps.

    Args:
        stamps: As they are in the log.
        unit: Their unit, or ``auto``.
        topic: Their topic, for messages.
        file: The log, for messages.

    Raises:
        ConfigurationError: For no stamp, one that is not finite, and a clock that was set.
    """
    if not len(stamps) or not np.isfinite(stamps).all():
        raise ConfigurationError(
            f"the topic {topic!r} has no samples" if not len(stamps) else "a stamp is not finite",
            file=file,
            key=topic or None,
            found=f"{len(stamps)} stamps",
            expected="samples with stamps",
            remedy="check the recording",
        )
    notes = []
    if unit == "auto":
        unit = _unit_of(stamps)
        if unit != "s":
            notes.append(f"stamps are read as {unit}, by their magnitude and distance")
    factor = UNITS[unit]
    first = stamps[0]
    if stamps.dtype.kind in "iu":
        origin = int(first) * factor
        seconds = (stamps - first).astype(np.float64) * (factor / 1e9)
        seconds = np.round(seconds, 9)
    else:
        origin = round(float(first) * factor)
        seconds = (stamps - first) * (factor / 1e9)
        # As it is, if it counts from 0: no rounding of a difference.
        origin = 0 if first == 0 else origin
    notes += _order_notes(seconds, topic, file)
    return Clock(origin, seconds, unit, notes)


def _unit_of(stamps: NDArray[Any]) -> str:
    """Unit by the magnitude of a date, else by the usual distance."""
    first = abs(float(stamps[0]))
    for unit, factor in UNITS.items():
        if _EPOCH[0] <= first * factor <= _EPOCH[1]:
            return unit
    steps = np.abs(np.diff(stamps.astype(np.float64)))
    steps = steps[steps > 0]
    usual = float(np.median(steps)) if len(steps) else 0.0
    for unit, factor in UNITS.items():
        if usual * factor / 1e9 <= _LONGEST_STEP:
            return unit
    return "ns"


def _order_notes(seconds: NDArray[np.float64], topic: str, file: str) -> list[str]:
    notes = []
    steps = np.diff(seconds)
    name = f" of {topic}" if topic else ""
    doubled = int((steps == 0).sum())
    if doubled:
        notes.append(f"{doubled} stamps{name} are doubled")
    late = np.concatenate([[False], seconds[1:] < np.maximum.accumulate(seconds)[:-1]])
    if late.any():
        edges = np.flatnonzero(np.diff(np.concatenate([[0], late.astype(np.int8), [0]])))
        lengths = edges[1::2] - edges[::2]
        place = int(edges[::2][int(np.argmax(lengths))])
        back = float(np.max(np.maximum.accumulate(seconds)[:-1] - seconds[1:]))
        if lengths.max() > _LATE:
            raise _was_set(seconds[place] - seconds[place - 1], place, seconds, topic, file)
        notes.append(f"{int(late.sum())} samples{name} are out of order, by up to {back:g} s")
    if len(steps) and steps.max() > _LONGEST_JUMP:
        place = int(np.argmax(steps)) + 1
        raise _was_set(float(steps.max()), place, seconds, topic, file)
    return notes


def _was_set(
    by: float, place: int, seconds: NDArray[np.float64], topic: str, file: str
) -> ConfigurationError:
    return ConfigurationError(
        f"the clock of the topic {topic!r} was set: it jumps by {by:+g} s",
        file=file,
        key=topic or None,
        found=f"at sample {place} of {len(seconds)}, {seconds[place - 1]:g} s after the first",
        expected="one clock",
        remedy="take the other stamps (`time: {stamps: receipt}`), or cut the log there",
    )
