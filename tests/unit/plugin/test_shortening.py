"""What the terminal leaves out of a great many cases."""

from __future__ import annotations

from entries import make

from pytest_dura.evidence.case_model import CaseEntry
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.reports.document import keep_worst
from pytest_dura.reports.session_tables import case_ranks


def verdict(case, word, pairs=None):
    return make(ItemVerdict, case=case, component="C", verdict=word, pairs=pairs)


def test_the_worst_stay_in_their_own_order():
    assert keep_worst("abcdef", [2, 0, 2, 1, 0, 2], most=3) == ["b", "d", "e"]
    assert keep_worst("abcdef", [2, 2, 2, 2, 2, 2], most=2) == ["a", "b"]
    assert keep_worst("abc", [2, 0, 1], most=3) == ["a", "b", "c"]
    assert keep_worst("abc", [2, 0, 1], most=None) == ["a", "b", "c"]


def test_no_case_with_a_violation_gives_way_to_one_without():
    cases = [make(CaseEntry, id=f"a/{n}", component="C") for n in range(8)]
    verdicts = [verdict(f"a/{n}", "supported") for n in range(5)]
    verdicts += [verdict("a/1", "undecided"), verdict("a/6", "violated")]
    verdicts += [verdict("a/4", "violated", {"case": "a/7"})]
    ranks = case_ranks(cases, verdicts)
    shown = [one.id for one in keep_worst(cases, ranks, most=4)]
    assert shown == ["a/1", "a/4", "a/6", "a/7"]
    assert [one.id for one in keep_worst(cases, ranks, most=5)] == ["a/0", *shown]
