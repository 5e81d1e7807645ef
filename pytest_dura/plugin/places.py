"""Where things go that are made from the evidence later."""

from __future__ import annotations

from pathlib import Path


def beside(evidence: Path, what: str) -> Path:
    """A directory of its own beside the evidence, whose manifest lists all that is in it.

    Args:
        evidence: The evidence directory.
        what: Follows its name, as in ``dura-evidence-replay``.
    """
    place = evidence.resolve()
    return place.with_name(f"{place.name}-{what}")
