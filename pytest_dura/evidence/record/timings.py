"""Where a session's time went."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any


def timings(
    episodes: Iterable[Mapping[str, Any]], *, wall_seconds: float, evidence_seconds: float
) -> dict[str, Any]:
    """Sums over the recorded episodes, fault-free twins apart, which no verdict rests on.

    Args:
        episodes: Of the record.
        wall_seconds: From the start of the session until the record was complete.
        evidence_seconds: Those of them that the controller spent on gathering the evidence; traces
            are written where the episodes run, and rendering follows.
    """
    simulated, processing = 0.0, Counter[str]()
    for one in episodes:
        simulated += one["timings"]["simulated_seconds"]
        processing.update(one["timings"]["processing_seconds"])
    return {
        "wall_seconds": wall_seconds,
        "evidence_seconds": evidence_seconds,
        "simulated_seconds": simulated,
        "processing_seconds": {role: processing[role] for role in sorted(processing)},
    }
