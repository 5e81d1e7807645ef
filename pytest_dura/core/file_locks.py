"""Locks of the operating system on open files: they end with the process, however that ends."""

from __future__ import annotations

import os
import sys
from pathlib import Path

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
