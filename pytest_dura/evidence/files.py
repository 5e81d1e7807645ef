"""Files of the evidence: written whole, locked, listed with their SHA-256, read in pieces.

A record as it is written has each episode on lines of its own, and a line break in JSON is
never inside of a text. What lies between the lines that open and close the list of episodes
can be taken out, and each piece of it read by itself: all of them together mean what the
whole file means. A file that is laid out in any other way is not read in pieces.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import platform
import sys
from array import array
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import IO, Any, Literal, get_args

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.files import OwnedHandle, WrittenFile, is_named, lock, replace_file
from pytest_dura.provenance import recorded_path


def write_file(file: Path, chunks: Iterable[str | bytes]) -> WrittenFile:
    """Write a file of the evidence, as :func:`replace_file` does, and for good.

    Args:
        file: Where. Missing folders are made.
        chunks: What it holds, one part after the other; they are never in memory at once.

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
"""Name of the file in the evidence directory; it is there as long as a session is."""


class DirectoryLock:
    """Held by the session that writes an evidence directory.

    The lock is the operating system's: it ends with the process, however that ends, so that no
    killed session blocks the next one, and it holds between containers that share a directory.

    Args:
        directory: The evidence directory; it is made if need be.

    Raises:
        ConfigurationError: If another session holds it, or it cannot be made.
    """

    def __init__(self, directory: Path) -> None:
        self._file = directory / LOCK_FILE
        self._handle: OwnedHandle | None = None
        try:
            directory.mkdir(parents=True, exist_ok=True)
            while self._handle is None:
                self._handle = self._tried()
        except OSError as error:
            raise ConfigurationError(
                f"the evidence cannot be written: {error.strerror or error}",
                key="--dura-evidence",
                found=str(directory),
                expected="a directory that can be written, on a file system that knows locks",
                remedy="choose another directory",
            ) from None

    def release(self) -> None:
        """Let others write. A second call does nothing."""
        if self._handle is None:
            return
        handle, self._handle = self._handle, None
        if not handle.is_intact:  # somebody closed it: by now the name may be another's
            return
        # Who finds the file finds it unlocked, so that one which cannot be removed hinders nobody.
        with contextlib.suppress(OSError):
            if sys.platform == "win32":  # which removes no open files
                handle.close()
            self._file.unlink(missing_ok=True)  # as long as it is held; then it may be another's
        handle.close()

    def _tried(self) -> OwnedHandle | None:
        """The file, open and locked; ``None`` if its former holder removed it meanwhile."""
        no_link = getattr(os, "O_NOFOLLOW", 0)
        handle = os.open(self._file, os.O_RDWR | os.O_CREAT | no_link, 0o644)
        try:
            lock(handle)
            if not is_named(handle, self._file):
                os.close(handle)
                return None
            os.ftruncate(handle, 0)
            os.write(handle, f"process {os.getpid()} on {platform.node()}\n".encode())
        except (BlockingIOError, PermissionError):  # the latter on Windows
            holder = os.read(handle, 200).decode(errors="replace").strip()
            os.close(handle)
            raise ConfigurationError(
                f"another session ({holder or 'of a process that is not known'}) "
                "is writing to this evidence directory",
                key="--dura-evidence",
                found=str(self._file.parent),
                expected="a directory of its own for each session at a time",
                remedy="wait for the other session, or name another directory",
            ) from None
        except BaseException:  # also ctrl-C leaves no lock that nobody holds; it is raised again
            os.close(handle)
            raise
        return OwnedHandle(handle)


MANIFEST_FILE = "manifest.json"
_CHUNK = 1 << 20


def file_entry(file: Path) -> dict[str, Any]:
    """SHA-256 and size of a file."""
    state, size = hashlib.sha256(), 0
    with file.open("rb") as stream:
        while chunk := stream.read(_CHUNK):
            state.update(chunk)
            size += len(chunk)
    return {"sha256": state.hexdigest(), "bytes": size}


def manifest_text(files: Mapping[str, Mapping[str, Any]]) -> str:
    """The manifest of these files: one text for one bundle, so that no byte of it is free."""
    listed = {name: dict(files[name]) for name in sorted(files)}
    return json.dumps({"files": listed, "digest": _digest(listed)}, indent=1) + "\n"


def manifest_problems(directory: Path, unlisted: Collection[str] = ()) -> Iterator[str]:
    """Everything in which a bundle's files differ from its manifest.

    Args:
        directory: The bundle's.
        unlisted: Names of files that are there for another purpose, and may be.
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
    there = set(files_below(directory)) - {MANIFEST_FILE}
    for name in sorted(there.difference(listed, unlisted)):
        yield f"{name}: not in the manifest"
    for name in sorted(set(listed) - there):
        yield f"{name}: in the manifest, but not in the bundle"
    for name in sorted(there & set(listed)):
        if (directory / name).is_symlink():
            yield f"{name}: a link, where a bundle holds files only"
        elif file_entry(directory / name) != listed[name]:
            yield f"{name}: changed since it was written (its SHA-256 differs)"


def listed_files(directory: Path) -> list[str]:
    """The names that a bundle's manifest lists; none where it is missing or damaged."""
    try:
        return list(json.loads((directory / MANIFEST_FILE).read_bytes())["files"])
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        return []


def files_below(directory: Path) -> list[str]:
    """All files below a directory, by their path in it, sorted; links are not followed."""
    return sorted(
        path.relative_to(directory).as_posix()
        for path in directory.rglob("*")
        if path.is_symlink() or not path.is_dir()
    )


def _digest(listed: Mapping[str, Any]) -> str:
    canonical = json.dumps(listed, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(canonical.encode()).hexdigest()


ReadEpisode = Callable[[bytes], Any]
_OPEN, _CLOSE = b' "episodes": [\n', (b" ]\n", b" ],\n")
_FIRST, _LAST, _BETWEEN = b"  {\n", b"  }\n", b"  },\n"


@dataclass(frozen=True)
class StreamedRecord:
    """A record whose episodes stay in its file.

    Args:
        head: Every top-level key but ``episodes``.
        file: The file.
        identity: Which file it was, and when it was written last.
        places: Where each episode begins in it, in bytes, and where the last one ends.
    """

    head: Mapping[str, Any]
    file: Path
    identity: tuple[int, ...]
    places: array[int]

    def episodes(self) -> Iterator[Any]:
        """The episodes, in the order of the record.

        Raises:
            ConfigurationError: If the file is not any more what it was.
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
            stream.seek(self.places[0])
            for start, end in pairwise(self.places):
                # Without the comma that parts it from the next one, and the break behind it.
                yield json.loads(stream.read(end - start).rstrip(b",\n"))


def stream_record(file: Path, read: ReadEpisode) -> StreamedRecord | None:
    """The record of a file, each episode of which was read once to see that it can be.

    Args:
        file: The file.
        read: Reads JSON, as strictly as it is to be read.

    Returns:
        ``None`` for a file that is laid out in another way, that has no episodes, or that cannot
        be read: whoever reads it as a whole finds out what it is.
    """
    head: list[bytes] = []
    places, opened, place = array("Q"), 0, 0
    try:
        with file.open("rb") as stream:
            identity = _stream_identity(stream)
            for line in stream:
                place += len(line)
                if line == _OPEN:
                    opened += 1
                    places, closing = _episode_offsets(stream, place, read)
                    place = places[-1] + len(closing)
                    head.append(_OPEN.rstrip() + closing.lstrip())
                else:
                    head.append(line)
        found = read(b"".join(head))
    except (OSError, ValueError, RecursionError):
        return None
    # Of two lists, or one further inside, a line alone does not say whose it is.
    if opened != 1 or not isinstance(found, dict) or found.pop("episodes", None) != []:
        return None
    return StreamedRecord(found, file, identity, places)


def _episode_offsets(stream: IO[bytes], place: int, read: ReadEpisode) -> tuple[array[int], bytes]:
    """Where the episodes of a list begin that was opened, and the line that closes it.

    Raises:
        ValueError: For one that cannot be read, and a list that is not as it is written.
    """
    places, lines, more = array("Q", [place]), list[bytes](), True
    for line in stream:
        if not lines and not more and line in _CLOSE:
            return places, line
        if not lines and (not more or line != _FIRST):
            break
        place += len(line)
        if line not in (_LAST, _BETWEEN):
            lines.append(line)
            continue
        if not isinstance(read(b"".join([*lines, _LAST])), dict):
            break
        places.append(place)
        lines.clear()
        more = line == _BETWEEN
    raise ValueError("its episodes are not listed as they are written")


def _stream_identity(stream: IO[bytes]) -> tuple[int, ...]:
    fstat = os.fstat(stream.fileno())
    return fstat.st_dev, fstat.st_ino, fstat.st_size, fstat.st_mtime_ns


InputKind = Literal[
    "scenario", "requirements", "faults", "test", "conftest", "component", "check", "role",
    "configuration", "baseline", "argument", "cassette",
]  # fmt: skip
_INPUT_KINDS: tuple[str, ...] = get_args(InputKind)


class InputFiles:
    """Files that results depend on. Each is read when it is named first, and again at the end.

    Args:
        root: The project's root.
        known: Folders outside of it that have a name of their own.
    """

    def __init__(self, root: Path, known: Mapping[Path, str] | None = None) -> None:
        self.root = root
        self.known = known or {}
        self._found: dict[tuple[str, Path], str | None] = {}
        self._told: dict[tuple[str, str], str] = {}
        self._steady: set[Path] = set()

    def add(self, kind: InputKind, file: Path, sha256: str | None = None) -> None:
        """Take in a file.

        Args:
            kind: What it is to the session.
            file: The file.
            sha256: What it was when it was read, for one that the session itself may replace.
        """
        if (kind, file) in self._found:
            return
        if sha256 is not None:
            self._steady.add(file)
        self._found[kind, file] = sha256 or sha256_of(file)

    def add_told(self, kind: InputKind, files: Iterable[Mapping[str, str]]) -> None:
        """Take in ``{path, sha256}`` of files that another process read.

        Args:
            kind: What they are to the session.
            files: Their names as the record has them.
        """
        for file in files:
            self._told.setdefault((kind, file["path"]), file["sha256"])

    def to_json(self) -> list[dict[str, Any]]:
        """``{path, kind, sha256, changed}`` of each file, sorted.

        ``sha256`` is ``None`` for one that could not be read; ``changed`` says that it is not the
        same any more.
        """
        told: dict[tuple[str, str, str | None], dict[str, Any]] = {}
        for (kind, file), sha256 in self._found.items():
            changed = file not in self._steady and sha256_of(file) != sha256
            self._take(told, recorded_path(file, self.root, self.known), kind, sha256, changed)
        for (kind, path), known in self._told.items():
            now = sha256_of(self.root / path)
            self._take(told, path, kind, known, now is not None and now != known)
        return [told[key] for key in sorted(told, key=str)]

    @staticmethod
    def _take(
        told: dict[tuple[str, str, str | None], dict[str, Any]],
        path: str,
        kind: str,
        sha256: str | None,
        changed: bool,
    ) -> None:
        item = {"path": path, "kind": kind, "sha256": sha256, "changed": changed}
        told.setdefault((path, kind, sha256), item)["changed"] |= changed


def sha256_of(file: Path) -> str | None:
    """SHA-256 of a file; ``None`` for one that cannot be read."""
    try:
        return str(file_entry(file)["sha256"])
    except (OSError, ValueError):  # ValueError: a name with a NUL in it
        return None
