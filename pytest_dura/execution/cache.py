"""EpisodeCache: the finished episodes of a session in a directory, for one that goes on with it."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from pytest_dura.core.codec import decode, encode
from pytest_dura.core.episode import EpisodeSpec
from pytest_dura.core.percepts import NOTHING
from pytest_dura.execution.address import Address
from pytest_dura.execution.codec import MAX_UNPACKED_BYTES, DamagedEpisodeError, unpack
from pytest_dura.execution.sources import Sources
from pytest_dura.requirements.episode_verdicts import JudgedEpisode

EPISODE, NEW, SOURCES = ".episode", ".new", ".sources"
_FORMAT = 2
_PRIVATE = 0o600
"""Mode of all files: they hold what secrets components were given, and what they made of them."""
_MAX_HEADER_BYTES = 1 << 20
_MAX_FILE_BYTES = _MAX_HEADER_BYTES + MAX_UNPACKED_BYTES


@dataclass(frozen=True)
class CacheEntry:
    """Header of an episode's file.

    Args:
        id: ``case#run``.
        component: Name of the component under test.
        session: Id of the session that simulated it.
        parts: Of its :class:`Address`.
        files: What it rests on beside the sources of that session, see :class:`EpisodeFiles`.
        changed: Parts that had changed since an earlier session simulated an episode of this name,
            which is why this one did; ``None`` if there was no earlier one.
    """

    id: str
    component: str
    session: str
    parts: Mapping[str, str]
    files: Mapping[str, str]
    changed: tuple[str, ...] | None = None


class EpisodeCache:
    """Episodes by address in a directory, each put there whole once it is over.

    Args:
        directory: Where they are; it is made when something is first put there.
        session: Id of the session that puts episodes there.
        earlier: Whether episodes of other sessions are taken over.
        read_sources: Reads what all episodes of this session rest on, if no process of it has.
    """

    def __init__(
        self,
        directory: Path,
        session: str,
        *,
        earlier: bool = False,
        read_sources: Callable[[], Sources | None] = lambda: None,
    ) -> None:
        self.directory, self.session, self.earlier = directory, session, earlier
        self._read_sources, self._has_put_sources = read_sources, False
        self._sources: dict[str, Sources | None] = {}

    def find(self, address: Address, spec: EpisodeSpec) -> tuple[JudgedEpisode, CacheEntry] | None:
        """An episode and its header; ``None`` if it is not there, or not whole."""
        file = self._file(address)
        try:
            with file.open("rb") as opened:
                data = opened.read(_MAX_FILE_BYTES)
        except OSError:
            return None
        header, _, packed = data.partition(b"\n")
        try:
            entry = _read_header(header, address)
            episode = unpack(packed, spec)
        except DamagedEpisodeError:
            # Of a full disk or a loss of power; it is simulated again.
            with suppress(OSError):
                file.unlink()
            return None
        return episode, entry

    def entry(self, address: Address) -> CacheEntry | None:
        """The header of an episode, whole or not; ``None`` if there is none."""
        try:
            with self._file(address).open("rb") as opened:
                return _read_header(opened.readline(_MAX_HEADER_BYTES), address)
        except (OSError, DamagedEpisodeError):
            return None

    def put(
        self,
        address: Address,
        spec: EpisodeSpec,
        packed: bytes,
        files: Mapping[str, str] = NOTHING,
        changed: Sequence[str] | None = None,
    ) -> None:
        """Store an episode where a later session, and any process of this one, finds it.

        Args:
            address: Its address.
            spec: What it was run from.
            packed: Of :func:`pytest_dura.execution.codec.pack`.
            files: See :class:`CacheEntry`.
            changed: See :class:`CacheEntry`.

        Raises:
            OSError: If it cannot be written.
        """
        known = None if changed is None else tuple(changed)
        entry = CacheEntry(spec.id, spec.component, self.session, address.parts, files, known)
        if not self._has_put_sources:
            self.put_sources()
        file = self._file(address)
        _make_private(file.parent.parent, file.parent)
        header = json.dumps({"format": _FORMAT, **encode(entry)}).encode()
        _replace_private(file, header + b"\n" + packed)

    def entries(self) -> Iterator[CacheEntry]:
        """Headers of all episodes, in no order; those that cannot be read are left out."""
        for file in self.directory.glob(f"??/*{EPISODE}"):
            with suppress(OSError, DamagedEpisodeError), file.open("rb") as opened:
                yield _read_header(opened.readline(_MAX_HEADER_BYTES))

    def count(self) -> int:
        """How many episodes there are, of whatever sessions, whole or not."""
        return sum(1 for _ in self.directory.glob(f"??/*{EPISODE}"))

    def put_sources(self) -> None:
        """Store what all episodes of this session rest on, unless another process has done so.

        Raises:
            OSError: If it cannot be written.
        """
        file, sources = self._sources_file(self.session), self.sources(self.session)
        if sources is not None and not file.exists():
            _make_private(self.directory)
            _replace_private(file, sources.to_bytes())
        self._has_put_sources = True

    def sources(self, session: str) -> Sources | None:
        """What all episodes of a session rest on; ``None`` if that is missing or damaged."""
        if session not in self._sources:
            try:
                sources = Sources.from_bytes(self._sources_file(session).read_bytes())
            except OSError:
                sources = self._read_sources() if session == self.session else None
            self._sources[session] = sources
        return self._sources[session]

    def _sources_file(self, session: str) -> Path:
        # The header of an episode may name any session, as "../x".
        return self.directory / f"{hashlib.sha256(session.encode()).hexdigest()[:32]}{SOURCES}"

    def clear(self) -> None:
        """Remove everything, by the names that we give; no symbolic link is followed.

        Raises:
            OSError: If something cannot be removed.
        """
        if self.directory.is_symlink():
            self.directory.unlink()
        if not self.directory.is_dir():
            return
        for folder in list(self.directory.iterdir()):
            if folder.suffix in (SOURCES, NEW) and not folder.is_dir():
                folder.unlink(missing_ok=True)
            if len(folder.name) == 2 and folder.is_dir() and not folder.is_symlink():
                for file in list(folder.iterdir()):
                    if file.suffix in (EPISODE, NEW):
                        file.unlink(missing_ok=True)
                with suppress(OSError):  # a file of other origin lies there
                    folder.rmdir()
        with suppress(OSError):
            self.directory.rmdir()

    def _file(self, address: Address) -> Path:
        return self.directory / address.name[:2] / f"{address.name}{EPISODE}"


def _make_private(*folders: Path) -> None:
    """Make folders of episodes, which are not redacted: for the owner alone, if they are new."""
    folders[0].parent.mkdir(parents=True, exist_ok=True)
    for folder in folders:
        folder.mkdir(mode=0o700, exist_ok=True)


def _replace_private(file: Path, data: bytes) -> None:
    new = file.with_suffix(f".{os.getpid()}{NEW}")
    try:
        new.touch(_PRIVATE)
        new.write_bytes(data)
        new.replace(file)
    except BaseException:  # also on ctrl-C nothing half-written stays; it is raised again
        with suppress(OSError):
            new.unlink(missing_ok=True)
        raise


def _read_header(line: bytes, address: Address | None = None) -> CacheEntry:
    try:
        header = json.loads(line)
        known = header.pop("format")
        entry = decode(CacheEntry, header)
    except (AttributeError, LookupError, RecursionError, TypeError, ValueError) as error:
        raise DamagedEpisodeError(f"{type(error).__name__}: {error}") from None
    if known != _FORMAT:
        raise DamagedEpisodeError(f"its format is not {_FORMAT}")
    if address is not None and entry.parts != address.parts:
        raise DamagedEpisodeError("it is not the episode of this name")
    return entry
