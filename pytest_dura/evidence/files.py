"""Files of the evidence: written whole, locked, listed with their SHA-256, read in pieces.

A record as it is written has each episode on lines of its own, and a line break in JSON is
never inside of a text. The lines between those that open and close the list of episodes can
therefore be read an episode at a time. A file of any other layout is not read in pieces.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
from array import array
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import IO, Any

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.files import LockedFile, LockHeldError, WrittenFile, replace_file
from pytest_dura.provenance import recorded_path


def write_file(file: Path, chunks: Iterable[str | bytes]) -> WrittenFile:
    """Write a file of the evidence durably, as :func:`replace_file` does.

    Args:
        file: Where. Missing folders are made.
        chunks: Its content, part by part; they are never all in memory.

    Raises:
        ConfigurationError: If it cannot be written.
    """
    try:
        return replace_file(file, chunks, durable=True)
    except OSError as error:
        raise ConfigurationError(
            f"the evidence cannot be written: {error.strerror or error}",
            key="--dura-evidence",
            found=str(file),
            expected="a directory that can be written, with room for the evidence",
            remedy="make room, or choose another directory",
        ) from None


LOCK_FILE = ".lock"
"""Name of the file in the evidence directory, which exists as long as a session runs."""


class DirectoryLock:
    """Lock of an evidence directory, held by the session that writes it.

    The lock is the operating system's: it ends with the process, so that no killed session blocks
    the next one, and it holds between containers that share a directory.

    Args:
        directory: The evidence directory; it is made if need be.

    Raises:
        ConfigurationError: If another session holds it, or it cannot be made.
    """

    def __init__(self, directory: Path) -> None:
        try:
            directory.mkdir(parents=True, exist_ok=True)
            self._locked = LockedFile.acquire(directory / LOCK_FILE)
            self._locked.write(f"process {os.getpid()} on {platform.node()}")
        except LockHeldError as holder:
            raise ConfigurationError(
                f"another session ({str(holder) or 'of a process that is not known'}) "
                "is writing to this evidence directory",
                key="--dura-evidence",
                found=str(directory),
                expected="a directory of its own for each session at a time",
                remedy="wait for the other session, or name another directory",
            ) from None
        except OSError as error:
            raise ConfigurationError(
                f"the evidence cannot be written: {error.strerror or error}",
                key="--dura-evidence",
                found=str(directory),
                expected="a directory that can be written, on a file system that knows locks",
                remedy="choose another directory",
            ) from None

    def release(self) -> None:
        """Release the lock. A second call does nothing."""
        self._locked.release()


def require_directory(directory: Path) -> None:
    """Refuse what is to be the evidence directory of a session, and is no directory.

    Raises:
        ConfigurationError: If there is none.
    """
    if not directory.is_dir():
        raise ConfigurationError(
            "there is no such directory",
            key="DIR",
            found=str(directory),
            expected="the evidence directory of a session",
            remedy="name the directory that --dura-evidence named; by default dura-evidence",
        )


MANIFEST_FILE = "manifest.json"
SIGNATURE_FILE = "test-result.intoto.dsse.json"
REVIEW_FILE = "review.dsse.json"
SIGNED_FILES = (SIGNATURE_FILE, REVIEW_FILE)
"""Envelopes beside a bundle (see ``signing``), which come after its manifest."""
_CHUNK = 1 << 20


def file_entry(file: Path) -> dict[str, Any]:
    """Compute SHA-256 and size of a file."""
    state, size = hashlib.sha256(), 0
    for chunk in read_chunks(file):
        state.update(chunk)
        size += len(chunk)
    return {"sha256": state.hexdigest(), "bytes": size}


def read_chunks(file: Path) -> Iterator[bytes]:
    """Read a file in pieces of 1 MiB."""
    with file.open("rb") as stream:
        while chunk := stream.read(_CHUNK):
            yield chunk


def manifest_text(files: Mapping[str, Mapping[str, Any]]) -> str:
    """Write the manifest of these files, in the single form that is accepted."""
    listed = {name: dict(files[name]) for name in sorted(files)}
    canonical = json.dumps(listed, sort_keys=True, separators=(",", ":"))
    digest = hashlib.sha256(canonical.encode()).hexdigest()
    return json.dumps({"files": listed, "digest": digest}, indent=1) + "\n"


def manifest_problems(directory: Path, unlisted: Collection[str] = ()) -> Iterator[str]:
    """Yield the differences between a bundle's files and its manifest.

    Args:
        directory: The bundle's.
        unlisted: Names of files that may be there and are not listed.
    """
    try:
        text = (directory / MANIFEST_FILE).read_bytes().decode()
        listed = json.loads(text)["files"]
        canonical = manifest_text(listed)
    except FileNotFoundError:
        yield f"{MANIFEST_FILE}: missing; the session did not finish writing its evidence"
        return
    except (OSError, UnicodeError, ValueError, LookupError, TypeError, AttributeError) as error:
        yield f"{MANIFEST_FILE}: damaged ({type(error).__name__})"
        return
    if text != canonical:
        yield f"{MANIFEST_FILE}: not as it was written; its own digest or form does not agree"
    present = set(files_below(directory)) - {MANIFEST_FILE}
    for name in sorted(present.difference(listed, unlisted, SIGNED_FILES)):
        yield f"{name}: not in the manifest"
    for name in sorted(set(listed) - present):
        yield f"{name}: in the manifest, but not in the bundle"
    for name in sorted(present & set(listed)):
        if (directory / name).is_symlink():
            yield f"{name}: a link, where a bundle holds files only"
        elif file_entry(directory / name) != listed[name]:
            yield f"{name}: changed since it was written (its SHA-256 differs)"


def listed_files(directory: Path) -> list[str]:
    """List the names in a bundle's manifest; none where it is missing or damaged."""
    try:
        return list(json.loads((directory / MANIFEST_FILE).read_bytes())["files"])
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        return []


def files_below(directory: Path) -> list[str]:
    """List all files below a directory by their path in it, sorted; links are not followed."""
    return sorted(
        path.relative_to(directory).as_posix()
        for path in directory.rglob("*")
        if path.is_symlink() or not path.is_dir()
    )


ReadEpisode = Callable[[bytes], Any]
_OPEN, _CLOSE = b' "episodes": [\n', (b" ]\n", b" ],\n")
_FIRST, _LAST, _BETWEEN = b"  {\n", b"  }\n", b"  },\n"


@dataclass(frozen=True)
class StreamedRecord:
    """A record whose episodes stay in its file.

    Args:
        head: Every top-level key but ``episodes``.
        file: The file.
        identity: Device, inode, size and time of modification of the file.
        offsets: Where each episode begins in it, in bytes, and where the last one ends.
    """

    head: Mapping[str, Any]
    file: Path
    identity: tuple[int, ...]
    offsets: array[int]

    def episodes(self) -> Iterator[Any]:
        """Iterate over the episodes, in the order of the record.

        Raises:
            ConfigurationError: If the file has changed.
        """
        try:
            yield from self._read()
        except (OSError, ValueError) as error:
            raise ConfigurationError(
                "the record changed while it was read",
                file=str(self.file),
                found=f"{type(error).__name__}: {error}",
                expected="a bundle to which nothing writes",
                remedy="let the session that writes it come to its end",
            ) from None

    def _read(self) -> Iterator[Any]:
        with self.file.open("rb") as stream:
            if _stream_identity(stream) != self.identity:
                raise ValueError("another file")
            stream.seek(self.offsets[0])
            for start, end in pairwise(self.offsets):
                # Without the comma and the line break before the next one.
                yield json.loads(stream.read(end - start).rstrip(b",\n"))


def stream_record(file: Path, read: ReadEpisode) -> StreamedRecord | None:
    """Read a record without its episodes, each of which is parsed once as a check.

    Args:
        file: The file.
        read: Parser of JSON.

    Returns:
        ``None`` for a file of another layout, without episodes, or that cannot be read; to read it
        as a whole then tells what is wrong.
    """
    head_lines: list[bytes] = []
    offsets, lists, offset = array("Q"), 0, 0
    try:
        with file.open("rb") as stream:
            identity = _stream_identity(stream)
            for line in stream:
                offset += len(line)
                if line == _OPEN:
                    lists += 1
                    offsets, closing = _episode_offsets(stream, offset, read)
                    offset = offsets[-1] + len(closing)
                    head_lines.append(_OPEN.rstrip() + closing.lstrip())
                else:
                    head_lines.append(line)
        head = read(b"".join(head_lines))
    except (OSError, ValueError, RecursionError):
        return None
    # A line alone does not show which of two lists it opens, or at which depth.
    if lists != 1 or not isinstance(head, dict) or head.pop("episodes", None) != []:
        return None
    return StreamedRecord(head, file, identity, offsets)


def read_head(file: Path) -> dict[str, Any]:
    """Read a record as it is written, without its episodes, which are not parsed.

    Raises:
        OSError: If it cannot be read.
        ValueError: If it is not JSON.
        TypeError: If it is not an object.
    """
    lines, skipped = [], False
    with file.open("rb") as stream:
        for line in stream:
            skipped = skipped and line not in _CLOSE
            if not skipped:
                lines.append(line)
            skipped = skipped or line == _OPEN
    head: dict[str, Any] = dict(json.loads(b"".join(lines)))
    return head


def _episode_offsets(stream: IO[bytes], offset: int, read: ReadEpisode) -> tuple[array[int], bytes]:
    """Find the offsets of a list's episodes, and the line that closes it.

    Raises:
        ValueError: For an episode that cannot be parsed, and a list of another layout.
    """
    offsets, lines, more = array("Q", [offset]), list[bytes](), True
    for line in stream:
        if not lines and not more and line in _CLOSE:
            return offsets, line
        if not lines and (not more or line != _FIRST):
            break
        offset += len(line)
        if line not in (_LAST, _BETWEEN):
            lines.append(line)
            continue
        if not isinstance(read(b"".join([*lines, _LAST])), dict):
            break
        offsets.append(offset)
        lines.clear()
        more = line == _BETWEEN
    raise ValueError("its episodes are not listed as they are written")


def _stream_identity(stream: IO[bytes]) -> tuple[int, ...]:
    status = os.fstat(stream.fileno())
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns


class InputFiles:
    """Files that results depend on. Each is hashed when it is added, and again at the end.

    Args:
        root: The project's root.
        known: Folders outside of it that have a name of their own.
    """

    def __init__(self, root: Path, known: Mapping[Path, str] | None = None) -> None:
        self.root = root
        self.known = known or {}
        self._digests: dict[tuple[str, Path], str | None] = {}
        self._reported: dict[tuple[str, str], str] = {}
        self._unchanging: set[Path] = set()

    def add(self, kind: str, file: Path, sha256: str | None = None) -> None:
        """Add a file.

        Args:
            kind: Its purpose in the session.
            file: The file.
            sha256: Digest when it was read, for a file that the session itself may replace.
        """
        if (kind, file) in self._digests:
            return
        if sha256 is not None:
            self._unchanging.add(file)
        self._digests[kind, file] = sha256 or sha256_of(file)

    def add_reported(self, kind: str, files: Iterable[Mapping[str, str]]) -> None:
        """Add ``{path, sha256}`` of files that another process read.

        Args:
            kind: Their purpose in the session.
            files: Their names as in the record.
        """
        for file in files:
            self._reported.setdefault((kind, file["path"]), file["sha256"])

    def to_json(self) -> list[dict[str, Any]]:
        """List ``{path, kind, sha256, changed}`` of each file, sorted.

        ``sha256`` is ``None`` for a file that could not be read; ``changed`` says that it differs
        now.
        """
        entries: dict[tuple[str, str, str | None], dict[str, Any]] = {}
        for (kind, file), sha256 in self._digests.items():
            changed = file not in self._unchanging and sha256_of(file) != sha256
            self._take(entries, recorded_path(file, self.root, self.known), kind, sha256, changed)
        for (kind, path), known in self._reported.items():
            now = sha256_of(self.root / path)
            self._take(entries, path, kind, known, now is not None and now != known)
        return [entries[key] for key in sorted(entries, key=str)]

    @staticmethod
    def _take(
        entries: dict[tuple[str, str, str | None], dict[str, Any]],
        path: str,
        kind: str,
        sha256: str | None,
        changed: bool,
    ) -> None:
        entry = {"path": path, "kind": kind, "sha256": sha256, "changed": changed}
        entries.setdefault((path, kind, sha256), entry)["changed"] |= changed


def sha256_of(file: Path) -> str | None:
    """Compute the SHA-256 of a file; ``None`` for one that cannot be read."""
    try:
        return str(file_entry(file)["sha256"])
    except (OSError, ValueError):  # ValueError: a name with a NUL in it
        return None
