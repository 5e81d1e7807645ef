"""The loop: update, propose, assess, decide, act, log. One call of ``run`` is one episode."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from time import perf_counter_ns
from typing import Any, Protocol

from pytest_dura.core.episode import Episode, EpisodeSpec
from pytest_dura.core.errors import ActionError, ConfigurationError, InfrastructureError
from pytest_dura.core.limits import TimeBudgetExceeded, call_within
from pytest_dura.core.log import Decision, EpisodeLog
from pytest_dura.core.roles import (
    Assessed,
    Assessment,
    FaultInjector,
    Generator,
    Injection,
    PerformanceAssessment,
    Proposal,
    Recovery,
    RecoveryPlanner,
    Role,
    RoleContext,
    SecurityAssessment,
)
from pytest_dura.core.schedule import schedule
from pytest_dura.core.simulator import Simulator
from pytest_dura.core.state import NOTHING, Percept, RoleView, StateManager, Tick

ABANDON_AFTER = 3
"""A component that overran its wall-clock budget this often is not called again in the episode."""


class Judge(Protocol):
    """Tells during an episode whether it may end at a violation."""

    def __call__(self, simulator: Simulator, ticks: list[Tick]) -> bool:
        """Whether every requirement is decided and at least one is violated."""


class Orchestrator:
    """Runs one closed loop of roles around a simulator.

    Args:
        simulator: The world.
        roles: By name; ``generator`` is required, any other may be missing.
        judge: Asked each tick where the spec ends episodes at a violation.
        metrics: User-defined metrics by name, measured on the complete episode.

    Raises:
        ConfigurationError: If the roles cannot be scheduled or one is of the wrong kind.
    """

    def __init__(
        self,
        simulator: Simulator,
        roles: Mapping[str, Role],
        judge: Judge | None = None,
        metrics: Mapping[str, Callable[[Episode], float]] = NOTHING,
    ) -> None:
        self.simulator = simulator
        self.roles = dict(roles)
        self.judge = judge
        self.metrics = metrics
        self.generator = _of_kind(Generator, self.roles.get("generator"), "generator")
        self.injector: FaultInjector | None = None
        self.recovery: RecoveryPlanner | None = None
        if "fault_injector" in roles:
            self.injector = _of_kind(FaultInjector, roles["fault_injector"], "fault_injector")
        if "recovery_planner" in roles:
            self.recovery = _of_kind(RecoveryPlanner, roles["recovery_planner"], "recovery_planner")
        self.assessors = [(name, self.roles[name]) for name in schedule(self.roles)]

    @classmethod
    def build(
        cls,
        spec: EpisodeSpec,
        judge: Judge | None = None,
        metrics: Mapping[str, Callable[[Episode], float]] = NOTHING,
    ) -> Orchestrator:
        """The orchestrator that a spec describes, of fresh parts."""
        simulator = spec.simulator.create()
        return cls(simulator, {n: r.create() for n, r in spec.roles.items()}, judge, metrics)

    def run(self, spec: EpisodeSpec) -> Episode:
        """One episode. An infrastructure error ends it and is told by ``Episode.failure``."""
        self.spec = spec
        self.state = StateManager(spec.time_step)
        self.log = EpisodeLog(spec)
        failure: InfrastructureError | None = None
        try:
            tick = self._reset()
            while True:
                self._update(tick)
                ending = self._ending(tick)
                if ending is not None:
                    break
                action = self._decide_on_tick(tick)
                if action is _HALT:
                    ending = "halt"
                    break
                tick = self._guard("simulator", self.simulator.step, action)
        except InfrastructureError as error:
            failure, ending = error, "infrastructure"
        episode = self.log.close(self.simulator, self.state, ending, failure)
        episode.metrics.measure(self.metrics, episode)
        return episode

    def _reset(self) -> Tick:
        spec = self.spec
        self._timeouts = 0
        faults = tuple(spec.faults)
        context = RoleContext(spec.seed, spec.time_step, spec.scenario, faults)
        for name, role in self.roles.items():
            if name == "generator":
                self._propose_safely(lambda: self.generator.reset(context))
            else:
                self._guard(name, role.reset, context)
        self._guard("simulator", self.simulator.set_time_step, spec.time_step)
        tick: Tick = self._guard("simulator", self.simulator.reset, spec.scenario, spec.seed)
        return tick

    def _update(self, tick: Tick) -> None:
        channels, tampered = tick.channels, NOTHING
        if self.injector is not None:
            start = perf_counter_ns()
            channels, tampered = self._guard(
                "fault_injector", self.injector.corrupt, channels, tick.time
            )
            self._injector_ns = perf_counter_ns() - start
        self.state.update(tick, Percept(channels, tampered))
        for kind, subject, detail in tick.events:
            self.log.event(tick, kind, subject, detail)

    def _ending(self, tick: Tick) -> str | None:
        end = self.spec.termination
        if tick.critical is not None:
            self.log.event(tick, "critical", "simulator", tick.critical)
            return "critical"
        if end.goal and tick.goal:
            return "goal"
        if end.violation and self.judge is not None:
            if self._guard("simulator", self.judge, self.simulator, self.state.ticks):
                return "violation"
        # Ticks are counted, since a sum of float time steps would miss the limit by one.
        if tick.index >= round(end.time_limit / self.spec.time_step):
            return "time"
        if end.iterations is not None and tick.index >= end.iterations:
            return "iterations"
        return None

    def _decide_on_tick(self, tick: Tick) -> Any:
        self._propose()
        verdict, reasons = self._assess(first=True)
        attempts = 0
        if self.spec.policy.name == "refine":
            while verdict is Assessed.UNSAFE and attempts < self.spec.policy.attempts:
                attempts += 1
                self._propose(reasons)
                verdict, reasons = self._assess(first=False)
        decision = self._decide(verdict, reasons, attempts)
        if decision is None:
            self.log.event(tick, "halt", "orchestrator", "; ".join(reasons))
            return _HALT
        action = self._command(decision, tick)
        self.log.decided(tick, decision, self.state, self.simulator.describe_action)
        return action

    def _propose(self, feedback: tuple[str, ...] = ()) -> None:
        tick, spec = self.state.tick, self.spec
        self.state.proposal = None
        start = perf_counter_ns()
        problem = self._try_to_propose(feedback)
        elapsed = perf_counter_ns() - start
        self.state.generator_seconds = elapsed / 1e9
        self.log.metrics.log_time("generator", tick.index, elapsed)
        self.log.proposed(problem is None)
        if problem is not None:
            self.log.event(tick, "component_failure", spec.component, problem)

    def _try_to_propose(self, feedback: tuple[str, ...]) -> str | None:
        """Ask the Generator; returns what is wrong with its answer, if anything."""
        tick, spec = self.state.tick, self.spec
        recorded = spec.timeouts
        if self._timeouts >= ABANDON_AFTER:
            return f"not called: it overran its time budget {ABANDON_AFTER} times"
        if recorded is not None and tick.index in recorded:
            return self._timed_out()
        view = self.state.generator_view(feedback)
        limit = spec.time_budget if recorded is None else None
        try:
            proposal = call_within(limit, self.generator.propose, view)
        except TimeBudgetExceeded:
            return self._timed_out()
        except (Exception, SystemExit) as error:
            return f"raised {type(error).__name__}: {error}"
        if not isinstance(proposal, Proposal):
            return f"returned {type(proposal).__name__}, not a Proposal"
        if (latency := proposal.latency) is not None:
            if not (isinstance(latency, (int, float)) and math.isfinite(latency) and latency >= 0):
                return f"declared a latency of {latency!r}, which is not a duration in seconds"
            if spec.time_budget is not None and latency > spec.time_budget:
                return f"answered after {latency:g} s; its budget is {spec.time_budget:g} s"
        try:
            action = self.simulator.check_action(proposal.action)
        except ActionError as error:
            return f"no valid action: {error}"
        except Exception as error:
            raise self._infrastructure("simulator", error) from error
        self.state.proposal = Proposal(action, str(proposal.explanation), latency)
        return None

    def _timed_out(self) -> str:
        self._timeouts += 1
        self.log.timeouts.append(self.state.tick.index)
        return "overran its wall-clock time budget"

    def _propose_safely(self, call: Callable[[], None]) -> None:
        """A Generator that fails in ``reset`` is a failing component, not failing infrastructure."""
        try:
            call_within(self.spec.time_budget, call)
        except (Exception, SystemExit, TimeBudgetExceeded) as error:
            self._timeouts = ABANDON_AFTER
            detail = f"reset raised {type(error).__name__}: {error}"
            self.log.early_event("component_failure", self.spec.component, detail)

    def _assess(self, *, first: bool) -> tuple[Assessed, tuple[str, ...]]:
        state, tick = self.state, self.state.tick
        verdict, reasons = Assessed.SAFE, []
        if state.proposal is None:
            verdict, reasons = Assessed.UNSAFE, ["the component made no valid proposal"]
        view = state.role_view()
        for name, role in self.assessors:
            if not (first or role.reassess):
                continue
            start = perf_counter_ns()
            output = self._guard(name, _run_if_triggered, role, view)
            elapsed = perf_counter_ns() - start
            if role is self.injector:
                elapsed += self._injector_ns
            self.log.metrics.log_time(name, tick.index, elapsed)
            if output is None:
                continue
            state.outputs[name] = output
            if isinstance(output, Assessment):
                self._check_score(name, output)
                self.log.assessed(tick, name, output)
                found = Assessed.UNSAFE if output.critical else output.verdict
                if found > Assessed.SAFE:
                    reasons += [f"{name}: {reason}" for reason in output.reasons or (found.name,)]
                verdict = max(verdict, found)
                if isinstance(output, SecurityAssessment):
                    self.log.alerted(tick, name, output)
            elif isinstance(output, PerformanceAssessment):
                self._check_values(name, output)
                self.log.performed(tick, output)
            elif isinstance(output, Injection):
                self.log.injected(tick, output)
        return verdict, tuple(reasons)

    def _decide(
        self, verdict: Assessed, reasons: tuple[str, ...], attempts: int
    ) -> Decision | None:
        """The proposal, the recovery's action, or ``None`` to halt."""
        proposal, policy = self.state.proposal, self.spec.policy.name
        refused = verdict is Assessed.UNSAFE
        if refused and policy == "halt":
            return None
        if refused and policy in ("recover", "refine") and self.recovery is not None:
            start = perf_counter_ns()
            view = self.state.role_view(reasons)
            recovery = self._guard("recovery_planner", self._recover, view)
            self.log.recovered(self.state.tick, recovery, perf_counter_ns() - start)
            return Decision(recovery.action, "recovery", verdict, reasons, attempts)
        if proposal is None:
            fallback = self._guard("simulator", self.simulator.fallback_action)
            return Decision(fallback, "fallback", verdict, reasons, attempts)
        return Decision(proposal.action, "proposal", verdict, reasons, attempts)

    def _recover(self, view: RoleView) -> Recovery:
        assert self.recovery is not None
        recovery = self.recovery.run(view)
        if not isinstance(recovery, Recovery):
            raise TypeError(f"returned {type(recovery).__name__}, not a Recovery")
        action = self.simulator.check_action(recovery.action)
        return Recovery(action, recovery.name, recovery.explanation)

    def _command(self, decision: Decision, tick: Tick) -> Any:
        """The decided action after active command faults."""
        tampered: tuple[str, ...] = ()
        action = decision.action
        if self.injector is not None:
            action, tampered = self._guard(
                "fault_injector", self.injector.corrupt_command, action, tick.time
            )
        self.log.manifested(tick, self.state, tampered, decision.verdict)
        return action

    def _check_score(self, name: str, output: Assessment) -> None:
        if math.isnan(output.score):
            raise self._infrastructure(name, ValueError("its score is not a number (NaN)"))

    def _check_values(self, name: str, output: PerformanceAssessment) -> None:
        for key, value in output.values.items():
            if math.isnan(value):
                raise self._infrastructure(name, ValueError(f"{key} is not a number (NaN)"))

    def _guard(self, role: str, call: Callable[..., Any], *args: Any) -> Any:
        """Call into anything but the component; a failure there says nothing about the component."""
        try:
            return call(*args)
        except ConfigurationError:
            raise
        except Exception as error:
            raise self._infrastructure(role, error) from error

    def _infrastructure(self, role: str, error: Exception) -> InfrastructureError:
        ticks = self.state.ticks
        index, time = (ticks[-1].index, ticks[-1].time) if ticks else (0, 0.0)
        return InfrastructureError(role, index, time, f"{type(error).__name__}: {error}")


_HALT = object()


def _run_if_triggered(role: Role, view: RoleView) -> Any:
    return role.run(view) if role.trigger(view) else None


def _of_kind(kind: type[Any], role: object, name: str) -> Any:
    if not isinstance(role, kind):
        raise ConfigurationError(
            f"the role {name!r} must be a {kind.__name__}",
            key=name,
            found="nothing" if role is None else type(role).__name__,
            expected=f"a subclass of pytest_dura.{kind.__name__}",
            remedy=f"derive it from pytest_dura.{kind.__name__}",
        )
    return role
