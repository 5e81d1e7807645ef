"""A log block by block: signals at even distances, in memory that does not grow with the log."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.errors import ConfigurationError, did_you_mean, list_names
from pytest_dura.logs.clock import Order, clock_of, origin_of, seconds_of, unit_of
from pytest_dura.logs.episode import (
    MOST_SAMPLES,
    bounded,
    checked_step,
    no_sample,
    stamps_of,
    value_of,
)
from pytest_dura.logs.mapping import LogMapping, SignalEntry, bound
from pytest_dura.logs.reading import Columns, Topic, damaged, format_of, joined
from pytest_dura.logs.resampling import MISSING, places, resample, usual_step

Floats = NDArray[np.float64]
APART = 60.0
"""Seconds by which one topic of a log may be behind another one in the file."""
_HELD = 16
"""Samples that are held back, since one may be stamped before some of them."""
_ENOUGH = 1000
"""Samples of each topic by which its unit and usual distance are known."""
_BLOCK = 1 << 14
"""Samples of the episode that are made at a time, at least."""


@dataclass
class _Feed:
    """A signal, from the last sample that is still needed on.

    Args:
        entry: Its entry of the mapping.
        time: Seconds, in order.
        values: As many.
        longest: Seconds beyond which nothing is known between two samples.
        fixed: Seconds up to which its samples are taken to be complete.
        end: Seconds of the last sample of its topic, also if it lacks this signal.
    """

    entry: SignalEntry
    time: Floats = field(default_factory=lambda: np.empty(0))
    values: Floats = field(default_factory=lambda: np.empty(0))
    longest: float = 0.0
    fixed: float = -math.inf
    end: float = -math.inf

    def add(self, time: Floats, values: Floats) -> None:
        """Add samples, in order."""
        if len(self.time) and len(time) and time.min() < self.time[-1]:
            time, values = np.append(self.time, time), np.append(self.values, values)
            order = np.argsort(time, kind="stable")
            self.time, self.values = time[order], values[order]
        else:
            order = np.argsort(time, kind="stable")
            self.time = np.append(self.time, time[order])
            self.values = np.append(self.values, values[order])

    def forget(self, before: float) -> None:
        """Forget samples before a time, but for the last one of them."""
        keep = max(int(np.searchsorted(self.time, before, "left")) - 1, 0)
        self.time, self.values = self.time[keep:], self.values[keep:]


@dataclass
class _TopicClock:
    unit: str
    first: Any
    origin: int
    order: Order


class LogStream:
    """A log, or what is recorded right now, as blocks of signals at even distances.

    Args:
        file: Name of the log, for messages.
        topics: What it holds.
        mapping: Its mapping.
        names: Signals that there have to be; ``live``, those alone are made. Default: all.
        step: Seconds from sample to sample; default: what the mapping says, else the usual distance
            of the first samples of the fastest signal.
        live: Whether it is recorded right now: each sample is made as soon as it is known, and
            what comes late is left out, and counted in ``late``.

    Raises:
        ConfigurationError: For a mapping that does not fit, and a signal that it lacks.
    """

    def __init__(
        self,
        file: str,
        topics: list[Topic],
        mapping: LogMapping,
        names: Collection[str] | None = None,
        step: float | None = None,
        *,
        live: bool = False,
    ) -> None:
        entries = bound(mapping, topics, file)
        for name in names or ():
            if name not in entries:
                others = {each: kind for topic in topics for each, kind in topic.others.items()}
                raise _lacks(file, name, entries, others.get(name, ""))
        # Time 0, the step and the end of a log are those of all its signals, as when it is read
        # as a whole; of what is recorded right now nothing else is waited for.
        chosen = {name: entries[name] for name in names} if live and names else entries
        self.file, self._mapping, self._live = file, mapping, live
        self._topics = {topic.name: topic for topic in topics}
        self._feeds = {
            name: _Feed(entry, longest=entry.longest_gap or 0.0) for name, entry in chosen.items()
        }
        self.step = mapping.time_step or 0.0 if step is None else checked_step(step)
        self.names = tuple(chosen)
        self.wanted: dict[str, list[str]] = {}
        for name, entry in chosen.items():
            fields = self.wanted.setdefault(entry.topic, [])
            fields += [part for part in entry.fields(name) if part not in fields]
        if mapping.time.column:
            for fields in self.wanted.values():
                fields.append(mapping.time.column)
        self._clocks: dict[str, _TopicClock] = {}
        self._kind = ""
        self._origin = 0
        self._apart = 0.0 if live else APART
        self._held = 0 if live else _HELD
        self._reached = 0.0
        self.made = 0
        self.late = self.samples = self.lacking = 0
        self._notes: list[str] = []

    def blocks(self, given: Iterable[Mapping[str, Columns]]) -> Iterator[dict[str, Floats]]:
        """Yield the signals of one stretch after another, with bounds where they are not known.

        Args:
            given: Blocks of the log's format.

        Raises:
            ConfigurationError: For a clock that was set, and topics that do not go together.
        """
        source = iter(given)
        self._begin(source)
        yield from self._due()
        for block in source:
            for topic, columns in block.items():
                self._add(topic, columns)
            yield from self._due()
        yield from self._rest()

    def notes(self) -> list[str]:
        """Say what was noticed on the way, in words."""
        orders = [note for clock in self._clocks.values() for note in clock.order.notes()]
        lacking = f"{self.lacking} values are not numbers"
        return [*self._notes, *orders, *([lacking] if self.lacking else [])]

    def _begin(self, source: Iterator[Mapping[str, Columns]]) -> None:
        """Read until each topic is known: its unit, its usual distance and the time 0."""
        first: dict[str, list[Columns]] = {name: [] for name in self.wanted}
        for block in source:
            for topic, columns in block.items():
                first[topic].append(columns)
            counts = [sum(map(_count, pieces)) for pieces in first.values()]
            if min(counts) >= (1 if self._live else _ENOUGH) or sum(counts) > 100 * _ENOUGH:
                break
        whole = {name: joined(pieces, self.wanted[name]) for name, pieces in first.items()}
        there = {name: columns for name, columns in whole.items() if _count(columns)}
        if not there:
            raise damaged(Path(self.file), "it has no samples")
        self._kind, self._notes = stamps_of(self._mapping, there, self.file)
        origins = []
        for name, columns in there.items():
            clock = self._clock(name, columns)
            seconds = seconds_of(columns.stamps[self._kind], clock.first, clock.unit)
            origins.append(clock.origin + int(seconds.min() * 1e9))
        self._origin = min(origins)
        for name, columns in there.items():
            self._add(name, columns)
        if not self.step:
            steps = [usual_step(feed.time) for feed in self._feeds.values()]
            known = [step for step in steps if step is not None]
            self.step = float(f"{min(known):.3g}") if known else 1.0

    def _clock(self, topic: str, columns: Columns) -> _TopicClock:
        """The clock of a topic, by its first samples."""
        clock = self._clocks.get(topic)
        if clock is None:
            stamps = columns.stamps[self._kind]
            unit = unit_of(self._mapping.time.unit, columns.unit)
            known = clock_of(stamps, unit, topic, self.file)
            self._notes += [note for note in known.notes if note.startswith("stamps are read")]
            first = stamps[0]
            order = Order(topic, self.file)
            clock = _TopicClock(known.unit, first, origin_of(first, known.unit), order)
            self._clocks[topic] = clock
        return clock

    def _add(self, topic: str, columns: Columns) -> None:
        if not _count(columns):
            return
        if self._kind not in columns.stamps:
            raise damaged(Path(self.file), f"some messages of {topic!r} have no {self._kind} stamp")
        clock = self._clock(topic, columns)
        seconds = seconds_of(columns.stamps[self._kind], clock.first, clock.unit)
        clock.order.see(seconds)
        time = seconds + (clock.origin - self._origin) * 1e-9
        for name, feed in self._feeds.items():
            if feed.entry.topic != topic:
                continue
            values = value_of(name, feed.entry, self._topics[topic], columns, self.file)
            known = np.isfinite(values)
            self.lacking += int((~known).sum())
            known &= self._in_time(name, time, feed.fixed)
            self.samples += int(known.sum())
            feed.add(time[known], values[known])
            feed.end = max(feed.end, float(time.max()))
            if not feed.longest and len(feed.time) > 1:
                usual = usual_step(feed.time) or self.step or 1.0
                feed.longest = MISSING * usual
        self._reached = max(self._reached, float(time.max()))

    def _in_time(self, name: str, time: Floats, fixed: float) -> NDArray[np.bool_]:
        """Samples that do not fall into what was taken to be complete.

        Raises:
            ConfigurationError: For one that does, in a log.
        """
        late = time < fixed
        if late.any() and not self._live:
            behind = self._reached - float(time[late].min())
            raise ConfigurationError(
                f"samples of {name!r} come too late in the file to be read block by block",
                file=self.file,
                found=f"one stamped {behind:g} s before what was read",
                expected=f"at most {APART:g} s, and {_HELD} samples of its topic",
                remedy="judge the log as a whole, or take the other stamps "
                "(`time: {stamps: receipt}`)",
            )
        self.late += int(late.sum())
        return ~late

    def _due(self) -> Iterator[dict[str, Floats]]:
        """Make the samples that nothing which follows changes."""
        complete = self._reached - self._apart
        times, fixed = [], []
        for feed in self._feeds.values():
            own = feed.time[-1 - self._held] if len(feed.time) > self._held else -math.inf
            gone = complete - (feed.longest or MISSING * self.step)
            times.append(max(float(own), gone))
            fixed.append(float(own) if own >= gone else complete)
        end = math.floor(min(times) / self.step)  # each has a sample at or after the next one
        if end - self.made >= (1 if self._live else _BLOCK):
            for feed, until in zip(self._feeds.values(), fixed, strict=True):
                feed.fixed = max(feed.fixed, until)
            yield self._stretch(end, self._reached)

    def _rest(self) -> Iterator[dict[str, Floats]]:
        """Make the last samples.

        Raises:
            ConfigurationError: For a signal without a sample.
        """
        last = self.made
        for name, feed in self._feeds.items():
            if not len(feed.time):
                raise no_sample(Path(self.file), name)
            end = int(places(np.array([feed.end]), self.step, feed.entry.method)[0]) + 1
            last = max(last, end)
        if last > self.made:
            yield self._stretch(last, (last - 1) * self.step)

    def _stretch(self, end: int, until: float) -> dict[str, Floats]:
        """Make the samples up to the one of a number."""
        count = end - self.made
        if count > MOST_SAMPLES:
            raise damaged(
                Path(self.file), f"{count:,} steps of {self.step:g} s lie between two samples",
                "give a longer `time_step`, or the unit of the stamps: `time: {unit: ns}`",
            )  # fmt: skip
        columns: dict[str, Floats] = {}
        for name, feed in self._feeds.items():
            if not len(feed.time):
                unknown = np.full(count, np.nan)
                columns |= bounded(name, unknown, unknown, unknown)
                continue
            made = resample(
                feed.time,
                feed.values,
                count,
                self.step,
                method=feed.entry.method,
                longest_gap=feed.longest or MISSING * self.step,
                rate_at_most=feed.entry.rate_at_most,
                first=self.made,
                until=until,
            )
            columns |= bounded(name, made.values, made.least, made.greatest)
            feed.forget((end - 1) * self.step)
        self.made = end
        return columns


def _count(columns: Columns) -> int:
    return len(next(iter(columns.stamps.values()), ()))


def _lacks(file: str, name: str, known: Mapping[str, Any], kind: str = "") -> ConfigurationError:
    return ConfigurationError(
        f"unknown signal {name!r}",
        file=file,
        found=f"a field of that name that holds a {kind}, not a number" if kind else name,
        expected=f"one of {list_names(list(known))}" if known else "a log with numbers",
        remedy="record it as a number, with a point, and without its unit"
        if kind or not known
        else did_you_mean(name, list(known)),
    )


def stream_of(
    file: str,
    mapping: LogMapping,
    names: Collection[str] | None = None,
    step: float | None = None,
) -> tuple[LogStream, Iterator[dict[str, Floats]]]:
    """Open a log block by block: the stream, and its blocks.

    Raises:
        ConfigurationError: For a log that cannot be read, and a mapping that does not fit or names
            a world, whose signals need the whole log.
    """
    if mapping.world:
        raise ConfigurationError(
            "the signals of a world need the whole log",
            file=file,
            key="world",
            found=next(iter(mapping.world)),
            expected="a mapping without `world`",
            remedy="judge the log as a whole: `pytest --dura-log`",
        )
    path = Path(file)
    form = format_of(path)
    stream = LogStream(file, form.topics(path), mapping, names, step)
    return stream, stream.blocks(form.blocks(path, stream.wanted))
