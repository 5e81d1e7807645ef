"""Laws of a test that other plugins retry or repeat: each attempt is kept, and the worst counts."""

from __future__ import annotations

import copy
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Literal

import pytest
from entries import make
from item_lines import report
from session_records import HEADER

from pytest_dura.core.codec import encode
from pytest_dura.evidence import RecordBuilder
from pytest_dura.evidence.case_model import CasePlan
from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.lines import Line
from pytest_dura.requirements.episode_verdicts import CheckVerdict
from pytest_dura.requirements.judgements import Assertion, Judgement, RunJudgement

Word = Literal["satisfied", "violated", "invalid"]
WORDS: tuple[Word, ...] = ("satisfied", "violated", "invalid")
TEST = "test_it.py::test_it"
ITEMS = [f"{TEST}[a/b#0-1-2]", f"{TEST}[a/b#0-2-2]"]
"""Two that repeat a test."""
CASE = make(
    CasePlan, id="a/b", scenario="a/b", component="C", requirements=["R"], planned=1
).to_json()

TRIED = [
    tried
    for number in (1, 2)
    for tried in itertools.product(WORDS, repeat=number)
    if "satisfied" not in tried[:-1]  # what has passed is not tried again
]
"""What the attempts at an item may come to."""


EPISODE = make(
    EpisodeEntry, id="a/b#0", case="a/b", component="C", planned=True, validity="valid",
    digest="d" * 64, trajectory="0" * 64, termination="goal",
).to_json()  # fmt: skip


def asked(kind: str, word: Word) -> Judgement:
    """What an attempt asks of the runs of a case, or asserts of an episode."""
    said = CheckVerdict(word, None, None, "", vacuous=False)
    judgement = Judgement(
        "campaign", "R", "a/b", "C", 1, "x", runs=(RunJudgement("d" * 64, 0, verdict=said),)
    )
    if kind == "campaign":
        return judgement
    assertion = Assertion(alone=True, by_check=False, observed=(), false=(), failed="")
    return replace(judgement, kind="test", check="", assertion=assertion)


def reports(kind: str, tried: Sequence[Word], item: str) -> Iterator[list[Line]]:
    """What the attempts at an item report, in their order."""
    for number, word in enumerate(tried, 1):
        yield report(
            item,
            ITEMS[0],
            number,
            retried=number > 1 and word == "satisfied",
            cases=[CASE],
            episodes=[copy.deepcopy(EPISODE)],
            judgements=[encode(asked(kind, word))],
        )


def recorded(kind: str, tries: Sequence[tuple[str, Sequence[Word]]]) -> ItemVerdict:
    """The one verdict of a session in which the items were tried in this order."""
    builder = RecordBuilder(HEADER)
    for item, tried in tries:
        for lines in reports(kind, tried, item):
            builder.add(lines)
        if tried[-1] != "satisfied":
            builder.fail(item)
    (verdict,) = builder.record("complete").head.verdicts
    builder.close()
    return verdict


@pytest.mark.parametrize("kind", ["campaign", "episode"])
def test_every_attempt_is_kept_and_the_worst_counts(kind: str) -> None:
    for tried in itertools.product(TRIED, repeat=2):
        verdict = recorded(kind, list(zip(ITEMS, tried, strict=True)))
        words = [word for attempts in tried for word in attempts]
        assert (verdict.verdict == "violated") == ("violated" in words)
        last = {attempts[-1] for attempts in tried}
        assert (verdict.verdict == "supported") == (
            "violated" not in words and "invalid" not in last
        )
        assert len(verdict.attempts) == len(words) - 1
        kept = [verdict.verdict, *(attempt.verdict for attempt in verdict.attempts)]
        assert kept.count("violated") == words.count("violated")
        assert kept.count("supported") == words.count("satisfied")


@pytest.mark.parametrize("kind", ["campaign", "episode"])
def test_a_failed_attempt_is_excused_only_if_all_items_pass_in_the_end(kind: str) -> None:
    for tried in itertools.product(TRIED, repeat=2):
        verdict = recorded(kind, list(zip(ITEMS, tried, strict=True)))
        pass_in_the_end = all(attempts[-1] == "satisfied" for attempts in tried)
        retried = any(len(attempts) > 1 for attempts in tried)
        assert (verdict.waiver is not None) == (pass_in_the_end and retried)


@pytest.mark.parametrize("kind", ["campaign", "episode"])
def test_the_order_in_which_processes_report_does_not_matter(kind: str) -> None:
    for tried in itertools.product(TRIED, repeat=2):
        forth = list(zip(ITEMS, tried, strict=True))
        assert recorded(kind, forth) == recorded(kind, forth[::-1])
