"""What the faults of a case's episodes come to: how far each got along its causal chain."""

from __future__ import annotations

import statistics
from array import array
from collections import Counter
from collections.abc import Mapping, Sequence
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

STEPS = (
    "run", "activated", "manifested", "followed", "propagated",
    "detected", "recovery", "recovered", "judged", "violated", "violated_without",
)  # fmt: skip
LATENCIES = ("detection_latency", "recovery_latency", "time_to_recover")


def with_chains(episode: Data, chains: Mapping[str, Data]) -> dict[str, Any]:
    """An episode's record with what is known of each of its faults, by fault id."""
    faults = []
    for fault in episode["faults"]:
        chain = chains.get(fault["id"], UNFOLLOWED)
        faults.append({**fault, **{key: chain[key] for key in UNFOLLOWED}})
    return {**episode, "faults": faults}


class FaultMetrics:
    """How far each fault got, over the episodes in which it was planned.

    Of an episode it keeps a few numbers at most, so that there may be many of them.
    """

    def __init__(self) -> None:
        self._targets: dict[str, Any] = {}
        self._counts: dict[str, Counter[str]] = {}
        self._times: dict[tuple[str, str], array[float]] = {}

    def add(self, episode: Data) -> None:
        """Take in an episode, of :func:`with_chains`."""
        for fault in episode["faults"]:
            name = fault["id"]
            self._targets.setdefault(name, fault["target"])
            self._counts.setdefault(name, Counter()).update(_passed(fault))
            if fault["manifested_at"] is not None:
                for latency in LATENCIES:
                    if fault[latency] is not None:
                        self._times.setdefault((name, latency), array("d")).append(fault[latency])

    def to_json(self) -> list[dict[str, Any]]:
        """Plain data, fault by fault.

        ``activated`` and ``manifested`` are counted over all episodes that were run, what follows
        over those in which the fault manifested: ``propagated`` beside ``followed``, in which that
        is known, ``detected``, ``recovery`` (recovery acted) and ``recovered`` (control was handed
        back). ``violated`` stands beside ``judged``, the episodes whose outcome is known: without a
        verdict on a campaign nobody asked for it. What the run of the same seed violates without
        the fault as well is none of its doing: episodes that violated no more than that are no part
        of ``violated``, but ``violated_without``. Rates are shares of those that could: of
        activation and manifestation over all runs, of propagation over those followed, of
        detection over those manifested, of recovery over those in which it acted; ``None`` where
        there are none. Latencies are seconds: from the activation to the alert, from the
        manifestation to the first recovery action, and from there until the proposal was acceptable
        again.
        """
        return [self._of_fault(name, counts) for name, counts in self._counts.items()]

    def _of_fault(self, name: str, counts: Counter[str]) -> dict[str, Any]:
        return {
            "id": name,
            "target": self._targets[name],
            **{step: counts[step] for step in STEPS},
            "rates": {
                rate: counts[part] / counts[whole] if counts[whole] else None
                for rate, (part, whole) in RATES.items()
            },
            **{latency: _spread(self._times.get((name, latency))) for latency in LATENCIES},
        }


class SharedViolations:
    """Counts, verdict by verdict, the violations that no fault can have caused.

    The run of the same seed without any fault violates the requirement as well.

    Args:
        verdicts: Of the record.
    """

    def __init__(self, verdicts: Sequence[Data]) -> None:
        self._counts: list[int | None] = [None] * len(verdicts)
        self._wanted: dict[tuple[str, str], list[tuple[int, str]]] = {}
        for place, verdict in enumerate(verdicts):
            valid = [one["episode"] for one in verdict["counterexamples"] if one["valid"]]
            for episode in valid:
                key = verdict["component"], episode
                self._wanted.setdefault(key, []).append((place, verdict["requirement"]))

    def add(self, episode: Data) -> None:
        """Take in a planned episode, of :func:`with_chains`."""
        for place, requirement in self._wanted.get((episode["component"], episode["id"]), ()):
            known = [
                requirement in fault["violated_without"]
                for fault in episode["faults"]
                if requirement in fault["violated"] and fault["violated_without"] is not None
            ]
            if known:
                self._counts[place] = (self._counts[place] or 0) + any(known)

    def to_json(self) -> list[int | None]:
        """For each verdict how many; ``None`` where that was measured of no violation."""
        return self._counts


def _passed(fault: Data) -> list[str]:
    """The steps that a fault passed in one episode."""
    reached = fault["manifested_at"] is not None
    passed = {
        "run": True,
        "activated": fault["activated_at"] is not None,
        "manifested": reached,
        "followed": reached and fault["propagation"] in ("propagated", "contained"),
        "propagated": reached and fault["propagation"] == "propagated",
        "detected": reached and fault["detected_at"] is not None,
        "recovery": reached and fault["recovery_at"] is not None,
        "recovered": reached and fault["recovered_at"] is not None,
        "judged": fault["outcome"] not in (None, "missing"),
        "violated": fault["outcome"] == "violated",
        "violated_without": fault["outcome"] == "violated also without it",
    }
    return [step for step in STEPS if passed[step]]


def _spread(times: array[float] | None) -> dict[str, float] | None:
    """Median and greatest of a latency in s, where it is known."""
    return {"median": statistics.median(times), "max": max(times)} if times else None
