"""EpisodeCache: episodes in a directory that many processes share, and pruning it."""

from __future__ import annotations

import json
import os
import re
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pytest_dura.core.episode import EpisodeSpec
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.files import LockedFile, LockHeldError
from pytest_dura.execution.address import Address
from pytest_dura.execution.codec import MAX_UNPACKED_BYTES, DamagedEpisodeError, unpack
from pytest_dura.requirements.episode_verdicts import JudgedEpisode

EPISODE, CLAIM, NEW = ".episode", ".claim", ".new"
MAX_ATTEMPTS = 2
"""Processes that an episode may end before it is given up."""
_SECONDS_OF_USE = 3600.0
"""How exactly the time is kept at which an episode was used last: so it is rarely written."""
_FORMAT = 1
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
        changed: Parts that had changed since an earlier session simulated an episode of this name,
            which is why this one did; ``None`` if there was no earlier one.
    """

    id: str
    component: str
    session: str
    parts: Mapping[str, str]
    changed: tuple[str, ...] | None = None


class Claim(LockedFile):
    """Right to simulate an episode, as long as this process holds it.

    Attributes:
        attempts: How many processes ended while they had it, before this one.
    """

    attempts = 0


class EpisodeCache:
    """Episodes by address in a directory.

    A claim is a lock of the operating system: it ends with the process that holds it, whereupon
    another one takes the episode over. How many processes an episode has ended is kept beside it.

    Args:
        directory: Where they are; it is made when something is first put there.
        session: Id of the session that puts episodes there.
        earlier: Whether episodes of other sessions are taken over.
    """

    def __init__(self, directory: Path, session: str, *, earlier: bool = False) -> None:
        self.directory, self.session, self.earlier = directory, session, earlier

    def find(self, address: Address, spec: EpisodeSpec) -> tuple[JudgedEpisode, CacheEntry] | None:
        """An episode and its header; ``None`` if it is not there, or not whole."""
        file = self._file(address, EPISODE)
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
        if entry.session != self.session:
            _mark_used(file)
        return episode, entry

    def has(self, address: Address) -> bool:
        """Whether there is an episode, whole or not."""
        return self._file(address, EPISODE).is_file()

    def claim(self, address: Address) -> Claim | None:
        """The right to simulate an episode; ``None`` if another process has it.

        Raises:
            OSError: If the directory cannot be written.
        """
        file = self._file(address, CLAIM)
        _make_private(file.parent)
        try:
            claim = Claim.acquire(file, _PRIVATE)
        except LockHeldError:
            return None
        count, _, session = claim.read().partition(" ")
        # Attempts of another session do not count: what was wrong may be mended.
        claim.attempts = int(count) if count.isdigit() and session == self.session else 0
        claim.write(f"{claim.attempts + 1} {self.session}")
        return claim

    def put(
        self,
        address: Address,
        spec: EpisodeSpec,
        packed: bytes,
        changed: Sequence[str] | None = None,
    ) -> None:
        """Store an episode where every process finds it.

        Args:
            address: Its address.
            spec: What it was run from.
            packed: Of :func:`pytest_dura.execution.codec.pack`.
            changed: See :class:`CacheEntry`.

        Raises:
            OSError: If it cannot be written.
        """
        header = {
            "format": _FORMAT,
            "id": spec.id,
            "component": spec.component,
            "session": self.session,
            "parts": dict(address.parts),
            "changed": None if changed is None else list(changed),
        }
        data = json.dumps(header).encode() + b"\n" + packed
        file = self._file(address, EPISODE)
        _make_private(file.parent)
        new = file.with_suffix(f".{os.getpid()}{NEW}")
        try:
            new.touch(_PRIVATE)
            new.write_bytes(data)
            new.replace(file)
        except BaseException:  # also on ctrl-C nothing half-written stays; it is raised again
            with suppress(OSError):
                new.unlink(missing_ok=True)
            raise

    def entries(self) -> Iterator[CacheEntry]:
        """Headers of all episodes, in no order; those that cannot be read are left out."""
        for file in self.directory.glob(f"??/*{EPISODE}"):
            with suppress(OSError, DamagedEpisodeError), file.open("rb") as opened:
                yield _read_header(opened.readline(_MAX_HEADER_BYTES))

    def count(self) -> int:
        """How many episodes there are, of whatever sessions, whole or not."""
        return sum(1 for _ in self.directory.glob(f"??/*{EPISODE}"))

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
            if len(folder.name) == 2 and folder.is_dir() and not folder.is_symlink():
                for file in list(folder.iterdir()):
                    if file.suffix in (EPISODE, CLAIM, NEW):
                        file.unlink(missing_ok=True)
                with suppress(OSError):  # a file of other origin lies there
                    folder.rmdir()
        with suppress(OSError):
            self.directory.rmdir()

    def _file(self, address: Address, kind: str) -> Path:
        return self.directory / address.name[:2] / f"{address.name}{kind}"


def _make_private(folder: Path) -> None:
    """Make a folder of episodes, which are not redacted: for the owner alone, if it is new."""
    folder.parent.parent.mkdir(parents=True, exist_ok=True)
    for directory in (folder.parent, folder):
        directory.mkdir(mode=0o700, exist_ok=True)


def _mark_used(file: Path) -> None:
    """Keep an episode of another session from being pruned as unused."""
    with suppress(OSError):  # it belongs to another user, or is gone
        if time.time() - file.stat().st_mtime > _SECONDS_OF_USE:
            os.utime(file)


def _read_header(line: bytes, address: Address | None = None) -> CacheEntry:
    try:
        header: Any = json.loads(line)
        changed = header["changed"]
        entry = CacheEntry(
            header["id"],
            header["component"],
            header["session"],
            dict(header["parts"]),
            None if changed is None else tuple(changed),
        )
    except (LookupError, RecursionError, TypeError, ValueError) as error:
        raise DamagedEpisodeError(f"{type(error).__name__}: {error}") from None
    texts = [entry.id, entry.component, entry.session, *entry.parts, *entry.parts.values()]
    texts += entry.changed or ()
    if header.get("format") != _FORMAT or not all(isinstance(text, str) for text in texts):
        raise DamagedEpisodeError("its beginning is not as we write it")
    if address is not None and entry.parts != address.parts:
        raise DamagedEpisodeError("it is not the episode of this name")
    return entry


_MIN_AGE = 3600.0
"""s; a younger episode may be of a session that still runs, which would simulate it again."""
_AGES = {"h": 3600.0, "d": 86400.0, "w": 7 * 86400.0}
_SIZES = {"M": 10**6, "G": 10**9, "T": 10**12}
_ADDRESS = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True)
class Pruned:
    """Result of :func:`prune`.

    Args:
        removed: Episodes that were removed.
        removed_bytes: Their size.
        kept: Episodes that are left.
        kept_bytes: Their size.
    """

    removed: int
    removed_bytes: int
    kept: int
    kept_bytes: int


def prune(
    directory: Path, *, older_than: float | None = None, at_most: int | None = None
) -> Pruned:
    """Remove episodes from a directory of ``--dura-reuse``; sessions may use it meanwhile.

    A session that has looked for an episode before has it in memory or has its file open; one that
    looks for it afterwards simulates it again. No claim of a session that runs is touched, no
    symbolic link followed, and no file removed whose name we do not give.

    Args:
        directory: Where they are.
        older_than: Seconds: episodes that no session has written or taken over for so long go.
        at_most: Bytes: the episodes used least recently go until no more are left, except for
            those of the last hour.

    Raises:
        ConfigurationError: If there is no such directory.
    """
    if not directory.is_dir():
        raise ConfigurationError(
            "there is no such directory of episodes",
            found=str(directory),
            expected="the directory of --dura-reuse=DIR",
        )
    now = time.time()
    episodes = sorted(
        (stat.st_mtime, stat.st_size, file)
        for file in _files(directory, EPISODE)
        if (stat := _stat_or_none(file)) is not None
    )
    left = sum(size for _, size, _ in episodes)
    removed = removed_bytes = 0
    for used, size, file in episodes:
        too_old = older_than is not None and now - used > older_than
        too_much = at_most is not None and left > at_most and now - used > _MIN_AGE
        if (too_old or too_much) and _remove(file):
            removed, removed_bytes, left = removed + 1, removed_bytes + size, left - size
    _remove_leftovers(directory, now)
    return Pruned(removed, removed_bytes, len(episodes) - removed, left)


def read_age(text: str) -> float:
    """Seconds from a text such as ``30d``, ``12h`` or ``2w``.

    Raises:
        ConfigurationError: For anything else, and for less than an hour.
    """
    number = _number(text, _AGES)
    if number is None or number < _MIN_AGE:
        raise ConfigurationError(
            "--older-than takes a time",
            key="--older-than",
            found=text,
            expected="hours, days or weeks, of an hour at least, such as 12h, 30d or 8w",
            remedy="for example --older-than=30d",
        )
    return number


def read_size(text: str) -> int:
    """Bytes from a text such as ``500M`` or ``2.5G``, in powers of ten.

    Raises:
        ConfigurationError: For anything else.
    """
    number = _number(text, _SIZES)
    if number is None:
        raise ConfigurationError(
            "--at-most takes a size",
            key="--at-most",
            found=text,
            expected="megabytes, gigabytes or terabytes, such as 500M or 2.5G",
            remedy="for example --at-most=2G",
        )
    return int(number)


def _number(text: str, units: dict[str, float] | dict[str, int]) -> float | None:
    match = re.fullmatch(r"([0-9]{1,9}(?:\.[0-9]{1,9})?)([A-Za-z])", text)
    return None if match is None or match[2] not in units else float(match[1]) * units[match[2]]


def _files(directory: Path, kind: str) -> Iterator[Path]:
    """Files of a kind that have names as the cache gives them."""
    for file in directory.glob(f"??/*{kind}"):
        ours = _ADDRESS.fullmatch(file.name.partition(".")[0]) and file.name[:2] == file.parent.name
        if ours and not file.parent.is_symlink() and not file.is_symlink():
            yield file


def _stat_or_none(file: Path) -> os.stat_result | None:
    try:
        return file.stat()
    except OSError:  # removed in between
        return None


def _remove(file: Path) -> bool:
    try:
        file.unlink()
    except FileNotFoundError:  # another process was quicker
        return True
    except OSError:  # Windows removes no file that is open
        return False
    return True


def _remove_leftovers(directory: Path, now: float) -> None:
    """Remove what killed processes left: half-written files, and claims that none holds."""
    for kind in (NEW, CLAIM):
        for file in _files(directory, kind):
            stat = _stat_or_none(file)
            if stat is None or now - stat.st_mtime <= _MIN_AGE:
                continue
            if kind == NEW:
                _remove(file)
            else:
                _remove_claim(file)


def _remove_claim(file: Path) -> None:
    with suppress(LockHeldError, OSError):  # the latter if it is gone
        LockedFile.acquire(file, create=False).release()
