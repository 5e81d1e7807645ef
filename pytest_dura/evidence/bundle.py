"""The bundle on disk: the record, every format rendered from it, and the manifest, last.

A reader never sees half a file, nor a killed session that reads as a pass.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol, cast

from pytest_dura.core.errors import ConfigurationError, describe_error
from pytest_dura.core.files import temporary_prefix
from pytest_dura.evidence.episodes import SPOOL_PREFIX
from pytest_dura.evidence.files import (
    LOCK_FILE,
    MANIFEST_FILE,
    StreamedRecord,
    file_entry,
    files_below,
    listed_files,
    manifest_text,
    stream_record,
    write_file,
)
from pytest_dura.evidence.gather import SCHEMA_VERSION
from pytest_dura.evidence.model import Counts, SessionRecord, plain_data
from pytest_dura.evidence.schema import SCHEMA_FILE, schema_text
from pytest_dura.evidence.traces import TRACE_FOLDER, is_trace_name

FORMATS = (
    "pytest_dura.reports.summary",
    "pytest_dura.reports.html.page",
    "pytest_dura.reports.gsn.yaml_file",
    "pytest_dura.reports.gsn.svg_file",
    "pytest_dura.reports.cyclonedx",
    "pytest_dura.reports.intoto",
)
"""The modules of the formats, in the order in which they are written."""


class Format(Protocol):
    """What a module of a format offers."""

    FILE: str

    def render(self, record: SessionRecord) -> str:
        """The file's text: the same record gives the same text."""
        ...

    def read_counts(self, text: str) -> Counts:
        """What such a text states, read without the help of ``render``.

        Raises:
            ValueError: If the text is not what this format writes.
        """
        ...


def all_formats() -> Iterator[Format]:
    """Every format, imported when it is asked for."""
    for name in FORMATS:
        yield cast("Format", import_module(name))


RECORD_FILE = "evidence.json"
EPISODES_FOLDER = "episodes"
RENDERED_FILES = (
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
STREAMED_BYTES = 8 << 20
"""Bytes of a record above which its episodes are read one at a time."""
_TRACES_FOLDER = TRACE_FOLDER
"""The folder of the traces."""
RESUME_FOLDER = ".episodes"
"""The folder of the episodes that a session which is interrupted leaves to the next one."""
_TOOL = re.compile(rb'"tool"\s*:\s*\{\s*"name"\s*:\s*"pytest-dura"')
_HEAD_BYTES = 1 << 16
_TEMPORARY_PREFIXES = tuple(map(temporary_prefix, (RECORD_FILE, *RENDERED_FILES)))


def check_directory(directory: Path) -> None:
    """Refuse to write evidence over what is none of ours.

    A directory is ours if it is empty, or holds a record of ours and beside it what its manifest
    lists, or what a session leaves that did not come to its end.

    Raises:
        ConfigurationError: If it is a symbolic link, or holds anything else.
    """
    if directory.is_symlink():
        raise _foreign_error("the evidence directory is a symbolic link", directory, str(directory))
    names = [item for item in files_below(directory) if not _is_temporary(item)]
    if not names:
        return
    record = directory / RECORD_FILE
    if RECORD_FILE not in names:
        raise _foreign_error(
            "this directory is not empty and holds no evidence", directory, names[0]
        )
    if record.is_symlink() or not record.is_file() or not _is_our_record(record):
        problem = f"its {RECORD_FILE} is not of a session of pytest-dura"
        raise _foreign_error(f"this directory is not empty, and {problem}", directory, RECORD_FILE)
    ours = {RECORD_FILE, *RENDERED_FILES, *listed_files(directory)}
    for name in names:
        folder, _, last = name.rpartition("/")
        if name not in ours and not (folder == _TRACES_FOLDER and is_trace_name(last)):
            problem = "this directory holds a file that is no part of the evidence in it"
            raise _foreign_error(problem, directory, name)


def _is_temporary(name: str) -> bool:
    """Whether a file is of a session that runs or was killed: a lock, a spool, episodes, traces."""
    first, _, rest = name.partition("/")
    if rest:
        passing = first == RESUME_FOLDER or (first == _TRACES_FOLDER and rest.startswith("."))
        return passing or (first == _TRACES_FOLDER and is_trace_name(rest))
    return first == LOCK_FILE or first.startswith((*_TEMPORARY_PREFIXES, SPOOL_PREFIX))


def _is_our_record(record: Path) -> bool:
    """Whether a record names us as its tool, at its beginning: it may be great, or damaged."""
    try:
        with record.open("rb") as stream:
            return _TOOL.search(stream.read(_HEAD_BYTES)) is not None
    except OSError:
        return False


def _foreign_error(problem: str, directory: Path, found: str) -> ConfigurationError:
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
    write_file(directory / RECORD_FILE, _record_text(record))
    return directory / RECORD_FILE


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
    earlier = os.path.lexists(record.directory / RECORD_FILE)
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
    with _removal_errors(directory):
        for name in RENDERED_FILES:
            (directory / name).unlink(missing_ok=True)
        for begun in _entries(directory):
            if begun.name.startswith(_TEMPORARY_PREFIXES) or begun.name.startswith(SPOOL_PREFIX):
                begun.unlink()
    if traces:
        _clear_traces(directory)


def _clear_traces(directory: Path, kept: Collection[str] = ()) -> None:
    """Remove the traces of a bundle, some apart, as :func:`clear_bundle` does.

    Args:
        directory: The evidence directory.
        kept: Names of traces that stay, as the record has them.

    Raises:
        ConfigurationError: If one of them cannot be removed.
    """
    traces = directory / _TRACES_FOLDER
    with _removal_errors(directory):
        if traces.is_symlink():
            traces.unlink()
        for trace in _entries(traces):
            if is_trace_name(trace.name) and f"{_TRACES_FOLDER}/{trace.name}" not in kept:
                trace.unlink()
        if traces.is_dir() and not any(traces.iterdir()):
            traces.rmdir()


@contextmanager
def _removal_errors(directory: Path) -> Iterator[None]:
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
    file = directory / RECORD_FILE
    if file.is_symlink():
        raise _unreadable_record("the record is a symbolic link", file, "--dura-evidence")
    streamed = _streamed_record(file)
    if streamed is not None:
        return SessionRecord(streamed.head, directory, streamed.episodes)
    record = read_record(directory)
    if not isinstance(record.get("episodes"), list):
        raise _unreadable_record("this record has no episodes", file, "--dura-evidence")
    return SessionRecord.of(record, directory)


def _streamed_record(file: Path) -> StreamedRecord | None:
    """A great record of ours; of any other one it is found out what it is by reading it whole."""
    try:
        great = file.stat().st_size > STREAMED_BYTES
    except OSError:
        return None
    record = stream_record(file, _strict_json) if great else None
    return (
        record
        if record is not None and record.head.get("schema_version") == SCHEMA_VERSION
        else None
    )


def read_record(directory: Path) -> dict[str, Any]:
    """The record of an evidence directory.

    Raises:
        ConfigurationError: If there is none, or it cannot be read.
    """
    return load_record(directory / RECORD_FILE)[0]


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
        strict_json = _strict_json(data)
        version = strict_json["schema_version"]
    except FileNotFoundError:
        raise _unreadable_record("there is no evidence here", file, key) from None
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        problem = f"this is no evidence record ({type(error).__name__})"
        raise _unreadable_record(problem, file, key) from None
    if version != SCHEMA_VERSION:
        raise ConfigurationError(
            "this evidence was written by another version of pytest-dura",
            file=str(file),
            key="schema_version",
            found=version,
            expected=SCHEMA_VERSION,
            remedy="use the version that the record names under `tool`",
        )
    return strict_json, hashlib.sha256(data).hexdigest()


def _strict_json(data: bytes) -> Any:
    return json.loads(data, object_pairs_hook=_unique_keys, parse_constant=_no_number)


def _unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object whose keys are there once; of two, readers would take one or the other."""
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("a key is there twice")
    return found


def _no_number(name: str) -> float:
    raise ValueError(f"{name} is no number of JSON")


def _unreadable_record(problem: str, file: Path, key: str) -> ConfigurationError:
    return ConfigurationError(
        problem,
        file=str(file),
        key=key,
        expected=f"the {RECORD_FILE} of a session",
        remedy=f"run `pytest --dura-scenarios` first, or name its directory with {key}",
    )


def _record_text(record: SessionRecord) -> Iterator[str]:
    """The record as JSON, indented by one, with the episodes behind the cases."""
    head = plain_data(record.head)
    names = list(head)
    place = names.index("cases") + 1 if "cases" in names else len(names)
    names.insert(place, EPISODES_FOLDER)
    yield "{"
    for number, name in enumerate(names):
        yield ",\n " if number else "\n "
        yield f"{_json_text(name)}: "
        if name == EPISODES_FOLDER:
            yield from _list_text(record.episodes())
        else:
            yield _json_text(head[name]).replace("\n", "\n ")
    yield "\n}\n"


def _list_text(values: Iterable[Any]) -> Iterator[str]:
    """A list within an object that is no part of anything."""
    number = -1
    for number, value in enumerate(values):
        yield ",\n  " if number else "[\n  "
        # In JSON a line break is always one between its parts.
        yield _json_text(value).replace("\n", "\n  ")
    yield "[]" if number < 0 else "\n ]"


def _json_text(value: Any) -> str:
    """JSON in which letters of any script are themselves, and whatever cannot be seen is escaped.

    JSON asks that of the control characters below the blank alone; a terminal acts on others, too.
    """
    text = json.dumps(value, indent=1, ensure_ascii=False, allow_nan=False)
    return text if text.isascii() and "\x7f" not in text else text.translate(_VISIBLE)


class _VisibleCharacters(dict[int, str]):
    """What stands for a character in JSON, found once for each."""

    def __missing__(self, point: int) -> str:
        char = chr(point)
        seen = point < _DELETE or char.isprintable()
        self[point] = dumps = char if seen else json.dumps(char)[1:-1]
        return dumps


_DELETE = 0x7F
_VISIBLE = _VisibleCharacters()


def write_bundle(record: SessionRecord) -> SessionRecord:
    """Write everything and return the record as it was written.

    A format that cannot be rendered does not cost the others: the record then says which one is
    not there and its gate has failed, and so say all other formats.

    Raises:
        ConfigurationError: If the directory cannot be written. What is left of the bundle then
            says that it is incomplete.
    """
    before = _file_identity(record.directory / RECORD_FILE)
    try:
        return _write_all(record)
    except BaseException as error:  # also on ctrl-C; it is raised again
        _withdraw(record, error, before)
        raise


def _write_all(record: SessionRecord) -> SessionRecord:
    traces = {
        episode["trace"]["file"]: {
            "sha256": episode["trace"]["sha256"],
            "bytes": episode["trace"]["bytes"],
        }
        for episode in record.episodes()
        if episode["trace"] is not None
    }
    _clear_traces(record.directory, traces)
    broken = {
        file: "it is not there as it was written"
        for file, trace in traces.items()
        if _file_size(record.directory / file) != trace["bytes"]
    }
    while True:
        broken_files = _with_broken_files(record, broken)
        write_record(broken_files.directory, broken_files)
        before = len(broken)
        for item in all_formats():
            if item.FILE not in broken:
                _write_format(item, broken_files, broken)
        if len(broken) == before:
            break
    write_file(broken_files.directory / SCHEMA_FILE, [schema_text()])
    names = [
        RECORD_FILE,
        SCHEMA_FILE,
        *(item.FILE for item in all_formats() if item.FILE not in broken),
    ]
    # A trace is listed with the digest that its writer took, not with one of what lies there now.
    files = {name: file_entry(broken_files.directory / name) for name in names} | traces
    write_file(broken_files.directory / MANIFEST_FILE, [manifest_text(files)])
    return broken_files


def _withdraw(record: SessionRecord, error: BaseException, before: object) -> None:
    """Leave no half bundle that reads as a pass: room first, then a record that says so."""
    for name in RENDERED_FILES:
        with suppress(OSError):
            (record.directory / name).unlink(missing_ok=True)
    file = record.directory / RECORD_FILE
    if _file_identity(file) == before:
        return  # it says that the session is running
    why = f"infrastructure: the evidence could not be written as a whole: {describe_error(error)}"
    gate = {
        **record["gate"],
        "result": "incomplete",
        "exit_code": record["gate"]["exit_code"] or 1,
        "reasons": [*record["gate"]["reasons"], why],
    }
    told = {"status": "interrupted", "gate": gate}
    told["totals"] = {**record["totals"], "gate": gate["result"]}
    try:
        write_record(record.directory, replace(record, head={**record.head, **told}))
    except ConfigurationError:  # there is not even room for that
        with suppress(OSError):
            file.unlink(missing_ok=True)


def _file_size(file: Path) -> int | None:
    """Of a file as it lies there; ``None`` for none."""
    try:
        return file.lstat().st_size
    except OSError:
        return None


def _file_identity(file: Path) -> tuple[int, int] | None:
    """Which file it is that has this name."""
    try:
        lstat = file.lstat()
    except OSError:
        return None
    return lstat.st_ino, lstat.st_mtime_ns


def _write_format(item: Format, record: SessionRecord, broken: dict[str, str]) -> None:
    try:
        text = item.render(record)
    except Exception as error:  # told in the record, and the gate fails
        broken[item.FILE] = _failure_text(error)
        (record.directory / item.FILE).unlink(missing_ok=True)
        return
    write_file(record.directory / item.FILE, [text])


def _failure_text(error: Exception) -> str:
    """On one line; what the user can mend tells of the user's file and not of ours."""
    if isinstance(error, ConfigurationError):
        return "; ".join(" ".join(line.split()) for line in str(error).splitlines())
    return describe_error(error)


def _with_broken_files(record: SessionRecord, broken: Mapping[str, str]) -> SessionRecord:
    """The record of a session whose evidence is not whole."""
    if not broken:
        return record
    gate: dict[str, Any] = dict(record["gate"])
    reasons = [f"infrastructure: {file} could not be made: {why}" for file, why in broken.items()]
    gate["reasons"] = [*gate["reasons"], *reasons]
    if gate["result"] == "passed":
        gate["result"], gate["exit_code"] = "failed", 1
    totals = {**record["totals"], "gate": gate["result"]}
    return replace(record, head={**record.head, "gate": gate, "totals": totals})
