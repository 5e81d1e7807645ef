"""Files written whole or not at all, and locked files whose locks end with the process."""

from __future__ import annotations

import contextlib
import hashlib
import os
import sys
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from typing_extensions import Self


@dataclass(frozen=True)
class WrittenFile:
    """Digest and size of a written file.

    Args:
        sha256: Digest of the file, in hexadecimal digits.
        bytes: Its size.
    """

    sha256: str
    bytes: int


def temporary_prefix(name: str) -> str:
    """Prefix of the names of temporary files that a killed session may leave behind."""
    return f".{name}-"


def replace_file(file: Path, chunks: Iterable[str | bytes], *, durable: bool) -> WrittenFile:
    r"""Write a file atomically; after a failure the old file is as it was.

    A symbolic link of that name is replaced and not followed. Text is written as UTF-8; lone
    surrogates are escaped as in JSON: ``\udcff``. The file is readable for all who may read the
    folder.

    Args:
        file: Path of the file. Missing folders are made.
        chunks: Content, part by part; it is never in memory as a whole.
        durable: Whether the file survives a loss of power; that takes milliseconds.

    Raises:
        OSError: If it cannot be written.
    """
    file.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=file.parent, prefix=temporary_prefix(file.name))
    digest, size = hashlib.sha256(), 0
    try:
        with os.fdopen(handle, "wb") as stream:
            for chunk in chunks:
                data = chunk
                if isinstance(data, str):  # a file's name in it may hold lone surrogates
                    data = data.encode(errors="backslashreplace")
                stream.write(data)
                digest.update(data)
                size += len(data)
            if durable:
                stream.flush()
                os.fsync(stream.fileno())
        # mkstemp makes files for the owner alone.
        Path(name).chmod(0o644)
        Path(name).replace(file)
    except BaseException:  # also on ctrl-C no half-written file stays behind; it is raised again
        Path(name).unlink(missing_ok=True)
        raise
    if durable:
        _keep_name(file.parent)
    return WrittenFile(digest.hexdigest(), size)


def _keep_name(directory: Path) -> None:
    """Let the new name survive a loss of power, where directories can be synchronised."""
    if not hasattr(os, "O_DIRECTORY"):
        return
    handle = os.open(directory, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


class LockHeldError(Exception):
    """Lock of a file that another process holds; its text is what the holder wrote into it."""


class LockedFile:
    """Open file that this process alone has locked, until it is released or the process ends.

    filelock locks the descriptor and lets go of nothing else, as two things are not its: a process
    that is forked meanwhile may outlive this one, and holds no lock; and code that runs in this
    process may close descriptors that are not its own (``os.closerange(3, 256)``), whose numbers
    are then reused for other files, which must neither be closed nor written.

    Args:
        number: The open and locked descriptor.
        file: Its name.
    """

    def __init__(self, number: int, file: Path) -> None:
        self._number: int | None = number
        self._file, self._opened = file, os.fstat(number)
        _HELD.add(self)

    @classmethod
    def acquire(cls, file: Path) -> Self:
        """Open and lock a file; a symbolic link is not followed.

        Args:
            file: Its name, in a folder that exists.

        Raises:
            LockHeldError: If another process holds it.
            OSError: If it cannot be opened, or its file system knows no locks.
        """
        from filelock import lock_descriptor

        flags = os.O_RDWR | getattr(os, "O_NOFOLLOW", 0) | os.O_CREAT
        while True:
            number = os.open(file, flags, 0o644)
            try:
                locked = lock_descriptor(number, blocking=False)
                holder = "" if locked else _read_text(number)
                if locked and _is_named(number, file):
                    return cls(number, file)
            except BaseException:  # ctrl-C too must not leave the file open; it is raised again
                os.close(number)
                raise
            os.close(number)
            if not locked:
                raise LockHeldError(holder)
            # Otherwise its former holder removed it in between.

    @property
    def is_held(self) -> bool:
        """Whether the descriptor is open, and on the file that was opened."""
        if self._number is None:
            return False
        try:
            return os.path.samestat(os.fstat(self._number), self._opened)
        except OSError:
            return False

    def write(self, text: str) -> None:
        """Replace the text; the lock is given up if that fails.

        Raises:
            OSError: If it cannot be written.
        """
        if self._number is None:
            raise OSError(f"{self._file} is released")
        try:
            os.lseek(self._number, 0, os.SEEK_SET)
            os.ftruncate(self._number, 0)
            os.write(self._number, f"\n{text}\n".encode())
        except BaseException:  # see above
            self.forget()
            raise

    def release(self) -> None:
        """Remove the file and unlock it. A second call does nothing."""
        if self.is_held:  # otherwise the name may by now be another holder's
            if sys.platform == "win32":  # which removes no open files
                self.forget()
            # While it is locked: afterwards the name may be another's. A file that cannot be
            # removed is unlocked all the same.
            with contextlib.suppress(OSError):
                self._file.unlink(missing_ok=True)
        self.forget()

    def forget(self) -> None:
        """Close the descriptor, if it is still ours, and leave the file."""
        _HELD.discard(self)
        held, number, self._number = self.is_held, self._number, None
        if held and number is not None:
            os.close(number)


def _read_text(number: int) -> str:
    """Text of a holder, which begins behind the first byte: no other process may read it."""
    os.lseek(number, 1, os.SEEK_SET)
    return os.read(number, 200).decode(errors="replace").strip()


def _is_named(number: int, file: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(number), file.stat())
    except FileNotFoundError:
        return False


# Of the process: a handler of forks cannot be unregistered. It keeps locks without other reference.
_HELD: set[LockedFile] = set()


def _forget_locks() -> None:
    for locked in list(_HELD):
        locked.forget()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_locks)
