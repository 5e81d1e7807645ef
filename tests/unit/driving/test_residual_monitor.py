"""ResidualMonitor: each residual, its alarm, no false alarms, and that it changes no decision."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from roads import SCENARIOS, SIX, Views, car, channels_of, drive, run, spec_of_drive, truth_of

from pytest_dura.core import (
    Assessed,
    ConfigurationError,
    RoleContext,
    RoleSpec,
    SecurityAssessment,
    check_role,
)
from pytest_dura.domains import DOMAINS
from pytest_dura.driving import (
    LIMITS,
    BodyList,
    Command,
    HighwaySimulator,
    Maneuver,
    Snapshot,
    residuals,
)
from pytest_dura.driving.roles.residuals import ACTUATOR_SLEW, ResidualMonitor
from pytest_dura.library import expand_cases, load_scenarios

MONITOR = RoleSpec(DOMAINS["driving"].short_names["residual_monitor"]["cusum"])
TURNS = {"left": 1.0, "straight": 0.01, "right": 1.0}
BUSY = {
    "ego": {"distance": 30.0, "speed": 6.0, "turn": "left"},
    "traffic": {"headway": 5.0, "turns": TURNS, "arms": ["west", "north", "east"]},
}


def found(before: Mapping[str, Any], now: Mapping[str, Any], command: Command | None = None) -> Any:
    """The residuals between two percepts, by name; the last object's."""
    pair = Snapshot.of(before), Snapshot.of(now)
    return {name: value for name, _, value in residuals(*pair, command, 0.1)}


class Looker:
    """A monitor that is shown percepts one by one."""

    def __init__(self, **params: Any) -> None:
        self.monitor, self.views = ResidualMonitor(**params), Views()
        self.monitor.reset(RoleContext(1, 0.1))

    def look(self, percept: Mapping[str, Any]) -> SecurityAssessment:
        return self.monitor.run(self.views.role(percept))

    def patterns(self, percept: Mapping[str, Any]) -> list[tuple[str, str]]:
        return [(alert.pattern, alert.subject) for alert in self.look(percept).alerts]


def cruise(ticks: int, *bodies: Any, speed: float = 8.0) -> list[dict[str, Any]]:
    """Percepts of an ego that goes straight on at a constant speed."""
    return [channels_of(*bodies, s=50.0 + tick * speed * 0.1, speed=speed) for tick in range(ticks)]


def test_it_keeps_the_contract_of_a_role() -> None:
    check_role(
        ResidualMonitor,
        simulator=HighwaySimulator,
        scenario={"world": BUSY},
        context=RoleContext(1, 0.1, {"world": BUSY}),
        ticks=30,
    )


def test_the_model_knows_the_actuator() -> None:
    from pytest_dura.driving import Ego

    assert ACTUATOR_SLEW == Ego.SLEW


@pytest.mark.parametrize("maneuver", ["accelerate", "emergency_brake", "wait", "proceed"])
def test_the_model_of_the_ego_is_exact_while_all_is_well(maneuver: str) -> None:
    """Turning, starting, and braking to a standstill."""
    command = Command(Maneuver(maneuver))
    _, ticks = drive(BUSY, 60, lambda _: command)
    assert any(abs(tick.channels["imu"].acceleration) > 1.0 for tick in ticks)
    worst: dict[str, float] = {}
    for before, now in pairwise(ticks):
        for name, value in found(before.channels, now.channels, command).items():
            worst[name] = max(worst.get(name, 0.0), abs(value))
    assert {name for name in worst if worst[name] > 1e-9} <= {"lidar.x", "lidar.y"}


@pytest.mark.parametrize("name", SIX)
def test_no_false_alarms_in_clean_episodes(name: str) -> None:
    (case,) = expand_cases([load_scenarios([SCENARIOS / "intersection"])[name]], ["none"])
    component = RoleSpec(DOMAINS["driving"].short_names["generator"]["random"])
    episode = run(case.spec(0, 2024, {"generator": component, "residual_monitor": MONITOR}))
    assert episode.failure is None
    assert episode.metrics.alert_ticks["residual_monitor"] == []


def test_it_changes_no_decision() -> None:
    fault = {"type": "gnss-jump", "activation": {"at": 1.0}, "parameters": {"along": -5.0}}
    arms = [
        run(spec_of_drive(BUSY, generator="rule_based", faults=[fault], policy="recover", roles=r))
        for r in ({}, {"residual_monitor": MONITOR})
    ]
    assert arms[1].metrics.alert_ticks["residual_monitor"]
    assert truth_of(arms[0]) == truth_of(arms[1])
    for column in ("proposed", "executed", "source"):
        assert np.array_equal(arms[0].decisions[column], arms[1].decisions[column])


def shown(percept: Mapping[str, Any], **changes: Any) -> dict[str, Any]:
    """The percept with other values: speed, or parts of pose or imu."""
    changed = dict(percept)
    if "speed" in changes:
        changed["odometry"] = percept["odometry"]._replace(speed=changes.pop("speed"))
    for channel in ("localisation", "imu"):
        known = set(percept[channel]._fields) & set(changes)
        changed[channel] = percept[channel]._replace(**{key: changes.pop(key) for key in known})
    assert not changes
    return changed


@pytest.mark.parametrize(
    "change, expected",
    [
        ({"speed": 9.0}, {"odometry.speed": 10.0}),
        ({"speed": 7.0}, {"odometry.speed": -10.0}),
        ({"acceleration": 3.0}, {"odometry.speed": -3.0, "frozen.odometry": 1.0}),
        ({"heading": -math.pi / 2 + 0.02}, {"localisation.heading": 0.2}),
        (
            {"yaw_rate": 0.1},
            {
                "localisation.heading": -0.1,
                "localisation.across": -0.25,
                "localisation.along": 8.0 - math.sqrt(64.0 - 0.0625),
            },
        ),
    ],
)
def test_what_a_wrong_value_leaves(change: Any, expected: Mapping[str, float]) -> None:
    before, now = cruise(2)
    left = {name: value for name, value in found(before, shown(now, **change)).items() if value}
    kept = {name: value for name, value in left.items() if abs(value) > 1e-9}
    assert kept == pytest.approx(expected)


@pytest.mark.parametrize("along, across", [(1.0, 0.0), (0.0, 1.0), (-2.0, 0.5)])
def test_a_position_that_leaps_is_seen_ahead_and_across(along: float, across: float) -> None:
    before, now = cruise(2)
    pose = now["localisation"]
    c, s = math.cos(pose.heading), math.sin(pose.heading)
    leapt = shown(now, x=pose.x + along * c - across * s, y=pose.y + along * s + across * c)
    left = found(before, leapt)
    assert left["localisation.along"] == pytest.approx(10 * along, abs=1e-6)
    assert left["localisation.across"] == pytest.approx(10 * across, abs=1e-6)


def test_within_a_tick_the_speed_lies_between_its_readings() -> None:
    before, now = cruise(2)
    assert found(before, shown(now, speed=8.8))["localisation.along"] == pytest.approx(0.0)
    low, lower = shown(before, speed=7.0), shown(now, speed=6.0)
    assert found(low, lower)["localisation.along"] == pytest.approx(1.0)


@pytest.mark.parametrize(
    "command, speed, last, seen, left",
    [
        (Command(Maneuver.PROCEED, 2.0), 8.0, 0.0, 2.0, 0.0),
        (Command(Maneuver.PROCEED, 2.0), 8.0, 0.0, 0.5, -1.5),
        (Command(Maneuver.PROCEED, -8.0), 8.0, 0.0, -4.0, 0.0),
        (Command(Maneuver.EMERGENCY_BRAKE), 8.0, -4.0, 8.0, 16.0),
        (Command(Maneuver.EMERGENCY_BRAKE), 1.0, -8.0, -2.0, 0.0),
        (Command(Maneuver.EMERGENCY_BRAKE), 1.0, -8.0, 1.0, 1.0),
        (Command(Maneuver.PROCEED, 1.0), 0.1, -8.0, -1.0, 0.0),
        (Command(Maneuver.PROCEED, 9.0), 1.0, 0.0, 4.0, 0.0),
        (Command(Maneuver.ACCELERATE, 2.0), 1.0, 0.0, 0.0, -2.0),
    ],
)
def test_the_command_against_what_it_does(
    command: Command, speed: float, last: float, seen: float, left: float
) -> None:
    before, now = (
        channels_of(speed=speed, acceleration=last),
        channels_of(speed=speed, acceleration=seen),
    )
    assert found(before, now, command)["command"] == pytest.approx(left)
    assert "command" not in found(before, now)


def test_an_object_that_is_not_where_it_was_going() -> None:
    before = channels_of(car("V1", 10.0, 2.0, 0.0, 8.0))
    now = channels_of(car("V1", 10.8 + 0.3, 2.0 - 0.1, 0.0, 5.0), car("V2", 0.0, 0.0))
    left = found(before, now)
    assert left["lidar.x"] == pytest.approx(3.0)
    assert left["lidar.y"] == pytest.approx(-1.0)


def test_what_stays_although_it_moves_is_frozen() -> None:
    moving, standing = car("V1", 30.0, 2.0, 0.0, 8.0), car("V2", 0.0, 9.0)
    before, now = cruise(2, moving, standing)
    names = ("frozen.odometry", "frozen.localisation", "frozen.lidar", "frozen.radar")

    def which(last: Any, percept: Any) -> set[str]:
        left = found(last, percept)
        return {name.partition(".")[2] for name in names if left[name]}

    assert which(before, now) == {"lidar"}, "the made-up car stands where it was"
    assert which(before, {**now, "radar": before["radar"]}) == {"lidar", "radar"}
    assert which(before, {**now, "localisation": before["localisation"]}) == {
        "lidar",
        "localisation",
    }
    assert which(before, {**now, "lidar": BodyList.of([standing])}) == set()
    nobody = {**now, "lidar": BodyList.of([])}
    assert which(before, shown(nobody, acceleration=1.0)) == {"odometry"}
    still = channels_of(standing, s=50.0, speed=0.0)
    assert which(still, still) == set()


def test_a_lasting_contradiction_is_alerted_once_and_again_after_it_was_quiet() -> None:
    looker = Looker(quiet=0.5)
    off = {*range(10, 25), *range(32, 35)}
    alerted = [
        index
        for index, percept in enumerate(cruise(40))
        for pattern, _ in looker.patterns(shown(percept, speed=30.0) if index in off else percept)
        if pattern == "residual:localisation.along"
    ]
    # At the first tick the speed may still have been that of the tick before.
    assert alerted == [11, 33]


def test_a_turn_across_the_end_of_the_circle() -> None:
    before, now = cruise(2)
    left = found(
        shown(before, heading=math.pi - 0.01), shown(now, heading=0.02 - math.pi, yaw_rate=0.3)
    )
    assert left["localisation.heading"] == pytest.approx(0.0, abs=1e-9)


def test_an_alarm_is_a_warning_with_the_residuals_name() -> None:
    looker = Looker()
    first, second, third = cruise(3)
    assert looker.look(first).score == 1.0
    calm = looker.look(second)
    assert (calm.verdict, calm.alerts) == (Assessed.SAFE, ())
    assert calm.score == pytest.approx(1.0)
    alarmed = looker.look(shown(third, speed=20.0))
    assert alarmed.verdict is Assessed.WARNING
    assert alarmed.score == 0.0
    assert ("residual:odometry.speed", "odometry") in [
        (a.pattern, a.subject) for a in alarmed.alerts
    ]
    assert "residual:odometry.speed (odometry)" in alarmed.reasons


def test_the_score_falls_as_a_small_shift_lasts() -> None:
    looker = Looker()
    scores = [looker.look(shown(percept, speed=8.5)).score for percept in cruise(8)]
    first = scores[1]
    assert first == pytest.approx(1.0 - (0.5 - LIMITS["localisation.along"].drift) / 3.2)
    assert all(later < sooner for sooner, later in pairwise(scores[1:]))


def test_an_object_out_of_sight_is_forgotten() -> None:
    looker = Looker()
    for place in (10.0, 11.0):
        looker.look(channels_of(car("V1", place, 2.0, 0.0, 8.0)))
    assert any(subject == "V1" for _, subject in looker.monitor._tests)
    looker.look(channels_of())
    assert not any(subject == "V1" for _, subject in looker.monitor._tests)


@pytest.mark.parametrize("field", ["speed", "x", "heading", "acceleration", "yaw_rate"])
def test_absurd_values_alarm_and_break_nothing(field: str) -> None:
    first, second, third, fourth = cruise(4)
    for absurd in (1e300, -1e300, math.inf, math.nan):
        looker = Looker()
        for percept, wrong in ((first, False), (second, True), (third, False), (fourth, False)):
            seen = shown(percept, **{field: absurd}) if wrong else percept
            # Where the stop line is matters to what this command asks for.
            found = looker.monitor.run(looker.views.role(seen, "wait"))
            assert found.alerts or not wrong
            assert math.isfinite(found.score)


def test_limits_of_ones_own() -> None:
    looker = Looker(
        thresholds={"odometry.speed": [0.25, 100.0], "localisation.along": [0.2, 100.0]}
    )
    first, second = cruise(2)
    looker.look(first)
    assert looker.patterns(shown(second, speed=9.0)) == []


@pytest.mark.parametrize(
    "thresholds, key",
    [
        ({"odometry.sped": [0.1, 1.0]}, "thresholds"),
        ({"command": [0.1]}, "thresholds.command"),
        ({"command": [-0.1, 1.0]}, "thresholds.command"),
        ({"command": ["a", "b"]}, "thresholds.command"),
    ],
)
def test_limits_that_are_none_are_refused(thresholds: Any, key: str) -> None:
    for make in (
        lambda: ResidualMonitor(thresholds),
        lambda: ResidualMonitor.check_params({"thresholds": thresholds}, 0.1),
    ):
        with pytest.raises(ConfigurationError) as caught:
            make()
        assert caught.value.key == key


def test_a_scenario_names_it_by_its_short_name() -> None:
    scenario = load_scenarios([SCENARIOS / "intersection"])["intersection/nominal"]
    (case,) = expand_cases([scenario], ["none"])
    assert "residual_monitor" not in case.spec(0, 0).roles
    assert (
        case.spec(0, 0, {"residual_monitor": RoleSpec("cusum")}).roles["residual_monitor"]
        == MONITOR
    )
