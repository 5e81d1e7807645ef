"""Judgements: what items asked, in order; ``verify`` compares the runs that they name."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Container, Iterator, Mapping
from functools import cached_property
from typing import Any, NamedTuple

from pytest_dura.evidence.conclusions.conclusion import Conclusion
from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.evidence.model import RecordHead
from pytest_dura.evidence.searches import searched_claims
from pytest_dura.requirements.episode_verdicts import CheckVerdict
from pytest_dura.requirements.judgements import Judgement
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.searches import SEARCHED_MARK


def judgement_order(judgement: Judgement) -> tuple[str | int, ...]:
    """Sort key of judgements."""
    about = judgement.requirement, judgement.case, judgement.component
    return judgement.item, judgement.attempt, *about, judgement.kind, judgement.check


class _NamedRun(NamedTuple):
    """A run that a judgement names, and what its own check says of it."""

    judgement: Judgement
    case: str
    number: int
    verdict: CheckVerdict | None

    def contradictions(self, episode: EpisodeEntry) -> Iterator[str]:
        """Yield the contradictions with the episode of the run."""
        if self.case != episode.case:
            yield f"of the case {episode.case}, and not of {self.case}"
        if self.number != episode.spec.run:
            yield f"run {episode.spec.run}, and not {self.number}"
        if self.verdict is None:
            return
        yield from episode.contradictions_of(self.verdict)
        own = episode.verdicts.get(self.judgement.requirement)
        by_test = self.judgement.kind == "test" and self.verdict.status == "satisfied"
        if by_test and own is not None and own.status != "satisfied":
            yield f"{self.verdict.status}, and {own.status} by the check of the requirement"


def _place(judgement: Judgement) -> str:
    return f"judgement {judgement.requirement} on {judgement.case} by {judgement.item}"


class Judgements(Conclusion):
    """Concludes the order of the key ``judgements``."""

    def add(self, episode: EpisodeEntry) -> None:
        """Take no episode in: what a judgement says of one stands in it."""

    def concluded(self, head: RecordHead) -> Mapping[str, Any]:
        """Sort them."""
        return {"judgements": sorted(head.judgements, key=judgement_order)}

    @cached_property
    def _named(self) -> dict[str, list[_NamedRun]]:
        """The runs that judgements name and that were not found yet, by their digests."""
        named: dict[str, list[_NamedRun]] = defaultdict(list)
        for judgement in self.head.judgements:
            for run in judgement.runs:
                for case, digest, verdict in (
                    (judgement.case, run.digest, run.verdict),
                    (judgement.twins, run.twin, run.twin_verdict),
                    (judgement.references, run.reference, run.reference_verdict),
                ):
                    if digest:
                        named[digest].append(_NamedRun(judgement, case, run.run, verdict))
        return named

    def check(self, episode: EpisodeEntry) -> Iterator[str]:
        """Yield what judgements on an episode cannot say of it."""
        for each in self._named.pop(episode.digest, ()):
            for problem in each.contradictions(episode):
                yield f"{_place(each.judgement)}: {episode.id} is {problem}"

    def check_head(self) -> Iterator[str]:
        """Yield the contradictions within judgements, and with what the head lists."""
        cases = {(case.id, case.component): case for case in self.head.cases}
        requirements = {requirement.id: requirement for requirement in self.head.requirements}
        searched = searched_claims(self.head.searches)
        references: dict[str, set[str]] = defaultdict(set)
        for listed in self.head.cases:
            references[listed.reference or ""].add(listed.id)
        for judgement in self.head.judgements:
            case = cases.get((judgement.case, judgement.component))
            problems = [
                *_unlisted_arms(judgement, cases, references),
                *judgement.contradictions(),
                *_other_question(judgement, requirements.get(judgement.requirement)),
            ]
            about = judgement.decides, judgement.requirement, judgement.case
            runs_none = about in searched and not judgement.runs
            if SEARCHED_MARK in judgement.case and about not in searched:
                problems.append("a search chose the case, and no rate can be made of it")
            if case is None and about not in searched:
                problems.append("the case is not listed")
            elif case is not None and judgement.planned > case.planned and not runs_none:
                problems.append(f"{judgement.planned} runs planned, and {case.planned} of its case")
            yield from (f"{_place(judgement)}: {problem}" for problem in problems)
        doubtful = {(doubt.case, doubt.component) for doubt in self.head.doubts}
        for each in (each for entries in self._named.values() for each in entries):
            if (each.judgement.case, each.judgement.component) not in doubtful:
                yield f"{_place(each.judgement)}: one of its runs is not recorded"


def _unlisted_arms(
    judgement: Judgement,
    cases: Container[tuple[str, str]],
    references: Mapping[str, Container[str]],
) -> Iterator[str]:
    """Yield which cases of second and third runs are not listed."""
    paired, of_component = judgement.paired, (judgement.twins, judgement.component)
    listed: Container[str] = references.get(paired.reference, ()) if paired is not None else ()
    is_reference = paired is not None and bool(paired.reference) and not paired.without
    known = of_component in cases or not judgement.twins
    if not (judgement.twins in listed if is_reference else known):
        yield "the case of its second runs is not listed"
    if paired is not None and paired.prevents and judgement.references not in listed:
        yield "the case of its third runs is not listed"


def _other_question(judgement: Judgement, requirement: Requirement | None) -> Iterator[str]:
    """Compare check and limits with those of the requirement, as far as it has any."""
    if requirement is None:
        yield "the requirement is not listed"
    elif judgement.kind != "claim":
        if requirement.check and judgement.check not in ("", requirement.check):
            check = f"its check is {requirement.check!r}"
            yield f"judged by {judgement.check!r}, and {check}"
        limits = judgement.at_most, judgement.confidence
        if requirement.at_most is not None and limits != (
            requirement.at_most, requirement.confidence,
        ):  # fmt: skip
            yield f"judged by {[*limits]}, and its rate and confidence are others"
