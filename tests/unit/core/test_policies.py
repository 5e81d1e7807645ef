"""What follows a refused proposal: recover, halt, log_only, refine(k)."""

from __future__ import annotations

from typing import Any

import pytest
from loops import Says, doing, run_loop
from thermostat import HeatMonitor, SwitchOff

from pytest_dura import (
    Alert,
    Assessed,
    Assessment,
    ConfigurationError,
    Policy,
    Proposal,
    Role,
    SafetyMonitor,
    SecurityAssessment,
    SecurityAssessor,
)

HOT = {"scenario": {"world": {"start": 40.0}}}


def heater() -> Says:
    return Says(lambda view: Proposal(1.0))


@pytest.mark.parametrize("text", ["recover", "halt", "log_only", "refine(1)", "refine(12)"])
def test_a_policy_reads_and_writes_its_name(text: str) -> None:
    assert str(Policy.parse(text)) == text


@pytest.mark.parametrize(
    "text",
    ["", "Recover", "recover(", "recover()", "refine", "refine(0)", "refine(-1)", "refine(1.5)",
     "refine(2", "refine(2))", "refine(٣)", None, 3],
)  # fmt: skip
def test_anything_else_is_no_policy(text: Any) -> None:
    with pytest.raises(ConfigurationError, match="no such policy") as caught:
        Policy.parse(text)
    assert "refine(k)" in str(caught.value)


@pytest.mark.parametrize("fields", [("bogus",), ("refine",), ("recover", 2), ("refine", -1)])
def test_an_impossible_policy_cannot_be_made(fields: tuple[Any, ...]) -> None:
    with pytest.raises(ConfigurationError, match="no such policy"):
        Policy(*fields)


def test_recover_replaces_the_proposal() -> None:
    episode = run_loop(
        heater(), safety_monitor=HeatMonitor(), recovery_planner=SwitchOff(), spec=HOT
    )
    assert set(episode.decisions["executed"]) == {"0%"}
    assert set(episode.decisions["source"]) == {"recovery"}
    (event,) = (e for e in episode.events if e.kind == "recovery")
    assert (event.tick, event.subject) == (0, "switch_off")
    assert event.detail == "safety_monitor: heating above the limit"


def test_log_only_carries_out_what_was_refused() -> None:
    episode = run_loop(
        heater(),
        policy="log_only",
        safety_monitor=HeatMonitor(),
        recovery_planner=SwitchOff(),
        spec=HOT,
    )
    assert set(episode.decisions["executed"]) == {"100%"}
    assert set(episode.decisions["verdict"]) == {2}
    assert episode.metrics.recoveries == []


def test_halt_ends_the_episode_where_the_proposal_is_refused() -> None:
    monitor = doing(
        SafetyMonitor,
        lambda view: Assessment(
            Assessed.UNSAFE if view.index == 4 else Assessed.SAFE, 0.0, ("stop it",)
        ),
    )
    episode = run_loop(heater(), policy="halt", safety_monitor=monitor)
    assert episode.termination == "halt"
    assert episode.ticks == 5
    assert len(episode.decisions["verdict"]) == 4
    assert episode.flagged
    assert episode.events[-1].kind == "halt"
    assert episode.events[-1].detail == "safety_monitor: stop it"


def test_refine_tells_the_generator_why_and_takes_the_better_proposal() -> None:
    answers = Says(lambda view: Proposal(0.0 if view.feedback else 1.0))
    episode = run_loop(
        answers,
        policy="refine(3)",
        seconds=0.2,
        safety_monitor=HeatMonitor(),
        recovery_planner=SwitchOff(),
        spec=HOT,
    )
    feedback = [view.feedback for view in answers.views]
    assert feedback == [(), ("safety_monitor: heating above the limit",)] * 2
    assert episode.decisions["attempts"].tolist() == [1, 1]
    assert set(episode.decisions["source"]) == {"proposal"}
    assert set(episode.decisions["executed"]) == {"0%"}
    assert episode.metrics.proposals == 4
    # The tick was violated once, though its proposal was assessed twice; it ended well.
    assert episode.metrics.violations["safety_monitor"] == 2
    assert episode.decisions["verdict"].tolist() == [1, 1]


@pytest.mark.parametrize("k", [1, 2, 5])
def test_refine_asks_at_most_k_times_before_recovery(k: int) -> None:
    stubborn = heater()
    episode = run_loop(
        stubborn,
        policy=f"refine({k})",
        seconds=0.1,
        safety_monitor=HeatMonitor(),
        recovery_planner=SwitchOff(),
        spec=HOT,
    )
    assert len(stubborn.views) == 1 + k
    assert episode.decisions["attempts"].tolist() == [k]
    assert episode.decisions["source"].tolist() == ["recovery"]
    assert episode.metrics.violations["safety_monitor"] == 1


def test_a_role_that_does_not_reassess_runs_once_and_its_verdict_holds() -> None:
    world_watch = doing(
        SafetyMonitor, lambda view: Assessment(Assessed.UNSAFE, -1.0, ("smoke",)), reassess=False
    )
    episode = run_loop(
        Says(lambda view: Proposal(0.0)),
        policy="refine(2)",
        seconds=0.1,
        world_watch=world_watch,
        recovery_planner=SwitchOff(),
    )
    assert world_watch.seen == [0]
    assert episode.decisions["source"].tolist() == ["recovery"]
    assert episode.decisions["verdict"].tolist() == [2]


def test_the_same_alert_counts_once_in_a_tick_that_is_refined() -> None:
    alert = SecurityAssessment(alerts=(Alert("jump", "thermometer"),))
    episode = run_loop(
        heater(),
        policy="refine(2)",
        seconds=0.2,
        safety_monitor=HeatMonitor(),
        security_assessor=doing(SecurityAssessor, lambda view: alert),
        spec=HOT,
    )
    assert episode.metrics.alerts == 2
    assert [e.tick for e in episode.events if e.kind == "alert"] == [0, 1]


def test_a_component_that_fails_can_still_refine() -> None:
    answers = Says(lambda view: Proposal(0.5) if view.feedback else None)
    episode = run_loop(answers, policy="refine(1)", seconds=0.1, recovery_planner=SwitchOff())
    assert answers.views[1].feedback == ("the component made no valid proposal",)
    assert episode.decisions["executed"].tolist() == ["50%"]


def test_a_verdict_on_an_earlier_proposal_does_not_stick_to_one_that_was_not_assessed() -> None:
    answers = Says(lambda view: None if view.feedback else Proposal(1.0))
    episode = run_loop(
        answers,
        policy="refine(1)",
        seconds=0.1,
        safety_monitor=HeatMonitor(),
        recovery_planner=SwitchOff(),
        spec=HOT,
    )
    (event,) = (e for e in episode.events if e.kind == "recovery")
    assert event.detail == "the component made no valid proposal"


def test_a_users_role_may_take_its_verdict_back_by_saying_something_else() -> None:
    unsafe = Assessment(Assessed.UNSAFE, -1.0, ("too loud",))
    critic = doing(Role, lambda view: unsafe if view.proposal.action > 0.5 else 5)
    episode = run_loop(
        Says(lambda view: Proposal(0.5 if view.feedback else 1.0)),
        policy="refine(1)",
        seconds=0.1,
        critic=critic,
        recovery_planner=SwitchOff(),
    )
    assert episode.decisions["executed"].tolist() == ["50%"]
    assert episode.decisions["verdict"].tolist() == [0]
