"""Where evidence is, as the user is told, and where things go that are made from it later."""

from __future__ import annotations

import os
from pathlib import Path


def beside(evidence: Path, what: str) -> Path:
    """A directory of its own beside the evidence, whose manifest lists all that is in it.

    Args:
        evidence: The evidence directory.
        what: Follows its name, as in ``dura-evidence-replay``.
    """
    place = evidence.resolve()
    return place.with_name(f"{place.name}-{what}")


def from_here(file: Path, here: Path) -> str:
    """The path of a file as the user would type it.

    Args:
        file: The file, or folder.
        here: The directory in which pytest was started.
    """
    try:
        return os.path.relpath(file, here)
    except ValueError:  # it is on another drive of Windows
        return str(file)
