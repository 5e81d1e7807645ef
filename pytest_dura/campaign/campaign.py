"""Campaign: all episodes of a case that a verdict rests on, alone or in pairs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

from pytest_dura.campaign.events import EventStream, MonitorsMeasured, VerdictReached
from pytest_dura.campaign.falsification import BUDGET, REGION_RUNS, SHRINK_BUDGET
from pytest_dura.campaign.pairs import judged_pair, measured_value, monitor_qualities, twin_case
from pytest_dura.core.display import Shown
from pytest_dura.core.episode import Episode
from pytest_dura.core.errors import ConfigurationError, DuraError
from pytest_dura.core.text import one_line
from pytest_dura.execution.task import EpisodeTask, UpcomingTasks
from pytest_dura.library.cases import Case
from pytest_dura.library.requirements import check_formula
from pytest_dura.requirements.campaign_judge import CampaignJudge, RunSchedule
from pytest_dura.requirements.campaign_verdicts import CampaignVerdict, varies, with_doubt
from pytest_dura.requirements.checks import Check, check_name
from pytest_dura.requirements.drafts import unsigned_reason
from pytest_dura.requirements.episode_verdicts import JudgedEpisode, judge_episode, judge_run
from pytest_dura.requirements.judgements import (
    RECOVERY_ROLE,
    CampaignCourse,
    Judgement,
    RunJudgement,
)
from pytest_dura.requirements.model import (
    Method,
    Paired,
    Requirement,
    finite_number,
    requirement_of_call,
)
from pytest_dura.requirements.monitoring.quality import MonitorQuality
from pytest_dura.requirements.pairs import (
    Change,
    Pair,
    PairCounts,
    check_comparison,
    check_second_run,
    judge_pairs,
)
from pytest_dura.requirements.runs import Run
from pytest_dura.requirements.shortfalls import explain_verdict, own_failure_clause

if TYPE_CHECKING:
    from pytest_dura.core.role_spec import RoleSpec
    from pytest_dura.library.fault_campaigns import FaultCampaign
    from pytest_dura.library.loading import Library
    from pytest_dura.requirements.searches import Falsification


ObjectiveLike: TypeAlias = "str | Requirement | Check"
"""Objective of a search: id of a requirement, a requirement, or a check."""


@dataclass
class ComponentFailures:
    """The first failure of the component itself, and in how many episodes there was one."""

    first: str = ""
    failed: list[str] = field(default_factory=list)
    """Ids of the episodes with a failure."""
    episodes: int = 0

    def add(self, episode: Episode) -> None:
        """Take in an episode."""
        self.episodes += 1
        failed = [event for event in episode.events if event.kind == "component_failure"]
        if failed:
            clause = own_failure_clause(failed[0].subject, failed[0].detail)
            self.first = self.first or f"{clause} (t = {failed[0].time:.2f} s)"
            self.failed.append(episode.id)

    def __str__(self) -> str:
        if not self.first:
            return ""
        return f"{self.first}; in {len(self.failed)} of {self.episodes} episodes"


class RequirementViolated(DuraError):  # noqa: N818 - it is an outcome, not an error
    """A campaign does not support a requirement. ``verdict`` holds the counts it rests on."""

    def __init__(self, message: str, verdict: CampaignVerdict) -> None:
        self.verdict = verdict
        super().__init__(message)


class RunsEpisodes(Protocol):
    """What a campaign asks of its runner, see :class:`pytest_dura.campaign.runner.Runner`."""

    roles: Mapping[str, RoleSpec | None]
    simulator: RoleSpec | None
    events: EventStream

    @property
    def library(self) -> Callable[[], Library]:
        """All scenarios and requirements."""

    def task(self, case: Case, run: int = 0) -> EpisodeTask:
        """The task that simulates a run of a case."""

    def episode(
        self, case: Case, run: int = 0, *, planned: int = 1, ahead: Iterable[EpisodeTask] = ()
    ) -> JudgedEpisode:
        """One run of a case; simulated once per session."""

    def fetch(self, case: Case, run: int = 0) -> JudgedEpisode:
        """One run of a case, without an event."""

    def requirements_of(self, case: Case) -> list[Requirement]:
        """The requirements of a case."""

    def progress(
        self, case: Case, subject: str, budget: int, judge: CampaignJudge | None = None
    ) -> AbstractContextManager[Callable[[int, int], None]]:
        """Emit the progress of some runs of a case."""

    def trace_faults(self, case: Case, runs: Sequence[int]) -> None:
        """Emit the causal chains of episodes that were run before, each once."""

    def falsify(
        self, case: Case, own: Requirement | None, requirement: Any, **limits: Any
    ) -> Falsification:
        """Search a case for violations."""


@dataclass(repr=False)
class Campaign(Shown):
    """All episodes of a case that a verdict rests on.

    Args:
        runner: Runs the episodes.
        case: The case.
        planned: Episodes that are planned, or may be run at most.
        requirement: What :meth:`require` decides.
        until_decided: Whether runs end as soon as the requirement at hand is decided.
    """

    runner: RunsEpisodes
    case: Case
    planned: int
    requirement: Requirement | None = None
    until_decided: bool = False
    failures: ComponentFailures = field(default_factory=ComponentFailures, init=False)
    """Of the component itself, in the episodes that the last verdict rests on."""
    judgement: Judgement | None = field(default=None, init=False)
    """The last question that was decided, with the runs that decided it."""

    def __repr__(self) -> str:
        return f"Campaign({one_line(repr(self.case.id), 80)}, {self.planned} runs planned)"

    def _figures(self) -> Iterator[tuple[str, object]]:
        """Yield what a notebook shows; nothing is simulated for it."""
        yield "case", self.case.id
        yield "component", self.component
        yield "runs planned", str(self.planned)
        yield "requirement", None if self.requirement is None else self.requirement.id

    @property
    def component(self) -> str:
        """Name of the component under test."""
        return self.case.roles(self.runner.roles)["generator"].label

    @property
    def episodes(self) -> list[JudgedEpisode]:
        """The planned runs, and a further run for each invalid one as far as the budget goes."""
        return list(self)

    def __iter__(self) -> Iterator[JudgedEpisode]:
        return self.in_order([self.case])

    def require(
        self,
        check: Check | None = None,
        at_most: float | None = None,
        confidence: float | None = None,
        method: Method | None = None,
        p0: float | None = None,
    ) -> CampaignVerdict:
        """The verdict of a check, if the campaign supports it.

        A requirement of a file is judged as its file defines it, and nothing that is given here
        may differ from that.

        Args:
            check: Formula over signals, or a function of the episode or its import path. Without
                one, that of the requirement in the test's marker.
            at_most: Greatest acceptable rate of episodes that violate it; by default none may.
            confidence: One-sided confidence of the bound on that rate; by default 0.95.
            method: ``fixed`` for the planned number of runs; ``sprt`` or ``e-process`` to end the
                runs once the rate is decided. Default: ``fixed``, unless runs go on until decided.
            p0: For ``sprt``, the rate below ``at_most`` up to which a component is rarely rejected.

        Raises:
            RequirementViolated: If it is violated or undecided.
            ConfigurationError: For a check that cannot be read, a rate or method that makes no
                sense, and what is not as the requirement's file says.
        """
        __tracebackhide__ = True
        given: dict[str, Any] = {"at_most": at_most, "confidence": confidence}
        given |= {"method": method, "p0": p0}
        if check is not None:
            given |= {"check": check_name(check)}
        try:
            own = self._own_requirement() if check is None else self.requirement
            own = own or Requirement(id=check_name(check or ""))
            requirement = requirement_of_call(own, self.runner.library().requirements, given)
            verdict = self.judge(requirement, check)
        except ConfigurationError as error:
            raise error.with_traceback(None) from None
        return self.report_verdict(verdict, requirement)

    def _own_requirement(self) -> Requirement:
        own = self.requirement
        if own is None or not (own.check or own.paired):
            raise ConfigurationError(
                "there is no check to decide by",
                key="check",
                found=own.id if own is not None else "a test without a marker `requirement`",
                expected="a check, or a requirement with one in its file",
                remedy='call campaign.require("always (gap > 0)"), or add a `check` to the file',
            )
        return own

    def judge(self, requirement: Requirement, check: Check | None = None) -> CampaignVerdict:
        """The verdict of a requirement on as many episodes as it needs.

        Args:
            requirement: The requirement; its rate and method say how many episodes it needs.
            check: A check in place of the requirement's own.

        Raises:
            ConfigurationError: For a check that cannot be read, and a rate or method that makes
                no sense.
        """
        if requirement.paired is not None:
            pairs = requirement.paired
            campaign = self.paired(pairs.without, reference=pairs.reference)
            return with_doubt(campaign.judge(requirement, check), unsigned_reason(requirement))
        course, declared = self.course_of(requirement, check), self.is_declared(requirement, check)

        def judged() -> Iterator[tuple[RunJudgement, Sequence[JudgedEpisode]]]:
            for episode in self.in_order([self.case], course):
                verdict = judge_run(requirement, episode, check)
                stated = None if declared else verdict
                yield RunJudgement(episode.digest, episode.spec.run, verdict=stated), [episode]

        self.decide(course, judged())
        return with_doubt(course.verdict(), unsigned_reason(requirement))

    def paired(self, without: str = "", *, reference: str = "") -> PairedCampaign:
        """The same runs beside runs of equal seeds without something, or of another component.

        Args:
            without: ``faults``, or the name of a role that is switched off there.
            reference: In its place a component, by its registered name or import path, that takes
                the place of the component under test there, and that recovery does not overrule.
                Together with ``without="recovery_planner"`` it drives third runs: what it avoids is
                what recovery is asked to prevent.

        Raises:
            ConfigurationError: If there is no such role or component, or there are no faults, and
                unless one of the two is given.
        """
        __tracebackhide__ = True
        try:
            return PairedCampaign(self, without, reference)
        except ConfigurationError as error:
            raise error.with_traceback(None) from None

    def falsify(
        self,
        requirement: ObjectiveLike | Sequence[ObjectiveLike] | None = None,
        *,
        budget: int = BUDGET,
        faults: FaultCampaign | Sequence[FaultCampaign] = (),
        at_most: int = 1,
        shrink: int = SHRINK_BUDGET,
        seed: int | None = None,
        at_least: int = 1,
        all: bool = False,  # noqa: A002 - what a test reads best
        region_runs: int = REGION_RUNS,
        surrogate: bool = False,
    ) -> Falsification:
        """Search this campaign's case for violations; what comes of it enters no rate.

        What the scenario declares under ``variation`` is searched, and faults that may be added,
        both in one space. A violation that is found is replayed, made simpler, and stored as
        a scenario file, if the session has a place for it.

        Args:
            requirement: Id of a requirement, a formula, a function of the episode or its import
                path, or several of them. Without one, that of the test's marker.
            budget: Simulations of the search.
            faults: Faults that may be added to those of the case: names of the catalogue, globs,
                ``catalogue``, or faults as data.
            at_most: How many of them may act together.
            shrink: Simulations for making each counterexample simpler; 0 leaves it as it is.
            seed: From which its draws follow; by default from the session's seed and the case.
            at_least: Violations of each requirement after which it ends; with more than one, the
                session shows where failures lie.
            all: Whether it goes on to the end of its budget, and shows where failures lie.
            region_runs: Further simulations of each region of failures, for its probability.
            surrogate: Whether a Gaussian process of all values so far takes part: for budgets of 50
                to 200 on simulators of which one run takes longer than a tenth of a second.

        Returns:
            The search, if no violation was found.

        Raises:
            Falsified: If a violation was found, or too many simulations were inconclusive.
            ConfigurationError: For what cannot be judged or searched.
        """
        __tracebackhide__ = True
        limits: dict[str, Any] = {
            "budget": budget, "at_most": at_most, "shrink": shrink,
            "at_least": at_least, "all": all, "region_runs": region_runs,
            "surrogate": surrogate,
        }  # fmt: skip
        try:
            return self.runner.falsify(
                self.case, self.requirement, requirement, faults=faults, seed=seed, **limits
            )
        except ConfigurationError as error:
            raise error.with_traceback(None) from None

    def in_order(
        self, cases: Sequence[Case], course: CampaignCourse | None = None
    ) -> Iterator[JudgedEpisode]:
        """The planned runs, and a further run for each invalid one as far as the budget goes.

        Args:
            cases: This campaign's, and those whose runs are judged along with it.
            course: Ends the runs once they decide; each run is added to it before the next one.
        """
        judge = None if course is None else course.judge
        schedule = RunSchedule(self.planned, sequential=self.until_decided)
        schedule = schedule if course is None else course.schedule
        decided = self.requirement if judge is None else judge.requirement
        subject = "" if decided is None else decided.id
        run, ahead = 0, self.upcoming(cases)
        with self.runner.progress(self.case, subject, schedule.end, judge) as reach:
            while run < schedule.end if course is None else course.goes_on:
                ahead.reach(run)
                reach(run, schedule.end)
                episode = self.runner.episode(self.case, run, planned=self.planned, ahead=ahead)
                yield episode
                run += 1
                if course is None:
                    schedule.add(episode.validity)

    def upcoming(self, cases: Sequence[Case]) -> UpcomingTasks:
        """The planned runs of several cases as tasks, run by run."""
        return UpcomingTasks(
            self.planned, lambda run: [self.runner.task(case, run) for case in cases]
        )

    def decide(
        self,
        course: CampaignCourse,
        judged: Iterable[tuple[RunJudgement, Sequence[JudgedEpisode]]],
    ) -> list[int]:
        """Add runs to a course one by one, then trace their faults.

        Args:
            course: The course.
            judged: What the question's check says of each run, with the run itself, and with its
                twin if it is one of a pair.

        Returns:
            The numbers of the runs.
        """
        requirements = self.runner.requirements_of(self.case)
        self.failures = ComponentFailures()
        runs, faulty = [], []
        for judgement, episodes in judged:
            course.add(judgement, *(Run.of(episode, requirements) for episode in episodes))
            for episode in episodes:
                self.failures.add(episode)
            runs.append(episodes[0].spec.run)
            if episodes[0].faults:
                faulty.append(runs[-1])
        # Once all have run, so that a component that remembers episodes meets no twin between them.
        self.runner.trace_faults(self.case, faulty)
        self.judgement = course.judgement
        return runs

    def course_of(
        self,
        requirement: Requirement,
        check: Check | None = None,
        twins: str = "",
        references: str = "",
    ) -> CampaignCourse:
        """Begin the course of this campaign's runs.

        Args:
            requirement: What decides on them.
            check: A check in place of the requirement's own.
            twins: Id of the case of the second runs, if pairs are judged.
            references: Id of the case of third runs, if there are any.

        Raises:
            ConfigurationError: Before anything is run, for a requirement that cannot be judged.
        """
        if self.runner.simulator is None:  # signals of another simulator are known once it runs
            check_formula(self.case.scenario, requirement.check if check is None else check)
        question = Judgement(
            "campaign",
            requirement.id,
            self.case.id,
            self.component,
            self.planned,
            requirement.check if check is None else check_name(check),
            requirement.paired,
            requirement.at_most,
            requirement.confidence,
            requirement.method,
            requirement.p0,
            self.until_decided,
            twins,
            references,
        )
        faults = {fault.id for fault in self.case.faults}
        return CampaignCourse(question, varies=varies(self.case.scenario.variation, faults))

    def is_declared(self, requirement: Requirement, check: Check | None) -> bool:
        """Whether runs have a verdict on a requirement themselves, as its case declares it."""
        if requirement.id not in self.case.requirements or callable(check):
            return False
        declared = self.runner.library().requirements[requirement.id].check
        return declared == (requirement.check if check is None else check)

    def report_verdict(self, verdict: CampaignVerdict, requirement: Requirement) -> CampaignVerdict:
        """Report a verdict, and return it if it is "supported".

        Raises:
            RequirementViolated: If it is not.
        """
        __tracebackhide__ = True
        assert self.judgement is not None
        self.runner.events.emit(VerdictReached(verdict, requirement, self.judgement))
        if verdict.verdict != "supported":
            raise RequirementViolated("\n".join(self.explain(verdict, requirement)), verdict)
        return verdict

    def explain(self, verdict: CampaignVerdict, requirement: Requirement) -> list[str]:
        """Say in a few lines why a verdict is not "supported", with amounts in units."""
        units = self.case.scenario.units
        measures = self.runner.task(self.case).spec.measures
        units |= {measure.path: measure.unit for measure in measures}
        failures = self.failures
        return explain_verdict(verdict, requirement, str(failures), units, failed=failures.failed)


class PairedCampaign(Shown):
    """Pairs of episodes: one of a campaign, and its twin of the same seed without something.

    Args:
        campaign: The campaign.
        without: ``faults``, or the name of a role that is switched off in the twins.
        reference: In its place the component that the twins have.

    Raises:
        ConfigurationError: If there is no such role or component, or there are no faults.
    """

    def __init__(self, campaign: Campaign, without: str, reference: str = "") -> None:
        self.campaign, self.without, self.reference = campaign, without, reference
        check_second_run(Paired(without, reference=reference))
        self.case = twin_case(campaign.case, without, reference)
        self.others = [self.case]
        """The cases of the second runs, and of third ones of a reference."""
        if without and reference:
            self.others.append(campaign.case.referred(reference))
        # Raises before anything runs if there is no such role to switch off.
        for case in self.others:
            case.roles(campaign.runner.roles)

    def __repr__(self) -> str:
        name = one_line(repr(self.campaign.case.id), 64)
        given = {"without": self.without, "reference": self.reference}
        text = ", ".join(f"{key}={value!r}" for key, value in given.items() if value)
        return f"PairedCampaign({name}, {text})"

    def _figures(self) -> Iterator[tuple[str, object]]:
        """Yield what a notebook shows; nothing is simulated for it."""
        yield "case", self.campaign.case.id
        if self.without:
            yield "twins without", self.without
        if self.reference:
            yield "reference", self.reference
        yield "component", self.campaign.component
        yield "pairs planned", str(self.campaign.planned)

    def __iter__(self) -> Iterator[tuple[JudgedEpisode, JudgedEpisode]]:
        """The pairs of all planned runs."""
        cases = [self.campaign.case, self.case]
        yield from self._with_twins(self.campaign.in_order(cases), cases)

    def twin(self, episode: JudgedEpisode, ahead: Iterable[EpisodeTask] = ()) -> JudgedEpisode:
        """The episode of the same run and seed without something.

        Args:
            episode: One of the campaign's.
            ahead: Tasks that come next.
        """
        return self.campaign.runner.episode(
            self.case, episode.spec.run, planned=self.campaign.planned, ahead=ahead
        )

    def _with_twins(
        self, episodes: Iterable[JudgedEpisode], cases: Sequence[Case]
    ) -> Iterator[tuple[JudgedEpisode, JudgedEpisode]]:
        """Each episode with its twin; a process that waits for one simulates the next ones."""
        ahead = self.campaign.upcoming(cases)
        for episode in episodes:
            ahead.reach(episode.spec.run)
            yield episode, self.twin(episode, ahead)

    def judge(self, requirement: Requirement, check: Check | None = None) -> CampaignVerdict:
        """The verdict of a requirement on pairs; its counts are counts of pairs.

        Raises:
            ConfigurationError: For a check or measure that cannot be used.
        """
        check_comparison(requirement)
        campaign, cases = self.campaign, [self.campaign.case, *self.others]
        course = campaign.course_of(requirement, check, *(case.id for case in self.others))
        declared = campaign.is_declared(requirement, check)

        def judged() -> Iterator[tuple[RunJudgement, Sequence[JudgedEpisode]]]:
            for own, twin in self._with_twins(campaign.in_order(cases, course), cases):
                third = [
                    campaign.runner.episode(case, own.spec.run, planned=campaign.planned)
                    for case in self.others[1:]
                ]
                pair = [own, twin, *third]
                yield judged_pair(requirement, check, pair, declared=declared), pair

        runs = campaign.decide(course, judged())
        if self.without == RECOVERY_ROLE:
            measured = MonitorsMeasured(self.case, self._monitors(runs))
            campaign.runner.events.emit(measured)
        return course.verdict()

    def monitors(self) -> list[MonitorQuality]:
        """Quality of the monitors on all planned runs without recovery, where they cannot act.

        Raises:
            ConfigurationError: If it is not the recovery that the twins lack.
        """
        if self.without != RECOVERY_ROLE:
            raise ConfigurationError(
                "monitors are judged where recovery does not act on their verdicts",
                key="without",
                found=self.without,
                expected=RECOVERY_ROLE,
                remedy=f'compare with campaign.paired(without="{RECOVERY_ROLE}")',
            )
        return self._monitors([episode.spec.run for episode, _ in self])

    def _monitors(self, runs: Sequence[int]) -> list[MonitorQuality]:
        def twins() -> Iterator[JudgedEpisode]:
            return (self.campaign.runner.fetch(self.case, run) for run in runs)

        return monitor_qualities(twins, self.campaign.runner.requirements_of(self.case))

    def require(
        self,
        check: Check = "",
        at_most: float | None = None,
        confidence: float | None = None,
        method: Method | None = None,
        p0: float | None = None,
        *,
        measure: str = "",
        change_at_most: float | None = None,
    ) -> CampaignVerdict:
        """The verdict on the pairs, if the campaign supports it.

        Args:
            check: No pair, or at most a share, may violate it only with what the twins lack.
            at_most: Greatest acceptable rate of such pairs; by default there may be none.
            confidence: As in :meth:`Campaign.require`.
            method: As there.
            p0: As there.
            measure: Import path of a function of an episode to a number, in place of a check.
            change_at_most: By how much the measure may grow in a pair.

        Raises:
            RequirementViolated: If it is violated or undecided.
            ConfigurationError: For a check or measure that cannot be used, and what is not as the
                requirement's file says.
        """
        __tracebackhide__ = True
        given: dict[str, Any] = {"at_most": at_most, "confidence": confidence}
        given |= {"method": method, "p0": p0}
        if check:
            given |= {"check": check_name(check)}
        own = self.campaign.requirement
        own = own or Requirement(check_name(check) or measure, kind="recovery")
        try:
            if change_at_most is not None:
                change_at_most = finite_number("change_at_most", change_at_most)
            paired = Paired(self.without, measure, change_at_most, self.reference)
            if own.paired is not None and not measure and change_at_most is None:
                paired = replace(own.paired, without=self.without, reference=self.reference)
            known = self.campaign.runner.library().requirements
            requirement = requirement_of_call(own, known, given | {"paired": paired})
            verdict = self.judge(requirement, check or None)
        except ConfigurationError as error:
            raise error.with_traceback(None) from None
        return self.campaign.report_verdict(verdict, requirement)

    def counts(self, check: Check) -> PairCounts:
        """How many of all planned pairs violate a check in both runs, one of them, or neither."""
        __tracebackhide__ = True
        requirement = Requirement(check_name(check), check=check_name(check))
        pairs = []
        try:
            for episode, twin in self:
                own = judge_episode(requirement, episode, check)
                other = judge_episode(requirement, twin, check)
                other = replace(other, component=own.component)
                pairs.append(Pair(own, other, bool(episode.metrics.recoveries)))
        except ConfigurationError as error:
            raise error.with_traceback(None) from None
        return judge_pairs(pairs)

    def change(self, measure: str | Callable[[Episode], float]) -> Change:
        """By how much a measure differs in each of the planned pairs.

        Args:
            measure: A function of an episode to a number, or its import path. NaN is no value.
        """
        __tracebackhide__ = True
        try:
            values = {
                episode.id: (measured_value(measure, episode), measured_value(measure, twin))
                for episode, twin in self
            }
        except ConfigurationError as error:
            raise error.with_traceback(None) from None
        return Change.between(check_name(measure), values)
