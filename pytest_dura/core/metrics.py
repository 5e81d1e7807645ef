"""DependabilityMetrics: measurements that the loop makes of one episode."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.display import short_repr
from pytest_dura.core.fault import Fault

REACTIONS = ("unaffected", "erratic", "frozen", "follows the fake")
"""Classes of a component's reaction to a suspected attack; an assessor may have others."""
DISCOMFORT = "discomfort"
"""Performance value above 1 where passengers are uncomfortable: the greatest of the accelerations
and jerks that they feel, each as a share of its limit. An oracle need not measure it."""
COMMAND = "command"
"""Channel of the command on its way to the actuators."""


@dataclass(frozen=True)
class FaultRecord:
    """One fault from plan to recovery; times in s, ``None`` for what did not happen.

    A fault manifests when a role reads a value that it changed, or when it changes the command.
    Detections count from the fault's activation on, if the fault manifests then or later; recovery
    from the first manifestation on. Both count until one second after the fault's end. A fault of
    the command is answered after the tick at which it began, since it acts at its end.

    Args:
        id: Its name in the episode.
        target: Channel, field of a channel, or command.
        planned_at: Time of its activation where the plan has one.
        activated_at: First tick at which it acted.
        manifested_at: First tick at which it manifested.
        deactivated_at: First tick at which the latest activation no longer acted.
        detected_at: First alert while it was active.
        detected_by: Name of the role that raised it.
        pattern: Pattern of that alert.
        recovery_at: First recovery action.
        recovery: Name of that action.
        recovered_at: First tick after it at which the proposal was acceptable again.
        activations: How often it was activated.
        manifest_ticks: Ticks at which it manifested.
        flagged_ticks: Those of them at which the proposal was unsafe.
        by_chance: Whether its effect is drawn by chance; then it need not manifest.
        read_by: Names of the roles that read what it changed, sorted; none for a fault of the
            command, which reaches the plant. The digest leaves it out.
    """

    id: str
    target: str
    planned_at: float | None = None
    activated_at: float | None = None
    manifested_at: float | None = None
    deactivated_at: float | None = None
    detected_at: float | None = None
    detected_by: str | None = None
    pattern: str | None = None
    recovery_at: float | None = None
    recovery: str | None = None
    recovered_at: float | None = None
    activations: int = 0
    manifest_ticks: int = 0
    flagged_ticks: int = 0
    by_chance: bool = False
    read_by: tuple[str, ...] = ()

    __repr__ = short_repr

    @classmethod
    def of(cls, fault: Fault) -> FaultRecord:
        """Make the record of a planned fault, of which nothing has happened."""
        return cls(fault.id, fault.target, fault.planned_at, by_chance=fault.by_chance)

    @property
    def success(self) -> bool:
        """Whether the fault reached a role or the plant."""
        return self.manifested_at is not None

    @property
    def manifestation_latency(self) -> float | None:
        """Seconds from activation to manifestation."""
        return _between(self.activated_at, self.manifested_at)

    @property
    def on_command(self) -> bool:
        """Whether it acts on the command, or a part of it."""
        return self.target.partition(".")[0] == COMMAND

    @property
    def began_at(self) -> float | None:
        """Time of its activation, or of its manifestation if the injector reported none before."""
        times = [time for time in (self.activated_at, self.manifested_at) if time is not None]
        return min(times, default=None)

    @property
    def detection_latency(self) -> float | None:
        """Seconds from activation to the first alert, see :attr:`began_at`."""
        return _between(self.began_at, self.detected_at)

    @property
    def recovery_latency(self) -> float | None:
        """Seconds from manifestation to the first recovery action."""
        return _between(self.manifested_at, self.recovery_at)

    @property
    def time_to_recover(self) -> float | None:
        """Seconds from the first recovery action until the proposal was acceptable again."""
        return _between(self.recovery_at, self.recovered_at)

    def latencies(self) -> dict[str, float | None]:
        """All latencies by name, in s."""
        names = (
            "manifestation_latency", "detection_latency", "recovery_latency", "time_to_recover"
        )  # fmt: skip
        return {name: getattr(self, name) for name in names}


def _between(first: float | None, then: float | None) -> float | None:
    return None if first is None or then is None else then - first


KINDS = ("failure", "infrastructure", "control", "comparison")
"""Kinds of measures of a component's accounts, see :class:`Tally`."""


@dataclass(frozen=True)
class Tally:
    """Count of the decisions that showed a failure mode, among those that could have shown it.

    Args:
        hits: Decisions that showed it.
        of: Decisions that could have shown it.
        null_hits: The same for a null component, which ignores its input, on the same decisions.
        null_of: See above.
        kind: ``failure``, ``infrastructure`` (of what the component needs, not its own),
            ``control`` (a negative control: what a component does that takes no
            notice of its input) or ``comparison`` (no failure by itself).
    """

    hits: int
    of: int
    null_hits: int = 0
    null_of: int = 0
    kind: str = "failure"


@dataclass
class DependabilityMetrics:
    """Violations by type, performance over time, robustness scores, faults, recovery, timings.

    Args:
        violations: Ticks at which each kind was violated: a role's name for an unsafe
            assessment, ``component`` for a failed proposal, ``performance:x`` for a threshold
            (``wall_clock:x`` if it depends on the machine's speed).
        performance: Values over time by name: ``(times, values)``.
        wall_clock: The same, for values that depend on the machine's speed.
        robustness: The score of each monitor by role name: ``(times, scores)``, one for each
            assessment, of which a tick has several under ``refine``.
        flags: Ticks at which each monitor found a proposal unsafe, by role name, each once.
        faults: One record per planned fault.
        recoveries: Stretches of ticks in which recovery acted: ``(first, last, success)``.
            A stretch succeeds if the proposal was acceptable again and nothing critical followed.
        processing_ns: Wall-clock nanoseconds by role: ``(ticks, nanoseconds)``.
        alerts: Alerts raised; the same one at the same tick counts once.
        alert_ticks: Ticks at which each assessor that ran raised alerts, by role name.
        reactions: Number of the component's reactions to suspected attacks, by class.
        proposals: Number of proposals that the Generator was asked for.
        valid_proposals: Number of answers with an action of this simulator.
        tallies: Counts of each failure mode that the component's accounts show.
        answer_seconds: Wall-clock seconds that the component declares for its decisions.
        answer_ages: Simulated seconds from the percept behind each of its own decisions to the tick
            at which it came into force, as the component declares them.
        answer_usage: What its decisions used, as the component declares it: requests to language
            models and tokens; see :data:`pytest_dura.core.loop_signals.USAGE_COUNTS`.
        user: User-defined metrics, filled when the episode is complete.
    """

    violations: Counter[str] = field(default_factory=Counter)
    performance: dict[str, tuple[list[float], list[float]]] = field(default_factory=dict)
    wall_clock: dict[str, tuple[list[float], list[float]]] = field(default_factory=dict)
    robustness: dict[str, tuple[list[float], list[float]]] = field(default_factory=dict)
    flags: dict[str, list[int]] = field(default_factory=dict)
    faults: dict[str, FaultRecord] = field(default_factory=dict)
    recoveries: list[tuple[int, int, bool]] = field(default_factory=list)
    processing_ns: dict[str, tuple[list[int], list[int]]] = field(default_factory=dict)
    alerts: int = 0
    alert_ticks: dict[str, list[int]] = field(default_factory=dict)
    reactions: Counter[str] = field(default_factory=Counter)
    proposals: int = 0
    valid_proposals: int = 0
    tallies: dict[str, Tally] = field(default_factory=dict)
    answer_seconds: list[float] = field(default_factory=list)
    answer_ages: list[float] = field(default_factory=list)
    answer_usage: dict[str, int] = field(default_factory=dict)
    user: dict[str, float] = field(default_factory=dict)

    __repr__ = short_repr

    def log_time(self, role: str, tick: int, nanoseconds: int) -> None:
        """Log the processing time of a role at a tick."""
        columns = self.processing_ns.get(role)
        if columns is None:
            columns = self.processing_ns[role] = [], []
        columns[0].append(tick)
        columns[1].append(nanoseconds)

    def log_score(self, role: str, time: float, score: float) -> None:
        """Log the robustness score of a monitor."""
        columns = self.robustness.get(role)
        if columns is None:
            columns = self.robustness[role] = [], []
        columns[0].append(time)
        columns[1].append(score)

    def log_flag(self, role: str, tick: int) -> None:
        """Log that a monitor refused a proposal of this tick, which counts once."""
        _once(self.flags.setdefault(role, []), tick)

    def log_alerts(self, role: str, tick: int, *, raised: bool) -> None:
        """Log that an assessor ran, and whether it raised alerts."""
        if role not in self.alert_ticks:
            self.alert_ticks[role] = []
        if raised:
            _once(self.alert_ticks[role], tick)

    def log_performance(
        self, time: float, values: Mapping[str, float], wall_clock: Mapping[str, float]
    ) -> None:
        """Log performance values; those that depend on the machine's speed stay separate."""
        for table, source in ((self.performance, values), (self.wall_clock, wall_clock)):
            for name, value in source.items():
                columns = table.get(name)
                if columns is None:
                    columns = table[name] = [], []
                columns[0].append(time)
                columns[1].append(float(value))

    def log_recovery(self, tick: int) -> None:
        """Log that recovery acted at this tick."""
        if self.recoveries and self.recoveries[-1][1] == tick - 1:
            self.recoveries[-1] = (self.recoveries[-1][0], tick, False)
        else:
            self.recoveries.append((tick, tick, False))

    def settle_recoveries(self, last_tick: int, critical: bool) -> None:
        """Decide which stretches of recovery succeeded, once the episode is over."""
        for i, (first, last, _) in enumerate(self.recoveries):
            ended = last < last_tick
            is_final = i == len(self.recoveries) - 1
            self.recoveries[i] = (first, last, ended and not (critical and is_final))

    def column(self, name: str) -> NDArray[np.float64]:
        """A performance value over time; empty if it was never logged."""
        table = self.performance if name in self.performance else self.wall_clock
        return np.asarray(table.get(name, ((), ()))[1], dtype=float)

    def deterministic(self) -> dict[str, Any]:
        """Plain data of all that does not depend on the machine's speed."""
        tallies = sorted(self.tallies.items())
        return {
            "violations": {
                kind: count
                for kind, count in sorted(self.violations.items())
                if not kind.startswith("wall_clock:")
            },
            "performance": self.performance,
            "robustness": self.robustness,
            "flags": self.flags,
            "recoveries": self.recoveries,
            "alerts": self.alerts,
            "alert_ticks": self.alert_ticks,
            **({"reactions": dict(sorted(self.reactions.items()))} if self.reactions else {}),
            "proposals": [self.proposals, self.valid_proposals],
            **({"tallies": {name: asdict(tally) for name, tally in tallies}} if tallies else {}),
            **({"answer_ages": self.answer_ages} if self.answer_ages else {}),
        }

    def summary(self) -> dict[str, Any]:
        """Summary in plain data, for records and tables."""
        faults = list(self.faults.values())
        succeeded = [recovery for recovery in self.recoveries if recovery[2]]
        return {
            "violations": dict(sorted(self.violations.items())),
            "performance": {name: _last_and_worst(v) for name, (_, v) in self.performance.items()},
            "wall_clock": {name: _last_and_worst(v) for name, (_, v) in self.wall_clock.items()},
            "robustness_min": {role: min(v) for role, (_, v) in self.robustness.items()},
            "faults": {
                "planned": len(faults),
                "succeeded": sum(fault.success for fault in faults),
                "detected": sum(fault.detected_at is not None for fault in faults),
                "recovered": sum(fault.recovered_at is not None for fault in faults),
                "impact_ticks": sum(fault.flagged_ticks for fault in faults),
            },
            "recoveries": len(self.recoveries),
            "recoveries_succeeded": len(succeeded),
            "alerts": self.alerts,
            "reactions": dict(sorted(self.reactions.items())),
            "proposals": self.proposals,
            "valid_proposals": self.valid_proposals,
            "processing_us": {
                role: float(np.mean(ns)) / 1000.0 for role, (_, ns) in self.processing_ns.items()
            },
            "tallies": {name: asdict(tally) for name, tally in self.tallies.items()},
            "answer_seconds": list(self.answer_seconds),
            "answer_ages": list(self.answer_ages),
            **({"answer_usage": dict(self.answer_usage)} if self.answer_usage else {}),
            "user": dict(self.user),
        }


def _once(ticks: list[int], tick: int) -> None:
    if not ticks or ticks[-1] != tick:
        ticks.append(tick)


def _last_and_worst(values: list[float]) -> dict[str, float]:
    return {"last": values[-1], "min": min(values), "max": max(values)}
