"""Shelf: episodes in a directory that many processes share, each of them simulated by one."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pytest_dura.campaign.episodes.address import Address
from pytest_dura.campaign.episodes.codec import MOST_BYTES, DamagedEpisodeError, unpack
from pytest_dura.core.episode import Episode, EpisodeSpec
from pytest_dura.core.file_locks import OwnedHandle, is_named, lock

EPISODE, CLAIM, NEW = ".episode", ".claim", ".new"
MOST_ATTEMPTS = 2
"""Processes that an episode may end before it is given up."""
_SECONDS_OF_USE = 3600.0
"""How exactly it is noted when an episode was used last: so it is rarely written."""
_FORMAT = 1
_PRIVATE = 0o600
"""Mode of all files: they hold what secrets components were given, and what they made of them."""
_MOST_HEAD = 1 << 20
_MOST_FILE = _MOST_HEAD + MOST_BYTES


@dataclass(frozen=True)
class Entry:
    """What the beginning of an episode's file tells.

    Args:
        id: ``case#run``.
        component: Name of the component under test.
        session: Id of the session that simulated it.
        parts: Of its :class:`Address`.
        changed: What had changed since an earlier session simulated an episode of this name, which
            is why this one did; ``None`` if there was no earlier one.
    """

    id: str
    component: str
    session: str
    parts: Mapping[str, str]
    changed: tuple[str, ...] | None = None


class Claim:
    """The right to simulate an episode, as long as this process holds it.

    A process that is forked meanwhile, by a simulator for example, does not hold it as well: it
    may outlive this one, and nobody would take the episode over.

    Args:
        handle: The open and locked file.
        file: Its name.
        attempts: How many processes ended while they had it, before this one.
    """

    def __init__(self, handle: int, file: Path, attempts: int) -> None:
        self._handle = OwnedHandle(handle)
        self._file = file
        self.attempts = attempts
        _HELD.add(self)

    @property
    def is_held(self) -> bool:
        """Whether nobody closed its file, which gives the claim up."""
        return self._handle.is_intact

    def release(self) -> None:
        """Let others have it. A second call does nothing."""
        _HELD.discard(self)
        if not self.is_held:  # somebody closed it: by now the name may be another's
            return
        # While it is locked: afterwards the name may be another's. What cannot be removed counts
        # as an attempt, no more.
        if sys.platform == "win32":  # which removes no open files
            self._handle.close()
        with suppress(OSError):
            self._file.unlink(missing_ok=True)
        self._handle.close()

    def forget(self) -> None:
        """Close the file without giving the claim up, for a copy of the process that holds it."""
        self._handle.close()


_HELD: set[Claim] = set()
"""The claims of this process, also those that nobody has in hand any more."""


def _after_fork() -> None:
    for claim in list(_HELD):
        claim.forget()
    _HELD.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


class Shelf:
    """Episodes by address in a directory.

    A claim is a lock of the operating system: it ends with the process that holds it, whereupon
    another one takes the episode over. How many processes an episode has ended is kept beside it.

    Args:
        directory: Where; it is made when something is first put there.
        session: Id of the session that puts episodes there.
        earlier: Whether those of other sessions are taken over.
    """

    def __init__(self, directory: Path, session: str, *, earlier: bool = False) -> None:
        self.directory, self.session, self.earlier = directory, session, earlier

    def find(self, address: Address, spec: EpisodeSpec) -> tuple[Episode, Entry] | None:
        """An episode, and what is told of it; ``None`` if it is not there, or not whole."""
        file = self._file(address, EPISODE)
        try:
            with file.open("rb") as opened:
                data = opened.read(_MOST_FILE)
        except OSError:
            return None
        head, _, packed = data.partition(b"\n")
        try:
            entry = _entry(head, address)
            episode = unpack(packed, spec)
        except DamagedEpisodeError:
            # Of a full disk or a loss of power; it is simulated again.
            with suppress(OSError):
                file.unlink()
            return None
        if entry.session != self.session:
            _used(file)
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
        _make_folder(file.parent)
        while True:
            handle = os.open(file, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), _PRIVATE)
            try:
                lock(handle)
                if not is_named(handle, file):
                    os.close(handle)  # its former holder was done with it in between
                    continue
                told = os.read(handle, 200).decode(errors="replace").partition(" ")
                # Of another session it says nothing: what was wrong may be mended.
                attempts = int(told[0]) if told[0].isdigit() and told[2] == self.session else 0
                os.lseek(handle, 0, os.SEEK_SET)
                os.ftruncate(handle, 0)
                os.write(handle, f"{attempts + 1} {self.session}".encode())
            except (BlockingIOError, PermissionError):
                os.close(handle)
                return None
            except BaseException:  # also ctrl-C leaves no open file; it is raised again
                os.close(handle)
                raise
            return Claim(handle, file, attempts)

    def put(
        self,
        address: Address,
        spec: EpisodeSpec,
        packed: bytes,
        changed: Sequence[str] | None = None,
    ) -> None:
        """Let every process find an episode.

        Args:
            address: Where.
            spec: What it was run from.
            packed: Of :func:`pytest_dura.campaign.episodes.codec.pack`.
            changed: See :class:`Entry`.

        Raises:
            OSError: If it cannot be written.
        """
        head = {
            "format": _FORMAT,
            "id": spec.id,
            "component": spec.component,
            "session": self.session,
            "parts": dict(address.parts),
            "changed": None if changed is None else list(changed),
        }
        data = json.dumps(head).encode() + b"\n" + packed
        file = self._file(address, EPISODE)
        _make_folder(file.parent)
        new = file.with_suffix(f".{os.getpid()}{NEW}")
        try:
            new.touch(_PRIVATE)
            new.write_bytes(data)
            new.replace(file)
        except BaseException:  # also on ctrl-C nothing half-written stays; it is raised again
            with suppress(OSError):
                new.unlink(missing_ok=True)
            raise

    def entries(self) -> Iterator[Entry]:
        """What is told of all episodes, in no order; what cannot be read is left out."""
        for file in self.directory.glob(f"??/*{EPISODE}"):
            with suppress(OSError, DamagedEpisodeError), file.open("rb") as opened:
                yield _entry(opened.readline(_MOST_HEAD))

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
                with suppress(OSError):  # somebody else's file lies there
                    folder.rmdir()
        with suppress(OSError):
            self.directory.rmdir()

    def _file(self, address: Address, kind: str) -> Path:
        return self.directory / address.name[:2] / f"{address.name}{kind}"


def _make_folder(folder: Path) -> None:
    """Make a folder of episodes, which are not redacted: for the owner alone, if it is new."""
    for one in (folder.parent, folder):
        one.parent.mkdir(parents=True, exist_ok=True)
        one.mkdir(mode=0o700, exist_ok=True)


def _used(file: Path) -> None:
    """Note that an episode of another session is of use, for who prunes the directory."""
    with suppress(OSError):  # it is somebody else's, or gone
        if time.time() - file.stat().st_mtime > _SECONDS_OF_USE:
            os.utime(file)


def _entry(line: bytes, address: Address | None = None) -> Entry:
    try:
        head: Any = json.loads(line)
        changed = head["changed"]
        found = Entry(
            head["id"],
            head["component"],
            head["session"],
            dict(head["parts"]),
            None if changed is None else tuple(changed),
        )
    except (LookupError, RecursionError, TypeError, ValueError) as error:
        raise DamagedEpisodeError(f"{type(error).__name__}: {error}") from None
    told = [found.id, found.component, found.session, *found.parts, *found.parts.values()]
    told += found.changed or ()
    if head.get("format") != _FORMAT or not all(isinstance(one, str) for one in told):
        raise DamagedEpisodeError("its beginning is not as we write it")
    if address is not None and found.parts != address.parts:
        raise DamagedEpisodeError("it is not the episode of this name")
    return found
