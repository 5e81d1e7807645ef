"""Judgements: what an item asks of the runs of a case, and the campaign's verdict that follows.

A judgement holds the question and names its runs; what a check says of a run stands with the run,
unless the item brought a check of its own. The verdict on the campaign is a function of both:
while runs are simulated, when the session ends, and whenever its evidence is read.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Annotated, Literal, NamedTuple

from pytest_dura.core.codec import Confidence, Count, Limit, Sha256, Share
from pytest_dura.requirements.campaign_judge import CampaignJudge, RunSchedule
from pytest_dura.requirements.campaign_verdicts import (
    CampaignVerdict,
    Situations,
    number_ranges,
    with_doubt,
)
from pytest_dura.requirements.episode_verdicts import CheckVerdict, EpisodeStatus, EpisodeVerdict
from pytest_dura.requirements.model import Method, Paired, Requirement
from pytest_dura.requirements.pairs import (
    Change,
    ChangeTable,
    Pair,
    PairTable,
    change_verdict,
    judge_pairs,
    pair_verdict,
    prevention_verdict,
)
from pytest_dura.requirements.runs import Run

RECOVERY_ROLE = "recovery_planner"


@dataclass(frozen=True, slots=True)
class RunJudgement:
    """A run, or a pair of runs, that a judgement rests on."""

    digest: Sha256
    """Digest of the run."""
    run: Count
    """Number of the run."""
    twin: Annotated[str, Limit(pattern=r"^([0-9a-f]{64})?$")] = ""
    """Digest of the second run; empty without one."""
    verdict: CheckVerdict | None = None
    """What the question's check says of the run; null where the run itself has the verdict on that
    requirement, and where a measure is compared."""
    twin_verdict: CheckVerdict | None = None
    """The same of the second run."""
    values: tuple[float | None, float | None] | None = None
    """The measure of both runs; null of a run that is invalid, missing or not whole, infinite where
    it has no value."""
    reference: Annotated[str, Limit(pattern=r"^([0-9a-f]{64})?$")] = ""
    """Digest of the third run, of a reference; empty without one."""
    reference_verdict: CheckVerdict | None = None
    """What the question's check says of the third run, as of the others."""


@dataclass(frozen=True, slots=True)
class Assertion:
    """What the own assertions of a test on one episode came to."""

    alone: bool
    """Whether they decide, since the requirement's check does not apply."""
    by_check: bool
    """Whether the requirement's check is violated, whatever the test asserts."""
    observed: tuple[str, ...]
    """What the test read of the episode."""
    false: tuple[str, ...]
    """Checks that it asked for, and that were false although it passed."""
    failed: str
    """Which assertion failed; empty if none did."""


@dataclass(frozen=True, slots=True)
class Judgement:
    """What an item asks of the runs of a case. Verdicts are concluded from these and the runs."""

    kind: Literal["claim", "campaign", "test"]
    """`claim`: what an item is to decide, noted before it does. `campaign`: a requirement on the
    runs of a case. `test`: what a test asserts of one episode."""
    requirement: str
    """Id of the requirement."""
    case: str
    """Id of the case."""
    component: str
    """Name of the component under test."""
    planned: Count
    """Runs that are planned, or may be run at most."""
    check: str = ""
    """What judges each run: a formula or the import path of a function; empty where the test
    does."""
    paired: Paired | None = None
    """For a requirement on pairs of runs."""
    at_most: Share | None = None
    """Greatest acceptable rate of violations; null accepts none."""
    confidence: Confidence = 0.95
    """One-sided confidence of the bound on that rate."""
    method: Method | None = None
    """How a rate is decided; null for the default."""
    p0: Share | None = None
    """For `sprt`: the rate below `at_most` up to which a component is rarely rejected."""
    until_decided: bool = False
    """Whether runs end as soon as the requirement is decided."""
    twins: str = ""
    """Id of the case of the second runs; empty unless pairs are judged."""
    references: str = ""
    """Id of the case of the third runs, of a reference; empty without them."""
    runs: tuple[RunJudgement, ...] = ()
    """The runs that it rests on, in the order in which they were judged; none for a claim."""
    assertion: Assertion | None = None
    """What the assertions of a test came to; null for others."""
    item: str = ""
    """Node id of the item that asks."""
    decides: str = ""
    """Node id under which the verdict is recorded: that of the item, of the first of several that
    repeat one test, or, where there is an item for each run, that of the test."""
    recorded_as: str = ""
    """Node id of the first of several items that repeat one test; empty where nothing does."""
    attempt: Count = 0
    """Number of the attempt at the item, from 1; 0 for a claim."""

    @property
    def asked(self) -> Requirement:
        """The requirement as far as it decides: with the check, the rate and the method."""
        return Requirement(
            self.requirement,
            check=self.check,
            at_most=self.at_most,
            confidence=self.confidence,
            method=self.method,
            p0=self.p0,
            paired=self.paired,
        )

    def contradictions(self) -> Iterator[str]:
        """Yield what a judgement of its kind does not have."""
        kind, by_test, is_claim = self.kind, self.kind == "test", self.kind == "claim"
        asked = self.until_decided or self.twins or self.paired or self.check
        if is_claim and (self.runs or asked):
            yield "a claim, and it asks something of runs"
        if not by_test and self.decides != (self.recorded_as or self.item):
            yield f"a {kind} of {self.item}, recorded as {self.decides}"
        if is_claim != (self.attempt == 0):
            yield f"a {kind} of attempt {self.attempt}"
        if by_test != (self.assertion is not None) or (by_test and len(self.runs) != 1):
            yield f"a {kind} on {len(self.runs)} runs, with the assertion {self.assertion}"
        if bool(self.twins) != (self.paired is not None):
            yield f"second runs of {self.twins!r}, and pairs as in {self.paired}"
        if self.references and not (self.paired is not None and self.paired.prevents):
            yield "third runs, and no reference"

    @property
    def status(self) -> EpisodeStatus:
        """What a test says of its episode."""
        (run,) = self.runs
        assert run.verdict is not None
        return run.verdict.status


@dataclass(frozen=True, slots=True)
class Doubt:
    """Why the episodes of a case cannot be trusted, whatever their verdicts."""

    case: str
    """Id of the case."""
    component: str
    """Name of the component under test."""
    reason: str
    """Such as two digests of one episode."""


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
        self.requirement = judgement.asked
        self.judge = CampaignJudge(
            self.requirement,
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

    def add(
        self, judged: RunJudgement, run: Run, twin: Run | None = None, reference: Run | None = None
    ) -> None:
        """Take in the next run, or the next pair.

        Args:
            judged: What the question's check says of it.
            run: The run.
            twin: Its second run.
            reference: Its third run.
        """
        name, paired = self.requirement.id, self.requirement.paired
        sides = [side for side in (run, twin, reference) if side is not None]
        if twin is None:
            verdict = run.verdict(name, judged.verdict)
        else:
            verdict = self._pair_verdict(judged, run, twin, reference)
        if verdict.verdict != "violated":
            # A check of pairs compares two runs, and so sees the crash of neither.
            # That of a reference is not the component's.
            own = sides[:-1] if paired is not None and paired.reference else sides
            crashed = (side.episode for side in own if side.is_unseen_crash)
            verdict = replace(verdict, unseen_crash=next(crashed, ""))
        self.judge.add(verdict)
        for side in sides:
            self._situations.add(side)
        self.judge.situation = self._situations.situation
        self.schedule.add(run.validity)
        self.runs.append(judged)

    def _pair_verdict(
        self, judged: RunJudgement, run: Run, twin: Run, reference: Run | None
    ) -> EpisodeVerdict:
        requirement = self.requirement
        if judged.values is not None:
            self._values[run.episode] = judged.values
            return change_verdict(requirement, run, twin, judged.values)
        own = run.verdict(requirement.id, judged.verdict)
        # The second run may be another component's; a pair is about the component under test.
        other = replace(twin.verdict(requirement.id, judged.twin_verdict), component=run.component)
        if reference is None:
            self._pairs.append(Pair(own, other, acted=run.recovered))
            return pair_verdict(own, other)
        third = reference.verdict(requirement.id, judged.reference_verdict)
        third = replace(third, component=run.component)
        self._pairs.append(Pair(own, other, acted=run.recovered, reference=third))
        return prevention_verdict(own, other, third)

    def verdict(self) -> CampaignVerdict:
        """Return the verdict on the runs so far, with the table of pairs if there are any."""
        asked, paired = self.question, self.requirement.paired
        verdict = replace(self.judge.verdict(), check=asked.check, paired=paired)
        if paired is None:
            return verdict
        if paired.measure:
            change = Change.between(paired.measure, self._values)
            table = ChangeTable(paired.without, self.question.twins, change, paired.reference)
            return replace(verdict, pairs=table)
        counts = judge_pairs(self._pairs)
        if paired.without == RECOVERY_ROLE and counts.unexplained:
            verdict = with_doubt(
                verdict,
                f"infrastructure: nondeterministic: {counts.unexplained} of {counts.pairs} pairs "
                "differ although recovery never acted in them",
            )
        return replace(
            verdict,
            pairs=PairTable(
                **{f.name: getattr(counts, f.name) for f in fields(counts)},
                without=paired.without,
                case=self.question.twins,
                reference=paired.reference,
            ),
        )


class Conclusion(NamedTuple):
    """Verdict on a campaign.

    Args:
        verdict: The verdict.
        beyond_plan: Numbers of runs beyond those that decide, which enter nothing.
        judged: Verdicts on the runs that enter it, in their order.
    """

    verdict: CampaignVerdict
    beyond_plan: list[int]
    judged: Sequence[EpisodeVerdict]


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
    by_number: dict[int, RunJudgement] = {}
    for judged in judgement.runs:
        others = filter(None, (judged.twin, judged.reference))
        if judged.digest in known and all(digest in known for digest in others):
            by_number[known[judged.digest].number] = judged
    while course.goes_on and (due_run := by_number.pop(len(course.runs), None)) is not None:
        second, third = known.get(due_run.twin), known.get(due_run.reference)
        course.add(due_run, known[due_run.digest], second, third)
    if course.goes_on and by_number:
        # The order decides: what follows a gap is not judged before the gap is filled.
        due = range(len(course.runs), max(by_number))
        missing = [number for number in due if number not in by_number]
        runs, are = ("runs", "are") if missing[1:] else ("run", "is")
        doubt = f"{runs} {number_ranges(missing)} {are} missing"
        return Conclusion(with_doubt(course.verdict(), doubt), [], course.judge.verdicts)
    return Conclusion(course.verdict(), sorted(by_number), course.judge.verdicts)


def _recorded(judgement: Judgement, known: Mapping[str, Run]) -> Iterator[RunJudgement]:
    for judged in judgement.runs:
        others = filter(None, (judged.twin, judged.reference))
        if judged.digest in known and all(digest in known for digest in others):
            yield judged


def finite_or_infinite(value: float | None) -> float | None:
    """Replace NaN, which stands for no value as an infinite number does, and is no JSON."""
    return math.inf if value is not None and math.isnan(value) else value
