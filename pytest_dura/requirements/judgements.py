"""Judgements: what an item asks of the runs of a case, and the campaign's verdict that follows.

A judgement holds the question and names its runs; what a check says of a run stands with the run,
unless the item brought a check of its own. The verdict on the campaign is a function of both:
while runs are simulated, when the session ends, and whenever its evidence is read.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from pytest_dura.requirements.campaign_judge import CampaignJudge, RunSchedule
from pytest_dura.requirements.campaign_verdicts import CampaignVerdict, Situations, with_doubt
from pytest_dura.requirements.episode_verdicts import EpisodeVerdict
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.pairs import Change, Pair, change_verdict, judge_pairs, pair_verdict
from pytest_dura.requirements.runs import CheckVerdict, Run

RECOVERY_ROLE = "recovery_planner"


@dataclass(frozen=True, slots=True)
class RunJudgement:
    """A run, or a pair of runs, that a judgement rests on.

    Args:
        digest: Of the run.
        run: Number of the run.
        twin: Digest of the second run; empty without one.
        verdict: Of the question's check on the run; ``None`` where the run itself has the verdict
            on that requirement, and where a measure is compared.
        twin_verdict: The same of the second run.
        values: The measure of both runs; ``None`` of a run that is invalid, missing or not whole,
            an infinite number where it has no value.
    """

    digest: str
    run: int
    twin: str = ""
    verdict: CheckVerdict | None = None
    twin_verdict: CheckVerdict | None = None
    values: tuple[float | None, float | None] | None = None


@dataclass(frozen=True, slots=True)
class Judgement:
    """What an item asks of the runs of a case.

    Args:
        requirement: As it is judged: with the check, the rate and the method that apply.
        case: Id of the case.
        component: Name of the component under test.
        planned: Runs that are planned, or may be run at most.
        until_decided: Whether runs end as soon as the requirement is decided.
        twins: Id of the case of the second runs; empty unless pairs are judged.
        runs: The runs, in the order in which they were judged.
    """

    requirement: Requirement
    case: str
    component: str
    planned: int
    until_decided: bool
    twins: str = ""
    runs: tuple[RunJudgement, ...] = ()


class CampaignCourse:
    """The course of a campaign: run by run, up to where the plan's own rule stops.

    Args:
        judgement: What is asked; its runs are not looked at.
        varies: Whether something is declared to vary in the case.

    Raises:
        ConfigurationError: For a rate, confidence or method that makes no sense.
    """

    def __init__(self, judgement: Judgement, *, varies: bool) -> None:
        self.question = judgement
        self.judge = CampaignJudge(
            judgement.requirement,
            judgement.case,
            planned=judgement.planned,
            component=judgement.component,
            until_decided=judgement.until_decided,
        )
        self.schedule = RunSchedule(judgement.planned, sequential=self.judge.sequential)
        self.runs: list[RunJudgement] = []
        self._situations = Situations(varies=varies)
        self._pairs: list[Pair] = []
        self._values: dict[str, tuple[float | None, float | None]] = {}

    @property
    def goes_on(self) -> bool:
        """Whether another run is due."""
        return len(self.runs) < self.schedule.end and not self.judge.decided

    @property
    def judgement(self) -> Judgement:
        """What is asked, with the runs so far."""
        return replace(self.question, runs=tuple(self.runs))

    def add(self, judged: RunJudgement, run: Run, twin: Run | None = None) -> None:
        """Take in the next run, or the next pair.

        Args:
            judged: What the question's check says of it.
            run: The run.
            twin: Its second run.
        """
        name = self.question.requirement.id
        sides = [run] if twin is None else [run, twin]
        if twin is None:
            verdict = run.verdict(name, judged.verdict)
        else:
            verdict = self._pair_verdict(judged, run, twin)
        if verdict.verdict != "violated":
            # A check of pairs compares two runs, and so sees the crash of neither.
            crashed = (side.episode for side in sides if side.is_unseen_crash)
            verdict = replace(verdict, unseen_crash=next(crashed, ""))
        self.judge.add(verdict)
        for side in sides:
            self._situations.add(side)
        self.judge.situation = self._situations.situation
        self.schedule.add(run.validity)
        self.runs.append(judged)

    def _pair_verdict(self, judged: RunJudgement, run: Run, twin: Run) -> EpisodeVerdict:
        requirement = self.question.requirement
        if judged.values is not None:
            self._values[run.episode] = judged.values
            return change_verdict(requirement, run, twin, judged.values)
        own = run.verdict(requirement.id, judged.verdict)
        other = twin.verdict(requirement.id, judged.twin_verdict)
        self._pairs.append(Pair(own, other, acted=run.recovered))
        return pair_verdict(own, other)

    def verdict(self) -> CampaignVerdict:
        """Return the verdict on the runs so far, with the table of pairs if there are any."""
        verdict, paired = self.judge.verdict(), self.question.requirement.paired
        if paired is None:
            return verdict
        table: dict[str, Any] = {"without": paired.without, "case": self.question.twins}
        if paired.measure:
            change = Change.between(paired.measure, self._values)
            return replace(verdict, pairs={**table, "change": change.to_json()})
        counts = judge_pairs(self._pairs)
        if paired.without == RECOVERY_ROLE and counts.unexplained:
            verdict = with_doubt(
                verdict,
                f"infrastructure: nondeterministic: {counts.unexplained} of {counts.pairs} pairs "
                "differ although recovery never acted in them",
            )
        return replace(verdict, pairs={**table, **counts.to_json()})


class Conclusion(NamedTuple):
    """Verdict on a campaign.

    Args:
        verdict: The verdict.
        beyond_plan: Numbers of runs beyond those that decide, which enter nothing.
    """

    verdict: CampaignVerdict
    beyond_plan: list[int]


def conclude_campaign(
    judgement: Judgement, known: Mapping[str, Run], *, varies: bool
) -> Conclusion:
    """Judge a campaign from recorded runs, in the order of their numbers.

    Args:
        judgement: What was asked.
        known: Recorded runs by digest, the second runs of pairs among them.
        varies: Whether something is declared to vary in the case.
    """
    course = CampaignCourse(judgement, varies=varies)
    by_number = {known[judged.digest].number: judged for judged in _recorded(judgement, known)}
    while course.goes_on and (judged := by_number.pop(len(course.runs), None)) is not None:
        course.add(judged, known[judged.digest], known.get(judged.twin))
    return Conclusion(course.verdict(), sorted(by_number))


def _recorded(judgement: Judgement, known: Mapping[str, Run]) -> Iterator[RunJudgement]:
    for judged in judgement.runs:
        if judged.digest in known and (not judged.twin or judged.twin in known):
            yield judged


def finite_or_infinite(value: float | None) -> float | None:
    """Replace NaN, which stands for no value as an infinite number does, and is no JSON."""
    return math.inf if value is not None and math.isnan(value) else value
