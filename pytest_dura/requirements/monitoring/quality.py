"""MonitorQuality: how well a monitor's alarms foretell violations, or alerts tell of faults."""

from __future__ import annotations

import statistics
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class MonitorQuality:
    """How a monitor did on episodes in which nobody acted on its word; one count per episode.

    For a requirement, an episode is positive if it violated the requirement, at its time t. It is
    a true positive if an alarm stood at some time in ``[t - horizon, t)``: one that begins at t
    comes too late, and one that was withdrawn before t - horizon is not about it. The lead time is
    t less the beginning of the first such alarm, ``horizon`` at most. For faults, an episode is
    positive if a fault manifested, and a true positive if one was detected (``FaultRecord``): from
    its activation on, since a monitor may read a fake before the component does. The delay is from
    the first activation of one that manifested to the first detection.

    Args:
        monitor: Role name of the monitor, or ``alerts``.
        target: Id of the requirement, or ``faults``.
        component: Name of the component under test.
        horizon: Seconds, as above; ``None`` for faults.
        true_positives: Positive episodes that it warned of or detected.
        false_negatives: The other positive episodes.
        false_positives: Other episodes in which it raised an alarm at any time.
        true_negatives: Other episodes in which it raised none.
        late: False negatives with an alarm from t on; for faults, with an alert that came after
            the window in which it would have detected the fault.
        early: The other false negatives with an alarm: all of them withdrawn before t - horizon;
            for faults, before the first activation.
        untimed: Violated episodes whose check tells no time; in none of the counts above.
        invalid: Invalid episodes; in none of the counts above.
        missing: Missing episodes; in none of the counts above.
        lead_times: Seconds of each true positive of a requirement.
        delays: Seconds of each true positive for faults.
        false_alarms: Alarms in episodes that are not positive; one episode may have several.
        hours: Simulated hours of the episodes that are not positive.
    """

    monitor: str
    target: str
    component: str
    horizon: float | None
    true_positives: int
    false_negatives: int
    false_positives: int
    true_negatives: int
    late: int = 0
    early: int = 0
    untimed: int = 0
    invalid: int = 0
    missing: int = 0
    lead_times: tuple[float, ...] = ()
    delays: tuple[float, ...] = ()
    false_alarms: int = 0
    hours: float = 0.0

    @property
    def episodes(self) -> int:
        """Episodes that were counted."""
        positives = self.true_positives + self.false_negatives
        return positives + self.false_positives + self.true_negatives

    @property
    def precision(self) -> float | None:
        """Share of its alarmed episodes, true or false positive, that are true."""
        return _share(self.true_positives, self.true_positives + self.false_positives)

    @property
    def recall(self) -> float | None:
        """Share of the positive episodes that it warned of or detected."""
        return _share(self.true_positives, self.true_positives + self.false_negatives)

    @property
    def false_positive_rate(self) -> float | None:
        """Share of the other episodes in which it raised an alarm."""
        return _share(self.false_positives, self.false_positives + self.true_negatives)

    @property
    def false_alarms_per_hour(self) -> float | None:
        """False alarms per simulated hour of the episodes that are not positive."""
        return self.false_alarms / self.hours if self.hours > 0 else None

    def to_json(self) -> dict[str, Any]:
        """Plain data for the evidence record, with what follows from it."""
        return {
            **asdict(self),
            "lead_times": list(self.lead_times),
            "delays": list(self.delays),
            "episodes": self.episodes,
            "precision": self.precision,
            "recall": self.recall,
            "false_positive_rate": self.false_positive_rate,
            "false_alarms_per_hour": self.false_alarms_per_hour,
            "lead_time": _spread(self.lead_times),
            "delay": _spread(self.delays),
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> MonitorQuality:
        """The inverse of :meth:`to_json`."""
        own = {name: data[name] for name in cls.__dataclass_fields__}
        times = {name: tuple(data[name]) for name in ("lead_times", "delays")}
        return cls(**{**own, **times})


def _share(some: int, of: int) -> float | None:
    return some / of if of else None


def _spread(times: tuple[float, ...]) -> dict[str, float] | None:
    if not times:
        return None
    return {"min": min(times), "median": statistics.median(times), "max": max(times)}
