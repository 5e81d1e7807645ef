"""Tables of failure modes: what is summed, what stands apart, and whose names do no harm."""

from __future__ import annotations

import pytest
from session_records import session_record

from pytest_dura.evidence.bundle.schema import check_record
from pytest_dura.evidence.formats import summary
from pytest_dura.evidence.formats.report import failure_modes as part
from pytest_dura.evidence.formats.report import render
from pytest_dura.evidence.record.failure_modes import FailureModes
from pytest_dura.evidence.views.failure_modes import answers, by_kind, percent, summed
from pytest_dura.plugin.failure_mode_lines import failure_mode_table

NASTY = "<script>x</script>\x1b[2J|`@team\n# Gate passed"


def tally(hits=1, of=2, null_hits=0, null_of=2, kind="failure"):
    return {"hits": hits, "of": of, "null_hits": null_hits, "null_of": null_of, "kind": kind}


def metrics(*episodes, seconds=()):
    """The part of a case's metrics that these episodes' tallies come to."""
    found = FailureModes()
    for tallies in episodes:
        found.add({"tallies": tallies, "answer_seconds": list(seconds)})
    return {"failure_modes": found.to_json(), "answer_times": found.answer_times()}


def record_with(*told, component="C"):
    """A record whose cases have these metrics."""
    record = session_record()
    cases = [
        {**case, "component": component, "metrics": case["metrics"] | one}
        for case, one in zip(record["cases"], told, strict=False)
    ]
    return session_record(cases=cases)


def test_shares_are_summed_and_not_averaged():
    found = record_with(metrics({"a": tally(1, 2)}), metrics({"a": tally(0, 98)}))
    (mode,) = summed(found["cases"])["C"]
    assert (mode["hits"], mode["of"], mode["share"]) == (1, 100, 0.01)
    assert (mode["episodes"], mode["of_episodes"]) == (1, 2)
    assert "upper" not in mode


def test_episodes_count_in_which_it_ever_showed_of_those_in_which_it_could():
    told = metrics({"a": tally(3, 3)}, {"a": tally(0, 3)}, {"a": tally(0, 0)}, {})
    (mode,) = told["failure_modes"]
    assert (mode["episodes"], mode["of_episodes"]) == (1, 2)
    # At least one of two with a chance of 5 %: the exact bound for 1 of 2 is sqrt(0.95).
    assert mode["upper"] == pytest.approx(0.95**0.5)
    (never,) = metrics({"a": tally(0, 0)})["failure_modes"]
    assert never["upper"] is never["share"] is None


def test_components_are_told_apart_and_arms_left_out():
    cases = session_record()["cases"]
    told = metrics({"a": tally(1, 2)})
    rows = [{**cases[0], "component": name, "metrics": cases[0]["metrics"] | told} for name in "AB"]
    rows.append({**rows[0], "id": "a/clear~monitor", "without": ["monitor"]})
    assert {name: modes[0]["of"] for name, modes in summed(rows).items()} == {"A": 2, "B": 2}
    lines = failure_mode_table(rows)
    assert [line.split("  ")[0] for line in lines if "failure modes" in line] == [
        "failure modes of A", "failure modes of B"
    ]  # fmt: skip


def test_controls_stand_below_and_what_could_not_show_nowhere():
    modes = metrics({
        "control": tally(kind="control"), "idle": tally(0, 0), "other": tally(kind="comparison"),
        "failure": tally(),
    })["failure_modes"]  # fmt: skip
    assert [one["name"] for one in by_kind(modes)] == ["failure", "control", "other"]


def test_percentiles_of_several_cases_are_a_range():
    quick, slow = metrics({}, seconds=(0.1, 0.2)), metrics({}, seconds=(3.0,))
    one = record_with(quick | metrics({"a": tally()}) | {"answer_times": quick["answer_times"]})
    assert dict(answers(one["cases"])) == {
        "C": "2 decisions, median 0.10 s, 95th percentile 0.20 s, longest 0.20 s"
    }
    modes = {"failure_modes": metrics({"a": tally()})["failure_modes"]}
    both = record_with(quick | modes, slow | modes)
    (told,) = dict(answers(both["cases"])).values()
    assert told == (
        "3 decisions, median 0.10 to 3.00 s by case, 95th percentile 0.20 to 3.00 s by case, "
        "longest 3.00 s"
    )


@pytest.mark.parametrize(
    "part, expected",
    [(None, "-"), (0.0, "0.0"), (1.0, "100.0"), (1e-6, "<0.1"), (0.9999, ">99.9"), (0.5, "50.0")],
)
def test_rare_is_not_never(part, expected):
    assert percent(part) == expected


def test_without_accounts_there_is_no_table_anywhere():
    record = session_record()
    assert check_record(record) == []
    assert failure_mode_table(record["cases"], by_case=True) == []
    assert "Failure modes" not in summary.render(record)
    assert 'id="failure-modes"' not in render(record)


def test_a_record_with_failure_modes_keeps_to_the_schema():
    record = record_with(metrics({"a": tally()}, seconds=(0.5,)))
    assert check_record(record) == []
    wrong = record_with(metrics({"a": tally(kind="bad luck")}))
    assert "bad luck" in check_record(wrong)[0]


def test_names_of_components_and_failure_modes_do_no_harm():
    record = record_with(metrics({NASTY: tally()}, seconds=(1.0,)), component=NASTY)
    page, text = render(record), summary.render(record)
    assert "<script>x" not in page
    assert "\x1b" not in page + text
    assert not [line for line in text.split("\n") if line.startswith("# Gate passed")]
    modes = text.partition("## Failure modes")[2].partition("\n## ")[0]
    (row,) = [line for line in modes.split("\n") if " 1 of 2 " in line]
    assert row.replace("\\|", "").count(" | ") == 6
    # The terminal is shown what `Shown` makes harmless; a row of its own stays a row.
    table = failure_mode_table(record["cases"])
    assert sum("1/2" in line for line in table) == 1
    assert not any("\x1b" in line or "\n" in line for line in table if "1/2" in line)


def test_rows_of_single_cases_are_bounded(monkeypatch):
    monkeypatch.setattr(part, "MOST_ROWS", 2)
    told = metrics({name: tally() for name in "abc"})
    page = render(record_with(told, told))
    assert "4 further rows are in evidence.json" in page
