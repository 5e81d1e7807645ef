"""Verdicts: what the questions of a session come to, concluded from its judgements and its runs.

The session's end, the verification of its evidence and a merge conclude them alike.
"""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from operator import attrgetter
from typing import Any

from pytest_dura.core.codec import encode
from pytest_dura.evidence.case_model import CasePlan, RepeatEntry
from pytest_dura.evidence.conclusions.conclusion import Conclusion
from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.evidence.gate import with_repeats
from pytest_dura.evidence.item_verdicts import (
    AssertionSummary,
    FailedAssertion,
    FalseCheck,
    ItemVerdict,
    Waiver,
)
from pytest_dura.evidence.model import RecordHead
from pytest_dura.evidence.searches import searched_claims
from pytest_dura.requirements.campaign_judge import judge_campaign
from pytest_dura.requirements.campaign_verdicts import (
    STOPPED,
    CampaignVerdict,
    Situation,
    Situations,
    doubted,
    varies,
)
from pytest_dura.requirements.drafts import unsigned_reason
from pytest_dura.requirements.episode_verdicts import EpisodeVerdict
from pytest_dura.requirements.judgements import Judgement, RunJudgement, conclude_campaign
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.runs import Run

CaseKey = tuple[str, str]
"""Case and component."""
UNKNOWN_COMPONENT = "unknown"
"""Name of a component that a conftest defines, until the first episode reports it."""
_WORST_VERDICT_FIRST = ("violated", "undecided", "supported")
_WORST_STATUS_FIRST = ("violated", "missing", "open", "invalid", "satisfied")
_MAX_OBSERVED = 50
"""Greatest number of names that a test looked at."""
_MAX_FAILED = 10
"""Greatest number of episodes with the assertion that failed there."""


@dataclass
class VerdictLines:
    """What verdicts are concluded from, episodes apart.

    Args:
        judgements: What items asked, in any order; the same one may stand there twice.
        cases: By id and component.
        requirements: By id.
        waivers: By the node id of the item that each excuses.
        repeats: Results of repeating an episode, by case and component.
        doubts: Why episodes of a case cannot be trusted, by case and component.
        searched: Item, requirement and case of what was searched instead of decided.
        stopped: Why items judged no run, by node id.
    """

    judgements: Sequence[Judgement]
    cases: Mapping[CaseKey, CasePlan]
    requirements: Mapping[str, Requirement]
    waivers: Mapping[str, Waiver] = field(default_factory=dict)
    repeats: Mapping[CaseKey, RepeatEntry | None] = field(default_factory=dict)
    doubts: Mapping[CaseKey, str] = field(default_factory=dict)
    searched: Collection[tuple[str, str, str]] = ()
    stopped: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, head: RecordHead) -> VerdictLines:
        """Select them from the head of a record."""
        cases = {(case.id, case.component): case for case in head.cases}
        return cls(
            head.judgements,
            cases,
            {requirement.id: requirement for requirement in head.requirements},
            head.waivers,
            {key: case.repeat for key, case in cases.items()},
            {(doubt.case, doubt.component): doubt.reason for doubt in head.doubts},
            searched_claims(head.searches),
            head.stopped_items or {},
        )


class Runs:
    """The planned runs of a session, and whether those of a case are all equal.

    Args:
        cases: By id and component.
        requirements: By id.
    """

    def __init__(
        self, cases: Mapping[CaseKey, CasePlan], requirements: Mapping[str, Requirement]
    ) -> None:
        self._cases = cases
        self._alone = {name for name, known in requirements.items() if known.judges_crashes}
        self._by_digest: dict[str, Run] = {}
        self._by_number: dict[tuple[str, str, int], list[Run]] = defaultdict(list)
        self._situations: dict[CaseKey, Situations] = {}
        self.cases: set[str] = set()
        """Ids of cases with any episode, planned or not."""

    def add(self, episode: EpisodeEntry) -> None:
        """Take in an episode of the record."""
        key = episode.case, episode.component
        self.cases.add(episode.case)
        case = self._cases.get(key)
        if not episode.planned or case is None:
            return
        alone = self._alone.intersection(case.requirements)  # what a single run can violate
        verdicts, metrics = episode.verdicts, episode.metrics
        run = Run(
            episode=episode.id,
            case=episode.case,
            number=episode.spec.run,
            component=episode.component,
            digest=episode.digest,
            validity=episode.validity,
            termination=episode.termination,
            failure=episode.failure,
            invalid_reason=episode.invalid_reason,
            proposals=metrics.proposals,
            valid_proposals=metrics.valid_proposals,
            not_manifested=tuple(f.id for f in episode.faults if f.manifested_at is None),
            recovered=metrics.recoveries > 0,
            trajectory=episode.trajectory,
            drawn=episode.drawn,
            verdicts=verdicts,
            violates=any(verdicts[name].status == "violated" for name in alone if name in verdicts),
        )
        self.take(run)
        if key not in self._situations:
            faults = {fault.id for fault in case.faults}
            self._situations[key] = Situations(varies=varies(case.variation, faults))
        self._situations[key].add(run)

    def take(self, run: Run) -> None:
        """Take in a planned run."""
        self._by_digest[run.digest] = run
        self._by_number[run.case, run.component, run.number].append(run)

    def find(self, case: str, component: str, number: int, digest: str) -> Run | None:
        """Find a run by its digest, or by its number where one run alone has that.

        An episode that was simulated twice, and came out differently, is recorded once.
        """
        if digest in self._by_digest:
            return self._by_digest[digest]
        numbered = self._by_number.get((case, component, number), [])
        return numbered[0] if len(numbered) == 1 else None

    def situation(self, case: str, component: str) -> Situation | None:
        """What the planned runs of a case are, if all of them are equal."""
        known = self._situations.get((case, component))
        return None if known is None else known.situation


class Verdicts(Conclusion):
    """Concludes the key ``verdicts``."""

    def __init__(self, head: RecordHead) -> None:
        super().__init__(head)
        lines = VerdictLines.of(head)
        self._runs = Runs(lines.cases, lines.requirements)

    def add(self, episode: EpisodeEntry) -> None:
        """Add an episode."""
        self._runs.add(episode)

    def concluded(self, head: RecordHead) -> Mapping[str, Any]:
        """Conclude them from judgements and runs."""
        return {"verdicts": conclude_verdicts(VerdictLines.of(head), self._runs)}


def conclude_verdicts(lines: VerdictLines, runs: Runs) -> list[ItemVerdict]:
    """Conclude all verdicts, also on what never reported, sorted by case and requirement.

    Args:
        lines: What was asked, and what bears on it.
        runs: The runs of the session.
    """
    return _conclude(lines, runs)[0]


def judged_runs(
    lines: VerdictLines, runs: Runs
) -> Mapping[tuple[str, ...], Sequence[EpisodeVerdict]]:
    """Conclude all verdicts, and return those on the runs behind each, by its question.

    Args:
        lines: What was asked, and what bears on it.
        runs: The runs of the session.
    """
    return _conclude(lines, runs)[1].judged


def _conclude(lines: VerdictLines, runs: Runs) -> tuple[list[ItemVerdict], _Verdicts]:
    campaigns: dict[tuple[str, ...], list[Judgement]] = defaultdict(list)
    tests: dict[tuple[str, ...], list[Judgement]] = defaultdict(list)
    claims: dict[tuple[str, str, str], Judgement] = {}
    for judgement in lines.judgements:
        about = judgement.requirement, judgement.case, judgement.component
        if judgement.kind == "campaign":
            campaigns[question_of(judgement)].append(judgement)
        elif judgement.kind == "test":
            # Two tests on one episode give two verdicts, not two attempts at one.
            test = judgement.decides, *about
            tests[test].append(judgement)
        else:
            claims.setdefault((judgement.decides, *about[:2]), judgement)
    conclusion = _Verdicts(lines, runs)
    verdicts = [conclusion.of_campaign(key[0], asked) for key, asked in campaigns.items()]
    verdicts += [conclusion.of_test(key[0], asked) for key, asked in tests.items()]
    reported = {(verdict.item, verdict.requirement, verdict.case) for verdict in verdicts}
    for key, claim in claims.items():
        if key not in reported and key not in lines.searched:
            verdicts.append(conclusion.unanswered(claim))
    ordered = sorted(verdicts, key=attrgetter("case", "requirement", "item"))
    return [conclusion.qualified(verdict) for verdict in ordered], conclusion


def runs_beyond_plan(verdicts: Iterable[ItemVerdict]) -> dict[CaseKey, set[int]]:
    """Number the runs of each case and component that lie beyond every decision on it."""
    beyond: dict[CaseKey, set[int]] = defaultdict(set)
    needed: dict[CaseKey, int] = defaultdict(int)
    for verdict in verdicts:
        # Each test on single episodes looks at runs of its own.
        runs = verdict.planned if verdict.assertion is not None else verdict.run
        for case in {verdict.case, verdict.pairs.case if verdict.pairs else verdict.case}:
            key = case, verdict.component
            beyond[key].update(verdict.beyond_plan)
            needed[key] = max(needed[key], runs)
    return {
        key: {number for number in numbers if number >= needed[key]}
        for key, numbers in beyond.items()
        if numbers
    }


def test_function(item: str) -> str:
    """Remove the parameters from a node id."""
    return item.partition("[")[0]


def question_of(judgement: Judgement) -> tuple[str, ...]:
    """Identify what a judgement asks: the item, requirement, case, component and question."""
    question = [
        judgement.check, encode(judgement.paired), judgement.method, judgement.at_most,
        judgement.confidence, judgement.until_decided,
    ]  # fmt: skip
    about = judgement.requirement, judgement.case, judgement.component
    return judgement.decides, *about, json.dumps(question, sort_keys=True)


def question_key(item: str, verdict: CampaignVerdict) -> tuple[str, ...]:
    """Identify what a verdict answers: the item, requirement, case, component and question."""
    paired = encode(verdict.paired)
    bound = verdict.bound
    question = [verdict.check, paired, verdict.method, bound.at_most, bound.confidence]
    about = verdict.requirement, verdict.case, verdict.component
    return item, *about, json.dumps(question, sort_keys=True)


@dataclass
class _Verdicts:
    """Concludes the verdict on one question after the other."""

    lines: VerdictLines
    runs: Runs
    judged: dict[tuple[str, ...], Sequence[EpisodeVerdict]] = field(default_factory=dict)
    """Verdicts on the runs behind each verdict, by its question."""

    @cached_property
    def _first_waived(self) -> dict[str, str]:
        """The first waived item of each test."""
        return {test_function(item): item for item in sorted(self.lines.waivers, reverse=True)}

    def of_campaign(self, item: str, asked: Sequence[Judgement]) -> ItemVerdict:
        """Conclude the verdict of one or several attempts, by one or several items.

        Of several attempts at an item a violation counts before anything else, and of several items
        the worst verdict; all of them are kept.
        """
        attempts: dict[str, list[CampaignVerdict]] = {}
        behind: list[tuple[CampaignVerdict, Sequence[EpisodeVerdict]]] = []
        for judgement in _joined(asked):
            attempt, judged = self._attempt(judgement)
            behind.append((attempt, judged))
            attempts.setdefault(judgement.item, []).append(attempt)
        counting = {name: _counting_attempt(entries) for name, entries in attempts.items()}
        verdict = min(counting.values(), key=lambda one: _WORST_VERDICT_FIRST.index(one.verdict))
        self.judged[question_key(item, verdict)] = next(
            judged for attempt, judged in behind if attempt is verdict
        )
        waivers = [self.lines.waivers[name] for name in attempts if name in self.lines.waivers]
        bad = {name for name, entry in counting.items() if entry.verdict != "supported"}
        return item_verdict(
            verdict,
            item,
            waiver=waivers[0] if waivers and bad <= self.lines.waivers.keys() else None,
            attempts=[
                entry for entries in attempts.values() for entry in entries if entry is not verdict
            ],
        )

    def _attempt(self, judgement: Judgement) -> tuple[CampaignVerdict, Sequence[EpisodeVerdict]]:
        """Conclude a campaign from its runs."""
        key = judgement.case, judgement.component
        case, judged = self.lines.cases.get(key), list[RunJudgement]()
        known: dict[str, Run] = {}
        for each in judgement.runs:
            run = self.runs.find(*key, each.run, each.digest)
            twin = self.runs.find(judgement.twins, key[1], each.run, each.twin)
            third = self.runs.find(judgement.references, key[1], each.run, each.reference)
            if run is None or (each.twin and not twin) or (each.reference and not third):
                continue
            known |= {side.digest: side for side in (run, twin, third) if side is not None}
            second = twin.digest if each.twin and twin is not None else ""
            last = third.digest if each.reference and third is not None else ""
            judged.append(replace(each, digest=run.digest, twin=second, reference=last))
        faults = set() if case is None else {fault.id for fault in case.faults}
        declared = varies(() if case is None else case.variation, faults)
        found = replace(judgement, runs=tuple(judged))
        verdict, beyond, on_runs = conclude_campaign(found, known, varies=declared)
        return replace(verdict, beyond_plan=tuple(beyond)), on_runs

    def of_test(self, test: str, asked: Sequence[Judgement]) -> ItemVerdict:
        """Conclude the verdict of a test that looks at one episode at a time."""
        # In an order of their own: they are reported in any.
        outcomes = sorted({*asked}, key=lambda each: (each.runs[0].run, each.item, each.attempt))
        final = _final_outcomes(outcomes)
        verdict = self._judge_test(outcomes)
        self.judged[question_key(test, verdict)] = self._worst_of_each_episode(final)
        attempts = [self._judge_test(seen) for seen in _outcomes_by_attempt(outcomes)]
        if verdict in attempts:
            attempts.remove(verdict)
        # All that is bad about it has to come from waived items.
        known = self.lines.waivers
        waivers = [known[outcome.item] for outcome in final if outcome.item in known]
        bad = {outcome.item for outcome in final if outcome.status != "satisfied"}
        excused = bad <= known.keys() and verdict.run >= verdict.planned
        return item_verdict(
            verdict,
            test,
            waiver=waivers[0] if waivers and excused else None,
            attempts=attempts,
            assertion=assertion_summary(final),
        )

    def _judge_test(self, outcomes: Sequence[Judgement]) -> CampaignVerdict:
        first = outcomes[0]
        # Tests are a fixed number, and run in no fixed order: no sequential method applies.
        judged_by = replace(
            self._requirement(first.requirement),
            at_most=first.at_most,
            confidence=first.confidence,
            method=None,
            p0=None,
        )
        planned = max(outcome.planned for outcome in outcomes)
        final = self._worst_of_each_episode(_final_outcomes(outcomes))
        # Each run is a test of its own: none is saved where all runs are equal.
        whole = len(final) >= planned > 1
        situation = self.runs.situation(first.case, first.component) if whole else None
        return judge_campaign(
            judged_by,
            first.case,
            final,
            planned=planned,
            component=first.component,
            situation=situation,
        )

    def _worst_of_each_episode(self, final: Iterable[Judgement]) -> list[EpisodeVerdict]:
        """Select the worst verdict on each episode, which several parameters of a test may judge.

        Args:
            final: Of :func:`_final_outcomes`.
        """
        worst: dict[str, EpisodeVerdict] = {}
        ordered = sorted(final, key=lambda entry: _WORST_STATUS_FIRST.index(entry.status))
        for outcome in ordered:
            (each,) = outcome.runs
            run = self.runs.find(outcome.case, outcome.component, each.run, each.digest)
            if run is not None and each.verdict is not None:
                verdict = run.verdict(outcome.requirement, each.verdict)
                crash = run.episode if run.is_unseen_crash else ""
                unseen = crash if verdict.verdict != "violated" else ""
                worst.setdefault(run.episode, replace(verdict, unseen_crash=unseen))
        return sorted(worst.values(), key=lambda verdict: int(verdict.episode.rpartition("#")[2]))

    def unanswered(self, claim: Judgement) -> ItemVerdict:
        """Make the verdict on what was to be decided, and was not."""
        item = claim.decides
        verdict = judge_campaign(
            self._requirement(claim.requirement),
            claim.case,
            [],
            planned=claim.planned,
            component=claim.component,
        )
        if item != f"{claim.case}::{claim.requirement}":
            # Its episodes may have run: what was not made is the verdict.
            verdict = replace(verdict, reason="the test ended without a verdict on it")
        elif claim.case in self.runs.cases:
            reason = "episodes of the case ran, and no verdict was made on them"
            verdict = replace(verdict, reason=reason)
        if why := self.lines.stopped.get(item):
            verdict = replace(verdict, reason=f"{STOPPED}{why}")
        waivers = self.lines.waivers
        waived = item if item in waivers else self._first_waived.get(item, "")
        return item_verdict(verdict, item, waiver=waivers.get(waived))

    def _requirement(self, name: str) -> Requirement:
        return self.lines.requirements.get(name) or Requirement(name)

    def qualified(self, verdict: ItemVerdict) -> ItemVerdict:
        """Apply doubts about the requirement, and about the case's episodes."""
        of_case = self.lines.doubts.get((verdict.case, verdict.component), "")
        for doubt in (unsigned_reason(self._requirement(verdict.requirement)), of_case):
            verdict = replace(verdict, **doubted(verdict.verdict, verdict.reason, doubt))
        cases = [verdict.case, *([verdict.pairs.case] if verdict.pairs else [])]
        repeats = [self.lines.repeats.get((case, verdict.component)) for case in cases]
        changed = with_repeats(verdict.verdict, verdict.reason, repeats, verdict.component)
        return replace(verdict, **changed)


def joined_lines(judgements: Iterable[Judgement]) -> list[Judgement]:
    """Join the lines of several parts: each once, and what they say of one campaign in one."""
    lines = dict.fromkeys(judgements)
    campaigns: dict[tuple[str, ...], list[Judgement]] = defaultdict(list)
    for judgement in lines:
        if judgement.kind == "campaign":
            campaigns[question_of(judgement)].append(judgement)
    others = [judgement for judgement in lines if judgement.kind != "campaign"]
    return [*others, *(each for asked in campaigns.values() for each in _joined(asked))]


def _joined(asked: Iterable[Judgement]) -> list[Judgement]:
    """Join what one attempt asks several times, or what parts of a session say of one plan.

    Where a check says two things of one run, both judgements stay.
    """
    joined: list[Judgement] = []
    ordered = sorted(asked, key=lambda one: (one.item, one.attempt, json.dumps(encode(one.runs))))
    for judgement in ordered:
        last = joined[-1] if joined else None
        if last is not None and (last.item, last.attempt) == (judgement.item, judgement.attempt):
            known = {run.run: run for run in last.runs}
            if all(known.get(run.run, run) == run for run in judgement.runs):
                known.update({run.run: run for run in judgement.runs})
                joined[-1] = replace(
                    last,
                    planned=max(last.planned, judgement.planned),
                    runs=tuple(known[number] for number in sorted(known)),
                )
                continue
        joined.append(judgement)
    return joined


def item_verdict(
    attempt: CampaignVerdict,
    item: str,
    *,
    waiver: Waiver | None = None,
    attempts: Sequence[CampaignVerdict] = (),
    assertion: AssertionSummary | None = None,
) -> ItemVerdict:
    """Make the verdict of an item of one on a campaign."""
    return ItemVerdict(
        **{field.name: getattr(attempt, field.name) for field in fields(CampaignVerdict)},
        item=item,
        waiver=waiver,
        attempts=tuple(attempts),
        assertion=assertion,
    )


def _counting_attempt(attempts: Sequence[CampaignVerdict]) -> CampaignVerdict:
    """Select the attempt at an item that counts: the first violation, else the last attempt."""
    return next((entry for entry in attempts if entry.verdict == "violated"), attempts[-1])


def _final_outcomes(outcomes: Sequence[Judgement]) -> list[Judgement]:
    """Select one attempt of each item: a violation if there is one, else the last."""
    final: dict[str, Judgement] = {}
    for outcome in outcomes:
        before = final.get(outcome.item)
        if before is None or before.status != "violated":
            final[outcome.item] = outcome
    return list(final.values())


def _outcomes_by_attempt(outcomes: Sequence[Judgement]) -> Iterator[list[Judgement]]:
    """Yield what each attempt at a test came to, where there are several.

    An attempt has the outcome of each item by then: not every item is run again. Items that repeat
    a test make an attempt of their own.
    """
    repeated: dict[str, list[str]] = {}
    for outcome in sorted(outcomes, key=attrgetter("item")):
        items = repeated.setdefault(outcome.recorded_as or outcome.item, [])
        if outcome.item not in items:
            items.append(outcome.item)
    place = {item: number for items in repeated.values() for number, item in enumerate(items)}
    numbers = sorted({(place[outcome.item], outcome.attempt) for outcome in outcomes})
    if len(numbers) == 1:
        return
    for repetition, number in numbers:
        latest = {
            outcome.item: outcome
            for outcome in outcomes
            if place[outcome.item] == repetition and outcome.attempt <= number
        }
        yield list(latest.values())


def assertion_summary(final: Sequence[Judgement]) -> AssertionSummary:
    """Summarise the assertions of a test over all episodes that it looked at.

    Args:
        final: Of :func:`_final_outcomes`.
    """
    assertions = [
        (f"{outcome.case}#{outcome.runs[0].run}", outcome.assertion)
        for outcome in final
        if outcome.assertion is not None
    ]
    false = Counter(check for _, assertion in assertions for check in assertion.false)
    observed = {name for _, assertion in assertions for name in assertion.observed}
    failed = sorted((name, entry.failed) for name, entry in assertions if entry.failed)
    return AssertionSummary(
        alone=all(assertion.alone for _, assertion in assertions),
        by_check=sum(assertion.by_check for _, assertion in assertions),
        observed=tuple(sorted(observed)[:_MAX_OBSERVED]),
        false=tuple(FalseCheck(name, false[name]) for name in sorted(false)[:_MAX_OBSERVED]),
        failed=tuple(FailedAssertion(name, why) for name, why in failed[:_MAX_FAILED]),
    )
