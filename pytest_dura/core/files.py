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
    """Whether an open file is still the one of this name."""
    try:
        return os.path.samestat(os.fstat(handle), file.stat())
    except FileNotFoundError:
        return False


class OwnedHandle:
    """File descriptor that is closed only as long as it belongs to the file that was opened.

    Code that runs in this process may close descriptors that are not its own
    (``os.closerange(3, 256)``). Their numbers are then reused for other files, which must neither
    be closed nor written.

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
