"""What one requirement says of one episode: the rows of the table of what counts as what."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import pytest
from episodes import episode, idle, manifested

from pytest_dura import ConfigurationError, Episode, FaultRecord
from pytest_dura.core.codec import decode, encode
from pytest_dura.requirements import (
    CheckResult,
    EpisodeVerdict,
    JudgedEpisode,
    Requirement,
    judge_episode,
)

FAILURE = "infrastructure: safety_monitor at tick 3 (t = 3.0 s): ValueError: x"


def word(one: Episode, check: str = "always (gap > 0)") -> EpisodeVerdict:
    return judge_episode(Requirement("R", check=check), one)


def test_satisfied_with_its_margin() -> None:
    found = word(episode(run=4))
    assert (found.verdict, found.margin, found.time) == ("satisfied", 2.0, None)
    assert (found.requirement, found.episode, found.component) == ("R", "case#4", "Planner")
    assert (found.proposals, found.valid_proposals) == (2, 2)


def test_violated_with_first_time_and_worst_margin() -> None:
    found = word(episode(gap=[1, -1, -3, 2]))
    assert (found.verdict, found.margin, found.time) == ("violated", -3.0, 1.0)
    assert "always (gap > 0)" in found.detail


def test_contact_violates_a_strict_bound_though_the_margin_is_zero() -> None:
    found = word(episode(gap=[1, 0, 1]))
    assert (found.verdict, found.margin, found.time) == ("violated", 0.0, 1.0)


def test_a_violation_before_an_infrastructure_error_counts() -> None:
    assert word(episode(gap=[1, -1], failure=FAILURE)).verdict == "violated"


def test_an_infrastructure_error_leaves_the_episode_missing() -> None:
    found = word(episode(failure=FAILURE))
    assert found.verdict == "missing"
    assert found.detail == FAILURE
    assert word(episode(gap=[], failure=FAILURE)).verdict == "missing"


def test_what_a_truncated_trace_did_not_reach_is_no_violation() -> None:
    assert word(episode(failure=FAILURE), "eventually (gap > 9)").verdict == "missing"
    assert word(episode(failure=FAILURE), "eventually[0:2] (gap > 9)").verdict == "violated"


def test_a_failure_before_the_first_signals_is_missing() -> None:
    broken = episode(failure=FAILURE)
    broken.signals = {}
    found = word(broken)
    assert (found.verdict, found.margin) == ("missing", None)


def test_a_nan_of_the_simulator_is_missing_unless_a_violation_came_before() -> None:
    failure = "infrastructure: simulator at tick 2 (t = 2.0 s): signal 'gap' is nan"
    assert word(episode(gap=[1, 1, math.nan], failure=failure)).verdict == "missing"
    assert word(episode(gap=[math.nan, 1], failure=failure)).verdict == "missing"
    assert word(episode(gap=[1, -1, math.nan], failure=failure)).verdict == "violated"


def test_a_planned_fault_that_never_manifested_makes_the_episode_invalid() -> None:
    found = word(episode(faults=(manifested("a"), idle("b"))))
    assert (found.verdict, found.detail) == ("invalid", "never manifested: b")


def test_a_violation_counts_whether_the_fault_manifested_or_not() -> None:
    assert word(episode(gap=[1, -1], faults=(idle(),))).verdict == "violated"


def test_a_manifested_fault_without_effect_is_resilience() -> None:
    assert word(episode(faults=(manifested(),))).verdict == "satisfied"


def test_a_fault_by_chance_that_drew_no_hit_is_valid() -> None:
    fault: FaultRecord = replace(idle(), by_chance=True)
    assert word(episode(faults=(fault,))).verdict == "satisfied"


def test_a_window_beyond_the_end_is_invalid_for_that_requirement() -> None:
    found = word(episode(), "always[0:9] (gap > 0)")
    assert found.verdict == "invalid"
    assert "the trace ends at 2 s" in found.detail
    assert word(episode(gap=[1, -1]), "always[0:9] (gap > 0)").verdict == "violated"
    assert word(episode(), "eventually[0:9] (gap > 3)").verdict == "satisfied"


def test_a_percept_that_is_not_finite_is_invalid_and_hides_no_violation() -> None:
    check = "always (percept.gap > 0)"
    found = word(episode(**{"percept.gap": [1, math.nan, 1]}), check)
    assert found.verdict == "invalid"
    assert "'percept.gap' is not finite at t = 1 s" in found.detail
    assert word(episode(**{"percept.gap": [math.nan, 1, 1]}), check).verdict == "invalid"
    assert word(episode(**{"percept.gap": [-1, math.nan, 1]}), check).verdict == "violated"


def test_a_signal_that_the_episode_does_not_have_is_an_error() -> None:
    with pytest.raises(ConfigurationError, match="unknown signal 'gapp'"):
        word(episode(), "always (gapp > 0)")


def test_a_requirement_without_a_check_cannot_judge() -> None:
    with pytest.raises(ConfigurationError, match="'R' has no check"):
        word(episode(), "")


def test_a_verdict_crosses_processes() -> None:
    for one in (word(episode()), word(episode(gap=[], failure=FAILURE))):
        assert decode(EpisodeVerdict, json.loads(json.dumps(encode(one)))) == one


def test_an_undecided_margin_is_no_number() -> None:
    assert word(episode(), "always[8:9] (gap > 0)").margin is None


def test_a_judged_episode_is_the_episode_with_answers() -> None:
    plain = episode(gap=[3, 2, 4])
    judged = JudgedEpisode.of(plain)
    assert isinstance(judged, Episode)
    assert judged.digest == plain.digest
    assert judged.robustness("always (gap >= 0.5)") == 1.5
    assert judged.satisfies("always (gap >= 0.5)")
    assert not judged.satisfies("always (gap >= 2.5)")


def test_a_judged_episode_fails_closed() -> None:
    assert JudgedEpisode.of(episode()).robustness("always[0:9] (gap > 0)") == -math.inf
    assert not JudgedEpisode.of(episode()).satisfies("always[0:9] (gap > 0)")
    missing = JudgedEpisode.of(episode(failure=FAILURE))
    assert missing.robustness("always (gap > 0)") == -math.inf
    assert not missing.satisfies("always (gap > 0)")
    assert JudgedEpisode.of(episode(gap=[], failure=FAILURE)).robustness("always (gap > 0)") < 0
    assert not JudgedEpisode.of(episode(faults=(idle(),))).satisfies("always (gap > 0)")


def test_a_formula_that_cannot_be_read_is_pointed_at() -> None:
    with pytest.raises(ConfigurationError, match="at column 14"):
        JudgedEpisode.of(episode()).robustness("always (gap >> 0)")


@pytest.mark.parametrize("faults", [(), (idle(),)], ids=["valid", "no fault manifested"])
def test_a_violation_that_a_function_tells_counts_in_an_invalid_episode_too(
    faults: tuple[FaultRecord, ...],
) -> None:
    rule, one = Requirement("R", check="given by the test"), episode(faults=faults)
    found = judge_episode(rule, one, lambda _: CheckResult(False, -1.0, 2.0, vacuous=True))
    assert (found.verdict, found.margin, found.time) == ("violated", -1.0, 2.0)
    assert not found.vacuous, "only what is satisfied is"
    assert judge_episode(rule, one, lambda _: 1.0).verdict == ("invalid" if faults else "satisfied")
