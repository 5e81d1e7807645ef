"""DirectoryLock: one session at a time writes an evidence directory."""

from __future__ import annotations

import contextlib
import os
import platform
import sys
from pathlib import Path

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.file_locks import OwnedHandle, is_named, lock

LOCK = ".lock"
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
        self._file = directory / LOCK
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
