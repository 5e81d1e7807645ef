"""What the accounts of a case's episodes come to: failure modes, times and ages of decisions."""

from __future__ import annotations

import math
from array import array
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

from pytest_dura.requirements.statistics import upper_bound

CONFIDENCE = 0.95
"""Of the bound on the rate of episodes in which a failure mode shows."""
COUNTS = ("hits", "of", "null_hits", "null_of")

Data = Mapping[str, Any]


class FailureModes:
    """Sums over the valid episodes of a case with one component.

    Of an episode it keeps a few numbers for each failure mode, and two for each decision.
    """

    def __init__(self) -> None:
        self._kinds: dict[str, str] = {}
        self._counts: dict[str, Counter[str]] = {}
        self._seconds = array("d")
        self._ages = array("d")

    def add(self, metrics: Data) -> None:
        """Take in the metrics of an episode's record."""
        for name, tally in metrics["tallies"].items():
            self._kinds.setdefault(name, tally["kind"])
            counts = self._counts.setdefault(name, Counter())
            counts.update({key: tally[key] for key in COUNTS})
            counts["episodes"] += tally["hits"] > 0
            counts["of_episodes"] += tally["of"] > 0
        self._seconds.extend(metrics["answer_seconds"])
        self._ages.extend(metrics["answer_ages"])

    def to_json(self) -> list[dict[str, Any]]:
        """Plain data, one entry for each failure mode, in the order in which they came up.

        The decisions of an episode depend on each other, so that no bound is given on their
        share. Episodes of a case are drawn independently: ``upper`` is the exact bound on the rate
        of those in which the failure ever shows, of those in which it could.
        """
        return [self._of(name, counts) for name, counts in self._counts.items()]

    def _of(self, name: str, counts: Counter[str]) -> dict[str, Any]:
        episodes, of = counts["episodes"], counts["of_episodes"]
        return {
            "name": name,
            "kind": self._kinds[name],
            "hits": counts["hits"],
            "of": counts["of"],
            "share": share(counts["hits"], counts["of"]),
            "null_hits": counts["null_hits"],
            "null_of": counts["null_of"],
            "null_share": share(counts["null_hits"], counts["null_of"]),
            "episodes": episodes,
            "of_episodes": of,
            "upper": upper_bound(episodes, of, CONFIDENCE) if of else None,
        }

    def answer_times(self) -> dict[str, Any] | None:
        """How long decisions took by the component's own account, in s of wall-clock time."""
        return _spread(self._seconds)

    def answer_ages(self) -> dict[str, Any] | None:
        """How old decisions were when they came into force, in simulated s since their percept."""
        return _spread(self._ages)


def share(part: int, whole: int) -> float | None:
    """``None`` of nothing."""
    return part / whole if whole else None


def _spread(values: Iterable[float]) -> dict[str, Any] | None:
    """``None`` of nothing."""
    ordered = sorted(values)
    if not ordered:
        return None
    return {
        "decisions": len(ordered),
        "p50": _percentile(ordered, 0.50),
        "p95": _percentile(ordered, 0.95),
        "max": ordered[-1],
    }


def _percentile(ordered: list[float], rank: float) -> float:
    """By the nearest rank: the value of a decision that there was."""
    return ordered[max(math.ceil(rank * len(ordered)) - 1, 0)]
