"""When anything but the component fails, the episode is missing, and says who failed and when."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from loops import doing, run_loop
from thermostat import HeatMonitor, Thermostat

from pytest_dura import (
    Alert,
    Assessed,
    Assessment,
    ConfigurationError,
    FaultInjector,
    Injection,
    PerformanceAssessment,
    PerformanceOracle,
    Proposal,
    Recovery,
    RecoveryPlanner,
    Role,
    SafetyMonitor,
    SecurityAssessment,
    SecurityAssessor,
    Tick,
)

NAN = float("nan")
A: Any = None


def heat(view: Any) -> Proposal:
    return Proposal(1.0)


def at_three(good: Any, bad: Any) -> Any:
    """A role's output: the good one, and from tick 3 on the bad one (raised, if an error)."""

    def output(view: Any) -> Any:
        if view.index < 3:
            return good
        if isinstance(bad, BaseException):
            raise bad
        return bad

    return output


GOOD = {
    "safety_monitor": (SafetyMonitor, Assessment()),
    "security_assessor": (SecurityAssessor, SecurityAssessment()),
    "fault_injector": (FaultInjector, Injection()),
    "performance_oracle": (PerformanceOracle, PerformanceAssessment()),
    "mine": (Role, 5),
}


@pytest.mark.parametrize(
    "role, bad, cause",
    [
        *((role, ZeroDivisionError("oh"), "ZeroDivisionError: oh") for role in GOOD),
        *((role, SystemExit("bye"), "SystemExit: bye") for role in GOOD),
        *((role, ConfigurationError("late"), "ConfigurationError: late") for role in GOOD),
        ("safety_monitor", None, "returned NoneType, not an Assessment"),
        ("safety_monitor", "safe", "returned str, not an Assessment"),
        ("safety_monitor", Assessment(score=NAN), "its score is not a number (NaN)"),
        ("safety_monitor", Assessment(score=A), "its score is None, which is not a number"),
        ("safety_monitor", Assessment("unsafe"), "its verdict is 'unsafe'"),  # type: ignore[arg-type]
        ("safety_monitor", Assessment(2), "its verdict is 2, not one of SAFE, WARNING, UNSAFE"),  # type: ignore[arg-type]
        ("safety_monitor", Assessment(reasons="hot"), "its reasons is a str, not a tuple of str"),  # type: ignore[arg-type]
        ("safety_monitor", Assessment(reasons=(1,)), "its reasons holds an int, not only str"),  # type: ignore[arg-type]
        ("security_assessor", Assessment(), "returned Assessment, not a SecurityAssessment"),
        ("security_assessor", SecurityAssessment(score=NAN), "score is not a number (NaN)"),
        ("security_assessor", SecurityAssessment(alerts=("x",)), "a str, not an Alert"),  # type: ignore[arg-type]
        ("security_assessor", SecurityAssessment(alerts=A), "its alerts are a NoneType"),
        ("security_assessor", SecurityAssessment(alerts=(Alert("x", A),)), "its alert holds"),
        ("security_assessor", SecurityAssessment(directives="f1"), "its directives is a str"),  # type: ignore[arg-type]
        ("security_assessor", SecurityAssessment(reaction=1), "its reaction holds an int"),  # type: ignore[arg-type]
        ("fault_injector", None, "returned NoneType, not an Injection"),
        ("fault_injector", Injection("f1"), "its activated is a str"),  # type: ignore[arg-type]
        ("performance_oracle", {"speed": 1}, "returned dict, not a PerformanceAssessment"),
        ("performance_oracle", PerformanceAssessment({"v": NAN}), "values['v'] is not a number"),
        ("performance_oracle", PerformanceAssessment({}, {"v": NAN}), "wall_clock['v'] is not"),
        ("performance_oracle", PerformanceAssessment({"v": A}), "values['v'] is None"),
        ("performance_oracle", PerformanceAssessment(5), "its values is an int, not a mapping"),  # type: ignore[arg-type]
        ("mine", Assessment(score=NAN), "its score is not a number (NaN)"),
    ],
)
def test_a_failing_role_makes_the_episode_missing(role: str, bad: Any, cause: str) -> None:
    base, good = GOOD[role]
    episode = run_loop(heat, **{role: doing(base, at_three(good, bad))})
    assert episode.failure is not None
    assert episode.failure.startswith(f"infrastructure: {role} at tick 3 (t = 0.3 s): ")
    assert cause in episode.failure
    assert episode.validity == "missing"
    assert episode.termination == "infrastructure"
    assert (episode.events[-1].kind, episode.events[-1].subject) == ("infrastructure", role)
    # What was observed up to there is kept, so that a violation in it still counts.
    assert episode.ticks == 4
    assert len(episode.signals["temperature"]) == 4
    assert len(episode.decisions["verdict"]) == 3
    assert len(episode.digest) == 64


def test_a_users_role_may_return_anything_also_nothing() -> None:
    for value in (None, 5, "text", Assessment(Assessed.SAFE)):
        assert run_loop(heat, mine=doing(Role, lambda view, v=value: v)).failure is None


@pytest.mark.parametrize("role", list(GOOD))
def test_a_role_that_fails_in_reset_fails_at_tick_0(role: str) -> None:
    base, good = GOOD[role]
    part = doing(base, lambda view: good)
    part.reset = at_tick_0
    episode = run_loop(heat, **{role: part})
    assert episode.failure is not None
    assert episode.failure.startswith(f"infrastructure: {role} at tick 0 (t = 0.0 s): KeyError")
    assert (episode.ticks, episode.signals, episode.validity) == (0, {}, "missing")
    assert len(episode.digest) == 64


def at_tick_0(context: Any) -> None:
    raise KeyError("speed")


def test_the_place_of_an_error_is_told_without_its_folder() -> None:
    part = doing(Role, lambda view: 1 / 0)
    failure = run_loop(heat, mine=part).failure
    assert failure is not None
    assert "division by zero (test_infrastructure.py:" in failure
    assert "/" not in failure


def test_a_trigger_that_raises_is_infrastructure() -> None:
    part = doing(Role, lambda view: 1)
    part.trigger = lambda view: view.no_such_thing
    failure = run_loop(heat, mine=part).failure
    assert failure is not None
    assert failure.startswith("infrastructure: mine at tick 0 (t = 0.0 s): AttributeError")


@pytest.mark.parametrize(
    "recovery, cause",
    [
        (lambda view: 1 / 0, "ZeroDivisionError"),
        (lambda view: None, "returned NoneType, not a Recovery"),
        (lambda view: 0.0, "returned float, not a Recovery"),
        (lambda view: Recovery(NAN, "x"), "ActionError: nan is not a heating power"),
        (lambda view: Recovery(0.0, None), "its name and explanation holds a NoneType"),  # type: ignore[arg-type]
    ],
)
def test_a_failing_recovery_planner_is_infrastructure(recovery: Any, cause: str) -> None:
    episode = run_loop(
        heat,
        safety_monitor=HeatMonitor(limit=16.0),
        recovery_planner=doing(RecoveryPlanner, recovery),
    )
    assert episode.failure is not None
    assert episode.failure.startswith("infrastructure: recovery_planner at tick 2 (t = 0.2 s)")
    assert cause in episode.failure


class Injector(FaultInjector):
    def __init__(self, channels: Any = None, command: Any = None) -> None:
        self._channels, self._command = channels, command

    def run(self, view: Any) -> Injection:
        return Injection()

    def corrupt(self, channels: Any, time: float) -> Any:
        return self._channels(channels, time) if self._channels else (channels, {})

    def corrupt_command(self, action: Any, time: float) -> Any:
        return self._command(action, time) if self._command else (action, ())


@pytest.mark.parametrize(
    "channels, cause",
    [
        (lambda channels, time: channels if time > 0.25 else (channels, {}), "ValueError"),
        (lambda channels, time: (None, {}) if time > 0.25 else (channels, {}), "NoneType"),
        (lambda c, time: (c, {"clock": "f"} if time > 0.25 else {}), "tampered faults is a str"),
        (lambda c, time: (c, {"clock": (1,)} if time > 0.25 else {}), "holds an int, not only"),
    ],
)
def test_a_fault_injector_that_breaks_perception_is_infrastructure_at_the_new_tick(
    channels: Any, cause: str
) -> None:
    episode = run_loop(heat, fault_injector=Injector(channels))
    assert episode.failure is not None
    assert episode.failure.startswith("infrastructure: fault_injector at tick 3 (t = 0.3 s): ")
    assert cause in episode.failure


def test_the_truth_of_a_tick_counts_even_if_it_could_not_be_perceived() -> None:
    def breaks(channels: Any, time: float) -> Any:
        if time > 0.25:
            raise RuntimeError("bus is down")
        return channels, {}

    episode = run_loop(heat, fault_injector=Injector(breaks))
    assert episode.failure is not None
    assert episode.failure.startswith("infrastructure: fault_injector at tick 3 (t = 0.3 s)")
    assert len(episode.signals["temperature"]) == 4
    assert np.isfinite(episode.signals["temperature"]).all()
    assert np.isnan(episode.signals["percept.temperature"]).tolist() == [False] * 3 + [True]


def test_a_fault_injector_that_breaks_the_command_is_infrastructure() -> None:
    for command in (lambda action, time: action, lambda action, time: (action, "f1")):
        episode = run_loop(heat, fault_injector=Injector(command=command))
        assert episode.failure is not None
        assert episode.failure.startswith("infrastructure: fault_injector at tick 0")


class Broken(Thermostat):
    """A simulator that goes wrong at step 3 in the way it is told."""

    def __init__(self, way: Any) -> None:
        self.way = way

    def step(self, action: Any) -> Any:
        tick = super().step(action)
        return self.way(tick) if tick.index == 3 else tick


def replaced(**fields: Any) -> Any:
    from dataclasses import replace

    return lambda tick: replace(tick, **fields)


@pytest.mark.parametrize(
    "way, cause",
    [
        (lambda tick: 1 / 0, "ZeroDivisionError"),
        (lambda tick: None, "returned NoneType, not a Tick"),
        (replaced(index=2), "returned tick 2 at 0.3 s where tick 3 at 0.3 s was due"),
        (replaced(time=NAN), "returned tick 3 at nan s where tick 3 at 0.3 s was due"),
        (replaced(time=0.2), "returned tick 3 at 0.2 s"),
        (replaced(channels=[1]), "its channels are a list, not a mapping"),
        (replaced(events=("switched",)), "its event is a str"),
    ],
)
def test_a_simulator_that_fails_in_step(way: Any, cause: str) -> None:
    episode = run_loop(heat, simulator=Broken(way))
    assert episode.failure is not None
    assert episode.failure.startswith("infrastructure: simulator at tick 2 (t = 0.2 s): ")
    assert cause in episode.failure
    assert episode.ticks == 3
    assert len(episode.decisions["verdict"]) == 2


def test_a_simulator_whose_clock_stands_still_does_not_hang_the_loop() -> None:
    class Still(Thermostat):
        def step(self, action: Any) -> Tick:
            return self._tick(())

    assert run_loop(heat, simulator=Still(), seconds=9e9).failure is not None


@pytest.mark.parametrize(
    "method",
    ["set_time_step", "reset", "check_action", "fallback_action", "describe_action", "signals",
     "percept_signals"],
)  # fmt: skip
def test_a_simulator_that_fails_anywhere_else(method: str) -> None:
    simulator = Thermostat()

    def broken(*args: Any) -> Any:
        raise RuntimeError("the plant is gone")

    setattr(simulator, method, broken)
    generator = (lambda view: None) if method == "fallback_action" else heat
    episode = run_loop(generator, simulator=simulator)
    assert episode.failure is not None
    tick = 10 if "signals" in method else 0
    assert episode.failure.startswith(f"infrastructure: simulator at tick {tick} (t = ")
    assert "RuntimeError: the plant is gone" in episode.failure
    assert ("temperature" in episode.signals) is (
        method not in ("set_time_step", "reset", "signals")
    )


@pytest.mark.parametrize(
    "column, cause",
    [
        (np.array([1.0, NAN, 3.0, NAN]), "at tick 1 (t = 0.1 s): signal 'x' is nan"),
        (np.array([1.0, 2.0, np.inf, 4.0]), "at tick 2 (t = 0.2 s): signal 'x' is inf"),
        (np.ones(3), "signal 'x' has the shape (3,), expected (4,)"),
        (np.ones((4, 1)), "signal 'x' has the shape (4, 1), expected (4,)"),
        (["a"] * 4, "could not convert string to float"),
    ],
)
def test_signals_that_cannot_be_judged_make_the_episode_missing(column: Any, cause: str) -> None:
    simulator = Thermostat()
    simulator.signals = lambda ticks: {"x": column, "ok": np.zeros(len(ticks))}  # type: ignore[method-assign]
    episode = run_loop(heat, simulator=simulator, seconds=0.3)
    assert episode.failure is not None
    assert cause in episode.failure
    assert episode.validity == "missing"


def test_a_percept_may_hold_nan_since_a_fault_may_have_put_it_there() -> None:
    injector = Injector(lambda channels, time: ({**channels, "thermometer": NAN}, {}))
    episode = run_loop(heat, fault_injector=injector)
    assert episode.failure is None
    assert np.isnan(episode.signals["percept.temperature"]).all()


def test_a_role_that_needs_mending_before_anything_moved_is_the_users_to_mend() -> None:
    part = doing(Role, lambda view: 1)

    def reset(context: Any) -> None:
        raise ConfigurationError("unknown threshold 'sped'", key="thresholds")

    part.reset = reset
    with pytest.raises(ConfigurationError, match="unknown threshold 'sped'"):
        run_loop(heat, mine=part)
    with pytest.raises(ConfigurationError, match="positive number of seconds"):
        Thermostat().set_time_step(0.0)


def test_user_metrics_that_fail_are_infrastructure() -> None:
    episode = run_loop(heat, metrics={"good": lambda e: e.ticks, "bad": lambda e: 1 / 0})
    assert episode.failure is not None
    assert episode.failure.startswith("infrastructure: metric 'bad' at tick 10 (t = 1.0 s): Zero")
    assert episode.metrics.user == {"good": 11.0}
    assert episode.termination == "infrastructure"
    assert episode.events[-1].subject == "metric 'bad'"
