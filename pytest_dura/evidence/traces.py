"""Trace: an episode tick by tick, the name of its file, and the first difference of two."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.codec import fields_as_data
from pytest_dura.core.episode import Episode
from pytest_dura.core.loop_signals import EXCHANGE, NULL, SECONDS
from pytest_dura.core.simulator import POSE, Recording
from pytest_dura.evidence.entry import plain_data
from pytest_dura.evidence.text import one_line

TRACE_FOLDER = "episodes"
"""Folder of the traces in a bundle."""
_MAX_SLUG = 80
"""Greatest number of characters of an id in a file's name."""
_NAME = re.compile(r"(?!.*\.\.)[A-Za-z0-9_][A-Za-z0-9._-]{0,79}-[0-9a-f]{8}\.mcap")
_PATH = re.compile(rf"{TRACE_FOLDER}/({_NAME.pattern})")
# Names of devices, which Windows recognises before the first point.
_DEVICE = re.compile(r"(?i)(con|prn|aux|nul|com[0-9]|lpt[0-9])(\.|-|$)")


def episode_name(about: Mapping[str, Any]) -> str:
    """Make a file's name without suffix: the shortened id, and a digest that is unique.

    Args:
        about: With ``id``, ``component``, ``seed`` and ``digest`` of the episode.
    """
    identity = [about[key] for key in ("id", "component", "seed", "digest")]
    digest = hashlib.sha256(json.dumps(identity).encode()).hexdigest()[:8]
    return f"{slug(str(about['id']))}-{digest}"


def slug(text: str) -> str:
    """Turn a text into a part of a file's name; two texts may have the same one."""
    name = re.sub(r"[^A-Za-z0-9._-]+", "-", text[: 4 * _MAX_SLUG])
    name = re.sub(r"\.{2,}", ".", name).lstrip(".-")[:_MAX_SLUG].rstrip(".-")
    return f"_{name}"[:_MAX_SLUG] if _DEVICE.match(name) else name or "episode"


def trace_path(about: Mapping[str, Any]) -> str:
    """Make the path of an episode's trace in the bundle: ``episodes/<name>.mcap``."""
    return f"{TRACE_FOLDER}/{episode_name(about)}.mcap"


def is_trace_name(name: str) -> bool:
    """Whether a file of this name in ``episodes`` is a trace, complete or partly written."""
    partial = name.removeprefix(".").rpartition("-")[0] if name.startswith(".") else ""
    return _NAME.fullmatch(partial or name) is not None


def is_trace_path(path: Any) -> bool:
    """Whether a path may be that of a trace, which never leads out of the bundle."""
    return isinstance(path, str) and _PATH.fullmatch(path) is not None


@dataclass(frozen=True)
class Trace:
    """All columns of an episode, bit by bit.

    Args:
        about: ``id``, ``case``, ``component``, ``seed``, ``digest``, ``validity``,
            ``termination``, ``failure``.
        time: Simulated seconds, shape ``(ticks,)``.
        signals: By name, each of shape ``(ticks,)``; ``percept.name`` is as perceived.
        decisions: ``verdict``, ``source``, ``proposed``, ``executed``, ``attempts``; each of shape
            ``(ticks - 1,)``. See :class:`~pytest_dura.core.episode.Episode`.
        events: ``{tick, time, kind, subject, detail, data}`` in their order; with ``wall_clock``
            where that is true, of what depends on the machine's speed.
        recording: Texts of each decision, and the scene. Accounts are without what does not
            belong to the trace: the null component's, and wall-clock times.
    """

    about: Mapping[str, Any]
    time: NDArray[np.float64]
    signals: Mapping[str, NDArray[np.float64]]
    decisions: Mapping[str, NDArray[Any]]
    events: Sequence[Mapping[str, Any]]
    recording: Recording

    @classmethod
    def of(cls, episode: Episode) -> Trace:
        """Make the trace of an episode, with which it shares the columns."""
        about = {
            "id": episode.id,
            "case": episode.spec.case,
            "component": episode.spec.component,
            "seed": episode.spec.seed,
            "digest": episode.digest,
            "validity": episode.validity,
            "termination": episode.termination,
            "failure": episode.failure,
        }
        recording = episode.recording or Recording()
        accounts = tuple(
            {key: value for key, value in account.items() if key not in (NULL, SECONDS)}
            for account in recording.accounts
        )
        return cls(
            about,
            episode.time,
            episode.signals,
            episode.decisions,
            [plain_data(fields_as_data(event)) for event in episode.events],
            replace(recording, accounts=accounts),
        )

    def without_secrets(self, redact: Callable[[Any], Any]) -> Trace:
        """Apply a function that removes secrets from plain data to all texts."""
        decisions = dict(self.decisions)
        for name, column in decisions.items():
            if column.dtype.kind == "U":
                distinct, places = np.unique(column, return_inverse=True)
                texts = distinct.tolist()
                redacted = redact(texts)
                if redacted is not texts:
                    decisions[name] = np.array(redacted, dtype=np.str_)[places]
        recording = self.recording
        return replace(
            self,
            about=redact(self.about),
            decisions=decisions,
            events=redact(self.events),
            recording=replace(
                recording,
                explanations=_redacted(recording.explanations, redact),
                reasons=_redacted(recording.reasons, redact),
                recoveries=_redacted(recording.recoveries, redact),
                accounts=tuple(map(redact, recording.accounts)),
                problem=None if recording.problem is None else redact(recording.problem),
            ),
        )


def _redacted(texts: tuple[str, ...], redact: Callable[[Any], Any]) -> tuple[str, ...]:
    """Redact texts, each of the distinct ones once."""
    distinct = list(dict.fromkeys(texts))
    redacted = redact(distinct)
    if redacted is distinct:
        return texts
    replacements = dict(zip(distinct, redacted, strict=True))
    return tuple(replacements[text] for text in texts)


def without_exchange(account: Mapping[str, Any]) -> Mapping[str, Any]:
    """Leave out of an account what was asked and answered in words."""
    return {key: value for key, value in account.items() if key != EXCHANGE}


ABSENT = "nothing"
"""Text in place of a value that only the other trace has."""


@dataclass(frozen=True)
class Difference:
    """First difference between two traces.

    Args:
        column: Name, such as ``signals.gap``, ``decisions.executed`` or ``events``.
        recorded: Value in the one trace, as text.
        replayed: Value in the other.
        tick: First tick at which they differ; ``None`` for what belongs to no tick.
        time: Simulated seconds at that tick.
        also: Further columns that differ at the same tick.
        covered: Whether the episode's digest covers it, which leaves out what is only shown.
    """

    column: str
    recorded: str
    replayed: str
    tick: int | None = None
    time: float | None = None
    also: tuple[str, ...] = ()
    covered: bool = True

    def __str__(self) -> str:
        """Describe the difference on one line."""
        place = "" if self.tick is None else f"tick {self.tick}"
        place += "" if self.time is None else f" ({self.time:.3f} s)"
        text = f"{place}, " if place else ""
        text += f"{self.column}: recorded {self.recorded}, replayed {self.replayed}"
        if self.also:
            more = f" and {len(self.also) - 4} more" if len(self.also) > 4 else ""
            text += f"; at this tick also {', '.join(self.also[:4])}{more}"
        return text


def first_difference(
    recorded: Trace, replayed: Trace, *, covered: bool = False
) -> Difference | None:
    """Find the earliest tick at which a column differs; else an event, the end, or the rest.

    Columns are compared bit by bit. Events that depend on the machine's speed are left out.

    Args:
        recorded: The original.
        replayed: The repetition.
        covered: Whether to compare only what the episode's digest covers.
    """
    differences = [
        difference
        for difference in _column_differences(recorded, replayed)
        if difference.covered or not covered
    ]
    timed = [difference for difference in differences if difference.tick is not None]
    if timed:
        tick = min(difference.tick for difference in timed if difference.tick is not None)
        first, *others = [difference for difference in timed if difference.tick == tick]
        times = (trace.time for trace in (recorded, replayed))
        time = next((float(column[tick]) for column in times if tick < len(column)), None)
        return replace(first, time=time, also=tuple(difference.column for difference in others))
    return next(iter([*_other_differences(recorded, replayed), *differences]), None)


def _column_differences(recorded: Trace, replayed: Trace) -> Iterator[Difference]:
    left, right = _all_columns(recorded), _all_columns(replayed)
    for name in dict.fromkeys([*left, *right]):
        covered = name == "time" or name.startswith(("signals.", "decisions."))
        if name not in left or name not in right:
            own, other = (
                "such a column" if name in columns else ABSENT for columns in (left, right)
            )
            yield Difference(name, own, other, covered=covered)
            continue
        place = _first_place(left[name], right[name])
        if place is not None:
            tick, own, other = place
            yield Difference(name, own, other, tick, covered=covered)


def _first_place(left: NDArray[Any], right: NDArray[Any]) -> tuple[int | None, str, str] | None:
    """Find the first place at which two columns differ, and both values there."""
    if left.dtype != right.dtype and not left.dtype.kind == right.dtype.kind == "U":
        return None, str(left.dtype), str(right.dtype)
    shared = min(len(left), len(right))
    places = np.flatnonzero(_bits(left[:shared]) != _bits(right[:shared]))
    place = int(places[0]) if len(places) else shared
    if place == len(left) == len(right):
        return None
    values = [
        _value_text(column[place]) if place < len(column) else ABSENT for column in (left, right)
    ]
    return place, values[0], values[1]


def _bits(column: NDArray[Any]) -> NDArray[Any]:
    """View a column so that it compares bit by bit: NaN equals itself, zeros differ by sign."""
    if column.dtype.kind == "f":
        return np.ascontiguousarray(column).view(f"u{column.dtype.itemsize}")
    return column


def _value_text(value: Any) -> str:
    plain = value.item() if isinstance(value, np.generic) else value
    return one_line(plain, 200, hashed=True) or "''" if isinstance(plain, str) else repr(plain)


def _all_columns(trace: Trace) -> dict[str, NDArray[Any]]:
    """Collect all columns by name: measured values first, then texts and the scene."""
    recording = trace.recording
    columns: dict[str, NDArray[Any]] = {"time": trace.time}
    columns |= {f"signals.{name}": column for name, column in trace.signals.items()}
    columns |= {f"decisions.{name}": column for name, column in trace.decisions.items()}
    columns |= {f"flags.{name}": column for name, column in recording.flags.items()}
    for name in ("explanations", "reasons", "recoveries"):
        texts: tuple[str, ...] = getattr(recording, name)
        # An array of texts would be as wide as its longest, and drop a NUL at the end.
        columns[name] = np.array([*texts, None], object)[:-1]
    accounts = (
        json.dumps(without_exchange(account), sort_keys=True) for account in recording.accounts
    )
    columns["accounts"] = np.array([*accounts, None], object)[:-1]
    scene, ticks = recording.scene, len(trace.time)
    if scene is not None:
        for kind, tracks in (("truth", scene.truth), ("percept", scene.percept)):
            for number, name in enumerate(tracks.ids):
                for place, what in enumerate(POSE):
                    columns[f"{kind}.{name}.{what}"] = tracks.poses[:ticks, number, place]
    return columns


def _other_differences(recorded: Trace, replayed: Trace) -> Iterator[Difference]:
    pairs = enumerate(zip_longest(_events(recorded), _events(replayed)))
    for number, (left, right) in pairs:
        if left != right:
            tick, time = (left or right)["tick"], (left or right)["time"]
            yield Difference(f"events[{number}]", _event_text(left), _event_text(right), tick, time)
            break
    for key in ("termination", "validity", "failure"):
        values = recorded.about.get(key), replayed.about.get(key)
        if values[0] != values[1]:
            own, other = (ABSENT if value is None else _value_text(value) for value in values)
            yield Difference(key, own, other)


def _events(trace: Trace) -> list[dict[str, Any]]:
    """Events that a replay repeats: a traceback names files of the machine."""
    plain = [dict(event) for event in trace.events if not event.get("wall_clock")]
    for event in plain:
        event.pop("traceback", None)
    return plain


def _event_text(event: dict[str, Any] | None) -> str:
    if event is None:
        return ABSENT
    text = " ".join(str(event.get(key, "")) for key in ("kind", "subject", "detail"))
    return f"{one_line(text, 200, hashed=True)} {event.get('data') or ''}".strip()
