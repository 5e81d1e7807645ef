"""The bundle on disk: the record, every format rendered from it, and last the manifest.

A reader never sees half a file, nor a killed session that reads as a pass.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

from pytest_dura.core.codec import decode
from pytest_dura.core.errors import ConfigurationError, describe_error, did_you_mean
from pytest_dura.core.files import temporary_prefix
from pytest_dura.core.mismatches import Mismatch, MismatchError
from pytest_dura.core.registry import Registry
from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.evidence.episodes import SPOOL_PREFIX
from pytest_dura.evidence.files import (
    LOCK_FILE,
    MANIFEST_FILE,
    SIGNED_FILES,
    StreamedRecord,
    file_entry,
    files_below,
    listed_files,
    manifest_problems,
    manifest_text,
    stream_record,
    write_file,
)
from pytest_dura.evidence.gate import GateResult
from pytest_dura.evidence.gather import SCHEMA_VERSION
from pytest_dura.evidence.model import RecordHead, SessionRecord
from pytest_dura.evidence.schema import check_parts, check_record
from pytest_dura.evidence.traces import TRACE_FOLDER, is_trace_name


class Format(Protocol):
    """Interface of a report format, which may be a module.

    With an attribute ``EXPORT``, its short name, it is made on request alone; each bundle has the
    others.
    """

    def render(self, record: SessionRecord) -> str:
        """Render the file's text, which is a function of the record."""
        ...


RECORD_FILE = "evidence.json"
FORMATS: Registry[Format] = Registry(
    "pytest_dura.reports",
    "report format",
    lambda value: callable(getattr(value, "render", None)),
    "a module or an object with a function render(record)",
    names=r"[A-Za-z0-9][\w-]*(\.[\w-]+)+",
    reserved=(RECORD_FILE, MANIFEST_FILE, *SIGNED_FILES),
)
"""Formats by the names of their files."""
_EPISODES_KEY = "episodes"


def all_formats() -> Iterator[Format]:
    """Import the formats, one at a time."""
    return (FORMATS[name] for name in FORMATS)


def short_name(name: str) -> str:
    """Return the short name of a format that is made on request alone; empty for any other."""
    try:
        return str(getattr(FORMATS[name], "EXPORT", ""))
    except ConfigurationError:  # it cannot be imported, which the bundle that lacks it says
        return ""


def default_files() -> tuple[str, ...]:
    """Names of the files that each bundle has beside its record and its manifest."""
    return tuple(name for name in FORMATS if not short_name(name))


def exported_file(short: str, key: str) -> str:
    """Return the name of the file of a format that is made on request.

    Args:
        short: Its short name, or that of the file.
        key: What the name was given by, for the message.

    Raises:
        ConfigurationError: For an unknown name.
    """
    names = sorted(FORMATS, key=FORMATS.is_ours)  # a name of ours is no other's
    files = {short_name(name): name for name in names if short_name(name)}
    if short in files.values():
        return short
    if short not in files:
        raise ConfigurationError(
            f"there is no export format {short!r}",
            key=key,
            found=short,
            expected=f"one of {', '.join(files)}",
            remedy=did_you_mean(short, files),
        )
    return files[short]


def rendered_files() -> tuple[str, ...]:
    """Names of the other files of a bundle; the manifest is the first to be removed."""
    return (MANIFEST_FILE, *FORMATS)


STREAMED_BYTES = 8 << 20
"""Bytes of a record above which its episodes are read one at a time."""
RESUME_FOLDER = ".episodes"
"""Folder of the episodes that an interrupted session leaves to the next one."""
_EARLIER_FILES = ("evidence.schema.json",)
"""Files of bundles of earlier versions, which a new session replaces as well."""
_TOOL = re.compile(rb'"tool"\s*:\s*\{\s*"name"\s*:\s*"pytest-dura"')
_HEAD_BYTES = 1 << 16


def _temporary_prefixes() -> tuple[str, ...]:
    return tuple(map(temporary_prefix, (RECORD_FILE, *rendered_files())))


def check_directory(directory: Path) -> None:
    """Refuse to write evidence over other files.

    A directory may be written if it is empty, or holds a record of pytest-dura and beside it only
    what its manifest lists, or what an unfinished session leaves.

    Raises:
        ConfigurationError: If it is a symbolic link, or holds anything else.
    """
    if directory.is_symlink():
        raise _foreign_error("the evidence directory is a symbolic link", directory, str(directory))
    names = [name for name in files_below(directory) if not _is_temporary(name)]
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
    expected = {RECORD_FILE, *rendered_files(), *SIGNED_FILES, *_EARLIER_FILES}
    expected.update(listed_files(directory))
    for name in names:
        folder, _, last = name.rpartition("/")
        if name not in expected and not (folder == TRACE_FOLDER and is_trace_name(last)):
            problem = "this directory holds a file that is no part of the evidence in it"
            raise _foreign_error(problem, directory, name)


def _is_temporary(name: str) -> bool:
    """Whether it is what an unfinished session leaves: lock, spool, episode, trace."""
    first, _, rest = name.partition("/")
    if rest:
        if first == TRACE_FOLDER:
            return rest.startswith(".") or is_trace_name(rest)
        return first == RESUME_FOLDER
    return first == LOCK_FILE or first.startswith((*_temporary_prefixes(), SPOOL_PREFIX))


def _is_our_record(record: Path) -> bool:
    """Whether a record, which may be large or damaged, begins with pytest-dura as its tool."""
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
    """Write the record of a session that begins, then remove what an earlier one left beside it.

    In this order no result of an earlier session is ever there without a record that says that a
    session is running.

    Args:
        record: Of the session that begins.
        traces: Whether traces are removed; not if some may be of the session that begins.

    Raises:
        ConfigurationError: If the directory cannot be made, written or cleared.
    """
    earlier = os.path.lexists(record.directory / RECORD_FILE)
    write_record(record.directory, record)
    # Without a record, files of such names are not evidence.
    if earlier:
        clear_bundle(record.directory, traces=traces)


def clear_bundle(directory: Path, *, traces: bool = True) -> None:
    """Remove what an earlier session left, apart from the record, which is to be replaced first.

    Files are recognised by their names; nothing else is touched, and of a symbolic link the link
    itself is removed.

    Args:
        directory: The evidence directory.
        traces: Whether traces are removed; not if some may be of the session that begins.

    Raises:
        ConfigurationError: If one of them cannot be removed.
    """
    with _removal_errors(directory):
        for name in (*rendered_files(), *SIGNED_FILES, *_EARLIER_FILES):
            (directory / name).unlink(missing_ok=True)
        for begun in _entries(directory):
            if begun.name.startswith(_temporary_prefixes()) or begun.name.startswith(SPOOL_PREFIX):
                begun.unlink()
    if traces:
        _clear_traces(directory)


def _clear_traces(directory: Path, kept: Collection[str] = ()) -> None:
    """Remove the traces of a bundle, as :func:`clear_bundle` does.

    Args:
        directory: The evidence directory.
        kept: Names of traces that stay, as in the record.

    Raises:
        ConfigurationError: If one of them cannot be removed.
    """
    traces = directory / TRACE_FOLDER
    with _removal_errors(directory):
        if traces.is_symlink():
            traces.unlink()
        for trace in _entries(traces):
            if is_trace_name(trace.name) and f"{TRACE_FOLDER}/{trace.name}" not in kept:
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
    """Yield the files and links in a directory, if it is one."""
    if directory.is_dir():
        for entry in list(directory.iterdir()):
            if entry.is_symlink() or entry.is_file():
                yield entry


class DamagedRecordError(ConfigurationError):
    """A record that does not agree with the models.

    Args:
        file: The file.
        mismatches: Where, at least one.
    """

    def __init__(self, file: Path, mismatches: Sequence[Mismatch]) -> None:
        self.mismatches = mismatches
        first, more = mismatches[0], len(mismatches) - 1
        super().__init__(
            "this record is damaged" + (f" at this and {more} more places" if more else ""),
            file=str(file),
            key=first.pointer,
            found=first.found,
            expected=first.expected or "a record as pytest-dura wrote it",
            remedy="restore the file, or run the session again",
        )


def open_record(
    file: Path, key: str = "--dura-evidence", *, may_be_link: bool = False
) -> SessionRecord:
    """Open a record of this version, all of which is checked by the models.

    The episodes of a large one stay in its file; a smaller one is in memory as a whole.

    Args:
        file: The file.
        key: The option that named it.
        may_be_link: Whether it may be a symbolic link; in a bundle that would lead to what is no
            part of it.

    Raises:
        DamagedRecordError: If it does not agree with the models.
        ConfigurationError: If there is none, or it cannot be read.
    """
    if file.is_symlink() and not may_be_link:
        raise _unreadable_record("the record is a symbolic link", file, key)
    streamed = _streamed_record(file)
    if streamed is None:
        data = _read_record(file, key)
        try:
            return SessionRecord.of(data, file.parent)
        except MismatchError:
            raise DamagedRecordError(file, check_record(data)) from None

    def episodes() -> Iterator[EpisodeEntry]:
        return (decode(EpisodeEntry, each) for each in streamed.episodes())

    try:
        head = decode(RecordHead, streamed.head)
        for _ in episodes():
            pass
    except MismatchError:
        raise DamagedRecordError(file, check_parts(streamed.head, streamed.episodes())) from None
    return SessionRecord(head, file.parent, episodes)


def _streamed_record(file: Path) -> StreamedRecord | None:
    """Stream a large record of this version; ``None`` for others, which are read as a whole."""
    try:
        is_large = file.stat().st_size > STREAMED_BYTES
    except OSError:
        return None
    record = stream_record(file, _strict_json) if is_large else None
    if record is None or record.head.get("schema_version") != SCHEMA_VERSION:
        return None
    return record


def _read_record(file: Path, key: str) -> dict[str, Any]:
    """Read a record of this version as plain data, which is not checked yet.

    Raises:
        ConfigurationError: If there is none, or it cannot be read.
    """
    try:
        record: dict[str, Any] = _strict_json(file.read_bytes())
        version = record["schema_version"]
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
            remedy="run its session again, by the command that the record names under `command`, "
            "or read it with the version that it names under `tool`",
        )
    return record


def _strict_json(data: bytes) -> Any:
    return json.loads(data, object_pairs_hook=_unique_keys, parse_constant=_no_number)


def _unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Refuse duplicate keys, of which readers take one or the other."""
    data = dict(pairs)
    if len(data) < len(pairs):
        raise ValueError("a key is there twice")
    return data


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
    """Write the record as JSON, indented by one, with the episodes after the cases.

    In JSON a line break is never inside of a text.
    """
    head = record.head.to_json()
    names = list(head)
    names.insert(names.index("cases") + 1, _EPISODES_KEY)
    yield "{"
    for number, name in enumerate(names):
        yield ",\n " if number else "\n "
        yield f"{_json_text(name)}: "
        if name != _EPISODES_KEY:
            yield _json_text(head[name]).replace("\n", "\n ")
            continue
        place = -1
        for place, episode in enumerate(record.episodes()):
            yield ",\n  " if place else "[\n  "
            yield _json_text(episode.to_json()).replace("\n", "\n  ")
        yield "[]" if place < 0 else "\n ]"
    yield "\n}\n"


def _json_text(value: Any) -> str:
    """Write JSON in which letters of any script stay and invisible characters are escaped.

    JSON requires that of control characters below the blank alone; terminals act on others, too.
    """
    text = json.dumps(value, indent=1, ensure_ascii=False, allow_nan=False)
    return text if text.isascii() and "\x7f" not in text else text.translate(_VISIBLE)


class _VisibleCharacters(dict[int, str]):
    """Replacements of characters in JSON, for ``str.translate``."""

    def __missing__(self, point: int) -> str:
        char = chr(point)
        is_visible = point < _DELETE or char.isprintable()
        self[point] = shown = char if is_visible else json.dumps(char)[1:-1]
        return shown


_DELETE = 0x7F
_VISIBLE = _VisibleCharacters()


def write_bundle(record: SessionRecord, exports: Collection[str] = ()) -> SessionRecord:
    """Write the bundle and return the record as it was written.

    A format that cannot be rendered does not prevent the others: record and other formats then
    name it, and the gate fails.

    Args:
        record: Of the session.
        exports: Names of further files, of formats that are made on request.

    Raises:
        ConfigurationError: If the directory cannot be written. The rest of the bundle then says
            that it is incomplete.
    """
    before = _file_identity(record.directory / RECORD_FILE)
    try:
        return _write_all(record, [*default_files(), *exports])
    except BaseException as error:  # also on ctrl-C; it is raised again
        _withdraw(record, error, before)
        raise


def _write_all(record: SessionRecord, formats: Collection[str]) -> SessionRecord:
    entries = (episode.trace for episode in record.episodes() if episode.trace is not None)
    traces = {entry.file: {"sha256": entry.sha256, "bytes": entry.bytes} for entry in entries}
    _clear_traces(record.directory, traces)
    broken = {
        file: "it is not there as it was written"
        for file, trace in traces.items()
        if _file_size(record.directory / file) != trace["bytes"]
    }
    result = record.head.gate.result
    written = record
    while True:
        if broken:
            reasons = [
                f"infrastructure: {file} could not be made: {why}" for file, why in broken.items()
            ]
            written = _with_gate(record, "failed" if result == "passed" else result, reasons)
        write_record(written.directory, written)
        before = len(broken)
        for name in formats:
            if name not in broken:
                _write_format(name, written, broken)
        if len(broken) == before:
            break
    names = [RECORD_FILE, *(name for name in formats if name not in broken)]
    # A trace is listed with the digest that its writer computed, which may reveal a later change.
    files = {name: file_entry(written.directory / name) for name in names} | traces
    write_file(written.directory / MANIFEST_FILE, [manifest_text(files)])
    return written


def render_again(record: SessionRecord) -> None:
    """Render the files of a written bundle again, since a review of it came, and list them anew.

    Raises:
        ConfigurationError: If they cannot be rendered or written.
    """
    manifest = json.loads((record.directory / MANIFEST_FILE).read_bytes())["files"]
    broken: dict[str, str] = {}
    for name in FORMATS:
        if name in manifest:
            _write_format(name, record, broken)
            manifest[name] = {} if broken else file_entry(record.directory / name)
    if broken:
        name, why = next(iter(broken.items()))
        raise ConfigurationError(
            f"it cannot be rendered with the review: {why}", file=str(record.directory / name)
        )
    write_file(record.directory / MANIFEST_FILE, [manifest_text(manifest)])


def export_file(directory: Path, name: str, output: Path | None = None) -> Path:
    """Render a format of a written bundle, into it or to another file.

    Args:
        directory: The bundle, whose manifest then lists the file.
        name: Name of the format's file.
        output: Where it goes otherwise.

    Raises:
        ConfigurationError: If the bundle differs from its manifest, or is signed, and for what
            cannot be rendered or written.
    """
    problem = next(manifest_problems(directory), None)
    if problem is not None:
        raise ConfigurationError(
            "this bundle differs from its manifest",
            file=str(directory),
            found=problem,
            expected="a bundle as pytest-dura wrote it",
            remedy="restore it, or run the session again",
        )
    if output is None and any((directory / each).exists() for each in SIGNED_FILES):
        raise ConfigurationError(
            "this bundle is signed, and a further file would break the signature",
            file=str(directory),
            remedy="name another place with --output FILE, or export before it is signed",
        )
    record = open_record(directory / RECORD_FILE)
    if output is None:
        add_format(record, name)
        return directory / name
    write_file(output, [_rendered(record, name)])
    return output


def add_format(record: SessionRecord, name: str) -> None:
    """Render a format into a written bundle, and list the file in its manifest.

    Raises:
        ConfigurationError: If it cannot be rendered or written.
    """
    file, manifest = record.directory / name, record.directory / MANIFEST_FILE
    write_file(file, [_rendered(record, name)])
    files = json.loads(manifest.read_bytes())["files"] | {name: file_entry(file)}
    write_file(manifest, [manifest_text(files)])


def _rendered(record: SessionRecord, name: str) -> str:
    try:
        return FORMATS[name].render(record)
    except ConfigurationError:
        raise
    except Exception as error:
        raise ConfigurationError(
            f"{name} cannot be rendered: {describe_error(error)}", file=str(record.directory)
        ) from error


def _withdraw(record: SessionRecord, error: BaseException, before: object) -> None:
    """Make room, then mark the record as incomplete, lest half a bundle reads as a pass."""
    for name in rendered_files():
        with suppress(OSError):
            (record.directory / name).unlink(missing_ok=True)
    file = record.directory / RECORD_FILE
    if _file_identity(file) == before:
        return  # it says that the session is running
    why = f"infrastructure: the evidence could not be written as a whole: {describe_error(error)}"
    marked = _with_gate(record, "incomplete", [why])
    try:
        write_record(record.directory, marked.changed(status="interrupted"))
    except ConfigurationError:  # no room even for that
        with suppress(OSError):
            file.unlink(missing_ok=True)


def _file_size(file: Path) -> int | None:
    """Size of a file, or of the link itself; ``None`` for none."""
    try:
        return file.lstat().st_size
    except OSError:
        return None


def _file_identity(file: Path) -> tuple[int, int] | None:
    """Inode and time of modification of a file; ``None`` for none."""
    try:
        status = file.lstat()
    except OSError:
        return None
    return status.st_ino, status.st_mtime_ns


def _write_format(name: str, record: SessionRecord, broken: dict[str, str]) -> None:
    try:
        text = FORMATS[name].render(record)
    except Exception as error:  # named in the record, and the gate fails
        why = describe_error(error)
        if isinstance(error, ConfigurationError):  # it names the user's file that caused it
            why = "; ".join(" ".join(line.split()) for line in str(error).splitlines())
        broken[name] = why
        (record.directory / name).unlink(missing_ok=True)
        return
    write_file(record.directory / name, [text])


def _with_gate(record: SessionRecord, result: GateResult, reasons: Sequence[str]) -> SessionRecord:
    """Change the gate of a record, which then has not passed."""
    gate = record.head.gate
    changed = replace(
        gate, result=result, exit_code=gate.exit_code or 1, reasons=(*gate.reasons, *reasons)
    )
    return record.changed(gate=changed, totals=record.head.totals.replace(gate=result))
