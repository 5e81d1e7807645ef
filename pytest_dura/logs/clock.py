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


def unit_of(declared: str, recorded: str) -> str:
    """Unit of stamps, or ``auto``: what a mapping declares, else what the format says."""
    return recorded or declared if declared == "auto" else declared


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
    known = np.isfinite(stamps)
    if not len(stamps) or not known.all():
        raise ConfigurationError(
            f"the topic {topic!r} has no samples" if not len(stamps) else "a stamp is not finite",
            file=file,
            key=topic or None,
            found=f"{int((~known).sum())} of {len(stamps)} stamps, the first at sample "
            f"{int(np.argmin(known))}"
            if len(stamps)
            else "0 stamps",
            expected="samples with stamps",
            remedy="take these samples out of the log, or name other stamps by `time`",
        )
    notes = []
    if unit == "auto":
        unit = _unit_of(stamps)
        if unit != "s":
            notes.append(f"stamps are read as {unit}, by their magnitude and distance")
    origin = origin_of(stamps[0], unit)
    seconds = seconds_of(stamps, stamps[0], unit)
    order = Order(topic, file)
    order.see(seconds)
    return Clock(origin, seconds, unit, notes + order.notes())


def origin_of(first: Any, unit: str) -> int:
    """Nanoseconds of a first stamp."""
    whole = isinstance(first, np.integer)
    return int(first) * UNITS[unit] if whole else round(float(first) * UNITS[unit])


def seconds_of(stamps: NDArray[Any], first: Any, unit: str) -> NDArray[np.float64]:
    """Seconds from a first stamp on."""
    seconds: NDArray[np.float64] = (stamps - first).astype(np.float64) * (UNITS[unit] / 1e9)
    return np.round(seconds, 9) if stamps.dtype.kind in "iu" else seconds


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


class Order:
    """What is wrong with the order of stamps, which may come piece by piece.

    Args:
        topic: Their topic, for messages.
        file: The log, for messages.
    """

    def __init__(self, topic: str, file: str) -> None:
        self._topic, self._file = topic, file
        self._before = np.empty(0)
        self._count = self._doubled = self._late = 0
        self._back = 0.0

    def see(self, seconds: NDArray[np.float64]) -> None:
        """Take in the next stamps.

        Raises:
            ConfigurationError: For a clock that was set.
        """
        known = len(self._before)
        seconds = np.concatenate([self._before, seconds])
        steps = np.diff(seconds)
        self._doubled += int((steps == 0).sum())
        latest = np.maximum.accumulate(seconds)
        late = np.concatenate([[False], seconds[1:] < latest[:-1]])
        if late.any():
            edges = np.flatnonzero(np.diff(np.concatenate([[0], late.astype(np.int8), [0]])))
            lengths = edges[1::2] - edges[::2]
            if lengths.max() > _LATE:
                raise self._was_set(int(edges[::2][int(np.argmax(lengths))]), seconds)
            self._late += int(late.sum())
            self._back = max(self._back, float(np.max(latest[:-1] - seconds[1:])))
        if len(steps) and steps.max() > _LONGEST_JUMP:
            raise self._was_set(int(np.argmax(steps)) + 1, seconds)
        self._count += len(seconds) - known
        self._before = latest[-1:]

    def notes(self) -> list[str]:
        """Say what was seen, in words."""
        name = f" of {self._topic}" if self._topic else ""
        notes = [f"{self._doubled} stamps{name} are doubled"] if self._doubled else []
        if self._late:
            notes.append(f"{self._late} samples{name} are out of order, by up to {self._back:g} s")
        return notes

    def _was_set(self, place: int, seconds: NDArray[np.float64]) -> ConfigurationError:
        number = self._count - len(self._before) + place
        by = float(seconds[place] - seconds[place - 1])
        return ConfigurationError(
            f"the clock of the topic {self._topic!r} was set: it jumps by {by:+g} s",
            file=self._file,
            key=self._topic or None,
            found=f"at sample {number}, {seconds[place - 1]:g} s after the first",
            expected="one clock",
            remedy="take the other stamps (`time: {stamps: receipt}`), or cut the log there",
        )
