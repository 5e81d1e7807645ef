"""Files that are written whole or not at all: no reader ever sees half of one."""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Written:
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


def replace_file(file: Path, chunks: Iterable[str | bytes], *, durable: bool) -> Written:
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
    return Written(digest.hexdigest(), size)


def _keep_name(directory: Path) -> None:
    """Let the new name survive a loss of power, where directories can be synchronised."""
    if not hasattr(os, "O_DIRECTORY"):
        return
    handle = os.open(directory, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
