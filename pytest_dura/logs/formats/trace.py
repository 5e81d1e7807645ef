"""Traces of our own bundles: the exact columns of an episode."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

from pytest_dura.evidence.mcap import read_trace
from pytest_dura.logs.reading import RECEIPT, Columns, Topic


def is_trace(path: Path) -> bool:
    """Whether an MCAP file is a trace of ours."""
    from mcap.exceptions import McapError
    from mcap.reader import make_reader

    try:
        with path.open("rb") as stream:
            return any(each.name == "trace" for each in make_reader(stream).iter_metadata())
    except (McapError, OSError, ValueError, EOFError):  # reading it names what is wrong
        return False


def fits(path: Path) -> bool:
    """Whether a file is a trace of ours."""
    return path.suffix.lower() == ".mcap" and path.is_file() and is_trace(path)


def topics(path: Path) -> list[Topic]:
    """Describe the only topic: the signals of the episode."""
    return [Topic("", "trace of pytest-dura", dict.fromkeys(read_trace(path).signals, ""))]


def blocks(path: Path, wanted: Mapping[str, Collection[str]]) -> Iterator[dict[str, Columns]]:
    """Read signals bit by bit as they were, in one block."""
    trace = read_trace(path)
    names = [name for fields in wanted.values() for name in fields if name in trace.signals]
    values = {name: trace.signals[name] for name in names}
    yield {"": Columns({RECEIPT: trace.time}, values, "s")}
