"""Traces as MCAP files: channels that Foxglove shows, and the exact columns as an attachment.

The columns are an ``.npz``, written and read back bit by bit.
"""

from __future__ import annotations

import io
import json
import math
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.files import replace_file
from pytest_dura.core.loop_signals import account_problem
from pytest_dura.core.simulator import POSE, Line, Recording, Scene, Tracks
from pytest_dura.evidence.foxglove import (
    CHANNELS,
    TextCache,
    decision_messages,
    event_messages,
    percept_messages,
    road_messages,
    schema_of,
    schema_text,
    signal_messages,
    truth_messages,
)
from pytest_dura.evidence.traces import Trace

MAX_UNPACKED_BYTES = 512 * 2**20
"""Greatest size of the unpacked columns; an episode has about 200 kB."""
_TEXT_TABLE = "texts"
"""Member in JSON: names, tables of texts and the layout of the columns."""

Column = NDArray[Any]
_KINDS = "biuf"


def pack_columns(trace: Trace) -> bytes:
    """Write a trace as an ``.npz`` for ``numpy.load``; the same trace gives the same bytes.

    Signals are the rows of ``signals``, in the order of ``texts["signals"]``. Texts are numbers
    that count the entries of a table in ``texts``.

    Raises:
        ValueError: For a column that has another type or shape than a trace's, and for a trace
            larger than ``MAX_UNPACKED_BYTES``.
    """
    shape = np.shape(trace.time)
    arrays: dict[str, Column] = {"time": _float64("time", trace.time, shape)}
    texts: dict[str, Any] = {
        "about": dict(trace.about),
        "events": list(trace.events),
        "signals": list(trace.signals),
        "decisions": {},
        "said": {},
        "flags": list(trace.recording.flags),
        "problem": trace.recording.problem,
        "scene": None,
    }
    columns = [_float64(name, signal, shape) for name, signal in trace.signals.items()]
    arrays["signals"] = np.array(columns) if columns else np.empty((0, *shape))
    for number, (name, column) in enumerate(trace.decisions.items()):
        if column.dtype.kind == "U":
            codes, table = _coded(column.tolist())
            texts["decisions"][name] = {"dtype": column.dtype.str, "table": table}
        elif column.dtype.kind in _KINDS:
            codes = column
            texts["decisions"][name] = None
        else:
            raise ValueError(f"the column {name!r} has the type {column.dtype}")
        arrays[f"decisions.{number}"] = codes
    for name in _TEXT_COLUMNS:
        arrays[f"said.{name}"], texts["said"][name] = _coded(getattr(trace.recording, name))
    accounts = [_compact(account) for account in trace.recording.accounts]
    arrays["accounts"], texts["accounts"] = _coded(accounts)
    flags = list(trace.recording.flags.values())
    arrays["flags"] = np.array(flags, np.int8) if flags else np.empty((0, 0), np.int8)
    if trace.recording.scene is not None:
        texts["scene"] = _pack_scene(arrays, trace.recording.scene)
    text = _compact(texts).encode()
    arrays[_TEXT_TABLE] = np.frombuffer(text, np.uint8)
    if sum(array.nbytes for array in arrays.values()) > MAX_UNPACKED_BYTES:
        raise ValueError(f"the trace is larger than {MAX_UNPACKED_BYTES} bytes")
    return _zipped(arrays)


_TEXT_COLUMNS = ("explanations", "reasons", "recoveries")


def _compact(data: Any) -> str:
    return json.dumps(data, allow_nan=False, separators=(",", ":"))


def _pack_scene(arrays: dict[str, Column], scene: Scene) -> dict[str, Any]:
    arrays["truth"], arrays["percept"] = scene.truth.poses, scene.percept.poses
    points = [np.asarray(line.points, np.float32) for line in scene.lines]
    arrays["lines"] = np.concatenate(points) if points else np.empty((0, 2), np.float32)
    return {
        "ego": scene.ego,
        "truth": list(scene.truth.ids),
        "percept": list(scene.percept.ids),
        "lines": [[line.kind, len(line.points)] for line in scene.lines],
    }


def _float64(name: str, column: Column, shape: tuple[int, ...]) -> NDArray[np.float64]:
    values = np.asarray(column)
    if values.dtype != np.float64 or values.shape != shape or len(shape) != 1:
        raise ValueError(f"the column {name!r} is {values.dtype} of the shape {values.shape}")
    return values


def _coded(values: Sequence[str]) -> tuple[NDArray[np.int32], list[str]]:
    """Encode texts as numbers that index a table."""
    table: dict[str, int] = {}
    codes = [table.setdefault(value, len(table)) for value in values]
    return np.array(codes, np.int32), list(table)


def _zipped(arrays: Mapping[str, Column]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, array in arrays.items():
            contiguous = np.ascontiguousarray(array)
            head = io.BytesIO()
            np.lib.format.write_array_header_1_0(
                head, np.lib.format.header_data_from_array_1_0(contiguous)
            )
            member = zipfile.ZipInfo(f"{name}.npy")  # dated 1980-01-01
            member.create_system = 3  # on any system
            data = head.getvalue() + contiguous.tobytes()
            archive.writestr(member, data, zipfile.ZIP_DEFLATED, compresslevel=1)
    return stream.getvalue()


def unpack_columns(data: bytes) -> Trace:
    """Read what :func:`pack_columns` gives; nothing in it is run, and its size is bounded.

    Raises:
        ValueError: For data that are no such columns.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = archive.infolist()
            most = MAX_UNPACKED_BYTES + 1024 * len(members)
            if sum(member.file_size for member in members) > most:
                raise ValueError(f"the columns are larger than {MAX_UNPACKED_BYTES} bytes")
            arrays = {}
            for member in members:
                # No more than the declared size is unpacked, unlike by `archive.read`.
                with archive.open(member) as stream:
                    column = _array(stream.read(member.file_size))
                arrays[member.filename.removesuffix(".npy")] = column
        return _trace(arrays)
    except (
        AttributeError, LookupError, NotImplementedError, OSError, RecursionError, RuntimeError,
        TypeError, zipfile.BadZipFile, zipfile.LargeZipFile, zlib.error,
    ) as error:  # fmt: skip
        raise ValueError(f"the columns are damaged ({type(error).__name__}: {error})") from None


def _array(data: bytes) -> Column:
    stream = io.BytesIO(data)
    if np.lib.format.read_magic(stream) != (1, 0):
        raise ValueError("the columns have another format")
    shape, by_columns, dtype = np.lib.format.read_array_header_1_0(stream)
    count, start = math.prod(shape), stream.tell()
    if dtype.kind not in _KINDS or by_columns or len(data) - start != count * dtype.itemsize:
        raise ValueError("a column is not what its header says")
    # A copy, as an array on a buffer of bytes is read-only.
    column: Column = np.frombuffer(data, dtype, count, start).reshape(shape).copy()
    return column


def _trace(arrays: Mapping[str, Column]) -> Trace:
    texts = json.loads(arrays[_TEXT_TABLE].tobytes())
    time, signals = arrays["time"], arrays["signals"]
    names = _names(texts["signals"])
    _require(time.dtype == np.float64 and time.ndim == 1, "time")
    _require(signals.dtype == np.float64 and signals.shape == (len(names), len(time)), "signals")
    decisions: dict[str, Column] = {}
    for number, (name, encoding) in enumerate(texts["decisions"].items()):
        codes = arrays[f"decisions.{number}"]
        if encoding is not None:
            dtype = np.dtype(str(encoding["dtype"]))
            table = _names(encoding["table"])
            _require(dtype.kind == "U" and dtype.itemsize * codes.size <= MAX_UNPACKED_BYTES, name)
            decoded = _decoded(codes, table)
            _require(max(map(len, table), default=0) * 4 <= dtype.itemsize, name)
            decisions[name] = np.array(decoded, dtype)
        else:
            _require(codes.ndim == 1, name)
            decisions[name] = codes
    columns: dict[str, Any] = {
        name: tuple(_decoded(arrays[f"said.{name}"], texts["said"][name])) for name in _TEXT_COLUMNS
    }
    columns["accounts"] = tuple(_accounts(arrays, texts)) if "accounts" in texts else ()
    monitors, flags = _names(texts["flags"]), arrays["flags"]
    _require(flags.dtype == np.int8 and flags.ndim == 2 and len(flags) == len(monitors), "flags")
    scene = None if texts["scene"] is None else _scene(arrays, texts["scene"])
    problem = texts["problem"]
    _require(problem is None or isinstance(problem, str), "problem")
    recording = Recording(
        **columns, flags=dict(zip(monitors, flags, strict=True)), scene=scene, problem=problem
    )
    rows = dict(zip(names, signals, strict=True))
    _require(isinstance(texts["about"], dict), "about")
    events = texts["events"]
    _require(
        isinstance(events, list) and all(isinstance(event, dict) for event in events), "events"
    )
    return Trace(texts["about"], time, rows, decisions, events, recording)


def _accounts(arrays: Mapping[str, Column], texts: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Parse each distinct account once."""
    known = {}
    for text in _names(texts["accounts"]):
        account = json.loads(text)
        _require(account_problem(account) is None, "accounts")
        known[text] = account
    return [known[text] for text in _decoded(arrays["accounts"], texts["accounts"])]


def _scene(arrays: Mapping[str, Column], layout: Mapping[str, Any]) -> Scene:
    tracks = {}
    for name in ("truth", "percept"):
        ids, poses = _names(layout[name]), arrays[name]
        _require(poses.dtype == np.float32 and poses.ndim == 3, name)
        _require(poses.shape[1:] == (len(ids), len(POSE)), name)
        tracks[name] = Tracks(tuple(ids), poses)
    points, start = arrays["lines"], 0
    _require(points.dtype == np.float32 and points.ndim == 2 and points.shape[1] == 2, "lines")
    lines = []
    for kind, length in layout["lines"]:
        _require(isinstance(length, int) and 0 <= length <= len(points) - start, "lines")
        lines.append(Line(str(kind), points[start : start + length]))
        start += length
    _require(start == len(points), "lines")
    return Scene(tuple(lines), ego=str(layout["ego"]), **tracks)


def _decoded(codes: Column, table: Sequence[str]) -> list[str]:
    texts = _names(table)
    _require(codes.dtype == np.int32 and codes.ndim == 1, "texts")
    _require(bool(((codes >= 0) & (codes < len(texts))).all()), "texts")
    return [texts[code] for code in codes.tolist()]


def _names(value: Any) -> list[str]:
    _require(isinstance(value, list) and all(isinstance(name, str) for name in value), "names")
    return list(value)


def _require(holds: bool, what: str) -> None:
    if not holds:
        raise ValueError(f"the columns are damaged: {what} is not what it should be")


_TRACE_VERSION = "1"
"""Version of channels and columns, in the metadata record ``trace`` of each file."""
COLUMNS_ATTACHMENT = "columns.npz"
_MESSAGES = (
    signal_messages, decision_messages, event_messages, road_messages, truth_messages,
    percept_messages,
)  # fmt: skip


def write_trace(
    file: Path, trace: Trace, verdicts: Sequence[Mapping[str, Any]] = ()
) -> dict[str, Any]:
    """Write a trace atomically and return its ``sha256`` and ``bytes``.

    Args:
        file: Where. Its directory is made if it does not exist.
        trace: The trace.
        verdicts: Verdicts on the episode, for the metadata record ``verdicts``.

    Raises:
        OSError: If it cannot be written.
        ValueError: For a trace whose columns are not what they should be.
    """
    # Not durable: a bundle has many traces, and its manifest reveals lost ones.
    return asdict(replace_file(file, [trace_bytes(trace, verdicts)], durable=False))


def trace_bytes(trace: Trace, verdicts: Sequence[Mapping[str, Any]] = ()) -> bytes:
    """Make the content of the file; equal for equal traces.

    Times are nanoseconds of simulated time. Texts in messages and metadata are shortened and made
    visible, poses rounded to millimetres; the columns have everything as it was.

    Raises:
        ValueError: For a trace whose columns are not what they should be.
    """
    from mcap.writer import Writer

    columns = pack_columns(trace)
    texts, stream = TextCache(), io.BytesIO()
    writer = Writer(stream)
    # The default names the version of the library, with which the bytes would change.
    writer.start(profile="", library="pytest-dura")
    schemas: dict[str, int] = {}
    ids: dict[str, int] = {}
    for channel in CHANNELS:
        title = schema_of(channel)["title"]
        if title not in schemas:
            schemas[title] = writer.register_schema(title, "jsonschema", schema_text(channel))
        ids[channel] = writer.register_channel(channel, "json", schemas[title])
    channels = zip(CHANNELS, _MESSAGES, strict=True)
    messages = [
        (time, ids[name], data) for name, make in channels for time, data in make(trace, texts)
    ]
    messages.sort(key=lambda message: message[0])
    for time, channel_id, data in messages:
        writer.add_message(channel_id, time, data.encode("ascii"), time)
    about = {texts.shown(key): texts.any(value) for key, value in trace.about.items()}
    writer.add_metadata("trace", {"schema_version": _TRACE_VERSION})
    writer.add_metadata("about", about)
    if verdicts:
        verdict_texts = {str(n): texts.any(dict(verdict)) for n, verdict in enumerate(verdicts)}
        writer.add_metadata("verdicts", verdict_texts)
    writer.add_attachment(0, 0, COLUMNS_ATTACHMENT, "application/x-npz", columns)
    writer.finish()  # type: ignore[no-untyped-call]
    return stream.getvalue()


def read_trace(file: Path) -> Trace:
    """Read the trace in a file, bit by bit as it was written.

    Raises:
        ConfigurationError: If there is none, it is damaged, or of another version.
    """
    try:
        version, columns = _read(_content(file))
        if version == _TRACE_VERSION:
            return unpack_columns(columns)
    except OSError as error:
        raise _unreadable(f"the trace cannot be read: {error.strerror or error}", file) from None
    except ValueError as error:
        raise _unreadable(f"this is no trace: {error}", file) from None
    raise ConfigurationError(
        "this trace was written by another version of pytest-dura",
        file=str(file),
        key="schema_version",
        found=version,
        expected=_TRACE_VERSION,
        remedy="use the version that the evidence names under `tool`",
    )


def _content(file: Path) -> bytes:
    size = file.stat().st_size
    if size > MAX_UNPACKED_BYTES:
        raise ValueError(f"it has {size} bytes, and no trace has more than {MAX_UNPACKED_BYTES}")
    return file.read_bytes()


def _read(data: bytes) -> tuple[str, bytes]:
    """Read version and columns by the file's index alone.

    Raises:
        ValueError: If they are not there.
    """
    import struct

    from mcap.exceptions import McapError
    from mcap.reader import SeekingReader

    try:
        # No record can be larger than the file.
        reader = SeekingReader(io.BytesIO(data), record_size_limit=len(data))
        if reader.get_summary() is None:
            raise ValueError("it has no index")
        about = next((each for each in reader.iter_metadata() if each.name == "trace"), None)
        if about is None:
            raise ValueError("it does not say that it is one")
        attachments = [
            attachment.data
            for attachment in reader.iter_attachments()
            if attachment.name == COLUMNS_ATTACHMENT
        ]
        if len(attachments) != 1:
            raise ValueError(f"it has {len(attachments)} attachments named {COLUMNS_ATTACHMENT}")
        return str(about.metadata["schema_version"]), attachments[0]
    except (
        McapError, struct.error, LookupError, TypeError, UnicodeDecodeError, OverflowError,
        StopIteration, RecursionError, MemoryError, OSError, RuntimeError,
    ) as error:  # fmt: skip
        raise ValueError(f"the file is damaged ({type(error).__name__}: {error})") from None


def _unreadable(problem: str, file: Path) -> ConfigurationError:
    return ConfigurationError(
        problem,
        file=str(file),
        expected="the trace of an episode as pytest-dura wrote it",
        remedy="restore the file, or run the session again",
    )
