"""Failure modes: how often each shows in valid episodes of a case, and how long answers take."""

from __future__ import annotations

import math
from array import array
from collections import Counter
from collections.abc import Iterable
from typing import Any

from pytest_dura.core.metrics import EpisodeMetrics
from pytest_dura.evidence.case_model import FailureModeEntry, Percentiles
from pytest_dura.requirements.rate_tests import upper_bound

CONFIDENCE = 0.95
"""Confidence of the bound on the rate of episodes in which a failure mode shows."""
_FAILURE_MODE_COUNTS = ("hits", "of", "null_hits", "null_of")


class FailureModes:
    """Sums up the failure modes in the valid episodes of a case with one component.

    It stores a few numbers for each failure mode, and two for each decision.
    """

    def __init__(self) -> None:
        self._kinds: dict[str, Any] = {}
        self._counts: dict[str, Counter[str]] = {}
        self._seconds = array("d")
        self._ages = array("d")

    def add(self, metrics: EpisodeMetrics) -> None:
        """Add the metrics of an episode's entry."""
        for name, tally in metrics.tallies.items():
            self._kinds.setdefault(name, tally.kind)
            counts = self._counts.setdefault(name, Counter())
            counts.update({key: getattr(tally, key) for key in _FAILURE_MODE_COUNTS})
            counts["episodes"] += tally.hits > 0
            counts["of_episodes"] += tally.of > 0
        self._seconds.extend(metrics.answer_seconds)
        self._ages.extend(metrics.answer_ages)

    def join(self, other: FailureModes) -> None:
        """Add the sums of another case."""
        self._kinds = {**other._kinds, **self._kinds}
        for name, counts in other._counts.items():
            self._counts.setdefault(name, Counter()).update(counts)
        self._seconds.extend(other._seconds)
        self._ages.extend(other._ages)

    def entries(self) -> list[FailureModeEntry]:
        """Return an entry for each failure mode, in the order of appearance.

        The decisions of an episode depend on each other, so that no bound is given on their
        share. Episodes of a case are drawn independently: ``upper`` is the exact bound on the rate
        of those in which the failure ever shows, of those in which it could.
        """
        return [
            FailureModeEntry(
                name=name,
                kind=self._kinds[name],
                hits=counts["hits"],
                of=counts["of"],
                share=share(counts["hits"], counts["of"]),
                null_hits=counts["null_hits"],
                null_of=counts["null_of"],
                null_share=share(counts["null_hits"], counts["null_of"]),
                episodes=counts["episodes"],
                of_episodes=counts["of_episodes"],
                upper=upper_bound(counts["episodes"], counts["of_episodes"], CONFIDENCE)
                if counts["of_episodes"]
                else None,
            )
            for name, counts in self._counts.items()
        ]

    def answer_times(self) -> Percentiles | None:
        """Summarise how long decisions took by the component's account, in s of wall-clock time."""
        return percentile_summary(self._seconds)

    def answer_ages(self) -> Percentiles | None:
        """Summarise the ages of decisions when they took effect, in simulated s."""
        return percentile_summary(self._ages)


def share(part: int, whole: int) -> float | None:
    """Quotient of two counts; ``None`` if the whole is 0."""
    return part / whole if whole else None


def percentile_summary(values: Iterable[float]) -> Percentiles | None:
    """Summarise times of decisions; ``None`` without any."""
    ordered = sorted(values)
    if not ordered:
        return None
    return Percentiles(
        decisions=len(ordered),
        p50=_percentile(ordered, 0.50),
        p95=_percentile(ordered, 0.95),
        max=ordered[-1],
    )


def _percentile(ordered: list[float], rank: float) -> float:
    """Percentile by the nearest rank, which is the value of an actual decision."""
    return ordered[max(math.ceil(rank * len(ordered)) - 1, 0)]
