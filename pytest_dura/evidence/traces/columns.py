"""The exact columns of a trace as ``columns.npz``, and back: bit by bit, and nothing else."""

from __future__ import annotations

import io
import json
import math
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.accounts import account_problem
from pytest_dura.core.recording import POSE, Line, Recording, Scene, Tracks
from pytest_dura.evidence.traces.trace import Trace

LIMIT = 512 * 2**20
"""Bytes that the unpacked columns may come to; a real episode has about 200 kB."""
TEXTS = "texts"
"""The member that is JSON: names, texts and what tells the columns apart."""

Column = NDArray[Any]
_KINDS = "biuf"


def pack_columns(trace: Trace) -> bytes:
    """All of a trace as an ``.npz`` that ``numpy.load`` reads; the same trace gives the same bytes.

    Signals are the rows of ``signals``, in the order of ``texts["signals"]``. Texts are numbers
    that count the entries of a table in ``texts``.

    Raises:
        ValueError: For a column that has another type or shape than a trace's, and for a trace
            larger than ``LIMIT``.
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
    columns = [_float64(name, one, shape) for name, one in trace.signals.items()]
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
    for name in _SAID:
        arrays[f"said.{name}"], texts["said"][name] = _coded(getattr(trace.recording, name))
    accounts = [_compact(account) for account in trace.recording.accounts]
    arrays["accounts"], texts["accounts"] = _coded(accounts)
    flags = list(trace.recording.flags.values())
    arrays["flags"] = np.array(flags, np.int8) if flags else np.empty((0, 0), np.int8)
    if trace.recording.scene is not None:
        texts["scene"] = _pack_scene(arrays, trace.recording.scene)
    text = _compact(texts).encode()
    arrays[TEXTS] = np.frombuffer(text, np.uint8)
    if sum(one.nbytes for one in arrays.values()) > LIMIT:
        raise ValueError(f"the trace is larger than {LIMIT} bytes")
    return _zipped(arrays)


_SAID = ("explanations", "reasons", "recoveries")


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
    found = np.asarray(column)
    if found.dtype != np.float64 or found.shape != shape or len(shape) != 1:
        raise ValueError(f"the column {name!r} is {found.dtype} of the shape {found.shape}")
    return found


def _coded(values: Sequence[str]) -> tuple[NDArray[np.int32], list[str]]:
    """Numbers, and the texts that they count."""
    table: dict[str, int] = {}
    codes = [table.setdefault(value, len(table)) for value in values]
    return np.array(codes, np.int32), list(table)


def _zipped(arrays: Mapping[str, Column]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, array in arrays.items():
            found = np.ascontiguousarray(array)
            head = io.BytesIO()
            np.lib.format.write_array_header_1_0(
                head, np.lib.format.header_data_from_array_1_0(found)
            )
            member = zipfile.ZipInfo(f"{name}.npy")  # of the date 1980-01-01, whatever the clock
            member.create_system = 3  # on any system
            data = head.getvalue() + found.tobytes()
            archive.writestr(member, data, zipfile.ZIP_DEFLATED, compresslevel=1)
    return stream.getvalue()


def unpack_columns(data: bytes) -> Trace:
    """The inverse of :func:`pack_columns`; nothing in the data is run, and its size is bounded.

    Raises:
        ValueError: For data that are no such columns.
    """
    try:
        return _trace(_arrays(data))
    except (
        AttributeError, LookupError, NotImplementedError, OSError, RecursionError, RuntimeError,
        TypeError, zipfile.BadZipFile, zipfile.LargeZipFile, zlib.error,
    ) as error:  # fmt: skip
        raise ValueError(f"the columns are damaged ({type(error).__name__}: {error})") from None


def _arrays(data: bytes) -> dict[str, Column]:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = archive.infolist()
        if sum(member.file_size for member in members) > LIMIT + 1024 * len(members):
            raise ValueError(f"the columns are larger than {LIMIT} bytes")
        return {
            member.filename.removesuffix(".npy"): _array(_member(archive, member))
            for member in members
        }


def _member(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> bytes:
    """What it declares to hold and no more, which ``archive.read`` would unpack first."""
    with archive.open(member) as stream:
        return stream.read(member.file_size)


def _array(data: bytes) -> Column:
    stream = io.BytesIO(data)
    if np.lib.format.read_magic(stream) != (1, 0):
        raise ValueError("the columns have another format")
    shape, by_columns, dtype = np.lib.format.read_array_header_1_0(stream)
    count, start = math.prod(shape), stream.tell()
    if dtype.kind not in _KINDS or by_columns or len(data) - start != count * dtype.itemsize:
        raise ValueError("a column is not what its header says")
    # A copy: of a buffer of bytes nobody could make an array that can be written.
    found: Column = np.frombuffer(data, dtype, count, start).reshape(shape).copy()
    return found


def _trace(arrays: Mapping[str, Column]) -> Trace:
    texts = json.loads(arrays[TEXTS].tobytes())
    time, signals = arrays["time"], arrays["signals"]
    names = _names(texts["signals"])
    _check(time.dtype == np.float64 and time.ndim == 1, "time")
    _check(signals.dtype == np.float64 and signals.shape == (len(names), len(time)), "signals")
    decisions: dict[str, Column] = {}
    for number, (name, told) in enumerate(texts["decisions"].items()):
        codes = arrays[f"decisions.{number}"]
        if told is not None:
            dtype = np.dtype(str(told["dtype"]))
            table = _names(told["table"])
            _check(dtype.kind == "U" and dtype.itemsize * codes.size <= LIMIT, name)
            found = _decoded(codes, table)
            _check(max(map(len, table), default=0) * 4 <= dtype.itemsize, name)
            decisions[name] = np.array(found, dtype)
        else:
            _check(codes.ndim == 1, name)
            decisions[name] = codes
    said: dict[str, Any] = {
        name: tuple(_decoded(arrays[f"said.{name}"], texts["said"][name])) for name in _SAID
    }
    said["accounts"] = tuple(_accounts(arrays, texts)) if "accounts" in texts else ()
    monitors, flags = _names(texts["flags"]), arrays["flags"]
    _check(flags.dtype == np.int8 and flags.ndim == 2 and len(flags) == len(monitors), "flags")
    scene = None if texts["scene"] is None else _scene(arrays, texts["scene"])
    problem = texts["problem"]
    _check(problem is None or isinstance(problem, str), "problem")
    recording = Recording(
        **said, flags=dict(zip(monitors, flags, strict=True)), scene=scene, problem=problem
    )
    rows = dict(zip(names, signals, strict=True))
    _check(isinstance(texts["about"], dict), "about")
    events = texts["events"]
    _check(isinstance(events, list) and all(isinstance(one, dict) for one in events), "events")
    return Trace(texts["about"], time, rows, decisions, events, recording)


def _accounts(arrays: Mapping[str, Column], texts: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Each is read once, however long its decision held."""
    known = {}
    for text in _names(texts["accounts"]):
        account = json.loads(text)
        _check(account_problem(account) is None, "accounts")
        known[text] = account
    return [known[text] for text in _decoded(arrays["accounts"], texts["accounts"])]


def _scene(arrays: Mapping[str, Column], told: Mapping[str, Any]) -> Scene:
    tracks = {}
    for name in ("truth", "percept"):
        ids, poses = _names(told[name]), arrays[name]
        _check(poses.dtype == np.float32 and poses.ndim == 3, name)
        _check(poses.shape[1:] == (len(ids), len(POSE)), name)
        tracks[name] = Tracks(tuple(ids), poses)
    points = arrays["lines"]
    _check(points.dtype == np.float32 and points.ndim == 2 and points.shape[1] == 2, "lines")
    return Scene(tuple(_lines(points, told["lines"])), ego=str(told["ego"]), **tracks)


def _lines(points: NDArray[np.float32], told: Sequence[Any]) -> Iterator[Line]:
    start = 0
    for kind, length in told:
        _check(isinstance(length, int) and 0 <= length <= len(points) - start, "lines")
        yield Line(str(kind), points[start : start + length])
        start += length
    _check(start == len(points), "lines")


def _decoded(codes: Column, table: Sequence[str]) -> list[str]:
    texts = _names(table)
    _check(codes.dtype == np.int32 and codes.ndim == 1, "texts")
    _check(bool(((codes >= 0) & (codes < len(texts))).all()), "texts")
    return [texts[code] for code in codes.tolist()]


def _names(found: Any) -> list[str]:
    _check(isinstance(found, list) and all(isinstance(one, str) for one in found), "names")
    return list(found)


def _check(holds: bool, what: str) -> None:
    if not holds:
        raise ValueError(f"the columns are damaged: {what} is not what it should be")
