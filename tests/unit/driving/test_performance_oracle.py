"""DrivingOracle and EmergencyBrake."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from roads import Views, channels_of, run, spec_of_drive

from pytest_dura.core import (
    Assessed,
    Assessment,
    Generator,
    PerformanceAssessment,
    Proposal,
    RoleContext,
    RoleSpec,
    SafetyMonitor,
    check_role,
)
from pytest_dura.driving import Command, DrivingOracle, EmergencyBrake, HighwaySimulator, Maneuver
from pytest_dura.driving.roles import performance

EMPTY: dict[str, Any] = {"ego": {"distance": 40.0, "speed": 8.0}}


class Slow(Generator):
    """Drives on, and declares a latency."""

    def __init__(self, latency: float | None = 0.25, maneuver: str = "proceed") -> None:
        self.latency, self.maneuver = latency, maneuver

    def propose(self, view: Any) -> Proposal:
        """Always the same."""
        return Proposal(Command(Maneuver(self.maneuver)), latency=self.latency)


def measured(generator: Any = None, world: Any = EMPTY, **options: Any) -> Any:
    role = RoleSpec("test_performance_oracle:Slow", generator or {})
    episode = run(spec_of_drive(world, generator=role, **options))
    assert episode.failure is None
    return episode


class Oracle:
    """An oracle that is shown percepts one by one."""

    def __init__(self, **limits: float) -> None:
        self.oracle, self.views = DrivingOracle(**limits), Views()
        self.oracle.reset(RoleContext(1, 0.1))

    def look(self, action: Any = "proceed", **percept: Any) -> PerformanceAssessment:
        latency = percept.pop("latency", None)
        return self.oracle.run(self.views.role(channels_of(**percept), action, latency=latency))


def test_both_keep_the_contract_of_a_role() -> None:
    for role in (DrivingOracle, EmergencyBrake):
        check_role(role, simulator=HighwaySimulator, scenario={"world": {}})


def test_clearance_time_is_the_tick_at_which_the_rear_has_left() -> None:
    episode = measured(duration=25.0)
    cleared = int(np.flatnonzero(episode.signals["cleared"] > 0.5)[0])
    times, values = episode.metrics.performance["clearance_time"]
    assert times[0] == values[0] == pytest.approx(episode.time[cleared])
    assert set(values) == {values[0]}
    assert episode.metrics.column("completion")[cleared] == 1.0
    assert episode.metrics.column("completion")[0] == 0.0
    assert (np.diff(episode.metrics.column("completion")) >= 0.0).all()


def test_who_never_clears_the_junction_has_no_clearance_time() -> None:
    episode = measured({"maneuver": "emergency_brake"}, duration=4.0)
    assert "clearance_time" not in episode.metrics.performance
    assert episode.metrics.column("completion").max() < 0.2


def test_gridlock_is_standing_for_longer_than_allowed() -> None:
    oracle = Oracle(gridlock_after=1.0)
    standing = [oracle.look(s=90.0, speed=0.0) for _ in range(14)]
    assert [found.values["standing_time"] for found in standing[:3]] == pytest.approx(
        [0.1, 0.2, 0.3]
    )
    failed = ["gridlock" in found.performance_fail for found in standing]
    assert failed == [False] * 10 + [True] * 4
    assert "gridlock" not in oracle.look(s=90.0, speed=2.0).performance_fail
    assert oracle.look(s=90.0, speed=0.0).values["standing_time"] == pytest.approx(0.1)


def test_standing_behind_the_junction_is_no_gridlock() -> None:
    oracle = Oracle(gridlock_after=0.5)
    for _ in range(20):
        assert oracle.look(s=125.0, speed=0.0).performance_fail == ()


def test_gridlock_in_the_loop_is_an_event_and_counted_per_tick() -> None:
    episode = measured({"maneuver": "wait"}, duration=40.0)
    (event,) = [
        e for e in episode.events if (e.kind, e.subject) == ("performance_fail", "gridlock")
    ]
    standing = np.flatnonzero(episode.signals["speed"] < 0.1)
    assert event.time == pytest.approx(episode.time[standing[0]] + 20.0, abs=0.11)
    assert episode.metrics.violations["performance:gridlock"] > 10


def test_the_declared_latency_is_the_response_time() -> None:
    episode = measured({"latency": 0.25}, duration=2.0)
    assert set(episode.metrics.performance["response_time"][1]) == {0.25}
    assert "response_time" not in episode.metrics.wall_clock
    assert episode.metrics.violations["performance:response_time"] == 20
    assert measured({"latency": 0.05}, duration=2.0).metrics.violations == {}


def test_a_declared_latency_counts_in_the_digest_and_the_clock_does_not() -> None:
    slow = {"latency": 0.25}
    assert measured(slow, duration=2.0).digest == measured(slow, duration=2.0).digest
    undeclared = measured({"latency": None}, duration=2.0)
    assert undeclared.digest == measured({"latency": None}, duration=2.0).digest
    assert "response_time" not in undeclared.metrics.performance
    clocked = undeclared.metrics.wall_clock["response_time"][1]
    assert len(clocked) == 20
    assert all(0.0 < value < 0.1 for value in clocked)


def test_memory_is_measured_where_it_can_be(monkeypatch: pytest.MonkeyPatch) -> None:
    assert 10.0 < Oracle().look().wall_clock["memory"] < 100_000.0
    monkeypatch.setattr(performance, "resource", None)
    found = Oracle().look()
    assert "memory" not in found.wall_clock
    assert "response_time" in found.wall_clock


def test_control_error_is_commanded_against_executed() -> None:
    oracle = Oracle()
    first = oracle.look(Command(Maneuver.PROCEED, 2.0))
    assert "control_error" not in first.values, "nothing has been commanded yet"
    assert oracle.look(acceleration=1.5).values["control_error"] == pytest.approx(0.5)


def test_control_error_in_the_loop_is_the_actuator_s_lag() -> None:
    episode = measured({"maneuver": "emergency_brake"}, duration=0.6)
    assert episode.metrics.column("control_error")[:4] == pytest.approx([4.0, 0.0, 0.0, 0.0])
    assert episode.signals["command_error"][:4] == pytest.approx([0.0, 4.0, 0.0, 0.0])


class Alarmed(SafetyMonitor):
    """Refuses everything."""

    def run(self, view: Any) -> Assessment:
        return Assessment(Assessed.UNSAFE)


def test_control_error_is_that_of_the_recovery_while_it_acts() -> None:
    roles = {"safety_monitor": RoleSpec("test_performance_oracle:Alarmed")}
    episode = measured({"maneuver": "accelerate"}, duration=0.6, policy="recover", roles=roles)
    assert set(episode.decisions["executed"]) == {"emergency_brake"}
    assert episode.metrics.column("control_error")[:4] == pytest.approx([4.0, 0.0, 0.0, 0.0])


def test_jerk_is_the_change_of_acceleration() -> None:
    oracle = Oracle()
    assert oracle.look(acceleration=1.0).values["jerk"] == 0.0
    found = oracle.look(acceleration=-2.0)
    assert found.values["jerk"] == pytest.approx(-30.0)
    assert found.values["acceleration"] == -2.0


def test_sustained_jerk_is_its_average_over_a_second() -> None:
    oracle = Oracle()
    oracle.look(acceleration=1.0)
    found = [oracle.look(acceleration=-2.0).values["sustained_jerk"] for _ in range(12)]
    assert found[:10] == pytest.approx([-3.0] * 10)
    assert found[10:] == pytest.approx([0.0, 0.0])


def test_an_emergency_stop_is_no_comfort_and_a_firm_stop_is() -> None:
    for braking, comfortable in ((3.0, True), (8.0, False)):
        oracle = Oracle()
        oracle.look(acceleration=0.0)
        found = oracle.look(acceleration=-braking)
        assert found.values["discomfort"] == pytest.approx(max(braking / 6.0, braking / 5.0))
        assert (found.performance_fail == ()) is comfortable


def test_discomfort_is_that_of_the_limit_that_is_nearest() -> None:
    oracle = Oracle(acceleration_limit=4.0, lateral_limit=2.0, jerk_limit=50.0)
    oracle.look()
    found = oracle.look(acceleration=-1.0)
    assert found.values["discomfort"] == pytest.approx(0.25)
    assert found.performance_fail == ()


@pytest.mark.parametrize(
    "limit, seen, failed",
    [
        ({"acceleration_limit": 5.0}, [{"acceleration": -5.5}], "acceleration"),
        ({"acceleration_limit": 5.0}, [{"acceleration": -4.5}], None),
        ({"jerk_limit": 2.0}, [{"acceleration": 0.0}, {"acceleration": 2.5}], "jerk"),
        ({"jerk_limit": 3.0}, [{"acceleration": 0.0}, {"acceleration": 2.5}], None),
        ({"response_limit": 0.1}, [{"latency": 0.2}], "response_time"),
        ({"response_limit": 0.1}, [{"latency": 0.1}], None),
        ({"clearance_limit": 0.15}, [{}, {}, {}], "clearance_time"),
        ({"clearance_limit": 0.25}, [{}, {}, {}], None),
    ],
)
def test_each_threshold(limit: dict[str, float], seen: list[Any], failed: str | None) -> None:
    oracle = Oracle(**limit)
    for percept in seen:
        found = oracle.look(**percept)
    assert found.performance_fail == ((failed,) if failed else ())


def test_lateral_acceleration_in_a_curve() -> None:
    world = {"ego": {"distance": 20.0, "speed": 8.0, "turn": "right"}}
    episode = measured({"maneuver": "proceed", "latency": None}, world, duration=8.0)
    lateral = np.abs(episode.metrics.column("lateral_acceleration"))
    signal = np.abs(episode.signals["lateral_acceleration"])[: len(lateral)]
    assert lateral == pytest.approx(signal)
    assert lateral.max() > 3.0, "9 m/s in a curve of 9 m"
    assert episode.metrics.violations["performance:lateral_acceleration"] > 0


def test_performance_never_starts_recovery() -> None:
    episode = measured({"latency": 0.9}, duration=2.0, policy="recover")
    assert (episode.decisions["source"] == "proposal").all()
    assert episode.metrics.recoveries == []


def test_recovery_brakes_as_hard_as_it_can_and_says_why() -> None:
    views = Views()
    views.see(channels_of())
    recovery = EmergencyBrake().run(views.state.role_view(("comes too near", "and fast")))
    assert recovery.action == Command(Maneuver.EMERGENCY_BRAKE)
    assert recovery.name == "emergency_brake"
    assert recovery.explanation == "comes too near; and fast"


def test_recovery_in_the_loop_replaces_what_is_unsafe() -> None:
    ghost = {"type": "ghost-obstacle", "activation": {"at": 1.0}, "duration": 1.0}
    spec = spec_of_drive(
        {"ego": {"distance": 70.0, "speed": 8.0}},
        generator="aggressive",
        faults=[ghost],
        policy="recover",
        duration=10.0,
    )
    episode = run(spec)
    recovered = episode.decisions["source"] == "recovery"
    assert (recovered == (episode.decisions["verdict"] == 2)).all()
    assert set(episode.decisions["executed"][recovered]) == {"emergency_brake"}
    assert set(episode.decisions["proposed"]) == {"accelerate"}
    assert episode.metrics.recoveries
    assert all(success for _, _, success in episode.metrics.recoveries)
