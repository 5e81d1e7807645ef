"""Tables of failure modes: what is summed, what stands apart, and whose names do no harm."""

from __future__ import annotations

import pytest
from entries import make
from pens import table_lines
from session_records import session_data, session_record

from pytest_dura.core.codec import encode
from pytest_dura.core.metrics import EpisodeMetrics
from pytest_dura.evidence import FailureModes, check_record
from pytest_dura.reports import (
    decision_age_lines,
    decision_time_lines,
    failure_modes_by_component,
    measured_failure_modes,
    percent_text,
    summary,
)
from pytest_dura.reports.html import page as part
from pytest_dura.reports.html.page import render
from pytest_dura.reports.session_tables import failure_mode_tables


def tally(hits=1, of=2, null_hits=0, null_of=2, kind="failure"):
    return {"hits": hits, "of": of, "null_hits": null_hits, "null_of": null_of, "kind": kind}


def metrics(*episodes, seconds=(), ages=()):
    """The part of a case's metrics that these episodes' tallies come to."""
    found = FailureModes()
    for tallies in episodes:
        told = {"tallies": tallies, "answer_seconds": list(seconds), "answer_ages": list(ages)}
        found.add(make(EpisodeMetrics, **told))
    return {
        "failure_modes": encode(found.entries()),
        "answer_times": encode(found.answer_times()),
        "answer_ages": encode(found.answer_ages()),
    }


def cases_with(*told, component="C"):
    """Cases that have these metrics."""
    return [
        case.to_json() | {"component": component, "metrics": case.metrics.to_json() | one}
        for case, one in zip(session_record().head.cases, told, strict=False)
    ]


def record_with(*told, component="C"):
    """A record whose cases have these metrics."""
    return session_record(cases=cases_with(*told, component=component))


def test_shares_are_summed_and_not_averaged():
    found = record_with(metrics({"a": tally(1, 2)}), metrics({"a": tally(0, 98)}))
    (mode,) = failure_modes_by_component(found.head.cases)["C"]
    assert (mode.hits, mode.of, mode.share) == (1, 100, 0.01)
    assert (mode.episodes, mode.of_episodes) == (1, 2)
    assert mode.upper is None


def test_episodes_count_in_which_it_ever_showed_of_those_in_which_it_could():
    told = metrics({"a": tally(3, 3)}, {"a": tally(0, 3)}, {"a": tally(0, 0)}, {})
    (mode,) = told["failure_modes"]
    assert (mode["episodes"], mode["of_episodes"]) == (1, 2)
    # At least one of two with a chance of 5 %: the exact bound for 1 of 2 is sqrt(0.95).
    assert mode["upper"] == pytest.approx(0.95**0.5)
    (never,) = metrics({"a": tally(0, 0)})["failure_modes"]
    assert never["upper"] is never["share"] is None


def test_components_are_told_apart_and_arms_left_out():
    case = record_with(metrics({"a": tally(1, 2)})).head.cases[0]
    rows = [case.replace(component=name) for name in "AB"]
    rows.append(rows[0].replace(id="a/clear~monitor", without=["monitor"]))
    assert {name: modes[0].of for name, modes in failure_modes_by_component(rows).items()} == {
        "A": 2,
        "B": 2,
    }
    lines = table_lines(*failure_mode_tables(rows))
    assert [line.split("  ")[0] for line in lines if "failure modes of" in line] == [
        "failure modes of A", "failure modes of B"
    ]  # fmt: skip


def test_controls_stand_below_and_what_could_not_show_nowhere():
    told = metrics({
        "control": tally(kind="control"), "idle": tally(0, 0, 0, 0),
        "other": tally(kind="comparison"), "failure": tally(),
    })  # fmt: skip
    modes = record_with(told).head.cases[0].metrics.failure_modes
    assert [one.name for one in measured_failure_modes(modes)] == ["failure", "control", "other"]


def test_what_the_null_component_alone_could_show_is_told():
    unheard = metrics({"obeys_injection": tally(0, 0, 0, 4), "idle": tally(0, 0, 0, 0)})
    record = record_with(unheard)
    line, _by_case = [
        one
        for one in table_lines(*failure_mode_tables(record.head.cases))
        if one.startswith("obeys")
    ]
    assert line.split() == ["obeys", "injection", "0/0", "-", "0.0", "0/0"]
    assert "| `obeys injection` | failure | `C` | 0 of 0 | - | 0.0 | 0 of 0 |" in summary.render(
        record
    )
    page = render(record)
    assert page.count("obeys injection") == 2  # over all cases, and by case
    assert '<td class="n">- %</td>' not in page


def test_percentiles_of_several_cases_are_a_range():
    quick, slow = metrics({}, seconds=(0.1, 0.2)), metrics({}, seconds=(3.0,))
    one = record_with(quick | metrics({"a": tally()}) | {"answer_times": quick["answer_times"]})
    assert dict(decision_time_lines(one.head.cases)) == {
        "C": "2 decisions, median 0.10 s, 95th percentile 0.20 s, longest 0.20 s"
    }
    modes = {"failure_modes": metrics({"a": tally()})["failure_modes"]}
    both = record_with(quick | modes, slow | modes)
    (told,) = dict(decision_time_lines(both.head.cases)).values()
    assert told == (
        "3 decisions, median 0.10 to 3.00 s by case, 95th percentile 0.20 to 3.00 s by case, "
        "longest 3.00 s"
    )


def test_past_the_time_budget_are_timeouts_and_nothing_else():
    failed = ("unavailable", "empty", "refused", "malformed", "fallback", "past")
    quick = metrics(
        {name: tally(2, 2) for name in failed} | {"timeout": tally(0, 5)}, seconds=[0.1]
    )
    late = metrics({"timeout": tally(1, 50)}, {"timeout": tally(0, 0)}, seconds=[0.1])
    both = record_with(quick, late)
    (told,) = dict(decision_time_lines(both.head.cases)).values()
    assert told.endswith(", longest 0.10 s; 1 of 55 (1.8 %) past the time budget")
    (none,) = dict(decision_time_lines(record_with(quick).head.cases)).values()
    assert none.endswith("; 0 of 5 (0.0 %) past the time budget")
    unknown = metrics({"timeout": tally(0, 0), "a": tally()}, seconds=[0.1])
    (untold,) = dict(decision_time_lines(record_with(unknown).head.cases)).values()
    assert untold.endswith(", longest 0.10 s")


def test_ages_are_told_where_a_decision_came_into_force_later_than_its_percept():
    late = metrics({"a": tally()}, ages=(0.4, 0.4, 1.2, 0.0))
    assert late["answer_ages"] == {"decisions": 4, "p50": 0.4, "p95": 1.2, "max": 1.2}
    told = "median 0.4 s, 95th percentile 1.2 s, oldest 1.2 s"
    record = record_with(late)
    assert dict(decision_age_lines(record.head.cases)) == {"C": told}
    line = f"decisions came into force at an age of {told}"
    assert line in table_lines(*failure_mode_tables(record.head.cases))
    assert f"\n{line}\n" in summary.render(record)
    assert f"came into force at an age of {told}" in render(record)


def test_ages_of_several_cases_are_a_range_and_components_are_told_apart():
    told = [metrics({"a": tally()}, ages=one) for one in ((0.25,), (0.5, 12.3), (0.0,))]
    assert dict(decision_age_lines(record_with(*told).head.cases)) == {
        "C": "median 0.25 to 0.5 s by case, 95th percentile 0.25 to 12.3 s by case, oldest 12.3 s"
    }
    rows = [
        record_with(one, component=name).head.cases[0]
        for name, one in zip("ABC", told, strict=True)
    ]
    assert list(dict(decision_age_lines(rows))) == ["A", "B"]
    lines = [
        line for line in table_lines(*failure_mode_tables(rows)) if line.startswith("decisions of ")
    ]
    assert [line.partition(" at an age of ")[0] for line in lines] == [
        "decisions of A came into force", "decisions of B came into force"
    ]  # fmt: skip


def test_where_no_decision_is_older_than_its_percept_ages_are_not_told():
    for these in ((), (0.0, 0.0)):
        record = record_with(metrics({"a": tally()}, ages=these))
        assert list(decision_age_lines(record.head.cases)) == []
        lines = table_lines(*failure_mode_tables(record.head.cases))
        for page in ("\n".join(lines), summary.render(record), render(record)):
            assert "failure" in page.lower()
            assert "came into force" not in page
    assert metrics({}, ages=())["answer_ages"] is None


@pytest.mark.parametrize(
    "part, expected",
    [(None, "-"), (0.0, "0.0"), (1.0, "100.0"), (1e-6, "<0.1"), (0.9999, ">99.9"), (0.5, "50.0")],
)
def test_rare_is_not_never(part, expected):
    assert percent_text(part) == expected


def test_without_accounts_there_is_no_table_anywhere():
    record = session_record()
    assert table_lines(*failure_mode_tables(record.head.cases)) == []
    assert "Failure modes" not in summary.render(record)
    assert 'id="failure-modes"' not in render(record)


def test_a_record_with_failure_modes_keeps_to_the_schema():
    told = metrics({"a": tally()}, seconds=(0.5,))
    assert check_record(session_data(cases=cases_with(told))) == []
    told["failure_modes"][0]["kind"] = "bad luck"
    assert "bad luck" in check_record(session_data(cases=cases_with(told)))[0].found


def test_rows_of_single_cases_are_bounded(monkeypatch):
    monkeypatch.setattr(part, "MOST_ROWS", 2)
    told = metrics({name: tally() for name in "abc"})
    page = render(record_with(told, told))
    assert "4 further rows are in evidence.json" in page
