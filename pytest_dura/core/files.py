"""Files written whole or not at all, and locks on open files that end with the process."""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class WrittenFile:
    """What was written.

    Args:
        sha256: Digest of the file, in hexadecimal digits.
        bytes: Its size.
    """

    sha256: str
    bytes: int


def temporary_prefix(name: str) -> str:
    """How the names begin of what a killed session leaves behind of a file of this name."""
    return f".{name}-"


def replace_file(file: Path, chunks: Iterable[str | bytes], *, durable: bool) -> WrittenFile:
    r"""Write a file atomically; whatever goes wrong leaves the old one as it was.

    A symbolic link of that name is replaced and not followed. Text is written as UTF-8; what that
    cannot hold, as JSON can: ``\udcff``. Whoever may read the folder may read the file.

    Args:
        file: Where. Missing folders are made.
        chunks: What it holds, one part after the other; they are never in memory at once.
        durable: Whether it is to survive a loss of power; that takes milliseconds.

    Raises:
        OSError: If it cannot be written.
    """
    file.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=file.parent, prefix=temporary_prefix(file.name))
    digest, size = hashlib.sha256(), 0
    try:
        with os.fdopen(handle, "wb") as stream:
            for chunk in chunks:
                # A name of a file need not be text.
                data = chunk
                if isinstance(data, str):
                    data = data.encode(errors="backslashreplace")
                stream.write(data)
                digest.update(data)
                size += len(data)
            if durable:
                stream.flush()
                os.fsync(stream.fileno())
        # mkstemp makes files for the owner alone; these are for whoever may read the folder.
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


if sys.platform == "win32":
    import msvcrt

    _BYTE = 1 << 30  # behind what the file holds, which others are to read

    def lock(handle: int) -> None:
        """Lock an open file for this process.

        Raises:
            PermissionError: If another one has it.
        """
        os.lseek(handle, _BYTE, os.SEEK_SET)
        try:
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        finally:
            os.lseek(handle, 0, os.SEEK_SET)

else:
    import fcntl

    def lock(handle: int) -> None:
        """Lock an open file for this process.

        Raises:
            BlockingIOError: If another one has it.
        """
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)


def is_named(handle: int, file: Path) -> bool:
    """Whether an open file is the one of this name still, and no other took its place."""
    try:
        return os.path.samestat(os.fstat(handle), file.stat())
    except FileNotFoundError:
        return False


class OwnedHandle:
    """A file descriptor that is closed only as long as it stands for the file that was opened.

    Code that runs in this process may close descriptors that are not its own
    (``os.closerange(3, 256)``). Their numbers are then given to other files, which must neither be
    closed nor written in place of the first one.

    Args:
        number: The open descriptor.
    """

    def __init__(self, number: int) -> None:
        self.number: int | None = number
        self._opened = os.fstat(number)

    @property
    def is_intact(self) -> bool:
        """Whether it is open, and on the file that was opened."""
        if self.number is None:
            return False
        try:
            return os.path.samestat(os.fstat(self.number), self._opened)
        except OSError:
            return False

    def close(self) -> None:
        """Close it, if it is still ours. A second call does nothing."""
        intact, number, self.number = self.is_intact, self.number, None
        if intact and number is not None:
            os.close(number)
