"""Campaign: all episodes of a case that a verdict rests on."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeAlias

from pytest_dura.campaign.falsification import BUDGET, SHRINK_BUDGET, Falsifier
from pytest_dura.campaign.pairs import PairedCampaign
from pytest_dura.campaign.runs import CampaignRuns
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.requirements.campaign_verdicts import CampaignVerdict
from pytest_dura.requirements.checks import Check, check_name
from pytest_dura.requirements.episode_verdicts import JudgedEpisode, judge_episode
from pytest_dura.requirements.judgements import RunJudgement
from pytest_dura.requirements.model import Method, Requirement
from pytest_dura.requirements.runs import CheckVerdict

if TYPE_CHECKING:
    from pytest_dura.campaign.falsification import Falsification
    from pytest_dura.library.fault_campaigns import FaultCampaign


ObjectiveLike: TypeAlias = "str | Requirement | Check"
"""Objective of a search: id of a requirement, a requirement, or a check."""


@dataclass(repr=False)
class Campaign(CampaignRuns):
    """All episodes of a case that a verdict rests on.

    Args:
        runner: Runs the episodes.
        case: The case.
        planned: Episodes that are planned, or may be run at most.
        requirement: What :meth:`require` decides.
        until_decided: Whether runs end as soon as the requirement at hand is decided.
    """

    search: Falsifier | None = field(default=None, kw_only=True)

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
        course, declared = self.course_of(requirement, check), self.is_declared(requirement, check)

        def judged() -> Iterator[tuple[RunJudgement, Sequence[JudgedEpisode]]]:
            for episode in self.in_order([self.case], course):
                verdict = CheckVerdict.of(judge_episode(requirement, episode, check))
                stated = None if declared else verdict
                yield RunJudgement(episode.digest, episode.spec.run, verdict=stated), [episode]

        self.decide(course, judged())
        return course.verdict()

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

        Returns:
            The search, if no violation was found.

        Raises:
            Falsified: If a violation was found, or too many simulations were inconclusive.
            ConfigurationError: For what cannot be judged or searched.
        """
        __tracebackhide__ = True
        if self.search is None:
            raise ConfigurationError(
                "this campaign was made without a search",
                key="falsify",
                remedy="take it from Runner.campaign(...)",
            )
        try:
            return self.search(
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
            requirement = self.requirement_of_call(
                own or Requirement(id=check_name(check or "")), given
            )
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
