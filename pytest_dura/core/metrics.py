"""DependabilityMetrics: measurements that the loop makes of one episode."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.codec import LEFT_OUT, Amount, Count, Number, Positive
from pytest_dura.core.display import short_repr
from pytest_dura.core.fault import Fault

REACTIONS = ("unaffected", "erratic", "frozen", "follows the fake")
"""Classes of a component's reaction to a suspected attack; an assessor may have others."""
COMMAND = "command"
"""Channel of the command on its way to the actuators."""


@dataclass(frozen=True)
class FaultRecord:
    """One fault from plan to recovery; times in s, ``None`` for what did not happen.

    A fault manifests when a role reads a value that it changed, or when it changes the command.
    Detections count from the fault's activation on, if the fault manifests then or later; recovery
    from the first manifestation on. Both count until one second after the fault's end. A fault of
    the command is answered after the tick at which it began, since it acts at its end.
    """

    id: str
    """Its name in the case."""
    target: str
    """Sensor channel, field of a channel, or `command`."""
    planned_at: Number | None = None
    """Planned activation, in s, where the plan has a time."""
    activated_at: Number | None = None
    """First tick at which it acted, in s."""
    manifested_at: Number | None = None
    """First tick at which it changed what a role read, or the command, in s."""
    deactivated_at: Number | None = None
    """First tick at which the latest activation no longer acted, in s."""
    detected_at: Number | None = None
    """First alert while it was active, in s: also one from before it manifested, if it did."""
    detected_by: str | None = None
    """Role that raised it."""
    pattern: str | None = None
    """Pattern of that alert."""
    recovery_at: Number | None = None
    """First recovery action, in s."""
    recovery: str | None = None
    """Name of that action."""
    recovered_at: Number | None = None
    """First tick after it at which the proposal was acceptable again, in s."""
    activations: Count = 0
    """How often it was activated."""
    manifest_ticks: Count = 0
    """Ticks at which it manifested."""
    flagged_ticks: Count = 0
    """Those at which the proposal was unsafe."""
    by_chance: bool = False
    """Whether it is drawn whether it has any effect; then it need not manifest."""
    read_by: tuple[str, ...] = ()
    """Roles that read what it changed, sorted; none for a fault of the command, which reaches the
    plant. The digest leaves it out."""

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
        """Compute all latencies by name, in s."""
        return {
            "manifestation_latency": _between(self.activated_at, self.manifested_at),
            "detection_latency": _between(self.began_at, self.detected_at),
            "recovery_latency": _between(self.manifested_at, self.recovery_at),
            "time_to_recover": _between(self.recovery_at, self.recovered_at),
        }

    def traced(self, **known: Any) -> TracedFault:
        """Add its latencies, and what is known of how it spread.

        Args:
            known: Further fields of :class:`TracedFault`; default: nothing is known.
        """
        own: dict[str, Any] = vars(self) | self.latencies()
        return TracedFault(**own, **known)


PropagationStatus = Literal["propagated", "contained", "unknown"]
OutcomeStatus = Literal[
    "idle", "masked", "contained", "tolerated", "violated", "violated also without it", "missing"
]


@dataclass(frozen=True, kw_only=True)
class TracedFault(FaultRecord):
    """A fault in an episode, from plan to outcome.

    Times in simulated seconds, null for what never happened.
    """

    manifestation_latency: Number | None = None
    """From activation to manifestation, in s."""
    detection_latency: Number | None = None
    """From activation to the first alert, in s."""
    recovery_latency: Number | None = None
    """From manifestation to the first recovery action, in s."""
    time_to_recover: Number | None = None
    """From there until the proposal was acceptable again, in s."""
    propagation: PropagationStatus | None = None
    """Whether the proposals left those of the fault-free twin; null where it never manifested or
    that was not measured."""
    propagated_at: Number | None = None
    """When they did, in s."""
    unknown: str = ""
    """Why that is unknown; empty where it is known."""
    outcome: OutcomeStatus | None = None
    """What came of it; null where no verdict asked. What is violated also without it is not its
    doing."""
    violated: tuple[str, ...] = ()
    """Requirements that were violated from its manifestation on."""
    violated_without: tuple[str, ...] | None = None
    """Those among them that the fault-free twin violates, too; null without a twin."""

    __repr__ = short_repr


def _between(first: float | None, then: float | None) -> float | None:
    return None if first is None or then is None else then - first


MeasureKind = Literal["failure", "infrastructure", "control", "comparison"]
"""Kind of a measure of a component's accounts, see :class:`Tally`."""
KINDS: tuple[MeasureKind, ...] = get_args(MeasureKind)


@dataclass(frozen=True)
class Tally:
    """How often a failure mode showed in an episode's decisions."""

    hits: Count
    """Decisions that showed it."""
    of: Count
    """Decisions that could have shown it."""
    null_hits: Count = 0
    """The same of a null component, which ignores its input, on the same decisions."""
    null_of: Count = 0
    """Decisions of it that could have."""
    kind: MeasureKind = "failure"
    """Whether it is a failure, one of the server or the way there, the negative control (what a
    component does that takes no notice of its input), or a comparison that is no failure by
    itself."""


@dataclass(frozen=True, slots=True)
class Series:
    """A value over an episode, in its own unit."""

    last: Number | None
    """At the end."""
    min: Number | None
    """Least."""
    max: Number | None
    """Greatest."""

    @classmethod
    def summed_up(cls, values: list[float]) -> Series:
        """Sum up a column; a value that is not finite is none."""
        return cls(*map(_finite, (values[-1], min(values), max(values))))


@dataclass(frozen=True, slots=True)
class FaultCounts:
    """Counts of faults."""

    planned: Count
    """Planned."""
    succeeded: Count
    """Manifested."""
    detected: Count
    """Detected."""
    recovered: Count
    """Recovered from."""
    impact_ticks: Count
    """Ticks at which one manifested and the proposal was unsafe."""

    @classmethod
    def summed_up(cls, faults: Collection[FaultRecord]) -> FaultCounts:
        """Count faults of an episode."""
        return cls(
            planned=len(faults),
            succeeded=sum(fault.manifested_at is not None for fault in faults),
            detected=sum(fault.detected_at is not None for fault in faults),
            recovered=sum(fault.recovered_at is not None for fault in faults),
            impact_ticks=sum(fault.flagged_ticks for fault in faults),
        )


@dataclass(frozen=True, slots=True)
class EpisodeMetrics:
    """What the loop measured."""

    violations: Mapping[str, Count]
    """Ticks at which each kind was violated, by role or threshold."""
    performance: Mapping[str, Series]
    """Values over time, by name."""
    wall_clock: Mapping[str, Series]
    """Values that depend on the machine's speed, by name."""
    robustness_min: Mapping[str, Number | None]
    """Least score of each monitor, by role."""
    faults: FaultCounts
    """Counts of faults."""
    recoveries: Count
    """Stretches in which recovery acted."""
    recoveries_succeeded: Count
    """Those after which the proposal was acceptable again."""
    alerts: Count
    """Alerts."""
    reactions: Mapping[str, Positive]
    """How often the component reacted in which way to what looked like an attack, by class:
    `unaffected`, `erratic`, `frozen`, `follows the fake`, or the assessor's own. A suspicion that
    is not over at the end has none."""
    proposals: Count
    """How often the component was asked."""
    valid_proposals: Count
    """How often it answered with an action of the simulator."""
    processing_us: Mapping[str, Number | None]
    """Mean wall-clock time of a call, by role, in microseconds."""
    tallies: Mapping[str, Tally]
    """What the component's accounts of its decisions show, by failure mode; empty where it gives
    none."""
    answer_seconds: tuple[Amount, ...]
    """Wall-clock seconds that its decisions took, by its own account."""
    answer_ages: tuple[Amount, ...]
    """Simulated seconds from the percept behind each decision of its own to the tick at which it
    came into force, by its own account."""
    user: Mapping[str, Number | None]
    """Metrics of the user's own, by name."""
    answer_usage: Mapping[str, Count] | None = field(default=None, metadata=LEFT_OUT)
    """What its decisions used, by its own account, such as requests, by names of its own; absent
    where it tells of nothing."""

    def contradictions(self, decisions: int, lasted: float) -> Iterator[str]:
        """Yield what its counts cannot say together.

        Args:
            decisions: Decisions of the episode.
            lasted: Its simulated time, in s.
        """
        if self.valid_proposals > self.proposals:
            yield "more valid proposals than there were"
        for name, tally in self.tallies.items():
            for part, hits, of in (
                ("hits", tally.hits, tally.of),
                ("null_hits", tally.null_hits, tally.null_of),
            ):
                if not hits <= of <= decisions:
                    yield f"{hits} of {of} for {name} ({part}), in {decisions} decisions"
        for noun, answers in (("times", self.answer_seconds), ("ages", self.answer_ages)):
            if len(answers) > decisions:
                yield f"the {noun} of {len(answers)} answers, in {decisions} decisions"
        oldest = max(self.answer_ages, default=0.0)
        if oldest > round(lasted, 9):  # as ages are
            yield f"a decision came into force {oldest} s after its percept, within {lasted} s"


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
        answer_usage: What its decisions used, as the component declares it, by name.
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

    def summary(self) -> EpisodeMetrics:
        """Sum them up for records and tables."""
        return EpisodeMetrics(
            violations=dict(sorted(self.violations.items())),
            performance={
                name: Series.summed_up(values) for name, (_, values) in self.performance.items()
            },
            wall_clock={
                name: Series.summed_up(values) for name, (_, values) in self.wall_clock.items()
            },
            robustness_min={
                role: _finite(min(scores)) for role, (_, scores) in self.robustness.items()
            },
            faults=FaultCounts.summed_up(self.faults.values()),
            recoveries=len(self.recoveries),
            recoveries_succeeded=sum(success for _, _, success in self.recoveries),
            alerts=self.alerts,
            reactions=dict(sorted(self.reactions.items())),
            proposals=self.proposals,
            valid_proposals=self.valid_proposals,
            processing_us={
                role: sum(ns) / len(ns) / 1000.0 for role, (_, ns) in self.processing_ns.items()
            },
            tallies=dict(self.tallies),
            answer_seconds=tuple(self.answer_seconds),
            answer_ages=tuple(self.answer_ages),
            user={name: _finite(value) for name, value in self.user.items()},
            answer_usage=dict(self.answer_usage) or None,
        )


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _once(ticks: list[int], tick: int) -> None:
    if not ticks or ticks[-1] != tick:
        ticks.append(tick)
