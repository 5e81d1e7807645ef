"""Bags of ROS 1 (one file) and ROS 2 (a folder with ``metadata.yaml``), by ``rosbags``."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.logs.reading import (
    Columns,
    Topic,
    damaged,
    described,
    message_blocks,
    missing_library,
)


def fits(path: Path) -> bool:
    """Whether a path is a bag."""
    return path.suffix == ".bag" or (path / "metadata.yaml").is_file()


def topics(path: Path) -> list[Topic]:
    """Describe each topic by its first message."""
    seen = []
    with _reader(path) as reader:
        for name, info in sorted(reader.topics.items()):
            for connection, _, raw in reader.messages(connections=info.connections):
                message = reader.deserialize(raw, connection.msgtype)
                seen.append(described(name, connection.msgtype, message))
                break
    return seen


def blocks(path: Path, wanted: Mapping[str, Collection[str]]) -> Iterator[dict[str, Columns]]:
    """Read fields by topic, in the order of the recorder's stamps."""
    with _reader(path) as reader:
        chosen = [each for each in reader.connections if each.topic in wanted]
        given = (
            (each.topic, reader.deserialize(raw, each.msgtype), stamp)
            for each, stamp, raw in reader.messages(connections=chosen)
        )
        yield from message_blocks(given, wanted)


@contextmanager
def _reader(path: Path) -> Iterator[Any]:
    """Open a bag; what cannot be read or decoded is an error that names it.

    Raises:
        ConfigurationError: For a bag that is cut short or damaged.
    """
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise missing_library(path, "rosbags") from None
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            yield reader
    except ConfigurationError:
        raise
    except Exception as error:  # of the library and its decoders, of many kinds
        raise damaged(path, f"{type(error).__name__}: {error}") from None
