"""Where two traces of one episode begin to differ."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import zip_longest
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.recording import POSE, Scene
from pytest_dura.evidence.text import one_line
from pytest_dura.evidence.traces.trace import Trace

NOTHING = "nothing"
"""What stands for a value that one of the two does not have."""


@dataclass(frozen=True)
class Difference:
    """The first difference.

    Args:
        column: What differs, such as ``signals.gap``, ``decisions.executed`` or ``events``.
        recorded: What it is in the one trace, in words.
        replayed: What it is in the other.
        tick: From which tick on; ``None`` for what belongs to none.
        time: Simulated seconds at that tick.
        also: Further columns that differ at the same tick.
        covered: Whether the episode's digest covers it. It leaves out what is only shown.
    """

    column: str
    recorded: str
    replayed: str
    tick: int | None = None
    time: float | None = None
    also: tuple[str, ...] = ()
    covered: bool = True

    def __str__(self) -> str:
        """One line."""
        place = "" if self.tick is None else f"tick {self.tick}"
        place += "" if self.time is None else f" ({self.time:.3f} s)"
        told = f"{place}, " if place else ""
        told += f"{self.column}: recorded {self.recorded}, replayed {self.replayed}"
        if self.also:
            more = f" and {len(self.also) - 4} more" if len(self.also) > 4 else ""
            told += f"; at this tick also {', '.join(self.also[:4])}{more}"
        return told


def first_difference(
    recorded: Trace, replayed: Trace, *, covered: bool = False
) -> Difference | None:
    """The earliest tick at which a column differs; or else events, end or what belongs to no tick.

    Columns are compared bit by bit. Events that depend on the machine's speed are left out.

    Args:
        recorded: The one.
        replayed: The other.
        covered: Whether to look only at what the episode's digest covers.
    """
    found = [one for one in _columns(recorded, replayed) if one.covered or not covered]
    timed = [one for one in found if one.tick is not None]
    if timed:
        tick = min(one.tick for one in timed if one.tick is not None)
        first, *others = [one for one in timed if one.tick == tick]
        time = _time(recorded, replayed, tick)
        return replace(first, time=time, also=tuple(one.column for one in others))
    return next(iter([*_rest(recorded, replayed), *found]), None)


def _time(recorded: Trace, replayed: Trace, tick: int) -> float | None:
    for trace in (recorded, replayed):
        if tick < len(trace.time):
            return float(trace.time[tick])
    return None


def _columns(recorded: Trace, replayed: Trace) -> Iterator[Difference]:
    left, right = _all_columns(recorded), _all_columns(replayed)
    for name in dict.fromkeys([*left, *right]):
        covered = name == "time" or name.startswith(("signals.", "decisions."))
        if name not in left or name not in right:
            own, other = ("such a column" if name in one else NOTHING for one in (left, right))
            yield Difference(name, own, other, covered=covered)
            continue
        found = _first(left[name], right[name])
        if found is not None:
            tick, own, other = found
            yield Difference(name, own, other, tick, covered=covered)


def _first(left: NDArray[Any], right: NDArray[Any]) -> tuple[int | None, str, str] | None:
    """The first place at which two columns differ, and what is there."""
    if left.dtype != right.dtype and not left.dtype.kind == right.dtype.kind == "U":
        return None, str(left.dtype), str(right.dtype)
    shared = min(len(left), len(right))
    places = np.flatnonzero(_bits(left[:shared]) != _bits(right[:shared]))
    place = int(places[0]) if len(places) else shared
    if place == len(left) == len(right):
        return None
    words = [_word(one[place]) if place < len(one) else NOTHING for one in (left, right)]
    return place, words[0], words[1]


def _bits(column: NDArray[Any]) -> NDArray[Any]:
    """What is equal where the bits are: a NaN is itself, and zeros of both signs differ."""
    if column.dtype.kind == "f":
        return np.ascontiguousarray(column).view(f"u{column.dtype.itemsize}")
    return column


def _word(value: Any) -> str:
    plain = value.item() if isinstance(value, np.generic) else value
    return one_line(plain, 200, hashed=True) or "''" if isinstance(plain, str) else repr(plain)


def _all_columns(trace: Trace) -> dict[str, NDArray[Any]]:
    """Every column by a name of its own: what the loop measured before what it only said."""
    recording = trace.recording
    found: dict[str, NDArray[Any]] = {"time": trace.time}
    found |= {f"signals.{name}": column for name, column in trace.signals.items()}
    found |= {f"decisions.{name}": column for name, column in trace.decisions.items()}
    found |= {f"flags.{name}": column for name, column in recording.flags.items()}
    for name in ("explanations", "reasons", "recoveries"):
        texts: tuple[str, ...] = getattr(recording, name)
        # An array of texts would be as wide as its longest, and drop a NUL at the end.
        found[name] = np.array([*texts, None], object)[:-1]
    accounts = (json.dumps(account, sort_keys=True) for account in recording.accounts)
    found["accounts"] = np.array([*accounts, None], object)[:-1]
    if recording.scene is not None:
        found |= _poses(recording.scene, len(trace.time))
    return found


def _poses(scene: Scene, ticks: int) -> dict[str, NDArray[Any]]:
    """A column for each number of each thing; of one that is never there, none."""
    found = {}
    for kind, tracks in (("truth", scene.truth), ("percept", scene.percept)):
        for number, name in enumerate(tracks.ids):
            for place, what in enumerate(POSE):
                found[f"{kind}.{name}.{what}"] = tracks.poses[:ticks, number, place]
    return found


def _rest(recorded: Trace, replayed: Trace) -> Iterator[Difference]:
    pairs = enumerate(zip_longest(_events(recorded), _events(replayed)))
    for number, (left, right) in pairs:
        if left != right:
            tick, time = (left or right)["tick"], (left or right)["time"]
            yield Difference(f"events[{number}]", _event(left), _event(right), tick, time)
            break
    for key in ("termination", "validity", "failure"):
        values = recorded.about.get(key), replayed.about.get(key)
        if values[0] != values[1]:
            own, other = (NOTHING if one is None else _word(one) for one in values)
            yield Difference(key, own, other)


def _events(trace: Trace) -> list[dict[str, Any]]:
    return [dict(event) for event in trace.events if not event.get("wall_clock")]


def _event(event: dict[str, Any] | None) -> str:
    if event is None:
        return NOTHING
    told = " ".join(str(event.get(key, "")) for key in ("kind", "subject", "detail"))
    return f"{one_line(told, 200, hashed=True)} {event.get('data') or ''}".strip()
