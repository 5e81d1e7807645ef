"""EpisodeLog: collects the columns, events and metrics of an episode while it runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.boundary import let_pass
from pytest_dura.core.episode import Episode, EpisodeSpec
from pytest_dura.core.errors import InfrastructureError, cut, describe_error, traceback_text
from pytest_dura.core.loop_signals import PROPOSAL_PREFIX, account_columns, copied_account
from pytest_dura.core.metrics import DependabilityMetrics, FaultRecord
from pytest_dura.core.outputs import check_texts, exact_texts, shortened_with_hash
from pytest_dura.core.percepts import NOTHING
from pytest_dura.core.roles import (
    Assessed,
    Assessment,
    Injection,
    PerformanceAssessment,
    Recovery,
    SecurityAssessment,
)
from pytest_dura.core.simulator import Recording, Scene, Simulator, scene_problems
from pytest_dura.core.state import Alert, Event, Proposal, StateManager, Tick
from pytest_dura.core.time_limits import CallBlocked

_MOST_TRACEBACKS = 4
"""Failures of the component in an episode whose tracebacks are kept."""
_DETECTION_GRACE = 1.0
"""Seconds after a fault's end in which an alert or a recovery still answers it."""


class Decision(NamedTuple):
    """Action that is carried out at a tick, with its source and the reasons."""

    action: Any
    source: str
    verdict: Assessed
    reasons: tuple[str, ...]
    attempts: int


_ROW_LENGTH, _ACCOUNT = 9, 8
_Row = tuple[Assessed, str, str, str, int, str, str, str, Mapping[str, Any]]
"""Of a tick: verdict, source, proposed, executed, attempts, explanation, reasons, recovery, and the
component's account."""


class EpisodeLog:
    """Log that the orchestrator writes at each step of a tick; ``close`` makes the Episode."""

    def __init__(self, spec: EpisodeSpec) -> None:
        self.spec, self.component = spec, spec.component
        self.metrics = DependabilityMetrics()
        self.events: list[Event] = []
        self.timeouts: list[int] = []
        self.metrics.faults = {fault.id: FaultRecord.of(fault) for fault in spec.faults}
        self._rows: list[_Row] = []
        self._flags: dict[str, dict[int, int]] = {}
        self._open: dict[tuple[str, str], str] = {}
        self._violated_at: dict[str, int] = {}
        self._alerts: dict[Alert, str] = {}
        self._detections: dict[str, tuple[float, str, str]] = {}
        self._account: Mapping[str, Any] = NOTHING
        self._recovery: str | None = None
        self._recovery_text = ""
        self._reached: set[str] = set()
        self._tracebacks = 0
        self._reacted: dict[tuple[str, str], int] = {}

    def event(
        self, tick: Tick, kind: str, subject: str, detail: str = "", *, wall_clock: bool = False
    ) -> None:
        """Log an event of this tick."""
        self.events.append(Event(tick.index, tick.time, kind, subject, detail, NOTHING, wall_clock))

    def reset_failed(self, problem: str, error: BaseException | None) -> None:
        """Log that the Generator could not begin; ``error`` is what it raised, if it did."""
        self.events.append(Event(0, 0.0, "component_failure", self.component, problem))
        self._add_traceback(error)

    def proposed(
        self,
        tick: Tick,
        proposal: Proposal | None,
        problem: str | None,
        error: BaseException | None = None,
    ) -> None:
        """Log the Generator's answer.

        Args:
            tick: The present one.
            proposal: The answer, if it is one.
            problem: What is wrong with it, if anything.
            error: What the Generator raised, if it did.
        """
        self._account = NOTHING if proposal is None else copied_account(proposal.account)
        self.metrics.proposals += 1
        if problem is None:
            self.metrics.valid_proposals += 1
            if not self._open:  # nothing lasts that could end
                return
        else:
            self._violation(tick, "component")
        before = len(self.events)
        self._lasting(tick, "component_failure", self.component, problem, every_change=True)
        if problem is not None and len(self.events) > before:
            self._add_traceback(error)

    def _add_traceback(self, error: BaseException | None) -> None:
        """Put the traceback of what the component raised into the last event."""
        if error is not None and self._tracebacks < _MOST_TRACEBACKS:
            self._tracebacks += 1
            self.events[-1] = replace(self.events[-1], traceback=traceback_text(error))

    def assessed(self, tick: Tick, name: str, output: Assessment) -> None:
        """Log a monitor's assessment of the proposal."""
        self.metrics.log_score(name, tick.time, float(output.score))
        unsafe = output.critical or output.verdict is Assessed.UNSAFE
        if name not in self._flags:
            self._flags[name] = {}
        self._flags[name][tick.index] = int(Assessed.UNSAFE if unsafe else output.verdict)
        if unsafe:
            self._violation(tick, name)
            self.metrics.log_flag(name, tick.index)
        self._lasting(tick, "unsafe", name, "; ".join(output.reasons) if unsafe else None)

    def alerted(self, tick: Tick, name: str, output: SecurityAssessment) -> None:
        """Log the alerts and the reaction of a SecurityAssessor."""
        self.metrics.log_alerts(name, tick.index, raised=bool(output.alerts))
        for alert in output.alerts:
            if alert not in self._alerts:  # a refined proposal is assessed in the same tick
                self._alerts[alert] = name
                self.metrics.alerts += 1
                self.event(tick, "alert", alert.subject, f"{alert.pattern}: {alert.detail}")
        if output.reaction is not None:
            self._lasting(tick, "reaction", name, output.reaction, every_change=True)
            # A class that is repeated tick by tick, or for each refined proposal, is one reaction.
            before = self._reacted.get((name, output.reaction), -2)
            if tick.index > before + 1:
                self.metrics.reactions[output.reaction] += 1
            self._reacted[name, output.reaction] = tick.index

    def performed(self, tick: Tick, output: PerformanceAssessment) -> None:
        """Log the values of the PerformanceOracle."""
        self.metrics.log_performance(tick.time, output.values, output.wall_clock)
        for name in output.performance_fail:
            wall_clock = name in output.wall_clock
            kind = f"{'wall_clock' if wall_clock else 'performance'}:{name}"
            if kind not in self.metrics.violations:
                self.event(tick, "performance_fail", name, wall_clock=wall_clock)
            self._violation(tick, kind)

    def injected(self, tick: Tick, output: Injection) -> None:
        """Log activated and deactivated faults."""
        for fault in output.activated:
            record = self._record(fault)
            first = tick.time if record.activated_at is None else record.activated_at
            count = record.activations + 1
            self._update(record, activated_at=first, deactivated_at=None, activations=count)
            self._reached.discard(fault)
            self.event(tick, "fault_activated", fault)
        for fault in output.deactivated:
            self._update(self._record(fault), deactivated_at=tick.time)
            self.event(tick, "fault_deactivated", fault)

    def manifested(
        self, tick: Tick, state: StateManager, command: tuple[str, ...], verdict: Assessed
    ) -> tuple[str, ...]:
        """Log the active faults that reached a role or the plant, and their consequences.

        Returns:
            Ids of the faults that did so for the first time since their activation.
        """
        tampered = state.percepts[-1].tampered
        is_changed = tampered is not NOTHING or command or state.message_faults
        if not (is_changed or self.metrics.faults):
            self._alerts.clear()
            self._recovery = None
            return ()
        perceived = set(state.message_faults)
        for channel, faults in tampered.items():
            if channel in state.generator_reads:
                perceived.update(faults)
        for fault in perceived:
            self._read(fault, {"generator"})
        for readers in (state.readers, state.late_readers):
            for fault, roles in readers.items():
                self._read(fault, roles)
        perceived.update(state.readers)
        # Of an earlier percept only the first reader counts: the fault may have ended since.
        perceived.update(
            fault for fault in state.late_readers if self._record(fault).manifested_at is None
        )
        first_time = []
        for fault in sorted(perceived.union(command)):
            record = self._record(fault)
            self._update(
                record,
                manifest_ticks=record.manifest_ticks + 1,
                flagged_ticks=record.flagged_ticks + (verdict is Assessed.UNSAFE),
                manifested_at=tick.time if record.manifested_at is None else record.manifested_at,
            )
            if fault not in self._reached:
                self._reached.add(fault)
                first_time.append(fault)
                self.event(tick, "fault_manifested", fault)
        # A fault of the command alone acts once alerts and recovery of its tick are decided.
        self._log_consequences(tick, set(command) - perceived, verdict)
        return tuple(first_time)

    def _log_consequences(self, tick: Tick, late: set[str], verdict: Assessed) -> None:
        """Log detection and recovery of this tick, for the faults that can have caused them."""
        for alert, role in list(self._alerts.items())[:1]:
            self._detected(tick, alert, role, late)
        acceptable = self._recovery is None and verdict is not Assessed.UNSAFE
        for record in list(self.metrics.faults.values()):
            first, known = record.manifested_at, dict[str, Any]()
            if first is None:
                continue
            if record.detected_at is None and record.id in self._detections:
                names = ("detected_at", "detected_by", "pattern")
                known |= zip(names, self._detections[record.id], strict=True)
            if record.id not in late or first != tick.time:
                if acceptable and record.recovery_at is not None and record.recovered_at is None:
                    known["recovered_at"] = tick.time
                acts = self._recovery is not None and _in_time(record, tick.time)
                if acts and record.recovery_at is None:
                    known |= {"recovery_at": tick.time, "recovery": self._recovery}
            if known:
                self._update(record, **known)
        self._alerts.clear()
        self._recovery = None

    def _detected(self, tick: Tick, alert: Alert, role: str, late: set[str]) -> None:
        """Log an alert for each fault that it can answer, manifested or not.

        A fault of the command acts only after the alerts of its first tick.
        """
        for record in self.metrics.faults.values():
            began, at_end = record.began_at, record.on_command or record.id in late
            if began is None or (at_end and began == tick.time):
                continue
            if _in_time(record, tick.time):
                self._detections.setdefault(record.id, (tick.time, role, alert.pattern))

    def recovered(self, tick: Tick, recovery: Recovery, nanoseconds: int) -> None:
        """Log the recovery that replaces the proposal."""
        self._recovery = recovery.name
        self._recovery_text = cut(": ".join(filter(None, (recovery.name, recovery.explanation))))
        self.metrics.log_time("recovery_planner", tick.index, nanoseconds)
        before = len(self.metrics.recoveries)
        self.metrics.log_recovery(tick.index)
        if len(self.metrics.recoveries) > before:
            self.event(tick, "recovery", recovery.name, recovery.explanation)

    def decided(
        self, decision: Decision, state: StateManager, describe: Callable[[Any], str]
    ) -> None:
        """Log the tick's decision."""
        proposal, action = state.proposal, decision.action
        executed = describe(action)
        if proposal is None:
            proposed = ""
        else:
            proposed = executed if proposal.action is action else describe(proposal.action)
        if not (type(proposed) is type(executed) is str):  # the usual case
            check_texts("description of an action", (proposed, executed))
            proposed, executed = exact_texts((proposed, executed))
        short = shortened_with_hash(executed)
        # One row a tick; columns are made of them once, at the end.
        self._rows.append(
            (
                decision.verdict,
                decision.source,
                short if proposed is executed else shortened_with_hash(proposed),
                short,
                decision.attempts,
                "" if proposal is None else cut(proposal.explanation),
                cut("; ".join(decision.reasons)) if decision.reasons else "",
                self._recovery_text,
                self._account,
            )
        )
        self._recovery_text = ""

    def _read(self, fault: str, roles: set[str]) -> None:
        record = self._record(fault)
        if not roles.issubset(record.read_by):
            self._update(record, read_by=tuple(sorted(roles.union(record.read_by))))

    def _record(self, fault: str) -> FaultRecord:
        if fault not in self.metrics.faults:
            self.metrics.faults[fault] = FaultRecord(fault, "unplanned")
        return self.metrics.faults[fault]

    def _update(self, record: FaultRecord, **known: Any) -> None:
        """Keep the record of a fault with what has become known of it."""
        self.metrics.faults[record.id] = replace(record, **known)

    def _violation(self, tick: Tick, kind: str) -> None:
        """Count a violation, once per tick however often its proposal is refined."""
        if self._violated_at.get(kind) != tick.index:
            self._violated_at[kind] = tick.index
            self.metrics.violations[kind] += 1

    def _lasting(
        self, tick: Tick, kind: str, subject: str, detail: str | None, *, every_change: bool = False
    ) -> None:
        """Log where a lasting condition begins and ends, and with ``every_change`` changes too."""
        before = self._open.get((kind, subject))
        if detail is None:
            if before is not None:
                del self._open[kind, subject]
                self.event(tick, f"{kind}_ended", subject)
        elif before is None or (every_change and detail != before):
            self._open[kind, subject] = detail
            self.event(tick, kind, subject, detail)

    def failed(self, failure: InfrastructureError) -> None:
        """Log the failure of anything but the component."""
        self.events.append(
            Event(
                failure.tick, failure.time, "infrastructure", failure.role, failure.cause,
                traceback=failure.traceback,
            )
        )  # fmt: skip

    def close(
        self,
        simulator: Simulator,
        state: StateManager,
        ending: str,
        failure: InfrastructureError | None,
        loop: Mapping[str, NDArray[np.float64]] = NOTHING,
        *,
        recorded: bool = False,
    ) -> Episode:
        """Make the finished episode. Unusable signals make it an infrastructure error.

        Args:
            simulator: Computes the signals.
            state: Ticks and percepts of the episode.
            ending: Its termination.
            failure: The infrastructure error, if one ended it.
            loop: Signals of the loop that its decisions do not show.
            recorded: Whether to keep a recording for viewers.
        """
        time = np.array([tick.time for tick in state.ticks], dtype=np.float64)
        signals: dict[str, NDArray[np.float64]] = {}
        # A step that failed leaves a decision behind that no state follows.
        del self._rows[max(len(time) - 1, 0) :]
        if state.ticks:
            try:
                _add_signals(signals, simulator.signals(state.ticks), "", len(time))
                failure = failure or _first_bad_signal(signals, time)
                if ending == "decided":  # they depend on the rest, which is missing
                    signals = {n: x for n, x in signals.items() if n not in simulator.hindsight}
                percepts = simulator.percept_signals(state.percepts)
                _add_signals(signals, percepts, "percept.", len(time), len(state.percepts))
                self._add_accounts(signals, simulator, state)
                _add_signals(signals, loop, "", len(time))
                for index, *found in simulator.found_events(state.ticks):
                    self.event(state.ticks[index], *found)
            except BaseException as error:
                let_pass(error)
                blocked = isinstance(error, CallBlocked)
                last, cause = state.ticks[-1], str(error) if blocked else describe_error(error)
                raised = "" if blocked else traceback_text(error)
                failure = failure or InfrastructureError(
                    "simulator", last.index, last.time, cause, raised
                )
        if failure is not None:
            ending = "infrastructure"
            self.failed(failure)
        critical = ending == "critical"
        self.metrics.settle_recoveries(len(self._rows) - 1, critical)
        verdicts, sources, proposed, executed, attempts = self._transposed()[:5]
        return Episode(
            spec=self.spec,
            time=time,
            signals=signals,
            decisions={
                "verdict": np.array(verdicts, dtype=np.int8),
                "source": np.array(sources, dtype=np.str_),
                "proposed": np.array(proposed, dtype=np.str_),
                "executed": np.array(executed, dtype=np.str_),
                "attempts": np.array(attempts, dtype=np.int16),
            },
            events=tuple(self.events),
            faults=tuple(self.metrics.faults.values()),
            termination=ending,
            metrics=self.metrics,
            failure=str(failure) if failure else None,
            timeouts=tuple(self.timeouts),
            recording=self._recording(simulator, state) if recorded else None,
        )

    def _transposed(self) -> tuple[tuple[Any, ...], ...]:
        """Columns of the decisions, in the order of their rows."""
        return tuple(zip(*self._rows, strict=True)) or ((),) * _ROW_LENGTH

    def _add_accounts(
        self, signals: dict[str, NDArray[np.float64]], simulator: Simulator, state: StateManager
    ) -> None:
        """Add the signals and tallies of the component's accounts, if it gave any."""
        accounts = list(self._transposed()[_ACCOUNT])
        columns = account_columns(simulator, state.ticks, state.percepts, accounts)
        if columns is not None:
            _add_signals(signals, columns.signals, PROPOSAL_PREFIX, len(state.ticks))
            self.metrics.tallies = dict(columns.tallies)
            self.metrics.answer_seconds = list(columns.seconds)
            self.metrics.answer_ages = list(columns.ages)
            self.metrics.answer_usage = dict(columns.usage)

    def _recording(self, simulator: Simulator, state: StateManager) -> Recording:
        decisions = len(self._rows)
        flags = {}
        for name in sorted(self._flags):
            column = np.full(decisions, -1, np.int8)
            for tick, flag in self._flags[name].items():
                if tick < decisions:
                    column[tick] = flag
            flags[name] = column
        explanations, reasons, recoveries, accounts = self._transposed()[5:]
        scene, problem = _scene(simulator, state)
        accounts = accounts if any(accounts) else ()
        return Recording(explanations, reasons, recoveries, flags, scene, problem, accounts)


def _scene(simulator: Simulator, state: StateManager) -> tuple[Scene | None, str | None]:
    """Scene, or why there is none; without one the episode stays valid, no verdict needs it."""
    if len(state.percepts) < len(state.ticks) or not state.ticks:
        return None, None  # the episode failed before it was perceived
    try:
        scene = simulator.scene(state.ticks, state.percepts)
        wrong = None if scene is None else next(scene_problems(scene, len(state.ticks)), None)
    except BaseException as error:
        let_pass(error)
        return None, f"the simulator could not show its scene: {describe_error(error)}"
    if wrong is not None:
        return None, f"the simulator's scene cannot be shown: {'; '.join(wrong)}"
    return scene, None


def _in_time(fault: FaultRecord, time: float) -> bool:
    """Whether an alert or a recovery at this time may answer the fault."""
    return fault.deactivated_at is None or time <= fault.deactivated_at + _DETECTION_GRACE + 1e-9


def _add_signals(
    signals: dict[str, NDArray[np.float64]],
    columns: Mapping[str, Any],
    prefix: str,
    length: int,
    given: int | None = None,
) -> None:
    """Add columns of ``given`` values, filled up with NaN to the episode's length."""
    given = length if given is None else given
    for name, values in columns.items():
        column = np.asarray(values, dtype=np.float64)
        if column.shape != (given,):
            raise ValueError(
                f"signal {prefix + name!r} has the shape {column.shape}, expected ({given},)"
            )
        # The last tick has no percept if the FaultInjector failed at it.
        padding = np.full(length - given, np.nan)
        signals[prefix + name] = np.concatenate([column, padding]) if len(padding) else column


def _first_bad_signal(
    signals: Mapping[str, NDArray[np.float64]], time: NDArray[np.float64]
) -> InfrastructureError | None:
    for name, column in sorted(signals.items()):
        bad = np.flatnonzero(~np.isfinite(column))
        if len(bad):
            tick = int(bad[0])
            cause = f"signal {name!r} is {column[tick]}, not a finite number"
            return InfrastructureError("simulator", tick, float(time[tick]), cause)
    return None
