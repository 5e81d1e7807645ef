"""When an episode ends, to the tick."""

from __future__ import annotations

from typing import Any

import pytest
from loops import run_loop
from thermostat import Controller

from pytest_dura import ConfigurationError, EpisodeSpec, Proposal, RoleSpec, Termination


def heat(view: Any) -> Proposal:
    return Proposal(1.0)


@pytest.mark.parametrize(
    "seconds, step, steps",
    [
        (5.1, 0.1, 51),  # 50.99999999999999 in floats
        (4.0, 0.1, 40),
        (0.3, 0.1, 3),  # 2.9999999999999996
        (0.7, 0.1, 7),  # 6.999999999999999
        (1.0, 0.3, 4),  # the first tick at or past the limit
        (0.25, 0.1, 3),
        (0.35, 0.1, 4),
        (0.04, 0.1, 1),
        (2.0, 1.0, 2),
        (1.0, 0.0125, 80),
    ],
)
def test_time_ends_it_after_exactly_so_many_steps(seconds: float, step: float, steps: int) -> None:
    episode = run_loop(Controller(), seconds=seconds, spec={"time_step": step})
    assert episode.termination == "time"
    assert episode.ticks == steps + 1
    assert episode.time[-1] >= seconds - 1e-9
    assert episode.time[-2] < seconds - 1e-9


def test_the_goal_ends_it_unless_the_spec_says_otherwise() -> None:
    scenario = {"scenario": {"world": {"start": 19.0, "goal": 20.0}}}
    episode = run_loop(heat, seconds=5.0, spec=scenario)
    assert episode.termination == "goal"
    assert episode.signals["temperature"][-1] >= 20.0 > episode.signals["temperature"][-2]
    onwards = run_loop(heat, spec={**scenario, "termination": Termination(5.0, goal=False)})
    assert onwards.termination == "time"


def test_something_critical_ends_it_and_is_an_event() -> None:
    episode = run_loop(heat, seconds=5.0, spec={"scenario": {"world": {"start": 29, "fuse": 30}}})
    assert episode.termination == "critical"
    assert episode.signals["temperature"][-1] >= 30.0 > episode.signals["temperature"][-2]
    assert episode.events[-1].kind == "critical"
    assert episode.events[-1].detail == "the fuse has blown"


def test_what_is_critical_comes_before_the_goal() -> None:
    world = {"start": 29.0, "fuse": 30.0, "goal": 30.0}
    assert run_loop(heat, spec={"scenario": {"world": world}}).termination == "critical"


def test_an_episode_may_be_over_at_its_first_tick() -> None:
    episode = run_loop(heat, spec={"scenario": {"world": {"start": 70.0}}})
    assert (episode.termination, episode.ticks) == ("critical", 1)
    assert len(episode.decisions["verdict"]) == 0
    assert len(episode.digest) == 64


@pytest.mark.parametrize("count", [1, 7])
def test_iterations_count_decisions(count: int) -> None:
    episode = run_loop(heat, spec={"termination": Termination(9.0, iterations=count)})
    assert episode.termination == "iterations"
    assert len(episode.decisions["verdict"]) == count
    assert episode.ticks == count + 1


def test_the_judge_ends_it_at_a_violation_only_where_the_spec_asks_for_it() -> None:
    def too_warm(simulator: Any, ticks: Any) -> bool:
        return bool(simulator.signals(ticks)["temperature"][-1] > 18.0)

    asked = {"termination": Termination(9.0, violation=True)}
    episode = run_loop(heat, judge=too_warm, spec=asked)
    assert episode.termination == "violation"
    assert episode.signals["temperature"][-1] > 18.0 >= episode.signals["temperature"][-2]
    assert run_loop(heat, judge=too_warm, seconds=2.0).termination == "time"


def test_a_judge_that_fails_is_infrastructure() -> None:
    def broken(simulator: Any, ticks: Any) -> bool:
        if len(ticks) == 3:
            raise LookupError("no such requirement")
        return False

    episode = run_loop(heat, judge=broken, spec={"termination": Termination(9.0, violation=True)})
    assert episode.failure is not None
    assert episode.failure.startswith("infrastructure: judge at tick 2 (t = 0.2 s): LookupError")


@pytest.mark.parametrize("limit", [0.0, -1.0, float("nan"), float("inf")])
def test_impossible_limits_are_refused(limit: float) -> None:
    with pytest.raises(ConfigurationError, match="time_limit is a positive, finite number"):
        Termination(limit)
    with pytest.raises(ConfigurationError, match="iterations"):
        Termination(1.0, iterations=0)
    part = RoleSpec("thermostat:Thermostat")
    with pytest.raises(ConfigurationError, match="time_step"):
        EpisodeSpec("a/b", 0, 0, part, {}, time_step=limit)
    with pytest.raises(ConfigurationError, match="time_budget"):
        EpisodeSpec("a/b", 0, 0, part, {}, time_budget=limit)
