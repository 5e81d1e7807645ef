"""What one requirement says of a campaign."""

from __future__ import annotations

import json
from typing import Any

import pytest

from pytest_dura import ConfigurationError, Requirement
from pytest_dura.core.codec import decode, encode
from pytest_dura.requirements import CampaignJudge, CampaignVerdict, EpisodeVerdict, judge_campaign
from pytest_dura.requirements.campaign_verdicts import UncountedEpisode
from pytest_dura.requirements.model import Paired
from pytest_dura.requirements.shortfalls import explain_verdict

KEYS_OF_THE_RECORD = {
    "requirement", "case", "component", "verdict", "planned", "episodes", "violations", "invalid",
    "missing", "vacuous", "bound", "margin", "counterexamples",
}  # fmt: skip


def one(
    run: int, word: Any = "satisfied", margin: float | None = 1.0, **fields: Any
) -> EpisodeVerdict:
    plain = {
        "requirement": "R", "episode": f"case#{run}", "component": "Planner", "verdict": word,
        "margin": margin, "time": 2.0 if word == "violated" else None, "detail": "",
        "proposals": 100, "valid_proposals": 100,
    }  # fmt: skip
    return EpisodeVerdict(**{**plain, **fields})


def some(**counts: int) -> list[EpisodeVerdict]:
    words = [word for word, count in counts.items() for _ in range(count)]
    margins = {"violated": -1.0}
    return [one(run, word, margins.get(word, 1.0)) for run, word in enumerate(words)]


def judge(
    verdicts: list[EpisodeVerdict], planned: int | None = None, **rate: Any
) -> CampaignVerdict:
    planned = len(verdicts) if planned is None else planned
    return judge_campaign(Requirement("R", **rate), "case", verdicts, planned=planned)


def test_supported_when_every_episode_satisfied_it() -> None:
    found = judge(some(satisfied=15))
    assert (found.verdict, found.episodes, found.run, found.planned) == ("supported", 15, 15, 15)
    assert found.bound.upper == pytest.approx(0.181, abs=5e-4)
    assert (found.bound.confidence, found.bound.at_most) == (0.95, None)
    assert found.component == "Planner"
    assert found.counterexamples == ()


def test_one_violation_is_enough_whatever_else_is_wrong() -> None:
    for verdicts in (
        some(satisfied=14, violated=1),
        some(violated=1, missing=9),
        some(violated=1, invalid=9),
    ):
        assert judge(verdicts, planned=15).verdict == "violated"
    found = judge(some(satisfied=14, violated=1))
    assert (found.violations, found.episodes) == (1, 15)
    assert "1 of 15" in found.reason


def test_counterexamples_are_sorted_by_how_bad_they_are() -> None:
    found = judge(
        [one(0), one(1, "violated", -1.0), one(2, "violated", -5.0), one(3, "violated", 0.0)]
    )
    assert [example.episode for example in found.counterexamples] == ["case#2", "case#1", "case#3"]
    assert (found.counterexamples[0].time, found.counterexamples[0].margin) == (2.0, -5.0)
    assert found.margin == -5.0


def test_fewer_than_planned_is_undecided() -> None:
    found = judge(some(satisfied=14), planned=15)
    assert found.verdict == "undecided"
    assert found.reason == "only 14 of 15 planned episodes were run"
    assert (found.planned, found.run) == (15, 14)


def test_a_missing_episode_is_undecided() -> None:
    found = judge(some(satisfied=14, missing=1))
    assert (found.verdict, found.missing, found.episodes) == ("undecided", 1, 14)
    assert "1 of 15 episodes are missing (infrastructure)" in found.reason


def test_an_infrastructure_error_is_named_before_a_test_that_failed() -> None:
    by_test = one(0, "missing", detail="the test failed: KeyError: 'speed'")
    ended = one(1, "missing", detail="infrastructure: simulator at tick 2")
    verdict = judge([by_test, ended])
    assert verdict.first_uncounted == UncountedEpisode("case#1", "missing", ended.detail)
    assert "2 of 2 episodes are missing (infrastructure)" in verdict.reason


def test_invalid_episodes_up_to_a_fifth_are_borne() -> None:
    assert judge(some(satisfied=12, invalid=3)).verdict == "supported"
    found = judge(some(satisfied=11, invalid=4))
    assert (found.verdict, found.invalid, found.episodes) == ("undecided", 4, 11)
    assert "4 of 15 episodes are invalid, more than 20%" in found.reason


def test_further_runs_for_invalid_ones_count() -> None:
    found = judge(some(satisfied=15, invalid=2), planned=15)
    assert (found.verdict, found.run, found.episodes) == ("supported", 17, 15)


def test_no_valid_episode_supports_nothing() -> None:
    found = judge(some(invalid=3))
    assert (found.verdict, found.bound.upper, found.margin) == ("undecided", None, None)
    assert "none of the episodes was valid" in found.reason


def test_nothing_was_run() -> None:
    found = judge_campaign(Requirement("R"), "case", [], planned=5, component="Planner")
    assert (found.verdict, found.component, found.run) == ("undecided", "Planner", 0)
    assert "only 0 of 5 planned" in found.reason
    assert judge([], planned=0).verdict == "undecided"


def test_a_component_that_rarely_proposes_is_not_supported_by_its_recovery() -> None:
    rarely = [one(run, valid_proposals=49) for run in range(15)]
    found = judge(rarely)
    assert found.verdict == "undecided"
    assert "valid proposal at only 735 of 1500 ticks" in found.reason
    assert judge([one(run, valid_proposals=50) for run in range(15)]).verdict == "supported"


def test_all_obstacles_are_named() -> None:
    found = judge(some(satisfied=1, missing=1, invalid=2), planned=9)
    assert found.reason.count(";") == 2


def test_a_rate_that_n_supports() -> None:
    found = judge(some(satisfied=59), at_most=0.05)
    assert found.verdict == "supported"
    assert found.bound.upper is not None
    assert found.bound.upper <= 0.05
    assert "at most 0.0495" in found.reason
    assert judge(some(satisfied=92, violated=1), at_most=0.05).verdict == "supported"


def test_a_rate_that_n_cannot_support_is_undecided_and_says_what_would() -> None:
    found = judge(some(satisfied=58), at_most=0.05)
    assert found.verdict == "undecided"
    assert "which does not support 0.05; decide it by a sequential method" in found.reason
    assert (
        "or by a new plan on a fresh seed of 59 runs, which may hold no violations" in found.reason
    )
    # The distribution of scipy.stats.binom at 0 of 59 runs, with half of the rate.
    assert "with probability 22 % if the true rate is half of that" in found.reason
    found = judge(some(satisfied=91, violated=1), at_most=0.05)
    assert found.verdict == "undecided"
    assert "on a fresh seed of 124 runs, which may hold 2 violations: at" in found.reason
    assert "it succeeds with probability 84.7 %" in found.reason


def test_where_more_runs_violate_than_are_allowed_the_reason_says_that_first() -> None:
    found = judge(some(satisfied=6, violated=9), at_most=0.5)
    assert found.verdict == "undecided"
    counts = "9 of 15 valid episodes violated it (60 %, more than the 50 % allowed)"
    assert found.reason.startswith(counts)
    # The distribution of scipy.stats.binom at 9 of 28 runs, with a rate of 0.6.
    assert (
        "of 28 runs, which may hold 9 violations, succeeds with probability 0.27 %" in found.reason
    )
    assert "sequential" not in found.reason


def test_a_rate_that_is_exceeded() -> None:
    found = judge(some(satisfied=50, violated=10), at_most=0.05)
    assert found.verdict == "violated"
    assert "at most 0.05 is allowed" in found.reason
    assert len(found.counterexamples) == 10


def test_confidence_moves_the_bound() -> None:
    assert judge(some(satisfied=59), at_most=0.05, confidence=0.99).verdict == "undecided"
    assert judge(some(satisfied=90), at_most=0.05, confidence=0.99).verdict == "supported"


def test_a_rate_is_undecided_for_the_same_obstacles() -> None:
    for verdicts in (
        some(satisfied=200, missing=1),
        some(satisfied=200, invalid=60),
        [one(run, valid_proposals=1) for run in range(200)],
    ):
        assert judge(verdicts, at_most=0.05).verdict == "undecided"
    assert judge(some(satisfied=200), planned=201, at_most=0.05).verdict == "undecided"


def test_what_was_not_run_cannot_make_a_rate_violated() -> None:
    assert judge(some(violated=3), at_most=0.2).verdict == "violated"
    assert judge(some(violated=3), planned=100, at_most=0.2).verdict == "undecided"
    assert judge(some(violated=3, missing=97), at_most=0.2).verdict == "undecided"


@pytest.mark.parametrize("rate", [{"at_most": 0.0}, {"at_most": 1.0}, {"confidence": 1.5}])
def test_a_rate_outside_its_range(rate: dict[str, float]) -> None:
    with pytest.raises(ConfigurationError, match="lies strictly between") as caught:
        judge(some(satisfied=3), **rate)
    assert caught.value.key in rate


def test_of_several_attempts_a_violation_counts_and_otherwise_the_last() -> None:
    found = judge([one(0, "violated"), one(0), one(1, "missing"), one(1)], planned=2)
    assert (found.run, found.violations, found.missing) == (2, 1, 0)


def test_two_components_are_two_campaigns() -> None:
    with pytest.raises(ConfigurationError, match="one component") as caught:
        judge([one(0), one(1, component="Other")])
    assert caught.value.found == "Other, Planner"


def test_the_record_has_the_keys_of_the_design_and_survives_json() -> None:
    found = judge([one(0), one(1, "violated", -1.0)], at_most=0.3)
    plain = json.loads(json.dumps(encode(found)))
    assert set(plain) >= KEYS_OF_THE_RECORD
    assert set(plain["bound"]) >= {"confidence", "upper", "method"}
    counterexample = {"episode": "case#1", "time": 2.0, "margin": -1.0, "valid": True}
    assert plain["counterexamples"] == [counterexample]
    assert plain["vacuous"] == 0
    assert decode(CampaignVerdict, plain) == found


def test_the_first_uncounted_episode_is_named_a_missing_one_before_an_invalid_one() -> None:
    verdicts = [one(0), one(1, "invalid"), one(2, "missing"), one(3, "missing")]
    found = judge(verdicts)
    assert found.first_uncounted == UncountedEpisode("case#2", "missing", verdicts[2].detail)
    assert judge(verdicts[:2]).first_uncounted == UncountedEpisode(
        "case#1", "invalid", verdicts[1].detail
    )
    assert judge(verdicts[:1]).first_uncounted is None
    assert decode(CampaignVerdict, encode(found)) == found


def test_one_violation_shows_that_the_condition_held() -> None:
    vacuous = [one(run, vacuous=True) for run in range(1, 93)]
    found = judge([*vacuous, one(0, "violated", -1.0)], at_most=0.05)
    assert (found.verdict, found.vacuous, found.violations) == ("supported", 92, 1)


def test_nothing_is_saved_where_runs_ended_for_want_of_an_answer() -> None:
    verdicts = some(satisfied=3, missing=1)
    rule = Requirement("R", at_most=0.05)
    found = judge_campaign(rule, "case", verdicts, planned=100, until_decided=True)
    assert (found.verdict, found.saved) == ("undecided", 0)


def test_a_violation_after_a_sequential_acceptance_is_not_supported() -> None:
    rule = Requirement("R", at_most=0.05, method="e-process")
    found = judge_campaign(rule, "case", some(satisfied=76), planned=100)
    assert (found.verdict, found.episodes, found.saved) == ("supported", 76, 24)
    verdicts = [*some(satisfied=74), *(one(run, "violated", -1.0) for run in (75, 76, 77))]
    found = judge_campaign(rule, "case", verdicts, planned=100)
    assert (found.verdict, found.episodes, found.violations) == ("undecided", 77, 3)
    assert "supported after 74 episodes, and 3 after these violated it" in found.reason


@pytest.mark.parametrize("method", ["e-process", "sprt", "fixed"])
def test_runs_go_on_while_a_rate_is_decided_and_invalid_episodes_are_too_many(method: Any) -> None:
    rule = Requirement("R", at_most=0.3, method=method, p0=0.01 if method == "sprt" else None)
    judge = CampaignJudge(rule, "case", planned=60 if method != "fixed" else 20, until_decided=True)
    for run, word in enumerate(["invalid"] * 5 + ["satisfied"] * 19):
        judge.add(one(run, word))
    assert judge.test is not None
    assert judge.test.decision == "supported"
    assert (judge.decided, judge.verdict().verdict) == (False, "undecided")
    judge.add(one(30))
    assert (judge.decided, judge.verdict().verdict) == (True, "supported")


def test_runs_go_on_until_the_condition_has_held() -> None:
    rule = Requirement("R", at_most=0.3, method="e-process")
    judge = CampaignJudge(rule, "case", planned=60, until_decided=True)
    for run in range(30):
        judge.add(one(run, vacuous=True))
        assert not judge.decided
    judge.add(one(30))
    assert judge.decided
    assert (judge.verdict().verdict, judge.verdict().saved) == ("supported", 29)


def test_runs_until_decided_end_at_a_missing_episode_and_take_an_e_process_by_default() -> None:
    judge = CampaignJudge(Requirement("R", at_most=0.3), "case", planned=60, until_decided=True)
    assert judge.method == "e-process"
    judge.add(one(0))
    assert not judge.decided
    judge.add(one(1, "missing"))
    assert judge.decided


def test_without_a_valid_episode_a_sequential_test_bounds_nothing() -> None:
    assert judge(some(invalid=3), at_most=0.3, method="e-process").bound.upper is None
    assert judge(some(satisfied=3), at_most=0.3, method="e-process").bound.upper is not None


@pytest.mark.parametrize(
    "failed, labels", [(["case#1"], ["component", "worst"]), (["case#0"], ["worst", "component"])]
)
def test_what_the_component_raised_in_the_worst_run_stands_before_the_amount(
    failed: list[str], labels: list[str]
) -> None:
    found = judge([one(0), one(1, "violated", -1.0)])
    requirement = Requirement("R", text="It holds.")
    lines = explain_verdict(found, requirement, "Planner raised it", failed=failed)
    assert [line.partition(":")[0] for line in lines[1:]] == [*labels, "required"]


def test_what_the_component_raised_comes_first_where_no_run_violates_anything() -> None:
    pairs = Requirement("R", text="It holds.", paired=Paired("recovery_planner"))
    lines = explain_verdict(judge(some(satisfied=2)), pairs, "Planner raised it")
    assert [line.partition(":")[0] for line in lines[1:]] == ["component", "pairs", "required"]
