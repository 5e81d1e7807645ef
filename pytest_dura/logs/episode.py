"""A recorded log as an episode: resampled, with what was noticed on the way as events."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.episode import RECORDED, Episode, EpisodeSpec
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.metrics import DependabilityMetrics
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.core.simulator import Recording
from pytest_dura.core.state import Event
from pytest_dura.logs.clock import Clock, clock_of, unit_of
from pytest_dura.logs.mapping import LogMapping, SignalEntry, bound, converted, read_mapping
from pytest_dura.logs.reading import HEADER, RECEIPT, Columns, Topic, damaged, format_of, read_whole
from pytest_dura.logs.resampling import Resampled, places, resample, usual_step
from pytest_dura.logs.worlds import LOG_WORLDS, Derived
from pytest_dura.requirements.episode_verdicts import JudgedEpisode
from pytest_dura.requirements.stl.uncertainty import GREATEST, LEAST

NOT_RUN = "recorded, not run"
MOST_SAMPLES = 50_000_000
"""Samples of an episode at most; a step that makes more of them is a slip."""
_MOST_GAPS = 20
_SIMULATOR = "pytest_dura.logs.simulator:RecordedLog"
_COMPONENT = "pytest_dura.logs.simulator:RecordedNotRun"


@dataclass
class _Signal:
    entry: SignalEntry
    topic: str
    time: NDArray[np.float64]
    values: NDArray[np.float64]
    end: float
    """Seconds of the last sample of its topic, also if it lacks this signal."""


@dataclass
class Recorded:
    """A log, read and put on one clock.

    Args:
        file: The log.
        signals: By name.
        origin: Nanoseconds of time 0, from 1970 on if the stamps are dates.
        notes: What was noticed, in words.
        world: World of the mapping, with its options; empty without one.
    """

    file: str
    signals: dict[str, _Signal]
    origin: int
    notes: list[str]
    world: Mapping[str, Mapping[str, Any]]

    @property
    def samples(self) -> int:
        """Samples that were read, of all signals."""
        return sum(len(signal.time) for signal in self.signals.values())

    def step(self) -> float:
        """Return the usual distance of the samples of the fastest signal, to three digits."""
        steps = [usual_step(signal.time) for signal in self.signals.values()]
        known = [step for step in steps if step is not None]
        return float(f"{min(known):.3g}") if known else 1.0


def read_log_file(file: str, mapping: LogMapping) -> Recorded:
    """Read a log and put its signals on one clock.

    Raises:
        ConfigurationError: For a log that cannot be read as a whole, lacks what the mapping names,
            or whose topics do not overlap in time.
    """
    path = Path(file)
    form = format_of(path)
    topics = form.topics(path)
    entries = bound(mapping, topics, file)
    if not entries:
        raise damaged(path, "it has no field that is a number")
    wanted: dict[str, list[str]] = {}
    for name, entry in entries.items():
        fields = wanted.setdefault(entry.topic, [])
        fields += [part for part in entry.fields(name) if part not in fields]
    table = [mapping.time.column] if mapping.time.column else []
    given = read_whole(form, path, {name: [*fields, *table] for name, fields in wanted.items()})
    kind, notes = stamps_of(mapping, given, file)
    clocks = {
        name: clock_of(columns.stamps[kind], unit_of(mapping.time.unit, columns.unit), name, file)
        for name, columns in given.items()
    }
    origin = _origin(clocks, file)
    known = {topic.name: topic for topic in topics}
    notes += [note for clock in clocks.values() for note in clock.notes]
    signals = {}
    for name, entry in entries.items():
        clock, columns = clocks[entry.topic], given[entry.topic]
        values = value_of(name, entry, known[entry.topic], columns, file)
        finite = np.isfinite(values)
        if not finite.any():
            raise no_sample(path, name)
        if not finite.all():
            lacking = int((~finite).sum())
            notes.append(f"{lacking} of {len(values)} samples of {name} are not numbers")
        time = clock.seconds[finite] + (clock.origin - origin) * 1e-9
        order = np.argsort(time, kind="stable")
        end = float(clock.seconds.max()) + (clock.origin - origin) * 1e-9
        signals[name] = _Signal(entry, entry.topic, time[order], values[finite][order], end)
    return Recorded(file, signals, origin, list(dict.fromkeys(notes)), mapping.world)


def no_sample(path: Path, name: str) -> ConfigurationError:
    """Make the error for a signal that a log has, and knows nothing of."""
    return damaged(
        path, f"the signal {name!r} has no finite sample",
        "name the other signals in a mapping, if it is not needed; else record it again",
    )  # fmt: skip


def stamps_of(
    mapping: LogMapping, given: Mapping[str, Columns], file: str
) -> tuple[str, list[str]]:
    """Choose the stamps that all topics have, and say which."""
    asked = mapping.time.column or mapping.time.stamps
    both = [kind for kind in (HEADER, RECEIPT) if all(kind in c.stamps for c in given.values())]
    kinds = [asked] if asked else both
    lacking = [
        name for name, columns in given.items() if not kinds or kinds[0] not in columns.stamps
    ]
    if lacking:
        raise ConfigurationError(
            f"the topic {lacking[0]!r} has no such stamps" if lacking[0] else "no column of stamps",
            file=file,
            key="time",
            found=asked or "nothing that is called time, timestamp, stamp or t",
            expected="stamps of each topic that is bound",
            remedy="name them: `time: {column: NAME}` in a table, else `time: {stamps: receipt}`",
        )
    words = {HEADER: "stamps are those of the messages", RECEIPT: "stamps are the recorder's"}
    return kinds[0], [words[kinds[0]]] if kinds[0] in words and set(given) != {""} else []


def _origin(clocks: Mapping[str, Clock], file: str) -> int:
    """Time 0 of the episode: the first stamp of all topics.

    Raises:
        ConfigurationError: For topics that do not overlap.
    """
    spans = {
        name: (clock.origin, clock.origin + int(clock.seconds.max() * 1e9))
        for name, clock in clocks.items()
    }
    latest = max(first for first, _ in spans.values())
    for name, (first, last) in spans.items():
        if last < latest:
            other = next(each for each, (begin, _) in spans.items() if begin == latest)
            raise ConfigurationError(
                f"the topics {name!r} and {other!r} do not overlap in time",
                file=file,
                key="time",
                found=f"{name!r} from {first * 1e-9:.3f} to {last * 1e-9:.3f} s, "
                f"{other!r} from {latest * 1e-9:.3f} s on",
                expected="one clock",
                remedy="take the other stamps, `time: {stamps: receipt}`, or bind one alone",
            )
    starts = [
        first + int(clock.seconds.min() * 1e9)
        for (first, _), clock in zip(spans.values(), clocks.values(), strict=True)
    ]
    return min(starts)


def value_of(
    name: str, entry: SignalEntry, topic: Topic, columns: Columns, file: str
) -> NDArray[np.float64]:
    """Values of a signal, from the fields that it is made of."""
    parts = [columns.values[part] for part in entry.fields(name)]
    if entry.combine == "norm":
        value = np.sqrt(sum(part * part for part in parts))
    elif entry.combine == "sum":
        value = sum(parts[1:], parts[0])
    elif entry.combine == "difference":
        value = parts[0] - parts[1]
    elif entry.combine == "yaw":
        x, y, z, w = parts
        value = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    else:
        value = parts[0]
    unit = topic.fields.get(entry.fields(name)[0], "")
    unit = "rad" if entry.combine == "yaw" else unit
    return np.asarray(converted(name, entry, value, unit, file), dtype=np.float64)


def sampled(recorded: Recorded, step: float) -> tuple[NDArray[np.float64], dict[str, Resampled]]:
    """Resample all signals to one step; returns the times, and the signals by name.

    Raises:
        ConfigurationError: For a step that makes too many samples.
    """
    last = max(
        int(places(np.array([signal.end]), step, signal.entry.method)[0])
        for signal in recorded.signals.values()
    )
    if last >= MOST_SAMPLES:
        raise ConfigurationError(
            "the log has too many steps",
            file=recorded.file,
            key="time_step",
            found=f"{last:,} steps of {step:g} s",
            expected=f"at most {MOST_SAMPLES:,}",
            remedy="give a longer `time_step`, or the unit of the stamps: `time: {unit: ns}`",
        )
    signals = {
        name: resample(
            signal.time,
            signal.values,
            last + 1,
            step,
            method=signal.entry.method,
            longest_gap=signal.entry.longest_gap,
            rate_at_most=signal.entry.rate_at_most,
        )
        for name, signal in recorded.signals.items()
    }
    return np.arange(last + 1, dtype=np.float64) * step, signals


def columns_of(resampled: Mapping[str, Resampled]) -> dict[str, NDArray[np.float64]]:
    """Return the signals, each with its bounds where it is not known at each sample."""
    columns: dict[str, NDArray[np.float64]] = {}
    for name, each in resampled.items():
        columns |= bounded(name, each.values, each.least, each.greatest)
    return columns


def bounded(name: str, values: Any, least: Any, greatest: Any) -> dict[str, NDArray[np.float64]]:
    """Name the column of a signal, and its bounds where it is not known at each sample."""
    if (least == greatest).all():
        return {name: values}
    return {name: values, LEAST + name: least, GREATEST + name: greatest}


def derived(recorded: Recorded, columns: Mapping[str, NDArray[np.float64]], step: float) -> Derived:
    """What the world of a log makes of its signals; nothing without one.

    Raises:
        ConfigurationError: If the log is not of such a world.
    """
    if not recorded.world:
        return Derived({}, {}, (), None)
    ((name, options),) = recorded.world.items()
    try:
        return Derived(*LOG_WORLDS[name].derive(columns, step, options))
    except ConfigurationError as error:
        raise ConfigurationError(
            error.problem,
            file=error.file or recorded.file,
            key=error.key,
            found=error.found,
            expected=error.expected,
            remedy=error.remedy,
        ) from None


def with_derived(
    columns: dict[str, NDArray[np.float64]], found: Derived
) -> dict[str, NDArray[np.float64]]:
    """Add derived signals, with bounds where they are not known; those of the log stay."""
    whole = dict(columns)
    for name, least in found.least.items():
        greatest = found.greatest[name]
        if name in columns:
            continue
        whole[name] = np.where(least == greatest, least, np.nan)
        if np.isnan(whole[name]).any():
            whole[LEAST + name], whole[GREATEST + name] = least, greatest
    return whole


def episode_of(recorded: Recorded, spec: EpisodeSpec) -> Episode:
    """Make the episode of a log."""
    time, resampled = sampled(recorded, spec.time_step)
    events = []
    whole = np.ones(len(time), dtype=bool)
    for name, each in resampled.items():
        whole &= ~np.isnan(each.values)
        gaps = [
            Event(
                min(int(begin / spec.time_step), len(time) - 1),
                begin,
                "gap",
                name,
                f"no sample from {begin:g} to {end:g} s, and at most {each.longest_gap:g} s is "
                "bridged",
            )
            for begin, end in each.gaps
        ]
        events += gaps[:_MOST_GAPS]
        if len(gaps) > _MOST_GAPS:
            more = f"{len(gaps) - _MOST_GAPS} more gaps"
            events.append(Event(len(time) - 1, float(time[-1]), "gap", name, more))
    share = float(whole.mean())
    detail = (
        f"{NOT_RUN}: {recorded.samples:,} samples of {len(resampled)} signals over {time[-1]:g} s, "
        f"one every {spec.time_step:g} s; all signals are known at {100 * share:.4g} % of them"
    )
    head = Event(0, 0.0, "recorded", recorded.file, detail, {"origin_ns": recorded.origin})
    notes = [Event(0, 0.0, "clock", recorded.file, note) for note in recorded.notes]
    columns = columns_of(resampled)
    found = derived(
        recorded, {name: each.values for name, each in resampled.items()}, spec.time_step
    )
    events += [
        Event(tick, float(time[tick]), kind, subject, detail)
        for tick, kind, subject, detail in found.events
    ]
    steps = len(time) - 1
    kinds = {
        "verdict": "i1",
        "source": "<U1",
        "proposed": "<U1",
        "executed": "<U1",
        "attempts": "i2",
    }
    return Episode(
        spec=spec,
        time=time,
        signals=with_derived(columns, found),
        decisions={name: np.zeros(steps, np.dtype(kind)) for name, kind in kinds.items()},
        events=(head, *notes, *sorted(events, key=lambda event: event.tick)),
        faults=(),
        termination=RECORDED,
        metrics=DependabilityMetrics(),
        recording=None
        if found.scene is None
        else Recording(("",) * steps, ("",) * steps, ("",) * steps, scene=found.scene),
    )


def read_log(
    path: str | Path, mapping: object = None, *, time_step: float | None = None
) -> JudgedEpisode:
    """Read a recorded log as an episode, for scripts and notebooks.

    Args:
        path: The log.
        mapping: Path of a mapping file, or its data; by default each field of a table is a signal.
        time_step: Seconds from sample to sample; by default what the mapping says, else the usual
            distance of the samples of the fastest signal.

    Returns:
        The episode: ``read_log("drive.csv").satisfies("always (gap > 0)")``.

    Raises:
        ConfigurationError: For a log that cannot be read as a whole, or does not fit the mapping.
    """
    read = read_mapping(mapping)
    recorded = read_log_file(str(path), read)
    step = read.time_step or recorded.step() if time_step is None else checked_step(time_step)
    return JudgedEpisode.of(episode_of(recorded, log_spec(str(path), read, step)))


def checked_step(step: float) -> float:
    """Check a step that was given.

    Raises:
        ConfigurationError: If it is no number of seconds above 0.
    """
    if not (math.isfinite(step) and step > 0):
        raise ConfigurationError(
            "the step of a log is a finite number of seconds above 0",
            key="time_step",
            found=step,
            expected="a number above 0, such as 0.1",
            remedy="leave it out for the usual distance of the samples",
        )
    return step


def log_spec(file: str, mapping: LogMapping, step: float) -> EpisodeSpec:
    """Make the spec of a log outside of a session."""
    world = {"log": file, "sha256": digest(file), "mapping": plain(mapping)}
    return EpisodeSpec(
        case=Path(file).name,
        run=0,
        seed=0,
        simulator=RoleSpec(_SIMULATOR),
        roles={"generator": RoleSpec(_COMPONENT)},
        scenario={"name": Path(file).name, "world": world},
        time_step=step,
    )


def plain(mapping: LogMapping) -> dict[str, Any]:
    """Return a mapping as plain data, without what it leaves to defaults."""
    return mapping.model_dump(mode="json", exclude_unset=True)


def digest(file: str) -> str:
    """Return the SHA-256 of a log, or of all files of a folder.

    Raises:
        ConfigurationError: If it cannot be read.
    """
    path = Path(file)
    try:
        files = [path] if path.is_file() else sorted(p for p in path.rglob("*") if p.is_file())
        stats = tuple((str(p), p.stat().st_size, p.stat().st_mtime_ns) for p in files)
        return _digest(stats)
    except OSError as error:
        raise damaged(path, error.strerror or error) from None


@lru_cache(maxsize=4096)
def _digest(files: tuple[tuple[str, int, int], ...]) -> str:
    state = hashlib.sha256()
    for name, _, _ in files:
        with Path(name).open("rb") as stream:
            while block := stream.read(1 << 20):
                state.update(block)
    return state.hexdigest()
