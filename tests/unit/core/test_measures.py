"""DependabilityMetrics: every item of the paper's list, and the user's own."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest
from loops import doing, run_loop
from thermostat import Bias, Controller, HeatMonitor, JumpWatch, Meter, Overheater, SwitchOff

from pytest_dura import (
    Assessed,
    Assessment,
    DependabilityMetrics,
    PerformanceAssessment,
    PerformanceOracle,
    Proposal,
    SafetyMonitor,
    SecurityAssessor,
)
from pytest_dura.core import SecurityAssessment


def unsafe_at(*ticks: int) -> Any:
    return doing(
        SafetyMonitor,
        lambda view: Assessment(
            Assessed.UNSAFE if view.index in ticks else Assessed.SAFE, 1.0 - view.index
        ),
    )


def test_the_summary_has_every_item_and_is_plain_data() -> None:
    bias = {"id": "bias", "target": "thermometer", "activation": {"at": 0.5}, "duration": 0.3}
    episode = run_loop(
        Overheater(),
        seconds=2.0,
        safety_monitor=HeatMonitor(limit=16.0),
        security_assessor=JumpWatch(),
        fault_injector=Bias(),
        performance_oracle=Meter(),
        recovery_planner=SwitchOff(),
        metrics={"hottest": lambda e: e.signal("temperature").max()},
        spec={"faults": (bias,)},
    )
    summary = episode.metrics.summary()
    assert set(summary) == {
        "violations", "performance", "wall_clock", "robustness_min", "faults", "recoveries",
        "recoveries_succeeded", "alerts", "proposals", "valid_proposals", "processing_us",
        "tallies", "answer_seconds", "answer_ages", "user", "reactions",
    }  # fmt: skip
    assert summary["violations"]["safety_monitor"] > 0
    assert summary["violations"]["performance:energy"] > 0
    assert summary["performance"]["energy"]["last"] == pytest.approx(2.0)
    assert set(summary["wall_clock"]) == {"response_s"}
    assert summary["robustness_min"]["safety_monitor"] < 0.0
    assert summary["faults"] == {
        "planned": 1,
        "succeeded": 1,
        "detected": 1,
        "recovered": 0,
        "impact_ticks": 0,
    }
    assert summary["recoveries"] >= 1
    assert summary["proposals"] == summary["valid_proposals"] == 20
    assert set(summary["processing_us"]) == {
        "generator", "safety_monitor", "security_assessor", "fault_injector",
        "performance_oracle", "recovery_planner",
    }  # fmt: skip
    assert summary["user"] == {"hottest": episode.signals["temperature"].max()}
    assert json.loads(json.dumps(summary)) == summary


def test_values_scores_and_times_are_kept_per_tick() -> None:
    episode = run_loop(
        Controller(), seconds=0.3, safety_monitor=unsafe_at(), performance_oracle=Meter()
    )
    metrics = episode.metrics
    times, energy = metrics.performance["energy"]
    assert times == episode.time[:3].tolist()
    assert energy == pytest.approx([0.1, 0.2, 0.3])
    assert metrics.robustness["safety_monitor"] == (times, [1.0, 0.0, -1.0])
    assert metrics.processing_ns["generator"][0] == [0, 1, 2]
    assert all(ns > 0 for ns in metrics.processing_ns["generator"][1])
    assert metrics.column("energy").tolist() == energy
    assert len(metrics.column("response_s")) == 3
    assert len(metrics.column("unknown")) == 0


@pytest.mark.parametrize(
    "ticks, recoveries",
    [
        ((), []),
        ((2, 3), [(2, 3, True)]),
        ((2, 4, 5), [(2, 2, True), (4, 5, True)]),
        ((8, 9), [(8, 9, False)]),  # still at it when the episode ended
    ],
)
def test_a_recovery_succeeds_when_the_proposal_is_acceptable_again(
    ticks: tuple[int, ...], recoveries: list[Any]
) -> None:
    episode = run_loop(
        Controller(),
        seconds=1.0,
        safety_monitor=unsafe_at(*ticks),
        recovery_planner=SwitchOff(),
    )
    assert episode.metrics.recoveries == recoveries
    summary = episode.metrics.summary()
    assert summary["recoveries"] == len(recoveries)
    assert summary["recoveries_succeeded"] == sum(r[2] for r in recoveries)
    began = [e.tick for e in episode.events if e.kind == "recovery"]
    assert began == [first for first, _, _ in recoveries]


def test_a_recovery_before_something_critical_has_failed() -> None:
    episode = run_loop(
        lambda view: Proposal(1.0),
        seconds=9.0,
        safety_monitor=unsafe_at(1, 3),
        recovery_planner=SwitchOff(),
        spec={"scenario": {"world": {"start": 29.0, "fuse": 31.0}}},
    )
    assert episode.termination == "critical"
    assert episode.metrics.recoveries == [(1, 1, True), (3, 3, False)]


def test_thresholds_that_depend_on_the_clock_are_told_apart() -> None:
    output = PerformanceAssessment({"jerk": 9.0}, {"response_s": 1.0}, ("jerk", "response_s"))
    episode = run_loop(
        Controller(), seconds=0.3, performance_oracle=doing(PerformanceOracle, lambda v: output)
    )
    assert episode.metrics.violations == {"performance:jerk": 3, "wall_clock:response_s": 3}
    fails = [(e.tick, e.subject, e.wall_clock) for e in episode.events if "fail" in e.kind]
    assert fails == [(0, "jerk", False), (0, "response_s", True)]
    deterministic = episode.metrics.deterministic()
    assert deterministic["violations"] == {"performance:jerk": 3}
    assert "response_s" not in json.dumps(deterministic)


def test_a_class_of_reaction_that_lasts_counts_once_each_time_it_begins() -> None:
    said = ["frozen", "frozen", None, "frozen", "erratic", None]

    def assess(view: Any) -> SecurityAssessment:
        return SecurityAssessment(reaction=said[view.index])

    episode = run_loop(Controller(), seconds=0.6, security_assessor=doing(SecurityAssessor, assess))
    assert episode.metrics.reactions == {"frozen": 2, "erratic": 1}
    assert episode.metrics.deterministic()["reactions"] == {"erratic": 1, "frozen": 2}
    assert episode.metrics.summary()["reactions"] == {"erratic": 1, "frozen": 2}


def test_performance_never_activates_recovery() -> None:
    output = PerformanceAssessment({"jerk": 9.0}, {}, ("jerk",))
    episode = run_loop(
        Controller(),
        performance_oracle=doing(PerformanceOracle, lambda v: output),
        recovery_planner=SwitchOff(),
    )
    assert set(episode.decisions["source"]) == {"proposal"}
    assert not episode.flagged


def test_user_metrics_see_the_complete_episode_and_may_have_no_value() -> None:
    seen: list[str] = []

    def termination(episode: Any) -> float:
        seen.append(episode.termination)
        return math.nan

    episode = run_loop(Controller(), seconds=0.2, metrics={"none": termination})
    assert seen == ["time"]
    assert math.isnan(episode.metrics.user["none"])
    assert episode.failure is None


def test_an_empty_record_has_a_summary() -> None:
    assert DependabilityMetrics().summary()["proposals"] == 0
