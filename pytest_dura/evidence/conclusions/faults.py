"""Faults: how far each fault of a case got, over the episodes in which it was planned."""

from __future__ import annotations

import statistics
from array import array
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from pytest_dura.core.metrics import TracedFault
from pytest_dura.evidence.case_model import FaultMetricsEntry, FaultRates, LatencyEntry
from pytest_dura.evidence.conclusions.failure_modes import share
from pytest_dura.evidence.entry import JsonObject
from pytest_dura.evidence.episode_model import EpisodeEntry

TRACED = ("propagation", "propagated_at", "unknown", "outcome", "violated", "violated_without")
"""What is known of a fault only once its episode was followed."""


RATES: Mapping[str, tuple[str, str]] = {
    "activation": ("activated", "run"),
    "manifestation": ("manifested", "run"),
    "propagation": ("propagated", "followed"),
    "detection": ("detected", "manifested"),
    "recovery": ("recovered", "recovery"),
}
"""Numerator and denominator of each rate."""

_CHAIN_STEPS = (
    "run", "activated", "manifested", "followed", "propagated",
    "detected", "recovery", "recovered", "judged", "violated", "violated_without",
)  # fmt: skip
_LATENCIES = ("detection_latency", "recovery_latency", "time_to_recover")


def with_chains(episode: JsonObject, chains: Mapping[str, Mapping[str, Any]]) -> JsonObject:
    """Add what is known of each fault, by its id, to an episode's entry."""
    faults = []
    for fault in episode["faults"]:
        chain = chains.get(fault["id"])
        faults.append(fault if chain is None else fault | {key: chain[key] for key in TRACED})
    return {**episode, "faults": faults}


def untraced(fault: TracedFault) -> TracedFault:
    """Copy a fault without what is known only once its episode was followed."""
    return replace(
        fault,
        propagation=None,
        propagated_at=None,
        unknown="",
        outcome=None,
        violated=(),
        violated_without=None,
    )


class FaultMetrics:
    """Counts how far each fault got, over the episodes in which it was planned.

    It stores a few numbers of each episode.
    """

    def __init__(self) -> None:
        self._targets: dict[str, Any] = {}
        self._readers: dict[str, set[str]] = {}
        self._counts: dict[str, Counter[str]] = {}
        self._times: dict[tuple[str, str], array[float]] = {}

    def add(self, episode: EpisodeEntry) -> None:
        """Add an episode of :func:`with_chains`."""
        for fault in episode.faults:
            name = fault.id
            self._targets.setdefault(name, fault.target)
            self._readers.setdefault(name, set()).update(fault.read_by)
            self._counts.setdefault(name, Counter()).update(_passed_steps(fault))
            if fault.manifested_at is not None:
                for latency in _LATENCIES:
                    seconds = getattr(fault, latency)
                    if seconds is not None:
                        self._times.setdefault((name, latency), array("d")).append(seconds)

    def join(self, other: FaultMetrics) -> None:
        """Add the sums of another case."""
        self._targets = {**other._targets, **self._targets}
        for name, counts in other._counts.items():
            self._readers.setdefault(name, set()).update(other._readers[name])
            self._counts.setdefault(name, Counter()).update(counts)
        for key, times in other._times.items():
            self._times.setdefault(key, array("d")).extend(times)

    def entries(self) -> list[FaultMetricsEntry]:
        """Return what came of them, fault by fault.

        ``activated`` and ``manifested`` are counted over all episodes that were run, what follows
        over those in which the fault manifested: ``propagated`` of ``followed``, in which that is
        known, ``detected``, ``recovery`` (recovery acted) and ``recovered`` (control was handed
        back). ``violated`` is counted of ``judged``, the episodes whose outcome is known from a
        verdict on a campaign. A violation that the run of the same seed without the fault has as
        well is not attributed to it: episodes with no others count as ``violated_without``.
        Rates: activation and manifestation are shares of all runs, propagation of those followed,
        detection of those manifested, recovery of those in which it acted; ``None`` where there
        are none. Latencies are seconds: from the activation to the alert, from the
        manifestation to the first recovery action, and from there until the proposal was acceptable
        again.
        """
        entries = []
        for name, counts in self._counts.items():
            figures: dict[str, Any] = {step: counts[step] for step in _CHAIN_STEPS}
            for latency in _LATENCIES:
                times = self._times.get((name, latency))
                known = (
                    LatencyEntry(median=statistics.median(times), max=max(times)) if times else None
                )
                figures[latency] = known
            rates = {
                rate: share(counts[part], counts[whole]) for rate, (part, whole) in RATES.items()
            }
            entries.append(
                FaultMetricsEntry(
                    id=name,
                    target=self._targets[name],
                    read_by=sorted(self._readers[name]),
                    rates=FaultRates(**rates),
                    **figures,
                )
            )
        return entries


def _passed_steps(fault: TracedFault) -> list[str]:
    """List the steps that a fault passed in one episode."""
    reached = fault.manifested_at is not None
    passed = {
        "run": True,
        "activated": fault.activated_at is not None,
        "manifested": reached,
        "followed": reached and fault.propagation in ("propagated", "contained"),
        "propagated": reached and fault.propagation == "propagated",
        "detected": reached and fault.detected_at is not None,
        "recovery": reached and fault.recovery_at is not None,
        "recovered": reached and fault.recovered_at is not None,
        "judged": fault.outcome not in (None, "missing"),
        "violated": fault.outcome == "violated",
        "violated_without": fault.outcome == "violated also without it",
    }
    return [step for step in _CHAIN_STEPS if passed[step]]
