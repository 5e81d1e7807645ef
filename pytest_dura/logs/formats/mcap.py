"""MCAP files of other writers: messages in JSON, protobuf and ROS 2."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.logs.formats.trace import is_trace
from pytest_dura.logs.reading import (
    Columns,
    Topic,
    damaged,
    described,
    message_blocks,
    missing_library,
)


def fits(path: Path) -> bool:
    """Whether a file is MCAP, and not a trace of ours."""
    return path.suffix.lower() == ".mcap" and path.is_file() and not is_trace(path)


def topics(path: Path) -> list[Topic]:
    """Describe each topic by its first message."""
    described_topics = {}
    with _reader(path) as reader:
        summary = reader.get_summary()
        names = {channel.topic for channel in summary.channels.values()}
        for name in sorted(names):
            for schema, _, _, message in reader.iter_decoded_messages(topics=[name]):
                kind = schema.name if schema is not None else "json"
                described_topics[name] = described(name, kind, message)
                break
    return list(described_topics.values())


def blocks(path: Path, wanted: Mapping[str, Collection[str]]) -> Iterator[dict[str, Columns]]:
    """Read fields by topic, in the order of the recorder's stamps."""
    with _reader(path) as reader:
        messages = reader.iter_decoded_messages(topics=list(wanted))
        given = ((each.topic, decoded, raw.log_time) for _, each, raw, decoded in messages)
        yield from message_blocks(given, wanted)


class _JsonDecoder:
    """Decodes messages in JSON, by the interface of the library's decoders."""

    def decoder_for(self, encoding: str, _schema: Any) -> Callable[[bytes], Any] | None:
        """Return the decoder of an encoding; ``None`` for another one than JSON."""
        return json.loads if encoding == "json" else None


@contextmanager
def _reader(path: Path) -> Iterator[Any]:
    """Open a file; what cannot be read or decoded is an error that names it.

    Raises:
        ConfigurationError: For a file that is cut short or damaged, one without an index, and
            messages whose encoding is not known.
    """
    from mcap.exceptions import DecoderNotFoundError, McapError
    from mcap.reader import make_reader

    try:
        with path.open("rb") as stream:
            decoders = [_JsonDecoder(), *_decoders()]
            reader = make_reader(stream, validate_crcs=True, decoder_factories=decoders)
            if reader.get_summary() is None:
                raise damaged(path, "it has no index", "complete it: mcap recover FILE")
            yield reader
    except DecoderNotFoundError as error:
        known = "ros2" in str(error) or "protobuf" in str(error) or "cdr" in str(error)
        if known and len(decoders) < len(_LIBRARIES) + 1:
            raise missing_library(path, " or ".join(_LIBRARIES)) from None
        raise damaged(path, error) from None
    except ConfigurationError:
        raise
    except (McapError, struct.error, OSError, ValueError, LookupError, TypeError) as error:
        problem = f"{type(error).__name__}: {error}"
        raise damaged(path, problem, "complete it: mcap recover FILE") from None


_LIBRARIES = ("mcap_ros2", "mcap_protobuf")


def _decoders() -> Iterator[Any]:
    """Yield the decoders whose libraries are installed."""
    for library in filter(find_spec, _LIBRARIES):
        yield import_module(f"{library}.decoder").DecoderFactory()
