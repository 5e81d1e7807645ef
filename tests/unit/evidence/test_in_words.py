"""What the report and the summary say in sentences of a session."""

from __future__ import annotations

import pytest
from session_records import session_record, verdict

from pytest_dura.reports import summary
from pytest_dura.reports.html.page import render
from pytest_dura.reports.wording import conclusion_sentences, limitation_sentences

SUPPORTED = verdict("SAF-1", "a/clear", ("satisfied",) * 14)
WIDER = verdict("SAF-1", "a/clear+ghost", ("satisfied",) * 3)
UNDECIDED = verdict("SEC-1", "a/clear+ghost", ("invalid",) * 2)
PASSED = {"result": "passed", "exit_code": 0, "reasons": []}


def told(sentences, **changes):
    return " ".join(sentences(session_record(**changes)))


def test_what_is_violated_and_supported_comes_with_the_weakest_bound_and_its_n():
    text = told(
        conclusion_sentences,
        verdicts=[SUPPORTED, WIDER, verdict("PERF-1", "a/clear", ("violated",))],
    )
    assert text.startswith("1 of 3 verdicts is violated (PERF-1)")
    assert "2 of 3 verdicts are supported." in text
    # The bound of three runs without a violation is one minus the cube root of 0.05.
    assert "at most 63.2 % of such episodes" in text
    assert "with 95 % confidence (n = 3)" in text


def test_what_was_judged_in_less_than_half_of_the_runs_is_named():
    half, rarely = (SUPPORTED | {"vacuous": number} for number in (7, 8))
    assert "vacuous" not in told(conclusion_sentences, verdicts=[half])
    text = told(conclusion_sentences, verdicts=[half, rarely])
    assert "Mostly vacuous: SAF-1 on a/clear, whose condition did not hold in 8 of 14 runs." in text


def test_a_session_that_supports_nothing_says_so():
    assert told(conclusion_sentences, verdicts=[]) == "No requirement led to a verdict."
    text = told(conclusion_sentences, verdicts=[UNDECIDED])
    assert text == "The one verdict is not supported."
    assert "no violation" not in told(limitation_sentences, verdicts=[UNDECIDED])


def test_what_was_not_tried_or_did_not_count_is_told():
    cases = session_record().head.cases
    recovered = cases[0].metrics.replace(recoveries=7)
    cases = [cases[0].replace(missing_runs_total=4, metrics=recovered), cases[1]]
    coverage = session_record().head.coverage.replace(left_out=5)
    text = told(
        limitation_sentences, verdicts=[SUPPORTED, UNDECIDED], cases=cases, coverage=coverage
    )
    assert "1 of 2 verdicts is undecided, 1 of them without a single valid episode" in text
    assert "6 of 10 cells of requirement, scenario and faults were not tried" in text
    assert "4 planned episodes were not run" in text
    assert "1 of 6 episodes are invalid and 1 missing" in text
    assert "Recovery acted 7 times" in text
    assert "simulated" in text
    assert "holds by itself" not in text
    assert "holds by itself" in told(limitation_sentences, verdicts=[SUPPORTED, WIDER])


def test_recovery_in_reference_arms_is_not_counted():
    case = session_record().head.cases[0]
    arm = case.replace(without=["x"], metrics=case.metrics.replace(recoveries=7))
    assert "Recovery acted" not in told(limitation_sentences, cases=[case, arm])


@pytest.mark.parametrize("status, end", [("complete", False), ("interrupted", True)])
def test_an_incomplete_session_shows_no_more_than_it_ran(status, end):
    assert (
        "did not come to its end" in told(limitation_sentences, status=status, gate=PASSED)
    ) is end


def test_report_and_summary_say_the_same():
    record = session_record(verdicts=[verdict("PERF-1", "a/clear", ("violated",))])
    page, text = render(record), summary.render(record)
    for sentence in limitation_sentences(record):
        assert sentence in text
        assert sentence in page
