"""Pairs of runs with equal seeds: counts, what they mean for a recovery, and changes."""

from __future__ import annotations

import itertools
import json
import math
from typing import Any

import pytest
from loops import run_loop
from scipy.stats import binomtest
from thermostat import HeatMonitor, Overheater, SwitchOff

from pytest_dura import ConfigurationError, Episode
from pytest_dura.core.codec import decode, encode
from pytest_dura.requirements import (
    Change,
    EpisodeVerdict,
    Pair,
    PairCounts,
    Paired,
    Requirement,
    check_comparison,
    judge_episode,
    judge_pairs,
)

WORDS = ("satisfied", "violated", "invalid", "missing")
RUNS = itertools.count()


def verdict(word: Any, run: int, *, case: str = "case", **fields: Any) -> EpisodeVerdict:
    plain = {
        "requirement": "R", "episode": f"{case}#{run}", "component": "Planner", "verdict": word,
        "margin": None, "time": None, "detail": "", "proposals": 10, "valid_proposals": 10,
    }  # fmt: skip
    return EpisodeVerdict(**{**plain, **fields})


def pair(own: str, twin: str, *, acted: bool = False) -> Pair:
    run = next(RUNS)
    return Pair(verdict(own, run), verdict(twin, run, case="case-without"), acted)


def several(*groups: tuple[int, str, str, bool]) -> PairCounts:
    return judge_pairs(
        pair(own, twin, acted=acted) for count, own, twin, acted in groups for _ in range(count)
    )


@pytest.mark.parametrize("own", WORDS)
@pytest.mark.parametrize("twin", WORDS)
def test_a_pair_falls_into_one_cell_and_only_judged_runs_compare(own: str, twin: str) -> None:
    expected = {
        ("violated", "satisfied"): "only_with",
        ("satisfied", "violated"): "only_without",
        ("violated", "violated"): "both",
        ("satisfied", "satisfied"): "neither",
    }.get((own, twin), "incomplete")
    assert pair(own, twin).status == expected


def test_each_cell_has_its_word_for_a_recovery() -> None:
    found = several(
        (7, "satisfied", "violated", True),
        (1, "violated", "satisfied", True),
        (2, "violated", "violated", True),
        (3, "violated", "violated", False),
        (4, "satisfied", "satisfied", True),
        (5, "satisfied", "satisfied", False),
        (6, "missing", "satisfied", True),
    )
    assert (found.pairs, found.complete, found.incomplete) == (28, 22, 6)
    assert (found.prevented, found.introduced) == (7, 1)
    assert (found.futile, found.unheeded) == (2, 3)
    assert (found.unnecessary, found.unneeded) == (4, 5)
    assert found.unexplained == 0
    assert found.difference == -6 / 22
    assert found.p_value == pytest.approx(binomtest(1, 8).pvalue)


def test_runs_that_differ_without_any_recovery_are_told() -> None:
    found = several((2, "satisfied", "violated", False), (1, "violated", "satisfied", True))
    assert found.unexplained == 2


def test_a_violation_in_an_incomplete_pair_is_counted_on_its_side() -> None:
    found = several(
        (2, "violated", "missing", True),
        (3, "invalid", "violated", True),
        (1, "violated", "violated", True),
    )
    assert (found.incomplete, found.both) == (5, 1)
    assert (found.violated_with, found.violated_without) == (3, 4)
    assert found.p_value == 1.0


def test_a_difference_that_chance_does_not_explain_has_a_small_p_value() -> None:
    assert several((6, "violated", "satisfied", True)).p_value == pytest.approx(2 / 64)
    assert several((6, "satisfied", "violated", True)).p_value == pytest.approx(2 / 64)


def test_no_pairs_show_nothing() -> None:
    found = judge_pairs([])
    assert (found.pairs, found.p_value, found.difference) == (0, 1.0, None)


def test_counts_are_plain_data_that_reads_back_equal() -> None:
    found = several((2, "violated", "satisfied", True), (1, "satisfied", "satisfied", False))
    data = json.loads(json.dumps(encode(found)))
    assert (data["only_with"], data["acted_only_with"], data["neither"]) == (2, 2, 1)
    assert decode(PairCounts, data) == found


@pytest.mark.parametrize(
    "twin, told",
    [
        ({"requirement": "Q"}, "one requirement"),
        ({"component": "Other"}, "one component"),
        ({"episode": "case#2"}, "one run"),
    ],
)
def test_a_pair_is_of_one_claim_and_one_run(twin: dict[str, str], told: str) -> None:
    with pytest.raises(ConfigurationError, match=told):
        Pair(verdict("satisfied", 1), verdict("satisfied", 1, **twin))


def test_pairs_of_different_claims_are_not_counted_together() -> None:
    other = Pair(verdict("satisfied", 1, requirement="Q"), verdict("satisfied", 1, requirement="Q"))
    with pytest.raises(ConfigurationError, match="Q of Planner and R of Planner"):
        judge_pairs([pair("satisfied", "satisfied"), other])


def test_a_run_counts_once() -> None:
    one = pair("violated", "satisfied")
    with pytest.raises(ConfigurationError, match="one pair only"):
        judge_pairs([one, one])


def heated(seconds: float, **roles: Any) -> Episode:
    monitors = {"safety_monitor": HeatMonitor(limit=16.0)}
    return run_loop(Overheater(), seconds=seconds, **monitors, **roles)


def test_a_real_recovery_prevents_what_happens_without_it() -> None:
    check = Requirement("R", check="always (temperature < 18)")
    with_it, without = heated(3.0, recovery_planner=SwitchOff()), heated(3.0)
    acted = bool(with_it.metrics.recoveries)
    found = judge_pairs([Pair(judge_episode(check, with_it), judge_episode(check, without), acted)])
    assert (found.prevented, found.unexplained, found.pairs) == (1, 0, 1)


def test_a_real_recovery_that_acts_for_nothing_is_unnecessary() -> None:
    check = Requirement("R", check="always (temperature < 50)")
    with_it, without = heated(3.0, recovery_planner=SwitchOff()), heated(3.0)
    acted = bool(with_it.metrics.recoveries)
    found = judge_pairs([Pair(judge_episode(check, with_it), judge_episode(check, without), acted)])
    assert (found.unnecessary, found.neither) == (1, 1)


def test_a_change_is_the_value_with_it_less_the_value_without() -> None:
    found = Change.between("time", {"a": (12.0, 10.0), "b": (9.0, 10.0), "c": (15.0, 10.0)})
    assert found.values == (2.0, -1.0, 5.0)
    assert (found.n, found.mean, found.median) == (3, 2.0, 2.0)
    assert (found.max_pair, found.max) == ("c", 5.0)
    assert (found.min_pair, found.min) == ("b", -1.0)


def test_a_pair_without_a_change_is_kept_with_the_reason() -> None:
    found = Change.between(
        "time",
        {
            "changed": (3.0, 1.0),
            "never clears": (math.nan, 10.0),
            "clears at last": (10.0, math.inf),
            "never at all": (math.nan, math.nan),
            "missing": (None, 10.0),
            "twin missing": (math.nan, None),
        },
    )
    assert found.values == (2.0, None, None, None, None, None)
    assert (found.n, found.mean) == (1, 2.0)
    assert (found.lost, found.gained) == (("never clears",), ("clears at last",))
    assert found.valueless == ("never at all",)
    assert found.incomplete == ("missing", "twin missing")


def test_the_sign_test_passes_over_pairs_that_do_not_change() -> None:
    sides = {str(i): (1.0 + (i < 8) - (i == 8), 1.0) for i in range(20)}
    found = Change.between("time", sides)
    assert [sum(v > 0 for v in found.changes), sum(v < 0 for v in found.changes)] == [8, 1]
    assert found.p_value == pytest.approx(binomtest(1, 9).pvalue)


def test_without_any_change_there_is_no_summary() -> None:
    found = Change.between("time", {"a": (None, 1.0)})
    assert (found.mean, found.median, found.max_pair, found.min_pair) == (None, None, None, None)
    assert found.p_value == 1.0


def test_a_change_is_plain_data_that_reads_back_equal() -> None:
    found = Change.between("time", {"a": (3.0, 1.0), "b": (math.nan, 1.0), "c": (0.0, 5.0)})
    data = json.loads(json.dumps(encode(found), allow_nan=False))
    assert (data["max"], data["max_pair"], data["min"], data["min_pair"]) == (2.0, "a", -5.0, "c")
    assert (data["n"], data["mean"], data["lost"], data["p_value"]) == (2, -1.5, ["b"], 1.0)
    assert decode(Change, data) == found


@pytest.mark.parametrize(
    "check, measure, bound, problem",
    [
        ("", "", None, "by a check or by a measure"),
        ("always (gap > 0)", "pkg:speed", 1.0, "by a check or by a measure"),
        ("", "pkg:speed", None, "go together"),
        ("always (gap > 0)", "", 1.0, "go together"),
    ],
)
def test_what_is_compared_is_said_once(
    check: str, measure: str, bound: float | None, problem: str
) -> None:
    paired = Paired("recovery_planner", measure, bound)
    with pytest.raises(ConfigurationError, match=problem):
        check_comparison(Requirement("R", check=check, paired=paired))


def test_a_check_or_a_measure_with_its_bound_can_be_compared() -> None:
    check_comparison(Requirement("R", check="always (gap > 0)", paired=Paired("faults")))
    check_comparison(Requirement("R", paired=Paired("faults", "pkg:speed", 0.0)))
    check_comparison(Requirement("R"))
