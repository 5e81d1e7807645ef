"""EpisodeLog: collects during an episode what the Episode and its metrics are made of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from pytest_dura.core.episode import Episode, EpisodeSpec
from pytest_dura.core.errors import InfrastructureError
from pytest_dura.core.metrics import DependabilityMetrics, FaultRecord
from pytest_dura.core.roles import (
    Assessed,
    Assessment,
    Injection,
    PerformanceAssessment,
    Recovery,
    SecurityAssessment,
)
from pytest_dura.core.simulator import Simulator
from pytest_dura.core.state import NOTHING, Event, StateManager, Tick

DETECTION_GRACE = 1.0
"""An alert this many seconds after a fault's end still detects it."""


@dataclass(frozen=True, slots=True)
class Decision:
    """What is carried out at a tick, where it came from and why."""

    action: Any
    source: str
    verdict: Assessed
    reasons: tuple[str, ...]
    attempts: int


class EpisodeLog:
    """Written by the orchestrator at each step of a tick; ``close`` makes the Episode."""

    def __init__(self, spec: EpisodeSpec) -> None:
        self.spec = spec
        self.metrics = DependabilityMetrics()
        self.events: list[Event] = []
        self.timeouts: list[int] = []
        self.metrics.faults = {
            fault["id"]: FaultRecord(fault["id"], fault["target"], fault.get("at"))
            for fault in spec.faults
        }
        self._columns: dict[str, list[Any]] = {
            name: [] for name in ("verdict", "source", "proposed", "executed", "attempts")
        }
        self._open: dict[str, str] = {}

    def event(
        self, tick: Tick, kind: str, subject: str, detail: str = "", *, wall_clock: bool = False
    ) -> None:
        """An event at this tick. One that lasts is recorded where it begins or changes."""
        self.events.append(
            Event(tick.index, tick.time, kind, subject, detail, NOTHING, wall_clock)
        )
        if kind == "component_failure":
            self.metrics.violations["component"] += 1

    def early_event(self, kind: str, subject: str, detail: str) -> None:
        """An event before the first tick."""
        self.events.append(Event(0, 0.0, kind, subject, detail))

    def proposed(self, valid: bool) -> None:
        """The Generator was asked."""
        self.metrics.proposals += 1
        self.metrics.valid_proposals += valid

    def assessed(self, tick: Tick, name: str, output: Assessment) -> None:
        """A monitor has judged the proposal."""
        self.metrics.log_score(name, tick.time, float(output.score))
        unsafe = output.critical or output.verdict is Assessed.UNSAFE
        if unsafe:
            self.metrics.violations[name] += 1
        self._edge(tick, "unsafe", name, "; ".join(output.reasons) if unsafe else None)

    def alerted(self, tick: Tick, name: str, output: SecurityAssessment) -> None:
        """The SecurityAssessor has looked at percept and component."""
        for alert in output.alerts:
            self.metrics.alerts += 1
            self.event(tick, "alert", alert.subject, f"{alert.pattern}: {alert.detail}")
            for fault in self.metrics.faults.values():
                self._detect(fault, tick.time, alert.pattern)
        if output.reaction is not None:
            self._edge(tick, "reaction", name, output.reaction)

    @staticmethod
    def _detect(fault: FaultRecord, time: float, pattern: str) -> None:
        if fault.manifested_at is None and fault.activated_at is None:
            return
        if fault.detected_at is not None:
            return
        if fault.deactivated_at is None or time <= fault.deactivated_at + DETECTION_GRACE:
            fault.detected_at, fault.detected_by = time, pattern

    def performed(self, tick: Tick, output: PerformanceAssessment) -> None:
        """The PerformanceOracle has measured."""
        self.metrics.log_performance(tick.time, output.values, output.wall_clock)
        for name in output.performance_fail:
            wall_clock = name in output.wall_clock
            kind = "wall_clock" if wall_clock else "performance"
            if not self.metrics.violations[f"{kind}:{name}"]:
                self.event(tick, "performance_fail", name, wall_clock=wall_clock)
            self.metrics.violations[f"{kind}:{name}"] += 1

    def injected(self, tick: Tick, output: Injection) -> None:
        """Faults were activated or deactivated."""
        for fault in output.activated:
            record = self.metrics.faults.setdefault(fault, FaultRecord(fault, "unplanned"))
            if record.activated_at is None:
                record.activated_at = tick.time
            record.deactivated_at = None
            self.event(tick, "fault_activated", fault)
        for fault in output.deactivated:
            self.metrics.faults[fault].deactivated_at = tick.time
            self.event(tick, "fault_deactivated", fault)

    def manifested(
        self, tick: Tick, state: StateManager, command: tuple[str, ...], verdict: Assessed
    ) -> None:
        """Which active faults reached the Generator or the plant at this tick."""
        tampered = state.percept.tampered
        if not tampered and not command:
            return
        reached = set(command)
        for channel, faults in tampered.items():
            if channel in state.generator_reads:
                reached.update(faults)
        for fault in sorted(reached):
            record = self.metrics.faults[fault]
            record.manifest_ticks += 1
            record.flagged_ticks += verdict is Assessed.UNSAFE
            if record.manifested_at is None:
                record.manifested_at = tick.time
                self.event(tick, "fault_manifested", fault)

    def recovered(self, tick: Tick, recovery: Recovery, nanoseconds: int) -> None:
        """The RecoveryPlanner has replaced the proposal."""
        self.metrics.log_time("recovery_planner", tick.index, nanoseconds)
        before = len(self.metrics.recoveries)
        self.metrics.log_recovery(tick.index)
        if len(self.metrics.recoveries) > before:
            self.event(tick, "recovery", recovery.name, recovery.explanation)

    def decided(
        self, tick: Tick, decision: Decision, state: StateManager, describe: Callable[[Any], str]
    ) -> None:
        """The tick's decision."""
        columns, proposal = self._columns, state.proposal
        columns["verdict"].append(int(decision.verdict))
        columns["source"].append(decision.source)
        columns["proposed"].append(describe(proposal.action) if proposal is not None else "")
        columns["executed"].append(describe(decision.action))
        columns["attempts"].append(decision.attempts)

    def _edge(self, tick: Tick, kind: str, subject: str, detail: str | None) -> None:
        """An event where a lasting condition begins, and one where it ends."""
        held = f"{kind}:{subject}" in self._open
        if detail is not None and not held:
            self._open[f"{kind}:{subject}"] = detail
            self.event(tick, kind, subject, detail)
        elif detail is None and held:
            del self._open[f"{kind}:{subject}"]
            self.event(tick, f"{kind}_ended", subject)

    def close(
        self,
        simulator: Simulator,
        state: StateManager,
        ending: str,
        failure: InfrastructureError | None,
    ) -> Episode:
        """The finished episode. Signals that are not finite make it an infrastructure error."""
        time = np.array([tick.time for tick in state.ticks])
        signals: dict[str, Any] = {}
        if state.ticks:
            try:
                signals = dict(simulator.signals(state.ticks))
                percept = simulator.percept_signals(state.percepts)
                signals |= {f"percept.{name}": column for name, column in percept.items()}
                failure = failure or _first_bad_signal(signals, time)
            except Exception as error:
                last = state.ticks[-1]
                failure = failure or InfrastructureError(
                    "simulator", last.index, last.time, f"{type(error).__name__}: {error}"
                )
        if failure is not None:
            ending = "infrastructure"
            self.events.append(Event(failure.tick, failure.time, "infrastructure", failure.role, failure.cause))
        critical = ending == "critical"
        self.metrics.settle_recoveries(len(self._columns["verdict"]) - 1, critical)
        return Episode(
            spec=self.spec,
            time=time,
            signals=signals,
            decisions={
                "verdict": np.array(self._columns["verdict"], dtype=np.int8),
                "source": np.array(self._columns["source"], dtype=np.str_),
                "proposed": np.array(self._columns["proposed"], dtype=np.str_),
                "executed": np.array(self._columns["executed"], dtype=np.str_),
                "attempts": np.array(self._columns["attempts"], dtype=np.int16),
            },
            events=tuple(self.events),
            faults=tuple(self.metrics.faults.values()),
            termination=ending,
            metrics=self.metrics,
            failure=str(failure) if failure else None,
            timeouts=tuple(self.timeouts),
        )


def _first_bad_signal(signals: dict[str, Any], time: Any) -> InfrastructureError | None:
    for name, column in sorted(signals.items()):
        bad = np.flatnonzero(~np.isfinite(column))
        if len(bad) and not name.startswith("percept."):
            tick = int(bad[0])
            cause = f"signal {name!r} is {column[tick]}, not a finite number"
            return InfrastructureError("simulator", tick, float(time[tick]), cause)
    return None
