"""What the faults of a case's episodes come to: how far each got along its causal chain."""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

Data = Mapping[str, Any]

UNFOLLOWED: Data = {
    "propagation": None,
    "propagated_at": None,
    "unknown": "",
    "outcome": None,
    "violated": [],
    "violated_without": None,
}
"""The rest of the chain where no verdict asked for it."""


RATES: Mapping[str, tuple[str, str]] = {
    "activation": ("activated", "run"),
    "manifestation": ("manifested", "run"),
    "propagation": ("propagated", "followed"),
    "detection": ("detected", "manifested"),
    "recovery": ("recovered", "recovery"),
}
"""Each rate's counts: how many did, of how many that could."""

LATENCIES = ("detection_latency", "recovery_latency", "time_to_recover")


def with_chains(episode: Data, chains: Mapping[str, Data]) -> dict[str, Any]:
    """An episode's record with what is known of each of its faults, by fault id."""
    faults = []
    for fault in episode["faults"]:
        chain = chains.get(fault["id"], UNFOLLOWED)
        faults.append({**fault, **{key: chain[key] for key in UNFOLLOWED}})
    return {**episode, "faults": faults}


def fault_metrics(episodes: Sequence[Data]) -> list[dict[str, Any]]:
    """How far each fault got, over the episodes in which it was planned.

    ``activated`` and ``manifested`` are counted over all episodes that were run, what follows over
    those in which the fault manifested: ``propagated`` beside ``followed``, in which that is known,
    ``detected``, ``recovery`` (recovery acted) and ``recovered`` (control was handed back).
    ``violated`` stands beside ``judged``, the episodes whose outcome is known: without a verdict
    on a campaign nobody asked for it. Rates are shares of those that could: of activation and
    manifestation over all runs, of propagation over those followed, of detection over those
    manifested, of recovery over those in which it acted; ``None`` where there are none. Latencies
    are seconds from the manifestation on: to the alert, to the first recovery action, and from
    there until the proposal was acceptable again.
    """
    columns: dict[str, list[Data]] = {}
    for episode in episodes:
        for fault in episode["faults"]:
            columns.setdefault(fault["id"], []).append(fault)
    return [_of_fault(name, found) for name, found in columns.items()]


def _of_fault(name: str, found: Sequence[Data]) -> dict[str, Any]:
    reached = [one for one in found if one["manifested_at"] is not None]
    counts = {
        "run": len(found),
        "activated": sum(one["activated_at"] is not None for one in found),
        "manifested": len(reached),
        "followed": sum(one["propagation"] in ("propagated", "contained") for one in reached),
        "propagated": sum(one["propagation"] == "propagated" for one in reached),
        "detected": sum(one["detected_at"] is not None for one in reached),
        "recovery": sum(one["recovery_at"] is not None for one in reached),
        "recovered": sum(one["recovered_at"] is not None for one in reached),
        "judged": sum(one["outcome"] not in (None, "missing") for one in found),
        "violated": sum(one["outcome"] == "violated" for one in found),
    }
    return {
        "id": name,
        "target": found[0]["target"],
        **counts,
        "rates": {
            rate: counts[part] / counts[whole] if counts[whole] else None
            for rate, (part, whole) in RATES.items()
        },
        **{name: _spread(reached, name) for name in LATENCIES},
    }


def _spread(found: Iterable[Data], name: str) -> dict[str, float] | None:
    """Median and greatest of a latency in s, where it is known."""
    times = [one[name] for one in found if one[name] is not None]
    return {"median": statistics.median(times), "max": max(times)} if times else None
