"""The tables in the terminal: cases, reliance, pairs, and what the runs show of recovery."""

from __future__ import annotations

from typing import Any

from entries import make
from pens import table_lines

from pytest_dura.core.codec import encode
from pytest_dura.core.measures import MeasureInfo
from pytest_dura.evidence.case_model import CaseEntry, OverallEntry
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.verdict_model import EffectivenessEntry
from pytest_dura.reports.session_tables import case_table, pair_table, reliance_table
from pytest_dura.reports.story import effectiveness_lines
from pytest_dura.requirements import PairCounts


def share(valid: int, of: int = 10) -> dict[str, Any]:
    return {
        "valid": valid, "run": valid, "share_of_valid": valid / of, "share_of_planned": valid / of,
    }  # fmt: skip


SWITCHING = {"share": 0.125, "takeovers": 3, "time_to_safe": {"median": 0.2, "censored": 0}}


def metrics(**changes: Any) -> dict[str, Any]:
    return {
        "planned": 10, "valid": 10, "missing": 0, "invalid": 0, "flagged": share(1),
        "measures": {"jerky": share(5)}, "recoveries": 1, "alerts": 0, "user": {},
        "rescued": share(2), "reactions": {}, "switching": SWITCHING,
    } | changes  # fmt: skip


JERKY = MeasureInfo(
    "jerky", "jerk", "runs that jerked", "a.lift:jerky", shown="share", table="reliance", place=0
)


def case(name: str, component: str = "C", **changes: Any) -> CaseEntry:
    return make(CaseEntry, id=name, component=component, metrics=metrics(**changes))


def overall(cases: int, component: str = "C", **changes: Any) -> OverallEntry:
    return make(OverallEntry, component=component, cases=cases, metrics=metrics(**changes))


def cells(line: str) -> list[str]:
    return line.split()


def verdict(name: str, *cells: int) -> ItemVerdict:
    prevented, introduced, futile, unnecessary, neither = cells
    counts = PairCounts(
        pairs=sum(cells), only_with=introduced, only_without=prevented, both=futile,
        neither=unnecessary + neither, incomplete=0, acted_only_with=introduced,
        acted_only_without=prevented, acted_both=futile, acted_neither=unnecessary,
        violated_with=introduced + futile, violated_without=prevented + futile, p_value=1.0,
    )  # fmt: skip
    pairs = {"without": "recovery_planner", "case": f"{name}~recovery_planner", **encode(counts)}
    return make(
        ItemVerdict, requirement="R", case=name, component="C", method="every episode", pairs=pairs
    )


def test_a_last_row_is_over_all_cases_where_there_are_several() -> None:
    found = [case("a/b"), case("c/d")]
    lines = table_lines(case_table(found, [overall(2, flagged=share(7))]))
    assert [cells(line)[0] for line in lines[1:4]] == ["a/b", "c/d", "overall"]
    assert cells(lines[3])[2] == "70"
    assert not any(
        line.startswith("overall") for line in table_lines(case_table(found[:1], [overall(1)]))
    )


def test_of_several_components_each_has_its_own() -> None:
    found = [case("a/b"), case("a/b", "D"), case("c/d"), case("c/d", "D")]
    lines = table_lines(case_table(found, [overall(2), overall(2, "D")]))
    assert [line.partition("  ")[0] for line in lines[5:7]] == ["overall (C)", "overall (D)"]


def test_reliance_its_measures_and_reactions_stand_beside_each_case() -> None:
    reactions = {"follows the fake": 3, "puzzled": 1}
    header, row, last, *legend = table_lines(
        reliance_table(
            [case("a/b", reactions=reactions)], [overall(2, reactions=reactions)], [JERKY]
        )
    )
    names = "reliance rescued % time % jerk % unaffected erratic frozen follows puzzled"
    assert header.split() == names.split()
    assert cells(row) == ["a/b", "20", "12.5", "50", "0", "0", "0", "3", "1"]
    assert cells(last)[0] == "overall"
    assert len(legend) == 3
    assert all(len(line) <= 100 for line in (header, row, last, *legend))


def test_what_nobody_measures_has_no_column_and_without_anything_there_is_no_table() -> None:
    quiet = case("a/b", measures={})
    header, row, *_ = table_lines(reliance_table([quiet]))
    assert header.split() == ["reliance", "rescued", "%", "time", "%"]
    assert cells(row) == ["a/b", "20", "12.5"]
    for shown in ({"rescued": share(0)}, {"rescued": None, "switching": None}):
        assert table_lines(reliance_table([case("a/b", measures={}, **shown)], (), [JERKY])) == []


def test_a_measure_of_reliance_has_no_column_among_the_outcomes() -> None:
    header = table_lines(case_table([case("a/b")], (), [JERKY]))[0]
    assert "jerk" not in header


def test_pairs_have_one_rate_of_success_each_and_together() -> None:
    cases = [case("z/first"), case("a/second")]
    verdicts = [verdict("a/second", 0, 1, 0, 2, 0), verdict("z/first", 3, 0, 1, 0, 4)]
    header, first, second, together, *_ = table_lines(pair_table(verdicts, cases))
    names = "recovery pairs prev intro futile unavoid share unnec success p takeovers to safe s"
    assert header.split() == names.split()
    assert " ".join(first.split()) == "R on z/first 8 3 0 1 - 19-99 0 75 (4) 1 3 0.2"
    assert " ".join(second.split()) == "R on a/second 3 0 1 0 - - 2 - 1 3 0.2"
    assert " ".join(together.split()) == "R overall 11 3 1 1 - 19-99 2 75 (4) - - -"


def test_sentences_on_recovery_and_on_monitors_are_kept_apart_and_so_is_what_is_not_known() -> None:
    entries = [
        make(EffectivenessEntry, role=role, component="C", finding=finding, detail=finding)
        for role in ("recovery_planner", "watch")
        for finding in ("prevented", "cannot be told")
    ]
    shown = {
        (recovery, known): list(effectiveness_lines(entries, recovery=recovery, known=known))
        for recovery in (True, False)
        for known in (True, False)
    }
    of_recovery = ["recovery_planner: prevented", "recovery_planner: cannot be told"]
    assert shown == {
        # How seldom recovery introduces something is known even where nothing was to prevent.
        (True, True): of_recovery,
        (True, False): [],
        (False, True): ["watch: prevented"],
        (False, False): ["watch: cannot be told"],
    }
