"""Traces as MCAP files: channels that Foxglove shows, and the exact columns as an attachment."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.whole_files import replace_file
from pytest_dura.evidence.traces.columns import LIMIT, pack_columns, unpack_columns
from pytest_dura.evidence.traces.messages import (
    Texts,
    decision_messages,
    event_messages,
    signal_messages,
)
from pytest_dura.evidence.traces.scene import percept_messages, road_messages, truth_messages
from pytest_dura.evidence.traces.schemas import CHANNELS, schema_of, schema_text
from pytest_dura.evidence.traces.trace import Trace

if TYPE_CHECKING:
    from mcap.reader import McapReader

VERSION = "1"
"""Of the channels and columns; in the metadata record ``trace`` of each file."""
COLUMNS = "columns.npz"
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
        verdicts: What requirements say of the episode, for the metadata record ``verdicts``.

    Raises:
        OSError: If it cannot be written.
        ValueError: For a trace whose columns are not what they should be.
    """
    # A bundle has many traces, and its manifest tells whether each has survived.
    return asdict(replace_file(file, [trace_bytes(trace, verdicts)], durable=False))


def trace_bytes(trace: Trace, verdicts: Sequence[Mapping[str, Any]] = ()) -> bytes:
    """The content of the file; equal for equal traces.

    Times are nanoseconds of simulated time. Texts in messages and metadata are shortened and made
    visible, poses rounded to millimetres; the columns have everything as it was.

    Raises:
        ValueError: For a trace whose columns are not what they should be.
    """
    from mcap.writer import Writer

    columns = pack_columns(trace)
    texts, stream = Texts(), io.BytesIO()
    writer = Writer(stream)
    # The library's own name would tell its version, and the bytes would change with it.
    writer.start(profile="", library="pytest-dura")
    schemas: dict[str, int] = {}
    ids: dict[str, int] = {}
    for channel in CHANNELS:
        title = schema_of(channel)["title"]
        if title not in schemas:
            schemas[title] = writer.register_schema(title, "jsonschema", schema_text(channel))
        ids[channel] = writer.register_channel(channel, "json", schemas[title])
    made = zip(CHANNELS, _MESSAGES, strict=True)
    found = [(time, ids[name], data) for name, make in made for time, data in make(trace, texts)]
    found.sort(key=lambda one: one[0])
    for time, channel_id, data in found:
        writer.add_message(channel_id, time, data.encode("ascii"), time)
    about = {texts.shown(key): texts.any(value) for key, value in trace.about.items()}
    writer.add_metadata("trace", {"schema_version": VERSION})
    writer.add_metadata("about", about)
    if verdicts:
        told = {str(n): texts.any(dict(one)) for n, one in enumerate(verdicts)}
        writer.add_metadata("verdicts", told)
    writer.add_attachment(0, 0, COLUMNS, "application/x-npz", columns)
    writer.finish()  # type: ignore[no-untyped-call]
    return stream.getvalue()


def read_trace(file: Path) -> Trace:
    """The trace in a file, bit by bit as it was written.

    Raises:
        ConfigurationError: If there is none, it is damaged, or of another version.
    """
    try:
        version, columns = _read(_content(file))
        if version == VERSION:
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
        expected=VERSION,
        remedy="use the version that the evidence names under `tool`",
    )


def _content(file: Path) -> bytes:
    size = file.stat().st_size
    if size > LIMIT:
        raise ValueError(f"it has {size} bytes, and no trace has more than {LIMIT}")
    return file.read_bytes()


def _read(data: bytes) -> tuple[str, bytes]:
    """Version and columns, from the file's index and nothing else of it.

    Raises:
        ValueError: If they are not there.
    """
    import struct

    from mcap.exceptions import McapError
    from mcap.reader import SeekingReader

    try:
        # The file is in memory, so that no record can be larger.
        reader = SeekingReader(io.BytesIO(data), record_size_limit=len(data))
        if reader.get_summary() is None:
            raise ValueError("it has no index")
        return _version(reader), _columns(reader)
    except (
        McapError, struct.error, LookupError, TypeError, UnicodeDecodeError, OverflowError,
        StopIteration, RecursionError, MemoryError, OSError, RuntimeError,
    ) as error:  # fmt: skip
        raise ValueError(f"the file is damaged ({type(error).__name__}: {error})") from None


def _version(reader: McapReader) -> str:
    for one in reader.iter_metadata():
        if one.name == "trace":
            return str(one.metadata["schema_version"])
    raise ValueError("it does not say that it is one")


def _columns(reader: McapReader) -> bytes:
    found = [one for one in _attachments(reader) if one[0] == COLUMNS]
    if len(found) != 1:
        raise ValueError(f"it has {len(found)} attachments named {COLUMNS}")
    return found[0][1]


def _attachments(reader: McapReader) -> Iterator[tuple[str, bytes]]:
    for one in reader.iter_attachments():
        yield one.name, one.data


def _unreadable(problem: str, file: Path) -> ConfigurationError:
    return ConfigurationError(
        problem,
        file=str(file),
        expected="the trace of an episode as pytest-dura wrote it",
        remedy="restore the file, or run the session again",
    )
