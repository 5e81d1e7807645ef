"""Searches in the record: told once, kept whole, beside the verdicts, and no way past the gate."""

from __future__ import annotations

import json

import pytest
from entries import make
from item_lines import report
from searches import ITEM, entry, falsification, told
from session_records import HEADER, session_data, verdict
from test_record import case

from pytest_dura.core.codec import decode, encode
from pytest_dura.evidence import (
    Gate,
    RecordBuilder,
    Redactor,
    check_record,
)
from pytest_dura.evidence.case_model import CasePlan
from pytest_dura.evidence.gather import claim
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.searches import RecordedSearch

WAIVER = {"kind": "xfail", "reason": "ticket 7"}


def search(*words, **changes):
    return told(falsification(*words, **changes))


def searches_of(*reports, waived=None):
    record = RecordBuilder(HEADER)
    for one in reports:
        record.add(one)
    if waived:
        record.waive(*waived)
    return record.record("complete").head.searches


def test_a_search_that_is_told_twice_is_told_once():
    once = report(ITEM, searches=[search("falsified")])
    (found,) = searches_of(once, once)
    assert encode(found) == {**search("falsified"), "item": ITEM}


def test_an_attempt_that_came_out_differently_stands_beside_the_first():
    good = search("nothing found")
    bad = {**good, "outcomes": search("falsified")["outcomes"]}
    found = searches_of(report(ITEM, searches=[bad]), report(ITEM, searches=[good]))
    words = sorted(one.outcomes[0].status for one in found)
    assert words == ["falsified", "nothing found"]


def test_searches_are_sorted_however_they_come():
    reports = [
        report(item, searches=[search("falsified", case=name, seed=seed)])
        for item, name, seed in [("i", "b", 1), ("j", "a", 2), ("i", "a", 5), ("i", "a", 3)]
    ]
    found = searches_of(*reports)
    assert found == searches_of(*reversed(reports))
    order = [(one.case, one.item, one.seed) for one in found]
    assert order == [("a", "i", 3), ("a", "i", 5), ("a", "j", 2), ("b", "i", 1)]


def test_what_excuses_a_test_excuses_its_searches_and_changes_no_word():
    (found,) = searches_of(
        report(ITEM, searches=[search("falsified")]), waived=(ITEM, "xfail", "ticket 7")
    )
    assert encode(found.waiver) == WAIVER
    assert found.outcomes[0].status == "falsified"


def test_a_search_makes_no_verdict_no_case_and_no_episode():
    record = RecordBuilder(HEADER)
    record.add(report(ITEM, searches=[search("nothing found")]))
    made = record.record("complete")
    assert (made.head.verdicts, made.head.cases, list(made.episodes())) == ([], [], [])


def claiming(requirement):
    """The report of an item that is to decide a requirement."""
    plan = make(CasePlan, **case())
    asked = [encode(claim(ITEM, requirement, plan))]
    return report(ITEM, judgements=asked, claimed=[plan.to_json()])


def verdicts(record):
    return [one.verdict for one in record.record("complete").head.verdicts]


def test_what_an_item_searched_it_was_not_to_decide():
    asked = search("nothing found", case="a/b")
    left = RecordBuilder(HEADER)
    left.add(claiming("SAF-1"))
    assert verdicts(left) == ["undecided"]
    left.add(report(ITEM, searches=[asked]))
    made = left.record("complete")
    assert (made.head.verdicts, made.head.cases) == ([], [])


@pytest.mark.parametrize(
    "changes", [{"item": "other"}, {"case": "a/other"}, {"requirement": "SAF-2"}]
)
def test_what_it_did_not_search_stays_undecided(changes):
    name = changes.pop("requirement", "SAF-1")
    item = changes.pop("item", ITEM)
    record = RecordBuilder(HEADER)
    record.add(claiming(name))
    record.add(report(item, searches=[search("nothing found", **{"case": "a/b", **changes})]))
    assert verdicts(record) == ["undecided"]


def gate(*searches, warn=False, verdicts=()):
    return Gate.of(
        [make(ItemVerdict, **one) for one in verdicts], (),
        searches=[decode(RecordedSearch, one) for one in searches],
        interrupted=False, exit_code=0, failed=0, warn_undecided=warn,
    )  # fmt: skip


@pytest.mark.parametrize("warn", [False, True])
@pytest.mark.parametrize(
    "word, reason",
    [
        ("falsified", "SAF-1 on a/clear is falsified by a search"),
        (
            "not repeatable",
            "SAF-1 on a/clear is violated in a search, and not again each time it was repeated",
        ),
    ],
)
def test_a_violation_that_a_search_found_fails_a_session_whose_tests_all_passed(word, reason, warn):
    found = gate(entry(word), warn=warn)
    assert (found.result, found.exit_code, found.reasons) == ("failed", 1, (reason,))
    assert gate(entry(word, waiver=WAIVER), warn=warn).result == "passed"


@pytest.mark.parametrize("warn", [False, True])
def test_an_undecided_search_fails(warn):
    found = gate(entry("undecided"), warn=warn)
    assert found.reasons == ("SAF-1 on a/clear is undecided by a search",)


def test_nothing_found_gives_no_reason_and_hides_none():
    assert gate(entry("nothing found")).result == "passed"
    undecided = verdict("SEC-1", "a/clear", ("satisfied",), planned=4)
    found = gate(entry("nothing found", "falsified"), verdicts=[undecided])
    assert found.reasons == (
        "SEC-1 on a/clear is undecided",
        "PERF-1 on a/clear is falsified by a search",
    )


WORDS = [
    ("falsified",),
    ("falsified", "falsified"),
    ("not repeatable", "nothing found"),
    ("undecided",),
    ("nothing found",),
]


@pytest.mark.parametrize("words", WORDS)
def test_each_word_keeps_the_schema(words):
    assert check_record(session_data(searches=[entry(*words)])) == []


@pytest.mark.parametrize("file", ["/project/found.yaml", "\\\\host\\found.yaml"])
def test_a_path_of_this_machine_is_no_file_of_the_project(file):
    record = session_data(searches=[entry("falsified")])
    record["searches"][0]["outcomes"][0]["counterexample"]["file"] = file
    (problem,) = check_record(record)
    assert problem.pointer == "/searches/0/outcomes/0/counterexample/file"


def test_secrets_of_a_counterexample_are_taken_out():
    redactor = Redactor()
    redactor.add("PASSWORD", "correct-horse-battery")
    found = search("falsified")
    found["outcomes"][0]["counterexample"]["detail"] = "the token was correct-horse-battery"
    text = json.dumps(redactor.redact(found))
    assert "correct-horse" not in text
    assert "[redacted: PASSWORD]" in text
