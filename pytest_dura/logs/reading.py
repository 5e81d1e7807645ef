"""What a format of logs gives: topics with their fields, and the columns of those that are read.

A format is registered in the group ``pytest_dura.log_formats``; a file goes to the first one whose
``fits`` says so.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.errors import ConfigurationError, list_names
from pytest_dura.core.registry import Registry

HEADER = "header"
RECEIPT = "receipt"
"""Stamps: those that a message has of itself, and those of the recorder."""


@dataclass(frozen=True)
class Topic:
    """A topic of a log; a table has one, without a name.

    Args:
        name: Its name.
        kind: Type of its messages, as the format calls it.
        fields: Dotted names of its fields that hold numbers or truth values, with their units as
            far as the log has them.
        others: Fields of another type, with that type.
        stamps: Which stamps it has, of :data:`HEADER` and :data:`RECEIPT`.
    """

    name: str
    kind: str
    fields: Mapping[str, str]
    others: Mapping[str, str] = field(default_factory=dict)
    stamps: tuple[str, ...] = (RECEIPT,)


@dataclass
class Columns:
    """What was read of a topic, message by message in the order of the log.

    Args:
        stamps: Stamps as they are in the log, by :data:`HEADER` and :data:`RECEIPT`.
        values: By field; NaN where a message lacks it.
        unit: Unit of the stamps where the format says it: ``s``, ``ms``, ``us`` or ``ns``.
    """

    stamps: dict[str, NDArray[Any]]
    values: dict[str, NDArray[np.float64]]
    unit: str = ""


@runtime_checkable
class LogFormat(Protocol):
    """A format of logs."""

    def fits(self, path: Path) -> bool:
        """Whether a file or folder is of this format, by its name."""

    def topics(self, path: Path) -> list[Topic]:
        """List what a log holds."""

    def blocks(
        self, path: Path, wanted: Mapping[str, Collection[str]]
    ) -> Iterator[dict[str, Columns]]:
        """Read fields by topic, block by block: roughly in the order of time over all topics."""


LOG_FORMATS: Registry[LogFormat] = Registry(
    "pytest_dura.log_formats",
    "format of logs",
    lambda value: isinstance(value, LogFormat),
    "an object with fits, topics and blocks",
)


def format_of(path: Path) -> LogFormat:
    """Find the format of a log.

    Raises:
        ConfigurationError: If there is no such file, or no format for it.
    """
    if not path.exists():
        raise ConfigurationError(
            "there is no such log",
            file=str(path),
            found="nothing at this path",
            expected="a recorded log",
            remedy="check the path",
        )
    for name in LOG_FORMATS:
        form = LOG_FORMATS[name]
        if form.fits(path):
            return form
    folder = path.is_dir()
    raise ConfigurationError(
        "no format of logs fits this " + ("folder" if folder else "file"),
        file=str(path),
        found="a folder without metadata.yaml" if folder else path.suffix or path.name,
        expected=f"a log of one of {list_names(list(LOG_FORMATS))}",
        remedy=f"name the logs in it, by '{path.name}/*.csv' or the like"
        if folder
        else "convert it, or register its format in the group pytest_dura.log_formats",
    )


def read_whole(
    form: LogFormat, path: Path, wanted: Mapping[str, Collection[str]]
) -> dict[str, Columns]:
    """Read fields by topic, all at once; stamps are those that each block has."""
    pieces: dict[str, list[Columns]] = {name: [] for name in wanted}
    for block in form.blocks(path, wanted):
        for name, columns in block.items():
            pieces[name].append(columns)
    return {name: joined(given, wanted[name]) for name, given in pieces.items()}


def joined(pieces: Sequence[Columns], fields: Collection[str]) -> Columns:
    """Join what was read of a topic piece by piece."""
    if not pieces:
        return Columns({RECEIPT: np.empty(0, np.int64)}, {name: np.empty(0) for name in fields})
    kinds = [kind for kind in pieces[0].stamps if all(kind in each.stamps for each in pieces)]
    stamps = {kind: np.concatenate([each.stamps[kind] for each in pieces]) for kind in kinds}
    names = pieces[0].values
    values = {name: np.concatenate([each.values[name] for each in pieces]) for name in names}
    return Columns(stamps, values, pieces[0].unit)


def damaged(path: Path, problem: object, remedy: str = "") -> ConfigurationError:
    """Make the error for a log that cannot be read, or not as a whole."""
    return ConfigurationError(
        f"the log cannot be read: {problem}",
        file=str(path),
        expected="a complete log",
        remedy=remedy or "record it again, or repair it by the tools of its format",
    )


def missing_library(path: Path, library: str) -> ConfigurationError:
    """Make the error for a format whose library is not installed."""
    return ConfigurationError(
        f"this log is read by the package {library}, which is not installed",
        file=str(path),
        expected=library,
        remedy="pip install 'pytest-dura[logs]'",
    )


_MOST_ENTRIES = 64
"""Entries of a list in a message that are fields, each by its number."""
_MOST_FIELDS = 2000


def leaves(message: Any) -> Iterator[tuple[str, Any]]:
    """Yield the dotted names and the values of all fields of a message of any library."""
    stack: list[tuple[str, Any]] = [("", message)]
    given = 0
    while stack and given < _MOST_FIELDS:
        name, value = stack.pop()
        inner = list(_parts(value))
        if not inner:
            if name:
                given += 1
                yield name, value
            continue
        stack += reversed([(f"{name}.{key}" if name else key, part) for key, part in inner])


def _parts(value: Any) -> Iterable[tuple[str, Any]]:
    if isinstance(value, Mapping):
        return ((str(key), part) for key, part in value.items())
    if isinstance(value, (list, tuple, np.ndarray)) and not isinstance(value, (str, bytes)):
        return ((str(place), part) for place, part in enumerate(value[:_MOST_ENTRIES]))
    names: Iterable[str]
    if hasattr(value, "DESCRIPTOR"):  # of protobuf
        names = [each.name for each in value.DESCRIPTOR.fields]
    else:
        names = tuple(getattr(value, "__slots__", ()) or getattr(value, "__dataclass_fields__", ()))
    return ((name, getattr(value, name)) for name in names if not name.startswith("_"))


def value_at(message: Any, path: tuple[str, ...]) -> Any:
    """Return what stands at a path of a message; ``None`` where it has nothing there."""
    value = message
    for key in path:
        if isinstance(value, Mapping):
            value = value.get(key)
        elif key.isdecimal():
            value = value[int(key)] if int(key) < len(value) else None
        else:
            value = getattr(value, key, None)
        if value is None:
            return None
    return value


def number_of(value: Any) -> float | None:
    """Return a number or a truth value as a number; NaN for nothing, ``None`` for another type."""
    if value is None:
        return math.nan
    if isinstance(value, (bool, int, float, np.integer, np.floating, np.bool_)):
        return float(value)
    return None


_PARTS_OF_STAMPS = {("sec", "nanosec"), ("secs", "nsecs"), ("sec", "nsec"), ("seconds", "nanos")}


def stamp_of(message: Any) -> int | None:
    """Return the stamp that a message has of itself, in nanoseconds; ``None`` without one."""
    header = value_at(message, ("header", "stamp"))
    for stamp in (header, value_at(message, ("timestamp",)), value_at(message, ("stamp",))):
        for whole, part in _PARTS_OF_STAMPS:
            seconds, rest = value_at(stamp, (whole,)), value_at(stamp, (part,))
            if seconds is not None and rest is not None:
                return int(seconds) * 10**9 + int(rest)
    return None


def described(name: str, kind: str, message: Any) -> Topic:
    """Describe a topic by one of its messages."""
    fields, others = {}, {}
    for path, value in leaves(message):
        if value is not None and number_of(value) is not None:
            fields[path] = ""
        else:
            others[path] = type(value).__name__
    own = stamp_of(message) is not None
    return Topic(name, kind, fields, others, (HEADER, RECEIPT) if own else (RECEIPT,))


class Gathered:
    """Gathers the fields of one topic, message by message.

    Args:
        fields: The fields.
    """

    def __init__(self, fields: Collection[str]) -> None:
        self._paths = {name: tuple(name.split(".")) for name in fields}
        self._values: dict[str, list[float]] = {name: [] for name in fields}
        self._receipt: list[int] = []
        self._header: list[int] = []

    def add(self, message: Any, receipt: int) -> None:
        """Add a message.

        Raises:
            ValueError: For a field of another type.
        """
        self._receipt.append(receipt)
        own = stamp_of(message)
        if own is not None:
            self._header.append(own)
        for name, path in self._paths.items():
            value = value_at(message, path)
            number = number_of(value)
            if number is None:
                raise ValueError(f"the field {name!r} holds a {type(value).__name__}")
            self._values[name].append(number)

    def columns(self) -> Columns:
        """Make the columns."""
        stamps: dict[str, NDArray[Any]] = {RECEIPT: np.array(self._receipt, np.int64)}
        if self._receipt and len(self._header) == len(self._receipt):
            stamps[HEADER] = np.array(self._header, np.int64)
        values = {name: np.array(column) for name, column in self._values.items()}
        return Columns(stamps, values, "ns")


ROWS = 50_000
"""Lines, or messages of all topics together, of a block."""


def message_blocks(
    messages: Iterable[tuple[str, Any, int]], wanted: Mapping[str, Collection[str]]
) -> Iterator[dict[str, Columns]]:
    """Gather messages into blocks.

    Args:
        messages: Topic, decoded message and stamp of the recorder.
        wanted: Fields by topic.

    Raises:
        ValueError: For a field of another type.
    """
    gathered: dict[str, Gathered] = {}
    for number, (topic, message, stamp) in enumerate(messages, 1):
        if topic not in gathered:
            gathered[topic] = Gathered(wanted[topic])
        gathered[topic].add(message, stamp)
        if number % ROWS == 0:
            yield {name: each.columns() for name, each in gathered.items()}
            gathered = {}
    if gathered:
        yield {name: each.columns() for name, each in gathered.items()}
