"""Writing the files of the evidence, with words for the user where it cannot be done."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.whole_files import Written, replace_file


def write_file(file: Path, chunks: Iterable[str | bytes]) -> Written:
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
