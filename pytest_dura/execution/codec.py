"""Codec of episodes: packed as plain data, so that unpacking one runs no code of others."""

from __future__ import annotations

import hashlib
import json
import math
import re
import zlib
from collections import Counter
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.codec import decode, encode
from pytest_dura.core.episode import Episode, EpisodeSpec, plain_value
from pytest_dura.core.errors import DuraError
from pytest_dura.core.metrics import DependabilityMetrics, FaultRecord, Tally
from pytest_dura.core.simulator import Line, Recording, Scene, Tracks
from pytest_dura.core.state import Event
from pytest_dura.requirements.episode_verdicts import CheckVerdict, JudgedEpisode

Data = dict[str, Any]

MAX_UNPACKED_BYTES = 1 << 28
"""Most that an episode may unpack to: some hundred times a long one with a full scene."""
_SEAL = 32
"""Bytes at the beginning: SHA-256 of the others."""
_KINDS = "biufU"
"""Kinds of NumPy columns: truth values, numbers and texts; none of them holds objects."""
_DTYPE = re.compile(rf"[<>|=][{_KINDS}][0-9]{{1,9}}")
_DIGEST = re.compile(r"[0-9a-f]{64}")
_DIGESTS = ("digest", "trajectory")


class DamagedEpisodeError(DuraError):
    """Error for bytes that are no episode, or not the one that was packed."""


def pack(episode: Episode) -> bytes:
    """Pack all of an episode but its spec, compressed, with what checks say of it by now.

    Floats come back to the bit, so that the digest is the same. Tuples in the data of events come
    back as lists.

    Raises:
        TypeError: For what is no plain data, in the events of a user's simulator for example.
        ValueError: If it is larger than :data:`MAX_UNPACKED_BYTES`.
    """
    columns = _Columns()
    head = {
        "key": episode.spec.key,
        "digest": episode.digest,
        "trajectory": episode.trajectory,
        "drawn": episode.drawn,
        "time": columns.add(episode.time),
        "signals": {name: columns.add(signal) for name, signal in episode.signals.items()},
        "decisions": {name: columns.add(decision) for name, decision in episode.decisions.items()},
        "events": [*episode.events],
        "faults": [asdict(fault) for fault in episode.faults],
        "termination": episode.termination,
        "metrics": _metrics(episode.metrics, columns),
        "failure": episode.failure,
        "timeouts": list(episode.timeouts),
        "recording": None if episode.recording is None else _recording(episode.recording, columns),
        "columns": columns.kinds,
        "verdicts": encode(episode.check_verdicts if isinstance(episode, JudgedEpisode) else {}),
    }
    text = json.dumps(head, default=plain_value).encode()
    whole = b"%d\n" % len(text) + text + b"".join(columns.data)
    if len(whole) > MAX_UNPACKED_BYTES:
        raise ValueError(f"it takes {len(whole)} bytes, and at most {MAX_UNPACKED_BYTES} are read")
    data = zlib.compress(whole, 1)
    return hashlib.sha256(data).digest() + data


def unpack(data: bytes, spec: EpisodeSpec) -> JudgedEpisode:
    """Unpack an episode, the inverse of :func:`pack`.

    Args:
        data: What was packed.
        spec: Of the same episode.

    Raises:
        DamagedEpisodeError: For any other bytes, the episode of another spec included.
    """
    seal, inner = data[:_SEAL], data[_SEAL:]
    if hashlib.sha256(inner).digest() != seal:
        raise DamagedEpisodeError("it is not as it was written")
    try:
        head, columns = _split(inner)
        if head["key"] != spec.key:
            raise DamagedEpisodeError("it is the episode of another spec")
        episode = JudgedEpisode.of(_episode(head, columns, spec))
        episode.check_verdicts.update(decode(dict[str, CheckVerdict], head["verdicts"]))
        # As it was taken when the episode was made: taking it again would cost more than the rest.
        for name in _DIGESTS:
            vars(episode)[name] = head[name]
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        raise DamagedEpisodeError(f"{type(error).__name__}: {error}") from None
    except (zlib.error, RecursionError, MemoryError) as error:
        raise DamagedEpisodeError(str(error) or type(error).__name__) from None
    return episode


class _Columns:
    """Arrays behind the JSON text, which refers to them by their number."""

    def __init__(self) -> None:
        self.kinds: list[list[Any]] = []
        self.data: list[bytes] = []

    def add(self, column: NDArray[Any]) -> int:
        """Add an array, and return its number."""
        array = np.asarray(column)
        if array.dtype.kind not in _KINDS:
            raise TypeError(f"a column of {array.dtype} is no plain data")
        self.kinds.append([array.dtype.str, list(array.shape)])
        self.data.append(array.tobytes())
        return len(self.kinds) - 1


def _split(data: bytes) -> tuple[Data, list[NDArray[Any]]]:
    decompressor = zlib.decompressobj()
    whole = decompressor.decompress(data, MAX_UNPACKED_BYTES)
    if not decompressor.eof:
        raise ValueError("it is cut short, or too large")
    size, _, rest = whole.partition(b"\n")
    if not size.isdigit():
        raise ValueError("it does not begin with the length of its head")
    length = int(size)
    head, place = json.loads(rest[:length]), length
    columns = []
    for dtype, shape in head["columns"]:
        if not _DTYPE.fullmatch(dtype) or any(type(n) is not int or n < 0 for n in shape):
            raise ValueError("a column is no plain data")
        kind = np.dtype(dtype)
        end = place + kind.itemsize * math.prod(shape)
        # A copy, as in the process that made it: those that a viewer shows can be written to.
        columns.append(np.frombuffer(rest[place:end], dtype=kind).reshape(shape).copy())
        place = end
    if place != len(rest):
        raise ValueError("there is more than its columns")
    return head, columns


def _episode(head: Data, columns: list[NDArray[Any]], spec: EpisodeSpec) -> Episode:
    if not all(_DIGEST.fullmatch(head[name]) for name in _DIGESTS):
        raise ValueError("its digest is none")
    if not isinstance(head["drawn"], bool):
        raise TypeError("what should be a truth value is none")
    texts = [head["termination"], *(() if head["failure"] is None else (head["failure"],))]
    texts += [event[name] for event in head["events"] for name in ("kind", "subject", "detail")]
    texts += [event.get("traceback", "") for event in head["events"]]
    texts += [fault[name] for fault in head["faults"] for name in ("id", "target")]
    if not all(isinstance(text, str) for text in texts):
        raise TypeError("what should be a text is none")
    metrics = _metrics_of(head["metrics"], columns)
    faults = tuple(
        FaultRecord(**{**fault, "read_by": tuple(fault["read_by"])}) for fault in head["faults"]
    )
    metrics.faults = {fault.id: fault for fault in faults}
    recording = head["recording"]
    return Episode(
        spec=spec,
        time=_row(columns[head["time"]], "f"),
        signals={name: _row(columns[place]) for name, place in head["signals"].items()},
        decisions={name: _row(columns[place]) for name, place in head["decisions"].items()},
        events=tuple(Event(**event) for event in head["events"]),
        faults=faults,
        termination=head["termination"],
        metrics=metrics,
        failure=head["failure"],
        timeouts=tuple(head["timeouts"]),
        recording=None if recording is None else _recording_of(recording, columns),
        drawn=head["drawn"],
    )


def _row(column: NDArray[Any], kinds: str = _KINDS) -> NDArray[Any]:
    if column.ndim != 1 or column.dtype.kind not in kinds:
        raise ValueError("a column is not what it stands for")
    return column


SERIES = ("performance", "wall_clock", "robustness", "processing_ns")
"""Metrics of an episode that are measured over time: pairs of lists, by name."""
_PLAIN_NUMBERS = {float: np.dtype("<f8"), int: np.dtype("<i8")}


def _metrics(metrics: DependabilityMetrics, columns: _Columns) -> Data:
    """Everything but the faults, which the episode has itself."""
    data = {name: value for name, value in vars(metrics).items() if name != "faults"}
    for name in SERIES:
        data[name] = {
            key: [_packed_list(values, columns) for values in pair]
            for key, pair in data[name].items()
        }
    return {**data, "tallies": {name: asdict(tally) for name, tally in metrics.tallies.items()}}


def _packed_list(values: list[Any], columns: _Columns) -> int | list[Any]:
    """The number of the column that holds a list, or the list itself; reading text takes longer."""
    kinds = set(map(type, values))
    kind = _PLAIN_NUMBERS.get(kinds.pop()) if len(kinds) == 1 else None
    if kind is None:
        return values
    try:
        return columns.add(np.array(values, kind))
    except OverflowError:  # of whole numbers that no column holds
        return values


def _metrics_of(data: Data, columns: list[NDArray[Any]]) -> DependabilityMetrics:
    series = {
        name: {
            key: tuple(columns[each].tolist() if isinstance(each, int) else each for each in pair)
            for key, pair in data[name].items()
        }
        for name in SERIES
    }
    restored = {
        "violations": Counter(data["violations"]),
        "reactions": Counter(data["reactions"]),
        "recoveries": [tuple(recovery) for recovery in data["recoveries"]],
        "tallies": {name: Tally(**tally) for name, tally in data["tallies"].items()},
    }
    return replace(DependabilityMetrics(), **{**data, **series, **restored})


def _recording(recording: Recording, columns: _Columns) -> Data:
    data = dict(vars(recording))
    data["flags"] = {name: columns.add(flag) for name, flag in recording.flags.items()}
    scene = recording.scene
    if scene is not None:
        data["scene"] = {
            "lines": [[line.kind, columns.add(line.points)] for line in scene.lines],
            "truth": [list(scene.truth.ids), columns.add(scene.truth.poses)],
            "percept": [list(scene.percept.ids), columns.add(scene.percept.poses)],
            "ego": scene.ego,
        }
    return data


def _recording_of(data: Data, columns: list[NDArray[Any]]) -> Recording:
    scene = data["scene"]
    if scene is not None:
        tracks = {
            name: Tracks(tuple(scene[name][0]), columns[scene[name][1]])
            for name in ("truth", "percept")
        }
        lines = tuple(Line(kind, columns[place]) for kind, place in scene["lines"])
        scene = Scene(lines, tracks["truth"], tracks["percept"], scene["ego"])
    texts = ("explanations", "reasons", "recoveries", "accounts")
    columns_of_texts = {name: tuple(data[name]) for name in texts}
    flags = {name: columns[place] for name, place in data["flags"].items()}
    return Recording(**{**data, **columns_of_texts, "flags": flags, "scene": scene})
