"""Loop of an episode: update, propose, assess, decide, act, log, and whether it may end early.

One call of :meth:`Orchestrator.run` is one episode.

A verdict on a prefix that no continuation can change is the verdict on the whole episode. But a
planned fault that has not manifested by then might still do so, and an episode in which it never
does is invalid. So an episode with such a fault ends early only if every requirement is violated,
which stays. A fault whose hits are drawn by chance is waited for in any case: a rate is not
supported under a fault that manifested in no episode, and the only hit may follow a violation.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from time import perf_counter_ns
from types import MappingProxyType
from typing import Any, Protocol, cast

from pytest_dura.core.boundary import Boundary
from pytest_dura.core.calls import AT, COMPONENT, current_calls
from pytest_dura.core.clock import Pace, clock_columns
from pytest_dura.core.collector import rare_collections
from pytest_dura.core.component import Answer, Component, Messages, plain_copy
from pytest_dura.core.episode import Episode, EpisodeSpec
from pytest_dura.core.errors import (
    ConfigurationError,
    InfrastructureError,
    describe_error,
    environment_errors,
    traceback_text,
)
from pytest_dura.core.fault import Fault
from pytest_dura.core.log import Decision, EpisodeLog
from pytest_dura.core.loop_signals import declared_seconds
from pytest_dura.core.metrics import FaultRecord
from pytest_dura.core.outputs import (
    accepted_action,
    checked_recovery,
    checked_tick,
    corrupted_command,
    corrupted_percept,
    end_directives,
    next_tick,
    required_output,
    run_if_triggered,
)
from pytest_dura.core.percepts import NOTHING, Percept
from pytest_dura.core.roles import (
    Assessed,
    Assessment,
    FaultInjector,
    Generator,
    Injection,
    PerformanceAssessment,
    RecoveryPlanner,
    Role,
    RoleContext,
    SecurityAssessment,
    check_kind,
    schedule,
)
from pytest_dura.core.seeding import derive_seed, recording_draws
from pytest_dura.core.simulator import Simulator, checked_aliases
from pytest_dura.core.state import GeneratorView, StateManager, Tick
from pytest_dura.core.time_limits import ROLE_TIMEOUT, CallBlocked, CallTimer, alarms, with_pauses
from pytest_dura.core.timed_component import TimedComponent


class EarlyEndJudge(Protocol):
    """Judge of whether an episode may end before its time, called at each tick."""

    def __call__(self, simulator: Simulator, ticks: list[Tick]) -> bool:
        """Whether every requirement is decided and at least one is violated."""

    def decided(self, simulator: Simulator, ticks: list[Tick], *, violated: bool) -> bool:
        """Whether no continuation can change the verdict of any requirement.

        ``True`` may come later than it could, but never too early.

        Args:
            simulator: Computes the signals that requirements read.
            ticks: All ticks so far.
            violated: Whether each requirement must be violated, too.
        """


def _all_decided(
    judge: EarlyEndJudge, simulator: Simulator, ticks: list[Tick], faults: Mapping[str, FaultRecord]
) -> bool:
    """Whether nothing that follows can change any verdict, see the module."""
    pending = [fault for fault in faults.values() if fault.manifested_at is None]
    if any(fault.by_chance for fault in pending):
        return False
    return judge.decided(simulator, ticks, violated=bool(pending))


class Orchestrator:
    """Runs one closed loop of roles around a simulator.

    Args:
        simulator: The world.
        roles: By name; ``generator`` is required, any other may be missing.
        judge: Called at each tick if the spec ends episodes at a violation, or once all is decided.
        metrics: User-defined metrics by name, measured on the complete episode. One that has no
            value for this episode returns NaN; one that raises is an infrastructure error.
        recorded: Whether episodes keep what a viewer shows of them.
        role_timeout: Seconds of wall-clock time that a role, the component apart, the simulator
            and a metric have for one call; one that takes longer ends the episode as an
            infrastructure error. ``None`` waits for ever. In the main thread it holds on systems
            that have alarms.

    Raises:
        ConfigurationError: If the roles cannot be scheduled or one is of the wrong kind.
    """

    def __init__(
        self,
        simulator: Simulator,
        roles: Mapping[str, Role],
        judge: EarlyEndJudge | None = None,
        metrics: Mapping[str, Callable[[Episode], float]] = NOTHING,
        *,
        recorded: bool = False,
        role_timeout: float | None = ROLE_TIMEOUT,
    ) -> None:
        self.simulator = simulator
        self.recorded = recorded
        self.role_timeout = role_timeout
        self.roles = dict(roles)
        for name, role in self.roles.items():
            check_kind(name, role)
        self.judge = judge
        self.metrics = metrics
        check_kind("generator", self.roles.get("generator"))
        self.generator: Generator = cast("Generator", self.roles["generator"])
        self.injector = cast("FaultInjector | None", self.roles.get("fault_injector"))
        self.recovery = cast("RecoveryPlanner | None", self.roles.get("recovery_planner"))
        self.assessors = [
            (name, self.roles[name], required_output(self.roles[name]))
            for name in schedule(self.roles)
        ]

    @classmethod
    def build(
        cls,
        spec: EpisodeSpec,
        judge: EarlyEndJudge | None = None,
        metrics: Mapping[str, Callable[[Episode], float]] = NOTHING,
        *,
        recorded: bool = False,
        role_timeout: float | None = ROLE_TIMEOUT,
    ) -> Orchestrator:
        """Build the orchestrator that a spec describes, of fresh parts."""
        calls = current_calls()
        with calls.calling("simulator"):
            simulator = spec.simulator.create()
        if not isinstance(simulator, Simulator):
            raise ConfigurationError(
                f"{spec.simulator.path} is not a simulator",
                key="simulator",
                found=type(simulator).__name__,
                expected="a subclass of pytest_dura.Simulator",
                remedy="derive it from pytest_dura.Simulator",
            )
        roles = {}
        for name, role in spec.roles.items():
            with calls.calling(name):
                roles[name] = role.create()
        return cls(simulator, roles, judge, metrics, recorded=recorded, role_timeout=role_timeout)

    def run(self, spec: EpisodeSpec) -> Episode:
        """Run one episode. An infrastructure error ends it and stands in ``Episode.failure``."""
        self.spec = spec
        self.state = StateManager(spec.time_step)
        self._messages = Messages(self.injector, self.state)
        self.log = EpisodeLog(spec)
        self._pace = Pace(spec.time_step) if spec.clock.kind == "wall" else None
        end = spec.termination
        self._last_index = end.last_index(spec.time_step)
        if end.iterations is not None:
            self._last_index = min(self._last_index, end.iterations)
        self._injector_ns = 0
        self._acting: FaultInjector | None = self.injector
        self._assessing = self.assessors
        self._policy = spec.policy.name
        self._timer = CallTimer(self.role_timeout)
        self._calls = current_calls()
        self._calls.at(0)
        with (
            Boundary() as self._boundary,
            alarms(self._timer),
            environment_errors() as self._environment,
            with_pauses() as self._pauses,
            rare_collections(),
            recording_draws() as draws,
        ):
            parts = self.generator, spec, self.log.timeouts, self._boundary
            timed = spec.clock.is_timed
            self._component = TimedComponent(*parts, self.state) if timed else Component(*parts)
            episode = self._run()
        # A world of its own is a draw, too: of what is to be driven, as with recorded logs.
        episode.drawn = draws.any or type(self.simulator).tells_runs_apart()
        return episode

    def _run(self) -> Episode:
        failure: InfrastructureError | None = None
        episode: Episode | None = None
        try:
            episode = self._guard("simulator", self.simulator.recorded_episode, self.spec)
            if episode is not None and not self.recorded:
                episode.recording = None
            ending = "" if episode is not None else self._loop()
            self._check_overrun()
        except InfrastructureError as error:
            failure, ending = error, "infrastructure"
        except CallBlocked as blocked:  # raised between the call's return and the end of its limit
            role = self._timer.overran or "simulator"
            failure, ending = self._failure_of(role, str(blocked)), "infrastructure"
        self._component.finish()
        if episode is None or failure is not None:
            episode = self._closed(ending, failure)
        if episode.failure is None:
            self._measure(episode)
        self._boundary.raise_signalled()
        return episode

    def _closed(self, ending: str, failure: InfrastructureError | None) -> Episode:
        with self._timer.calling("simulator"), self._calls.calling("simulator"):
            return self.log.close(
                self.simulator, self.state, ending, failure, self._clock_columns(),
                recorded=self.recorded,
            )  # fmt: skip

    def _clock_columns(self) -> Mapping[str, Any]:
        """Signals of what the clock did; empty where the world waits for the component."""
        if not self.spec.clock.is_timed:
            return NOTHING
        periods = None if self._pace is None else self._pace.periods
        component, ticks = self._component, len(self.state.ticks)
        return clock_columns(ticks, component.late, component.expired, periods)

    def _loop(self) -> str:
        """Run tick by tick until something ends the episode; returns the termination."""
        tick = self._reset()
        self._guard("simulator", self._begin, tick)
        while True:
            self._update(tick)
            ending = self._ending(tick)
            if ending is not None:
                return ending
            decision = self._decide_on_tick(tick)
            if decision is None:
                return "halt"
            action = self._command(decision, tick)
            self.state.decide(decision.action, decision.source)
            self._check_overrun()
            if self._pace is not None and tick.index == 0:
                self._pace.begin()
            tick = self._guard("simulator", self._step, decision, action, tick.index + 1)
            if self._pace is not None:
                self._pace.wait(tick.index)
                self._guard("simulator", self._begin, tick)

    def _step(self, decision: Decision, action: Any, due: int) -> Tick:
        """Log the decision, and step the simulator by what has become of its action."""
        self.log.decided(decision, self.state, self.simulator.describe_action)
        tick = next_tick(self.simulator, action, due, self.spec.time_step)
        if self._pace is None:
            self._begin(tick)
        return tick

    def _begin(self, tick: Tick) -> None:
        """Begin a tick, whose truth counts, even if perceiving it should fail."""
        self.state.ticks.append(tick)
        if self._acting is None:
            self.state.perceive(Percept(tick.channels, NOTHING, self._aliases))

    def _measure(self, episode: Episode) -> None:
        """Fill in the user-defined metrics."""
        try:
            self._check_overrun()
            for name, metric in self.metrics.items():
                measured = self._guard(f"metric {name!r}", metric, episode)
                episode.metrics.user[name] = self._guard(f"metric {name!r}", float, measured)
                self._check_overrun()
        except InfrastructureError as failure:
            self._mark_missing(episode, failure)

    def close(self, episode: Episode) -> Episode:
        """Close the simulator after its episode; if that fails, the episode is missing.

        Args:
            episode: The result of :meth:`run`.
        """
        with Boundary() as self._boundary, alarms(self._timer):
            try:
                self._guard("simulator", self.simulator.close)
            except InfrastructureError as failure:
                if episode.failure is None:
                    self._mark_missing(episode, failure)
        return episode

    def _mark_missing(self, episode: Episode, failure: InfrastructureError) -> None:
        self.log.failed(failure)
        episode.events, episode.failure = tuple(self.log.events), str(failure)
        episode.termination = "infrastructure"

    def _reset(self) -> Tick:
        spec = self.spec
        for name, role in self.roles.items():
            # Each gets copies: a role that changed the scenario would change the world.
            scenario = plain_copy(spec.scenario)
            if role is self.generator:
                own_seed = derive_seed(spec.seed, "generator")
                context = RoleContext(
                    own_seed, spec.time_step, scenario, time_budget=spec.time_budget
                )
                with self._calls.calling(COMPONENT):
                    problem = self._component.reset(context)
                self._raise_environment_error()
                if problem is not None:
                    self.log.reset_failed(problem, self._component.take_error())
            else:
                faults = tuple(Fault.of(plain_copy(fault.plain())) for fault in spec.faults)
                context = RoleContext(spec.seed, spec.time_step, scenario, faults)
                self._guard(name, role.reset, context)
                if role is self.injector and not self._guard(name, self.injector.may_act):
                    self._acting = None
                    self._assessing = [each for each in self.assessors if each[1] is not role]
                    self.state.hold(name, Injection())
        self._guard("simulator", self.simulator.set_time_step, spec.time_step)
        scenario = plain_copy(spec.scenario)
        tick = self._guard("simulator", self.simulator.reset, scenario, spec.seed)
        tick = self._guard("simulator", checked_tick, tick, 0, spec.time_step)
        aliases = self._guard("simulator", checked_aliases, self.simulator, tick.channels)
        self._aliases = MappingProxyType(dict(aliases))
        return cast("Tick", tick)

    def _update(self, tick: Tick) -> None:
        self._calls.at(tick.index)  # after the step, of which a copy of the process may have come
        if self._acting is not None:
            self._guard("fault_injector", self._perceive_by, self._acting, tick)
        for kind, subject, detail in tick.events:
            self.log.event(tick, kind, subject, detail)

    def _perceive_by(self, injector: FaultInjector, tick: Tick) -> None:
        start = perf_counter_ns()
        percept = corrupted_percept(injector, tick, self._aliases)
        self._injector_ns = perf_counter_ns() - start
        self.state.perceive(percept)

    def _ending(self, tick: Tick) -> str | None:
        end = self.spec.termination
        if tick.critical is not None:
            self.log.event(tick, "critical", "simulator", tick.critical)
            return "critical"
        if end.goal and tick.goal:
            return "goal"
        judge, so_far = self.judge, (self.simulator, self.state.ticks)
        if judge is not None and end.violation and self._guard("judge", judge, *so_far):
            return "violation"
        if tick.index >= self._last_index or tick.truncated:
            return self._limit(tick)
        if judge is not None and end.decided:
            faults = self.log.metrics.faults
            if self._guard("judge", _all_decided, judge, *so_far, faults):
                return "decided"
        return None

    def _limit(self, tick: Tick) -> str:
        """Limit of the scenario or of the plant that is reached at this tick."""
        end = self.spec.termination
        if tick.index >= end.last_index(self.spec.time_step):
            return "time"
        if end.iterations is not None and tick.index >= end.iterations:
            return "iterations"
        self.log.event(tick, "truncated", "simulator", "the plant ended by itself")
        return "truncated"

    def _decide_on_tick(self, tick: Tick) -> Decision | None:
        """Ask the component, let roles assess, and decide; ``None`` is for a halt."""
        self._propose()
        self._judgements: dict[str, Assessment] = {}
        verdict, reasons = self._assess(first=True)
        attempts = 0
        if verdict is Assessed.UNSAFE and self._policy == "refine":
            while verdict is Assessed.UNSAFE and attempts < self.spec.policy.attempts:
                attempts += 1
                self._propose(reasons)
                verdict, reasons = self._assess(first=False)
        decision = self._decide(verdict, reasons, attempts)
        if decision is None:
            self._manifested(tick, (), verdict)
            self.log.event(tick, "halt", "orchestrator", "; ".join(reasons))
        return decision

    def _propose(self, feedback: tuple[str, ...] = ()) -> None:
        state, component = self.state, self._component
        tick = state.ticks[-1]
        state.proposal = None
        view = state.generator_view(feedback, self._messages.transmit)
        proposal, problem, is_plain = self._ask(component, view)
        if self._environment:
            self._raise_environment_error()
        if proposal is not None:
            problem = proposal.failure or None
            if proposal.action is not None or problem is None:
                check, whose = accepted_action, "simulator"
                if not is_plain:  # the check calls the component's code
                    check, whose = component.check_action, COMPONENT
                action, wrong = self._guard(
                    "simulator", check, self.simulator, proposal.action, whose=whose
                )
                if wrong is not None:
                    problem = wrong
                elif action is proposal.action:
                    state.proposal = proposal
                else:
                    state.proposal = proposal.with_action(action)
        self.log.proposed(tick, proposal, problem, component.take_error())

    def _ask(self, component: Component, view: GeneratorView) -> Answer:
        """Ask the component, and measure how long it takes, without its pauses."""
        calls, pauses = self._calls, self._pauses
        paused, start = pauses.seconds, perf_counter_ns()
        number = calls.shared[AT] = calls.numbers[COMPONENT]
        answer = component.propose(view)
        if calls.check is not None:
            calls.check(number)
        calls.shared[AT] = 0
        elapsed = perf_counter_ns() - start - int((pauses.seconds - paused) * 1e9)
        if component.thought_seconds is not None:
            elapsed = int(component.thought_seconds * 1e9)
        proposal, seconds = answer.proposal, None
        if proposal is not None and proposal.account is not NOTHING:
            seconds = declared_seconds(proposal.account)
        self.state.generator_seconds = elapsed / 1e9 if seconds is None else seconds
        self.log.metrics.log_time("generator", view.index, elapsed)
        return answer

    def _assess(self, *, first: bool) -> tuple[Assessed, tuple[str, ...]]:
        state, metrics = self.state, self.log.metrics
        tick = state.ticks[-1]
        verdict, reasons = Assessed.SAFE, []
        if state.proposal is None:
            verdict, reasons = Assessed.UNSAFE, ["the component made no valid proposal"]
        if not self._assessing:
            return verdict, tuple(reasons)
        view = state.role_view()
        for name, role, required in self._assessing:
            if first or role.reassess:
                is_injector = role is self.injector
                start = perf_counter_ns()
                output, exact = self._guard(name, run_if_triggered, role, view, required)
                elapsed = perf_counter_ns() - start
                # The injector has made the changes: what it looks at itself has reached no role.
                state.has_read(None if is_injector else name)
                if is_injector:
                    elapsed += self._injector_ns
                metrics.log_time(name, tick.index, elapsed)
                if not first:
                    self._judgements.pop(name, None)
                if output is None:
                    end_directives(state.outputs, name)
                    continue
                state.put(name, output)
                self._log_output(tick, name, exact)
            # The judgement of a role that does not reassess holds for a refined proposal, too.
            judgement = self._judgements.get(name)
            if judgement is not None:
                level = Assessed.UNSAFE if judgement.critical else judgement.verdict
                if level is not Assessed.SAFE:
                    reasons += [f"{name}: {why}" for why in judgement.reasons or (level.name,)]
                    verdict = max(verdict, level)
        return verdict, tuple(reasons)

    def _log_output(self, tick: Tick, name: str, output: Any) -> None:
        if isinstance(output, Assessment):
            self._judgements[name] = output
            self.log.assessed(tick, name, output)
            if isinstance(output, SecurityAssessment):
                self.log.alerted(tick, name, output)
                self.state.alerts += [(tick.time, alert) for alert in output.alerts]
        elif isinstance(output, PerformanceAssessment):
            self.log.performed(tick, output)
        elif isinstance(output, Injection):
            self.log.injected(tick, output)

    def _decide(
        self, verdict: Assessed, reasons: tuple[str, ...], attempts: int
    ) -> Decision | None:
        """Choose the proposal, recovery's action, or ``None`` to halt."""
        proposal, policy = self.state.proposal, self._policy
        refused = verdict is Assessed.UNSAFE
        if refused and policy == "halt":
            return None
        if refused and policy in ("recover", "refine") and self.recovery is not None:
            start = perf_counter_ns()
            view = self.state.role_view(reasons)
            recovery = self._guard(
                "recovery_planner", checked_recovery, self.recovery, view, self.simulator
            )
            self.state.has_read("recovery_planner")
            self.log.recovered(self.state.tick, recovery, perf_counter_ns() - start)
            return Decision(recovery.action, "recovery", verdict, reasons, attempts)
        if proposal is None:
            fallback = self._guard("simulator", self.simulator.fallback_action)
            return Decision(fallback, "fallback", verdict, reasons, attempts)
        return Decision(proposal.action, "proposal", verdict, reasons, attempts)

    def _command(self, decision: Decision, tick: Tick) -> Any:
        """Apply active command faults to the decided action."""
        tampered: tuple[str, ...] = ()
        action = decision.action
        if self._acting is not None:
            sent = self._guard("simulator", self.simulator.actuation, action)
            sent, tampered = self._guard(
                "fault_injector", corrupted_command, self._acting, sent, tick.time
            )
            # Without an effect the plant gets what was decided, whatever `actuation` makes of it.
            action = sent if tampered else action
        self._manifested(tick, tampered, decision.verdict)
        return action

    def _manifested(self, tick: Tick, command: tuple[str, ...], verdict: Assessed) -> None:
        first = self.log.manifested(tick, self.state, command, verdict)
        if first and self.injector is not None:
            self._guard("fault_injector", self.injector.manifested, first, tick.time)

    def _guard(
        self, role: str, call: Callable[..., Any], *args: Any, whose: str | None = None
    ) -> Any:
        """Call anything but the component; its failure is an infrastructure error.

        A misconfiguration that shows before anything has moved is raised as it is, for the user.
        """
        timer, boundary, calls = self._timer, self._boundary, self._calls
        timer.calls += 1
        timer.role = role
        number = calls.shared[AT] = calls.numbers[whose or role]
        try:
            result = call(*args)
        except CallBlocked as blocked:
            raise self._failure_of(role, str(blocked)) from blocked
        except BaseException as error:
            boundary.let_pass(error)
            if isinstance(error, ConfigurationError) and len(self.state.ticks) <= 1:
                raise
            raise self._failure_of(role, describe_error(error), traceback_text(error)) from error
        finally:
            timer.role = None
            if calls.check is not None:
                calls.check(number)
            calls.shared[AT] = 0
        if boundary.signalled is not None:
            boundary.raise_signalled()
        return result

    def _check_overrun(self) -> None:
        """End the episode if a call overran, caught its interruption and went on."""
        if self._boundary.signalled is not None:
            self._boundary.raise_signalled()
        overran = self._timer.overran
        if overran is not None:
            raise self._failure_of(overran, self._timer.cause)

    def _raise_environment_error(self) -> None:
        """End the episode at the first environment error, if there is one."""
        for error in self._environment:
            raise self._failure_of(error.source, str(error)) from error

    def _failure_of(self, role: str, cause: str, traceback: str = "") -> InfrastructureError:
        ticks = self.state.ticks
        index, time = (ticks[-1].index, ticks[-1].time) if ticks else (0, 0.0)
        return InfrastructureError(role, index, time, cause, traceback)
