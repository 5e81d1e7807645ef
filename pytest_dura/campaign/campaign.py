"""Campaign: all episodes of a case that a verdict rests on."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, TypeAlias

from pytest_dura.campaign.falsification import BUDGET, SHRINK_BUDGET
from pytest_dura.campaign.progress import RunningCampaign
from pytest_dura.campaign.reasons import ComponentFailures, explain_verdict
from pytest_dura.campaign.runs import requirement_of_call
from pytest_dura.core.errors import ConfigurationError, DuraError
from pytest_dura.execution.task import EpisodeTask, UpcomingTasks
from pytest_dura.library.cases import Case
from pytest_dura.library.requirements import check_formula
from pytest_dura.requirements.checks import Check, check_name
from pytest_dura.requirements.model import Method, Requirement
from pytest_dura.requirements.verdicts.campaigns import CampaignVerdict, Situations, varies
from pytest_dura.requirements.verdicts.episodes import (
    EpisodeVerdict,
    JudgedEpisode,
    is_unseen_crash,
    judge_episode,
)
from pytest_dura.requirements.verdicts.judging import CampaignJudge

if TYPE_CHECKING:
    from pytest_dura.campaign.falsification import Falsification
    from pytest_dura.campaign.pairs import PairedCampaign
    from pytest_dura.library.fault_campaigns import FaultCampaign
    from pytest_dura.runner import Runner


ObjectiveLike: TypeAlias = "str | Requirement | Check"
"""What a search tries to violate: id of a requirement, a requirement, or a check."""
MAX_EXTRA_SHARE = 0.2
"""Further runs that may follow invalid ones, as a share of a fixed number of planned runs."""


class RequirementViolated(DuraError):  # noqa: N818 - it is an outcome, not an error
    """A campaign does not support a requirement. ``verdict`` holds the counts it rests on."""

    def __init__(self, message: str, verdict: CampaignVerdict) -> None:
        self.verdict = verdict
        super().__init__(message)


@dataclass(repr=False)
class Campaign:
    """All episodes of a case that a verdict rests on.

    Args:
        bench: What runs the episodes.
        case: The case.
        planned: Episodes that are planned, or may be run at most.
        requirement: What :meth:`require` decides.
        until_decided: Whether runs end as soon as the requirement at hand is decided.
    """

    bench: Runner
    case: Case
    planned: int
    requirement: Requirement | None = None
    until_decided: bool = False
    failures: ComponentFailures = field(default_factory=ComponentFailures, init=False)
    """Of the component itself, in the episodes that the last verdict rests on."""

    def __repr__(self) -> str:
        return f"Campaign({self.case.id!r}, {self.planned} runs planned)"

    @property
    def component(self) -> str:
        """Name of the component under test."""
        return self.case.roles(self.bench.roles)["generator"].label

    @property
    def episodes(self) -> list[JudgedEpisode]:
        """The planned runs, and a further run for each invalid one as far as the budget goes."""
        return list(self)

    def __iter__(self) -> Iterator[JudgedEpisode]:
        return self.in_order([self.case])

    def in_order(
        self, cases: Sequence[Case], judge: CampaignJudge | None = None
    ) -> Iterator[JudgedEpisode]:
        """The planned runs, and a further run for each invalid one as far as the budget goes.

        Args:
            cases: This campaign's, and those whose runs are looked at along with it.
            judge: Judges them, if something does.
        """
        budget = 0 if self.until_decided else math.ceil(MAX_EXTRA_SHARE * self.planned)
        run, end = 0, self.planned
        with self._under_way(cases, judge) as (running, ahead):
            while run < end and not (judge is not None and judge.decided):
                ahead.reach(run)
                episode = self._run(run, end, running, ahead)
                yield episode
                run += 1
                if episode.validity == "invalid" and end < self.planned + budget:
                    end += 1

    @contextmanager
    def _under_way(
        self, cases: Sequence[Case], judge: CampaignJudge | None
    ) -> Iterator[tuple[RunningCampaign, UpcomingTasks]]:
        """What tells how far it is, and the planned runs as tasks.

        At the end, what was begun of them is given up.
        """
        bench, own = self.bench, self.requirement
        asked_for = own if judge is None else judge.requirement
        subject = "" if asked_for is None else asked_for.id
        running = RunningCampaign(self.case.id, subject, self.planned, judge)
        ahead = self.upcoming(cases)
        try:
            yield running, ahead
        finally:
            bench.store.cancel()
            bench.on_progress(running.end())

    def upcoming(self, cases: Sequence[Case]) -> UpcomingTasks:
        """The planned runs of several cases as tasks, run by run."""
        return UpcomingTasks(
            self.planned, lambda run: [self.bench.task(case, run) for case in cases]
        )

    def _run(
        self, run: int, end: int, running: RunningCampaign, ahead: Iterable[EpisodeTask]
    ) -> JudgedEpisode:
        """The run of this number, of so many that are to come for all that is known."""
        self.bench.on_progress(running.reach(run, end, self.bench.store.simulated))
        return self.bench.episode(self.case, run, planned=self.planned, ahead=ahead)

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
            return self.paired(requirement.paired.without).judge(requirement, check)
        judge, situations = self.judge_of(requirement, check), self.situations()
        self.failures = ComponentFailures()
        faulty = []
        for episode in self.enough_for(judge):
            verdict = judge_episode(requirement, episode, check)
            judge.add(self.with_crash(verdict, episode, check or requirement.check))
            situations.add(episode)
            judge.situation = situations.situation
            self.failures.add(episode)
            if episode.faults:
                faulty.append(episode.spec.run)
        # Once all have run: twins come between no two episodes of a component that remembers them.
        self.bench.follow(self.case, faulty)
        return judge.verdict()

    def with_crash(
        self, verdict: EpisodeVerdict, episode: JudgedEpisode, check: Check
    ) -> EpisodeVerdict:
        """The verdict, marked where the episode's crash violates nothing.

        Args:
            verdict: On the episode, or on the pair that it belongs to.
            episode: The episode.
            check: What it was judged by, besides the requirements of its case.
        """
        requirements = self.bench.requirements_of(self.case)
        if verdict.verdict == "violated" or not is_unseen_crash(episode, requirements, check):
            return verdict
        return replace(verdict, unseen_crash=True)

    def judge_of(self, requirement: Requirement, check: Check | None) -> CampaignJudge:
        """What takes in the verdicts on this campaign's episodes.

        Raises:
            ConfigurationError: Before anything is run, for what cannot be judged.
        """
        if self.bench.simulator is None:  # another simulator than the scenario's tells by running
            check_formula(self.case.scenario, requirement.check if check is None else check)
        return CampaignJudge(
            requirement,
            self.case.id,
            planned=self.planned,
            component=self.component,
            until_decided=self.until_decided,
        )

    def situations(self) -> Situations:
        """What takes in this campaign's episodes and says whether they are all equal."""
        faults = {fault["id"] for fault in self.case.faults}
        return Situations(varies=varies(self.case.scenario.variation, faults))

    def enough_for(
        self, judge: CampaignJudge, beside: Sequence[Case] = ()
    ) -> Iterator[JudgedEpisode]:
        """Episodes until the judge needs no more of them, or the plan or budget is used up.

        Args:
            judge: Says whether it needs more.
            beside: Cases of which the same runs are looked at.
        """
        cases = [self.case, *beside]
        if not judge.sequential:
            yield from self.in_order(cases, judge)
            return
        run = 0
        with self._under_way(cases, judge) as (running, ahead):
            while run < self.planned and not judge.decided:
                ahead.reach(run)
                yield self._run(run, self.planned, running, ahead)
                run += 1

    def falsify(
        self,
        requirement: ObjectiveLike | Sequence[ObjectiveLike] | None = None,
        *,
        budget: int = BUDGET,
        faults: FaultCampaign | Sequence[FaultCampaign] = (),
        at_most: int = 1,
        shrink: int = SHRINK_BUDGET,
        seed: int | None = None,
    ) -> Falsification:
        """Search this campaign's case for violations; what comes of it enters no rate.

        What the scenario declares under ``variation`` is searched, and faults that may be added,
        both in one space. A violation that is found is replayed, made simpler, and kept as a
        scenario file, where the session has a place for it.

        Args:
            requirement: Id of a requirement, a formula, a function of the episode or its import
                path, or several of them. Without one, that of the test's marker.
            budget: Simulations of the search.
            faults: Faults that may be added to those of the case: names of the catalogue, globs,
                ``catalogue``, or faults as data.
            at_most: How many of them may act together.
            shrink: Simulations for making each counterexample simpler; 0 leaves it as it is.
            seed: From which its draws follow; by default from the session's seed and the case.

        Returns:
            What came of it, if nothing was found.

        Raises:
            Falsified: If a violation was found, or too many simulations said nothing.
            ConfigurationError: For what cannot be judged or searched.
        """
        __tracebackhide__ = True
        from pytest_dura.search.falsify import falsify_campaign

        try:
            return falsify_campaign(
                self, requirement, budget=budget, faults=faults, at_most=at_most,
                shrink=shrink, seed=seed,
            )  # fmt: skip
        except ConfigurationError as error:
            raise error.with_traceback(None) from None

    def paired(self, without: str) -> PairedCampaign:
        """The same runs beside runs of equal seeds without something.

        Args:
            without: ``faults``, or the name of a role that is switched off there.

        Raises:
            ConfigurationError: If there is no such role, or there are no faults.
        """
        __tracebackhide__ = True
        from pytest_dura.campaign.pairs import PairedCampaign

        try:
            return PairedCampaign(self, without)
        except ConfigurationError as error:
            raise error.with_traceback(None) from None

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
            requirement = self.asked(own or Requirement(id=check_name(check or "")), given)
            verdict = self.judge(requirement, check)
        except ConfigurationError as error:
            raise error.with_traceback(None) from None
        return self.decided(verdict, requirement)

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

    def asked(self, own: Requirement, given: Mapping[str, Any]) -> Requirement:
        """The requirement with what a call gives, ``None`` apart; see :func:`asked`.

        Raises:
            ConfigurationError: For what is not as the requirement's file says.
        """
        told = {key: value for key, value in given.items() if value is not None}
        return requirement_of_call(own, self.bench.library().requirements, told)

    def decided(self, verdict: CampaignVerdict, requirement: Requirement) -> CampaignVerdict:
        """Tell of a verdict, and return it if it is "supported".

        Raises:
            RequirementViolated: If it is not.
        """
        __tracebackhide__ = True
        self.bench.on_verdict(verdict, requirement)
        if verdict.verdict != "supported":
            raise RequirementViolated(
                "\n".join(explain_verdict(verdict, requirement, self.failures)), verdict
            )
        return verdict
