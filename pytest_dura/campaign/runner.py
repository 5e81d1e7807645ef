"""Runner: runs cases by name, each episode once, and makes campaigns of them."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from typing import Any, Literal

from pytest_dura.campaign.campaign import Campaign
from pytest_dura.campaign.events import (
    EpisodeUsed,
    EventStream,
    FaultsTraced,
    RunningCampaign,
    SearchedEpisodeUsed,
)
from pytest_dura.campaign.falsification import Falsifier
from pytest_dura.campaign.fault_tracing import TWINS_SUBJECT, causal_chains
from pytest_dura.core.clock import Clock
from pytest_dura.core.episode import Divergence, Episode, EpisodeSpec
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.metrics import TracedFault
from pytest_dura.core.percepts import NOTHING
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.core.time_limits import ROLE_TIMEOUT
from pytest_dura.execution.memory import EpisodeKey, key_of
from pytest_dura.execution.store import EpisodeStore
from pytest_dura.execution.task import EpisodeTask, Metrics, UpcomingTasks
from pytest_dura.library.cases import (
    SWITCHED_OFF_MARK,
    Case,
    SearchedCase,
    case_with_faults,
    expand_cases,
    no_match_error,
)
from pytest_dura.library.fault_campaigns import NO_FAULTS, FaultCampaign
from pytest_dura.library.loading import Library, load_library
from pytest_dura.library.roles import (
    ParameterResolver,
    RoleGiven,
    generator_of_option,
    role_of_fixture,
    simulator_of_option,
)
from pytest_dura.library.scenario import Scenario, simulator_class
from pytest_dura.requirements.campaign_judge import CampaignJudge
from pytest_dura.requirements.episode_verdicts import (
    EpisodeVerdict,
    JudgedEpisode,
    SearchedEpisode,
    judge_episode,
)
from pytest_dura.requirements.judgements import RECOVERY_ROLE
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.searches import Falsification

_MOST_SPECS = 1000
"""Specs that are kept, those used last."""


@dataclass(repr=False)
class Runner:
    """Runs cases by name, and makes campaigns of them: what the ``orchestrator`` fixture returns.

    Args:
        library: All scenarios and requirements, read at the first call.
        base_seed: From which the seed of each run follows.
        roles: Roles that replace those of the scenarios and domains; ``None`` switches one off.
        simulator: Replaces the scenarios' simulators.
        runs: Replaces the planned runs of every campaign.
        faults: Fault campaigns that replace those of the scenarios, if given.
        time_budget: Replaces the seconds that scenarios give the component for one proposal.
        end_when_decided: Replaces what scenarios say of whether episodes end once all is decided.
        clock: Replaces the clock of scenarios; latencies are those of the simulated one.
        metrics: User-defined metrics by name.
        events: On which it emits what happens.
        resolver: Resolves the parameters of roles, each class once.
        twins: Whether fault-free twins are run, to see which faults reached the proposals.
        recorded: Whether episodes keep what a viewer shows of them.
        store: Where episodes come from.
        role_timeout: Seconds that a role, the component apart, or the simulator has for one call.
        falsifier: Searches a campaign for violations; ``None`` where nothing is searched.
        mutation: Changes the spec of each run of a case, for runs that show what a suite catches.
    """

    library: Callable[[], Library]
    base_seed: int = 0
    roles: Mapping[str, RoleSpec | None] = field(default_factory=dict)
    simulator: RoleSpec | None = None
    runs: int | None = None
    faults: tuple[FaultCampaign, ...] | None = None
    time_budget: float | None = None
    end_when_decided: bool | None = None
    clock: Literal["simulated", "wall"] | None = None
    metrics: Metrics = NOTHING
    events: EventStream = field(default_factory=EventStream)
    twins: bool = True
    recorded: bool = False
    store: EpisodeStore = field(default_factory=EpisodeStore)
    role_timeout: float = ROLE_TIMEOUT
    resolver: ParameterResolver = field(default_factory=ParameterResolver)
    falsifier: Falsifier | None = None
    mutation: Callable[[Case, EpisodeSpec], EpisodeSpec] | None = None
    _cases: dict[str, dict[str, Case]] = field(default_factory=dict, init=False)
    _traced: set[EpisodeKey] = field(default_factory=set, init=False)
    _specs: dict[tuple[Any, ...], tuple[Any, EpisodeSpec]] = field(default_factory=dict, init=False)

    @classmethod
    def of(
        cls,
        *paths: Path | str,
        base_seed: int = 0,
        generator: RoleGiven = None,
        roles: Mapping[str, RoleGiven] = NOTHING,
        simulator: RoleGiven = None,
        time_budget: float | None = None,
        clock: Literal["simulated", "wall"] | None = None,
        falsifier: Falsifier | None = None,
    ) -> Runner:
        """Make a runner for a script, of files and folders and of the built-in scenarios.

        Args:
            paths: Files and folders of scenarios and requirements.
            base_seed: From which the seed of each run follows.
            generator: The component under test in place of the scenarios': a class, a factory, a
                RoleSpec, a short name such as ``aggressive``, or ``planner:Planner``.
            roles: Further roles in place of the scenarios', by name; ``None`` switches one off.
            simulator: In place of the scenarios'.
            time_budget: In place of the seconds that scenarios give the component.
            clock: In place of the scenarios' clock.
            falsifier: Searches, such as ``pytest_dura.search.falsify_case``.

        Raises:
            ConfigurationError: For what cannot serve as its role.
        """
        given = {name: role_of_fixture(name, value) for name, value in roles.items()}
        if generator is not None:
            given["generator"] = (
                generator_of_option(generator)
                if isinstance(generator, str)
                else role_of_fixture("generator", generator)
            )
        world = None
        if simulator is not None:
            world = (
                simulator_of_option(simulator)
                if isinstance(simulator, str)
                else role_of_fixture("simulator", simulator)
            )
        return cls(
            cache(partial(load_library, paths)),
            base_seed,
            given,
            simulator=world,
            time_budget=time_budget,
            clock=clock,
            falsifier=falsifier,
        )

    def __repr__(self) -> str:
        return f"Runner(base_seed={self.base_seed})"

    def run(
        self,
        name: str,
        seed: int | None = None,
        run: int = 0,
        faults: FaultCampaign | None = None,
    ) -> JudgedEpisode:
        """One episode of a scenario or case, by its name.

        Args:
            name: Such as ``intersection/nominal`` or ``intersection/nominal+ghost-obstacle``.
            seed: Seed of the episode; by default that of the run within the case.
            run: Number of the run.
            faults: Replaces the scenario's faults; ``none`` strips them.

        Raises:
            ConfigurationError: For an unknown name or fault, and a run that is no whole number of
                at least 0.
        """
        __tracebackhide__ = True
        if isinstance(run, bool) or not isinstance(run, int) or run < 0:
            raise ConfigurationError(
                "runs are counted from 0",
                key="run",
                found=run,
                expected="a whole number of at least 0",
                remedy="leave it out for the first run",
            )
        try:
            return self.episode(self.case(name, faults), run, seed)
        except ConfigurationError as error:
            raise error.with_traceback(None) from None

    def requirement(self, name: str) -> Requirement:
        """The requirement of this id.

        Raises:
            ConfigurationError: For an unknown one.
        """
        known = self.library().requirements
        if name not in known:
            raise no_match_error(name, list(known), "requirement")
        return known[name]

    def judge(self, episode: JudgedEpisode, requirement: Requirement | str) -> EpisodeVerdict:
        """Judge an episode: its verdict, its margin, and when it is violated.

        Args:
            episode: The episode.
            requirement: A requirement, the id of one, or a formula.

        Raises:
            ConfigurationError: For an unknown id, and a formula that cannot be read or names an
                unknown signal.
        """
        if isinstance(requirement, str):
            is_formula = re.search(r"[\s<>=()]", requirement) is not None
            requirement = (
                Requirement(requirement, check=requirement)
                if is_formula
                else self.requirement(requirement)
            )
        return judge_episode(requirement, episode)

    def case(self, name: str, faults: FaultCampaign | None = None) -> Case:
        """The case of this id, or of a scenario's name with these faults.

        Raises:
            ConfigurationError: For an unknown scenario or fault.
        """
        name, *off = name.split(SWITCHED_OFF_MARK)
        known = self.library().scenarios
        scenario, plus, of_id = name.partition("+")
        if scenario not in known:
            raise no_match_error(scenario, list(known), "scenario")
        case = self._planned(known[scenario], name) if faults is None else None
        if case is None:
            own = [fault.name for fault in known[scenario].faults] or NO_FAULTS
            if faults is None:
                faults = of_id if plus else own
            case = case_with_faults(known[scenario], faults)
        for role in off:
            case = case.lacking(role)
        return case

    def _planned(self, scenario: Scenario, name: str) -> Case | None:
        """The planned case of this id, which may hold faults of a grid."""
        if scenario.name not in self._cases:
            given = [] if self.faults is None else expand_cases([scenario], self.faults)
            planned = expand_cases([scenario], read=self.library().faults)
            planned += given  # given campaigns override
            self._cases[scenario.name] = {case.id: case for case in planned}
        return self._cases[scenario.name].get(name)

    def campaign(
        self,
        case: Case | str,
        runs: int | None = None,
        requirement: Requirement | None = None,
        *,
        until_decided: bool | None = None,
    ) -> Campaign:
        """All planned runs of a case.

        Args:
            case: The case, or its name.
            runs: Planned runs instead of the scenario's.
            requirement: What :meth:`Campaign.require` decides.
            until_decided: Whether runs end once the requirement is decided, instead of what the
                scenario says.

        Raises:
            ConfigurationError: For an unknown name, and a case that a search chose.
        """
        chosen = self.case(case) if isinstance(case, str) else case
        if isinstance(chosen, SearchedCase):
            raise ConfigurationError(
                f"the case {chosen.id!r} was chosen by a search, and no rate can be made of it",
                found=chosen.id,
                expected="a case of a scenario",
                remedy="run it as such, orchestrator.episode(case), or keep it as a scenario file",
            )
        planned = self.runs or runs or chosen.scenario.planned
        if until_decided is None:
            until_decided = chosen.scenario.until_decided and runs is None
        return Campaign(self, chosen, planned, requirement, until_decided)

    def episode(
        self,
        case: Case,
        run: int = 0,
        seed: int | None = None,
        planned: int = 1,
        ahead: Iterable[EpisodeTask] = (),
    ) -> JudgedEpisode:
        """One run of a case; simulated once per session.

        Args:
            case: The case.
            run: Number of the run.
            seed: Seed of the episode; by default that of the run within the case.
            planned: How many runs of this case are planned.
            ahead: Tasks that come next.

        Raises:
            ConfigurationError: If a role or the simulator cannot be built.
        """
        __tracebackhide__ = True
        if isinstance(case, SearchedCase):
            searched = self.searched(case, run, ahead=ahead)
            self.events.emit(SearchedEpisodeUsed(case, searched))
            return searched
        try:
            episode = self.fetch(case, run, seed, ahead)
        except ConfigurationError as error:
            raise error.with_traceback(None) from None
        self.events.emit(EpisodeUsed(case, episode, planned if seed is None else 0))
        return episode

    def fetch(
        self, case: Case, run: int = 0, seed: int | None = None, ahead: Iterable[EpisodeTask] = ()
    ) -> JudgedEpisode:
        """One run of a case, as :meth:`episode`, without an event.

        Args:
            case: The case.
            run: Number of the run.
            seed: Seed of the episode; by default that of the run within the case.
            ahead: Tasks that come next.

        Raises:
            ConfigurationError: If a role or the simulator cannot be built.
        """
        return self.store.get(self.task(case, run, seed), ahead)

    def searched(
        self,
        case: Case,
        run: int = 0,
        *,
        again: int = 0,
        ahead: Iterable[EpisodeTask] = (),
        beside: Sequence[Case] = (),
    ) -> SearchedEpisode:
        """One run of a case that a search chose, which is part of no campaign and no rate.

        Args:
            case: The case.
            run: Number of the run.
            again: Number of the repetition; another one is another simulation.
            ahead: Tasks that come next.
            beside: Cases that the search asks for at once, see :meth:`search_task`.

        Raises:
            ConfigurationError: If a role or the simulator cannot be built.
        """
        task = self.search_task(case, run, again, beside)
        episode = self.store.get(task, ahead)
        self.store.earlier.search_used(task)
        return SearchedEpisode.of(episode)

    @contextmanager
    def progress(
        self, case: Case, subject: str, budget: int, judge: CampaignJudge | None = None
    ) -> Iterator[Callable[[int, int], None]]:
        """Emit the progress of some runs of a case; in the end, cancel what was begun ahead.

        Args:
            case: The case.
            subject: What the runs are for.
            budget: Runs that are planned, or may be run at most.
            judge: Judges the runs; ``None`` where nothing is judged.

        Yields:
            A function to call before each run, with the runs that are over, and the budget by then.
        """
        running = RunningCampaign(case.id, subject, budget, judge)

        def reach(done: int, budget: int) -> None:
            self.events.emit(running.reach(done, budget, self.store.simulated))

        try:
            with self.store.steady():
                yield reach
        finally:
            self.events.emit(running.end())

    def search_task(
        self, case: Case, run: int = 0, again: int = 0, beside: Sequence[Case] = ()
    ) -> EpisodeTask:
        """The task of :meth:`searched`, without a recording and verdicts: the search judges it.

        Args:
            case: The case.
            run: Number of the run.
            again: Number of the repetition.
            beside: Cases that the search asks for at once, this one among them, for a simulator
                that simulates batches.
        """
        task = replace(self.task(case, run), recorded=False, again=again, checks=())
        factory = simulator_class(task.spec.simulator)
        if len(beside) < 2 or not getattr(factory, "simulates_batches", False):
            return task
        return replace(task, beside=tuple(each.scenario.world for each in beside))

    def task(self, case: Case, run: int = 0, seed: int | None = None) -> EpisodeTask:
        """The task that simulates a run of a case.

        Args:
            case: The case.
            run: Number of the run.
            seed: Seed of the episode; by default that of the run within the case.
        """
        task = self._task(case, self._spec(case, run, seed))
        if RECOVERY_ROLE not in case.without:
            return task
        aided = case.with_role(RECOVERY_ROLE)
        return replace(task, with_recovery=self._task(aided, self._spec(aided, run, seed)))

    def _spec(self, case: Case, run: int, seed: int | None) -> EpisodeSpec:
        """The spec of a run, drawn once for all requirements that look at it."""
        parts = (*self.roles.values(), self.simulator)
        instances = [id(part.instance) for part in parts if part is not None]  # equal, not the same
        given = (
            case,
            self.roles,
            self.simulator,
            self.end_when_decided,
            self.time_budget,
            instances,
            self.clock,
        )
        key = case.id, run, seed
        known = self._specs.pop(key, None)
        if known is None or known[0] != given:
            spec = case.spec(
                run,
                self.base_seed,
                self.roles,
                simulator=self.simulator,
                seed=seed,
                resolver=self.resolver,
            )
            if self.end_when_decided is not None:
                end = replace(spec.termination, decided=self.end_when_decided)
                spec = replace(spec, termination=end)
            if self.clock is not None:
                spec = replace(spec, clock=self.clock_of(case))
            if self.time_budget is not None:
                spec = replace(spec, time_budget=self.time_budget)
            if self.mutation is not None:
                spec = self.mutation(case, spec)
            known = given, spec
        self._specs[key] = known
        if len(self._specs) > _MOST_SPECS:
            del self._specs[next(iter(self._specs))]
        return known[1]

    def clock_of(self, case: Case) -> Clock:
        """Return the clock of a case's episodes.

        Raises:
            ConfigurationError: Where the scenario's policy does not go with it.
        """
        return case.scenario.paced(self.clock)

    def _task(self, case: Case, spec: EpisodeSpec) -> EpisodeTask:
        requirements = self.requirements_of(case)
        ends = spec.termination.violation or spec.termination.decided
        # What a second engine is compared on is counted in this process.
        checks = [each.check for each in requirements if self.store.second_engine is None]
        return EpisodeTask(
            spec,
            tuple(requirements) if ends else (),
            self.metrics,
            self.recorded,
            role_timeout=self.role_timeout,
            checks=tuple(dict.fromkeys(filter(None, checks))),
        )

    def twin(self, case: Case, spec: EpisodeSpec) -> EpisodeTask:
        """The run of the same seed without faults, judged by the same requirements."""
        return self._task(case, self.task(case.without_faults(), spec.run, spec.seed).spec)

    def requirements_of(self, case: Case) -> list[Requirement]:
        """The requirements of a case."""
        return [self.library().requirements[name] for name in case.requirements]

    def key(self, episode: Episode) -> EpisodeKey:
        """The key of an episode of this runner, by which stores and reports know it."""
        return key_of(EpisodeTask(episode.spec, metrics=self.metrics))

    def falsify(
        self, case: Case, own: Requirement | None, requirement: Any, **limits: Any
    ) -> Falsification:
        """Search a case for violations; see :meth:`Campaign.falsify`.

        Args:
            case: The case.
            own: What is searched a violation of where nothing is given.
            requirement: What is given.
            limits: Of the search.

        Raises:
            Falsified: If a violation was found, or too many simulations were inconclusive.
            ConfigurationError: For what cannot be judged or searched.
        """
        __tracebackhide__ = True
        if self.falsifier is None:
            raise ConfigurationError(
                "this runner was made without a search",
                key="falsify",
                remedy="take the runner from the fixture `orchestrator`, or make it with "
                "Runner.of(..., falsifier=pytest_dura.search.falsify_case)",
            )
        with self.store.steady():
            return self.falsifier(self, case, own, requirement, **limits)

    def trace_faults(self, case: Case, runs: Sequence[int]) -> None:
        """Emit the causal chains of episodes that were run before, each once.

        Args:
            case: The case.
            runs: Numbers of the runs.
        """
        tasks = {run: self.task(case, run) for run in runs}
        due = [run for run in runs if key_of(tasks[run]) not in self._traced]
        if not self.store.execution.inside:
            # Other processes simulate all twins first: then it is known which are repeated.
            compared = [run for run in due if self._has_twin(self.store.get(tasks[run]))]
            twins = [self.twin(case, tasks[run].spec) for run in compared]
            for number, twin in enumerate(twins, 1):
                self.store.get(twin, twins[number:])
        upcoming = UpcomingTasks(len(due), lambda step: self._twins(case, tasks[due[step]]))
        with self.progress(case, TWINS_SUBJECT, len(due)) as reach:
            for step, run in enumerate(due):
                upcoming.reach(step)
                reach(step, len(due))
                episode = self.fetch(case, run)
                self._traced.add(key_of(tasks[run]))
                chains = self.chains(case, episode, upcoming)
                self.events.emit(FaultsTraced(case, episode, chains))

    def _has_twin(self, episode: JudgedEpisode) -> bool:
        """Whether an episode is compared with its twin."""
        return self.twins and any(fault.manifested_at is not None for fault in episode.faults)

    def _twins(self, case: Case, task: EpisodeTask) -> list[EpisodeTask]:
        """The twin of an episode, and its repetition where it is known to be needed."""
        twin = self.twin(case, task.spec)
        first, second = (self.store.memory.find(each) for each in (task, twin))
        if first is None or second is None or Divergence.of(first, second).at is None:
            return [twin]
        return [twin, twin.repeated()]

    def chains(
        self, case: Case, episode: JudgedEpisode, ahead: Iterable[EpisodeTask] = ()
    ) -> list[TracedFault]:
        """Each fault of an episode from plan to outcome, with the help of fault-free twins.

        Args:
            case: The case that it belongs to.
            episode: One of its runs.
            ahead: Tasks that come next.
        """
        requirements = self.requirements_of(case)
        if not self._has_twin(episode):
            return causal_chains(episode, requirements)
        task = self.twin(case, episode.spec)

        def second() -> JudgedEpisode:
            # A component that remembers earlier episodes differs here as well, and then nothing
            # is known of the faults.
            return self.store.get(task.repeated(), ahead)

        twin = self.store.get(task, ahead)
        divergence = Divergence.of(episode, twin, second)
        return causal_chains(episode, requirements, twin, divergence)
