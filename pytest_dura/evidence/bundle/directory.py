"""Writing and reading the evidence directory. A reader never sees half a file."""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.whole_files import temporary_prefix
from pytest_dura.evidence.bundle.files import write_file
from pytest_dura.evidence.bundle.lock import LOCK
from pytest_dura.evidence.bundle.manifest import files_of, listed_files
from pytest_dura.evidence.bundle.streaming import Streamed, stream_record
from pytest_dura.evidence.plain import plain
from pytest_dura.evidence.record.evidence_record import SCHEMA_VERSION
from pytest_dura.evidence.record.session_record import SessionRecord
from pytest_dura.evidence.record.spool import SPOOL
from pytest_dura.evidence.traces.names import FOLDER, is_trace_name

RECORD = "evidence.json"
EPISODES = "episodes"
RENDERED = (
    "manifest.json",
    "report.html",
    "summary.md",
    "assurance-case.gsn.yaml",
    "assurance-case.svg",
    "cyclonedx.json",
    "test-result.intoto.json",
    "evidence.schema.json",
)
"""The other files of a bundle; the manifest comes first where they are removed."""
STREAMED = 8 << 20
"""Bytes of a record above which its episodes are read one at a time."""
TRACES = FOLDER
"""The folder of the traces."""
KEPT = ".episodes"
"""The folder of the episodes that a session which is interrupted leaves to the next one."""
_TOOL = re.compile(rb'"tool"\s*:\s*\{\s*"name"\s*:\s*"pytest-dura"')
_HEAD = 1 << 16
BEGUN = tuple(map(temporary_prefix, (RECORD, *RENDERED)))


def check_directory(directory: Path) -> None:
    """Refuse to write evidence over what is none of ours.

    A directory is ours if it is empty, or holds a record of ours and beside it what its manifest
    lists, or what a session leaves that did not come to its end.

    Raises:
        ConfigurationError: If it is a symbolic link, or holds anything else.
    """
    if directory.is_symlink():
        raise _not_ours("the evidence directory is a symbolic link", directory, str(directory))
    names = [one for one in files_of(directory) if not _is_passing(one)]
    if not names:
        return
    record = directory / RECORD
    if RECORD not in names:
        raise _not_ours("this directory is not empty and holds no evidence", directory, names[0])
    if record.is_symlink() or not record.is_file() or not _says_ours(record):
        problem = f"its {RECORD} is not of a session of pytest-dura"
        raise _not_ours(f"this directory is not empty, and {problem}", directory, RECORD)
    ours = {RECORD, *RENDERED, *listed_files(directory)}
    for name in names:
        folder, _, last = name.rpartition("/")
        if name not in ours and not (folder == TRACES and is_trace_name(last)):
            problem = "this directory holds a file that is no part of the evidence in it"
            raise _not_ours(problem, directory, name)


def _is_passing(name: str) -> bool:
    """Whether a file is of a session that runs or was killed: a lock, a spool, episodes, traces."""
    first, _, rest = name.partition("/")
    if rest:
        passing = first == KEPT or (first == TRACES and rest.startswith("."))
        return passing or (first == TRACES and is_trace_name(rest))
    return first == LOCK or first.startswith((*BEGUN, SPOOL))


def _says_ours(record: Path) -> bool:
    """Whether a record names us as its tool, at its beginning: it may be great, or damaged."""
    try:
        with record.open("rb") as stream:
            return _TOOL.search(stream.read(_HEAD)) is not None
    except OSError:
        return False


def _not_ours(problem: str, directory: Path, found: str) -> ConfigurationError:
    return ConfigurationError(
        problem,
        file=str(directory),
        key="--dura-evidence",
        found=found,
        expected="a directory that is empty, or not there yet, or holds evidence and nothing else",
        remedy="name another directory, or move away what is in it",
    )


def write_record(directory: Path, record: SessionRecord) -> Path:
    """Write ``evidence.json`` atomically, one episode at a time, and return its path.

    Raises:
        ConfigurationError: If the directory cannot be made or written.
    """
    write_file(directory / RECORD, _text(record))
    return directory / RECORD


def begin_bundle(record: SessionRecord, *, traces: bool = True) -> None:
    """Write the record of a session that begins, and remove what an earlier one left beside it.

    In this order nothing that an earlier session came to is ever there without a record that says
    that a session is running.

    Args:
        record: Of the session that begins.
        traces: Whether traces go, too; not if some may be of the session that begins.

    Raises:
        ConfigurationError: If the directory cannot be made, written or cleared.
    """
    earlier = os.path.lexists(record.directory / RECORD)
    write_record(record.directory, record)
    # Without a record of ours, files of such names are somebody else's.
    if earlier:
        clear_bundle(record.directory, traces=traces)


def clear_bundle(directory: Path, *, traces: bool = True) -> None:
    """Remove what an earlier session left, the record itself apart, which is to be replaced first.

    Files go by their names, and the traces by theirs, whole or begun; nothing else is touched, and
    no symbolic link is followed: it is removed itself.

    Args:
        directory: The evidence directory.
        traces: Whether traces go, too; not if some may be of the session that begins.

    Raises:
        ConfigurationError: If one of them cannot be removed.
    """
    with _removal_told(directory):
        for name in RENDERED:
            (directory / name).unlink(missing_ok=True)
        for begun in _entries(directory):
            if begun.name.startswith(BEGUN) or begun.name.startswith(SPOOL):
                begun.unlink()
    if traces:
        clear_traces(directory)


def clear_traces(directory: Path, kept: Collection[str] = ()) -> None:
    """Remove the traces of a bundle, some apart, as :func:`clear_bundle` does.

    Args:
        directory: The evidence directory.
        kept: Names of traces that stay, as the record has them.

    Raises:
        ConfigurationError: If one of them cannot be removed.
    """
    traces = directory / TRACES
    with _removal_told(directory):
        if traces.is_symlink():
            traces.unlink()
        for trace in _entries(traces):
            if is_trace_name(trace.name) and f"{TRACES}/{trace.name}" not in kept:
                trace.unlink()
        if traces.is_dir() and not any(traces.iterdir()):
            traces.rmdir()


@contextmanager
def _removal_told(directory: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise ConfigurationError(
            f"an earlier session's evidence cannot be removed: {error.strerror or error}",
            key="--dura-evidence",
            found=str(error.filename or directory),
            expected="a directory whose files can be replaced",
            remedy="remove it, or choose another directory",
        ) from None


def _entries(directory: Path) -> Iterator[Path]:
    """The files and links in a directory, if it is one."""
    if directory.is_dir():
        for entry in list(directory.iterdir()):
            if entry.is_symlink() or entry.is_file():
                yield entry


def read_session_record(directory: Path) -> SessionRecord:
    """The record of an evidence directory as renderers read it.

    The episodes of a great one stay in its file; another one is in memory as a whole.

    Raises:
        ConfigurationError: If there is none, or it cannot be read, or its file is a link, which
            leads to what is no part of the directory.
    """
    file = directory / RECORD
    if file.is_symlink():
        raise _unreadable("the record is a symbolic link", file, "--dura-evidence")
    streamed = _streamed(file)
    if streamed is not None:
        return SessionRecord(streamed.head, directory, streamed.episodes)
    record = read_record(directory)
    if not isinstance(record.get("episodes"), list):
        raise _unreadable("this record has no episodes", file, "--dura-evidence")
    return SessionRecord.of(record, directory)


def _streamed(file: Path) -> Streamed | None:
    """A great record of ours; of any other one it is found out what it is by reading it whole."""
    try:
        great = file.stat().st_size > STREAMED
    except OSError:
        return None
    found = stream_record(file, _strict) if great else None
    return (
        found if found is not None and found.head.get("schema_version") == SCHEMA_VERSION else None
    )


def read_record(directory: Path) -> dict[str, Any]:
    """The record of an evidence directory.

    Raises:
        ConfigurationError: If there is none, or it cannot be read.
    """
    return load_record(directory / RECORD)[0]


def load_record(file: Path, key: str = "--dura-evidence") -> tuple[dict[str, Any], str]:
    """The record in a file, and the SHA-256 of that file.

    Args:
        file: The file.
        key: The option that named it.

    Raises:
        ConfigurationError: If there is none, or it cannot be read.
    """
    try:
        data = file.read_bytes()
        found = _strict(data)
        version = found["schema_version"]
    except FileNotFoundError:
        raise _unreadable("there is no evidence here", file, key) from None
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        problem = f"this is no evidence record ({type(error).__name__})"
        raise _unreadable(problem, file, key) from None
    if version != SCHEMA_VERSION:
        raise ConfigurationError(
            "this evidence was written by another version of pytest-dura",
            file=str(file),
            key="schema_version",
            found=version,
            expected=SCHEMA_VERSION,
            remedy="use the version that the record names under `tool`",
        )
    return found, hashlib.sha256(data).hexdigest()


def _strict(data: bytes) -> Any:
    return json.loads(data, object_pairs_hook=_once, parse_constant=_no_number)


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object whose keys are there once; of two, readers would take one or the other."""
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("a key is there twice")
    return found


def _no_number(name: str) -> float:
    raise ValueError(f"{name} is no number of JSON")


def _unreadable(problem: str, file: Path, key: str) -> ConfigurationError:
    return ConfigurationError(
        problem,
        file=str(file),
        key=key,
        expected=f"the {RECORD} of a session",
        remedy=f"run `pytest --dura-scenarios` first, or name its directory with {key}",
    )


def _text(record: SessionRecord) -> Iterator[str]:
    """The record as JSON, indented by one, with the episodes behind the cases."""
    head = plain(record.head)
    names = list(head)
    place = names.index("cases") + 1 if "cases" in names else len(names)
    names.insert(place, EPISODES)
    yield "{"
    for number, name in enumerate(names):
        yield ",\n " if number else "\n "
        yield f"{_json(name)}: "
        if name == EPISODES:
            yield from _list(record.episodes())
        else:
            yield _json(head[name]).replace("\n", "\n ")
    yield "\n}\n"


def _list(values: Iterable[Any]) -> Iterator[str]:
    """A list within an object that is no part of anything."""
    number = -1
    for number, value in enumerate(values):
        yield ",\n  " if number else "[\n  "
        # In JSON a line break is always one between its parts.
        yield _json(value).replace("\n", "\n  ")
    yield "[]" if number < 0 else "\n ]"


def _json(value: Any) -> str:
    """JSON in which letters of any script are themselves, and whatever cannot be seen is escaped.

    JSON asks that of the control characters below the blank alone; a terminal acts on others, too.
    """
    text = json.dumps(value, indent=1, ensure_ascii=False, allow_nan=False)
    return text if text.isascii() and "\x7f" not in text else text.translate(_SHOWN)


class _Shown(dict[int, str]):
    """What stands for a character in JSON, found once for each."""

    def __missing__(self, point: int) -> str:
        char = chr(point)
        seen = point < _DELETE or char.isprintable()
        self[point] = found = char if seen else json.dumps(char)[1:-1]
        return found


_DELETE = 0x7F
_SHOWN = _Shown()
