"""The highway-env simulator: what is on the road, and what is reported of it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from roads import always, begin, bodies_at, car, drive

from pytest_dura import Simulator
from pytest_dura.core import ConfigurationError, Percept
from pytest_dura.core.simulator_conformance import check_simulator
from pytest_dura.driving import (
    ARM_LENGTH,
    ARMS,
    GAP_CAP,
    PERCEPT_NAMES,
    TTC_CAP,
    BodyList,
    Ego,
    HighwaySimulator,
    route,
)
from pytest_dura.driving.signals import NAMES
from pytest_dura.driving.traffic_rules import NOT_A_CAR

EMPTY: dict[str, Any] = {"ego": {"distance": 50.0, "speed": 8.0}}
BUSY: dict[str, Any] = {
    "ego": {"distance": 45.0, "speed": 8.0},
    "traffic": {"headway": 6.0},
    "vehicles": [{"id": "WEST", "arm": "west", "distance": 30.0}],
    "pedestrians": [{"id": "P1", "start": 0.5}],
}


def test_it_keeps_the_simulator_s_contract() -> None:
    actions: list[Any] = ["proceed", "wait", {"maneuver": "accelerate"}, "emergency_brake"]
    report = check_simulator(HighwaySimulator, {"world": BUSY, "duration": 10.0}, actions * 5)
    assert not report.not_supported


def test_an_empty_world_holds_the_ego_alone() -> None:
    _, ticks = drive(EMPTY, 60)
    assert all(len(bodies_at(tick)) == 0 for tick in ticks)
    ego = ticks[0].truth["ego"]
    assert (ego.x, ego.y, ego.speed, ego.s) == pytest.approx((2.0, 61.0, 8.0, 50.0))
    assert math.sin(ego.heading) == pytest.approx(-1.0)


@pytest.mark.parametrize("arm", ARMS)
@pytest.mark.parametrize("turn", ["left", "straight", "right"])
def test_an_explicit_vehicle_is_where_the_scenario_wants_it_and_takes_its_route(
    arm: str, turn: str
) -> None:
    distance = 20.0 if arm != "south" else 15.0
    start = {"id": "ME", "arm": arm, "turn": turn, "distance": distance, "speed": 6.0}
    world = {"ego": {"distance": 90.0, "speed": 0.0}, "vehicles": [start]}
    _, ticks = drive(world, 130, always("emergency_brake"))
    way = route(ARMS.index(arm), turn)
    (first,) = bodies_at(ticks[0])
    x, y, heading = (float(value) for value in way.pose(ARM_LENGTH - distance))
    assert first.id == "ME"
    assert (first.x, first.y) == pytest.approx((x, y))
    assert math.hypot(first.vx, first.vy) == pytest.approx(6.0)
    assert math.remainder(first.heading - heading, 2 * math.pi) == pytest.approx(0.0, abs=1e-9)
    for tick in ticks:
        assert bodies_at(tick).ids in (("ME",), ())
        for body in bodies_at(tick):
            s, lateral = way.project(body.x, body.y)
            assert abs(lateral) < 0.8, "it stays in its lane, 4 m wide"
            last = s
    assert last > way.exit + 20.0


def test_pedestrians_walk_from_kerb_to_kerb_when_they_are_told() -> None:
    people = [
        {"id": "RIGHT", "arm": "south", "offset": 4.0, "side": "right", "start": 1.0, "speed": 1.5},
        {"id": "LEFT", "arm": "west", "offset": 9.0, "side": "left", "start": 0.0, "speed": 1.0},
    ]
    world = {"ego": {"distance": 90.0, "speed": 0.0}, "pedestrians": people}
    _, ticks = drive(world, 120, always("emergency_brake"))
    right, left = (
        np.array([bodies_at(tick).get(name)[1:5] for tick in ticks])  # type: ignore[index]
        for name in ("RIGHT", "LEFT")
    )
    # South arm: a driver heads to -y, his right is +x; the crossing is 4 m out from the stop line.
    assert right[:, 1] == pytest.approx(15.0)
    assert right[10, 0] == right[0, 0] == pytest.approx(5.0)
    assert right[11, 0] == pytest.approx(5.0 - 0.15)
    assert right[-1, 0] == pytest.approx(-5.0, abs=0.16)
    assert right[-1, 3] == 0.0
    # West arm: a driver heads to +x, his left is -y (north).
    assert left[:, 0] == pytest.approx(-20.0)
    assert left[0, 1] == pytest.approx(-5.0)
    assert left[50, 1] == pytest.approx(0.0, abs=0.01)
    assert left[-1, 1] == pytest.approx(5.0, abs=0.11)
    assert bodies_at(ticks[0]).get("LEFT").is_pedestrian  # type: ignore[union-attr]


def arrivals(seed: int, **traffic: Any) -> int:
    world = {"traffic": {"arms": ["west", "north", "east"], **traffic}}
    simulator, _ = begin(world, seed=seed, duration=60.0)
    return len(simulator._arrivals) + len(simulator._road.vehicles) - 1


def test_the_mean_number_of_arrivals_is_what_the_headway_says() -> None:
    headway, seeds = 10.0, 60
    mean = np.mean([arrivals(seed, headway=headway) for seed in range(seeds)])
    # Three arms, 69 s from nine seconds before the beginning; a car without room then is left out.
    expected = 3 * 69.0 / headway
    assert mean == pytest.approx(expected, rel=0.07)


def test_arrivals_keep_the_least_headway_and_their_arms() -> None:
    world = {"traffic": {"headway": 4.0, "minimum_headway": 2.5, "arms": ["west", "east"]}}
    simulator, _ = begin(world, duration=600.0)
    times: dict[int, list[float]] = {}
    for time, _, plan, speed, _ in simulator._arrivals:
        times.setdefault(plan.origin, []).append(time)
        assert 4.0 <= speed <= 10.0
    assert sorted(times) == [1, 3]
    for found in times.values():
        assert np.diff(found).min() >= 2.5
        assert np.diff(found).mean() == pytest.approx(4.0, rel=0.15)


def test_what_the_ego_does_changes_nobody_else_s_demand() -> None:
    one, _ = drive(BUSY, 5, always("accelerate"))
    other, _ = drive(BUSY, 5, always("emergency_brake"))
    assert [(a[0], a[1]) for a in one._arrivals] == [(a[0], a[1]) for a in other._arrivals]


def test_a_longer_duration_and_another_arm_shift_no_draws() -> None:
    def of_west(**options: Any) -> list[Any]:
        world = {"traffic": {"headway": 8.0, "arms": options.pop("arms")}}
        simulator, _ = begin(world, **options)
        return [(a[0], a[3], a[4]) for a in simulator._arrivals if a[2].origin == 1]

    short = of_west(arms=["west"], duration=30.0)
    long = of_west(arms=["north", "west"], duration=60.0)
    assert short
    assert long[: len(short)] == short
    assert len(long) > len(short)


def test_ids_are_stable_and_unique_and_everybody_moves_continuously() -> None:
    simulator, ticks = drive(
        {"ego": {"distance": 95.0, "speed": 0.0}, "traffic": {"headway": 5.0}},
        300,
        always("emergency_brake"),
    )
    seen: dict[str, Any] = {}
    gone: set[str] = set()
    for tick in ticks:
        bodies = bodies_at(tick)
        assert len(set(bodies.ids)) == len(bodies)
        assert not gone & set(bodies.ids), "an id is not used again"
        for body in bodies:
            before = seen.get(body.id)
            if before is not None:
                assert math.hypot(body.x - before.x, body.y - before.y) < 1.2
        gone |= set(seen) - set(bodies.ids)
        seen = {body.id: body for body in bodies}
    assert len(gone) > 3, "who has left the junction is taken away"
    assert all(name.startswith("V") for name in {*gone, *seen})
    assert simulator._road.vehicles[0] is simulator._ego


def test_nobody_enters_where_there_is_no_room() -> None:
    world = {
        "ego": {"distance": 95.0, "speed": 0.0},
        "traffic": {"headway": 2.6, "minimum_headway": 2.5, "speed_deviation": 2.0},
    }
    _, ticks = drive(world, 150, always("emergency_brake"), duration=20.0)
    known: set[str] = set()
    for tick in ticks:
        bodies = bodies_at(tick)
        for body in bodies:
            if body.id in known:
                continue
            for other in bodies:
                if other is not body and other.id != body.id:
                    assert math.hypot(body.x - other.x, body.y - other.y) >= 8.0
        known |= set(bodies.ids)


def test_all_channels_and_signals_are_there() -> None:
    simulator, ticks = drive(BUSY, 10)
    assert set(ticks[0].channels) == {
        "lidar", "radar", "camera_front", "camera_third_person", "imu", "odometry",
        "localisation", "map", "controls",
    }  # fmt: skip
    signals = simulator.signals(ticks)
    assert set(signals) == set(NAMES)
    assert set(NAMES) >= {
        "gap", "ttc", "speed", "acceleration", "jerk", "lateral_acceleration", "lateral_jerk",
        "progress", "in_conflict_zone", "collided", "struck", "cleared",
    }  # fmt: skip
    percept = simulator.percept_signals([Percept(tick.channels) for tick in ticks])
    assert set(percept) == set(PERCEPT_NAMES)
    for name in ("gap", "leader_gap", "speed"):
        assert percept[name] == pytest.approx(signals[name], abs=1e-9), "there is no fault"
    assert (percept["ttc"] >= signals["ttc"] - 1e-9).all(), "who is out of reach is not perceived"


def test_radar_and_lidar_mean_the_same_objects() -> None:
    _, ticks = drive(BUSY, 30)
    for tick in ticks:
        pose, returns = tick.channels["localisation"], tick.channels["radar"]
        for body, (distance, azimuth, _) in zip(tick.channels["lidar"], returns, strict=True):
            bearing = pose.heading - azimuth
            assert pose.x + distance * math.cos(bearing) == pytest.approx(body.x, abs=1e-9)
            assert pose.y + distance * math.sin(bearing) == pytest.approx(body.y, abs=1e-9)


def test_the_range_rate_is_the_change_of_range() -> None:
    north = {"id": "N", "arm": "north", "turn": "straight", "distance": 25}
    world = {"ego": {"distance": 25.0}, "vehicles": [north]}
    _, ticks = drive(world, 10)
    ranges = np.array([tick.channels["radar"][0, 0] for tick in ticks])
    rates = np.array([tick.channels["radar"][0, 2] for tick in ticks])
    middle = (rates[1:] + rates[:-1]) / 2
    assert np.diff(ranges) / 0.1 == pytest.approx(middle, abs=0.6)
    assert rates[0] < -10.0, "they close"


def test_sensors_reach_80_metres() -> None:
    world = {
        "ego": {"distance": 95.0, "speed": 0.0},
        "vehicles": [
            {"id": "NEAR", "arm": "south", "distance": 20.0, "speed": 0.0},
            {"id": "FAR", "arm": "north", "distance": 30.0, "speed": 0.0},
        ],
    }
    _, ticks = begin(world)
    assert bodies_at(ticks[0]).ids == ("NEAR", "FAR")
    assert ticks[0].channels["lidar"].ids == ("NEAR",)
    assert len(ticks[0].channels["radar"]) == 1


def test_signs_and_map() -> None:
    _, ticks = begin({"ego": {"turn": "left"}})
    channels = ticks[0].channels
    assert [(sign.kind, sign.at) for sign in channels["controls"]] == [("give_way", 100.0)]
    assert channels["map"].route is route(0, "left")
    assert channels["map"].exit == route(0, "left").exit
    assert channels["map"].speed_limit == 10.0


@pytest.mark.parametrize("dt", [0.05, 0.1, 0.2])
def test_the_time_step_is_what_is_asked_for(dt: float) -> None:
    simulator, ticks = drive(EMPTY, 40, dt=dt)
    assert [tick.time for tick in ticks] == [index * dt for index in range(len(ticks))]
    driven = simulator.signals(ticks)["progress"][-1]
    assert driven == pytest.approx(8.0 * 40 * dt, rel=1e-6)


def test_half_the_time_step_gives_nearly_the_same_course() -> None:
    coarse, ticks = drive(EMPTY, 60, always("wait"), dt=0.1)
    fine, more = drive(EMPTY, 120, always("wait"), dt=0.05)
    here, there = coarse.signals(ticks)["progress"], fine.signals(more)["progress"]
    assert np.abs(here - there[::2]).max() < 0.5


def test_acceleration_and_jerk_are_the_changes_of_speed() -> None:
    simulator, ticks = drive(EMPTY, 30, always("emergency_brake"))
    signals = simulator.signals(ticks)
    assert np.diff(signals["speed"]) / 0.1 == pytest.approx(signals["acceleration"][1:])
    assert signals["acceleration"][0] == 0.0
    assert np.diff(signals["acceleration"]) / 0.1 == pytest.approx(signals["jerk"][1:])
    assert signals["acceleration"].min() == pytest.approx(-8.0)


def test_the_actuator_takes_time_and_the_command_error_says_so() -> None:
    simulator, ticks = drive(EMPTY, 4, always("emergency_brake"))
    signals = simulator.signals(ticks)
    assert signals["acceleration"] == pytest.approx([0.0, -4.0, -8.0, -8.0, -8.0])
    assert signals["command_error"] == pytest.approx([0.0, 4.0, 0.0, 0.0, 0.0])


@settings(derandomize=True, deadline=None, max_examples=25)
@given(speed=st.floats(0.05, 10.0), dt=st.sampled_from([0.05, 0.1]))
def test_a_stop_keeps_the_slew_rate_and_does_not_reverse(speed: float, dt: float) -> None:
    world = {"ego": {"distance": 60.0, "speed": speed}}
    simulator, ticks = drive(world, round(3.0 / dt), always("emergency_brake"), dt=dt)
    signals = simulator.signals(ticks)
    assert signals["speed"].min() >= -1e-12, "but for the rounding of one step"
    assert signals["speed"][-1] == pytest.approx(0.0, abs=1e-9)
    assert np.abs(signals["jerk"]).max() <= Ego.SLEW + 1e-6
    braked = signals["progress"][-1]
    assert braked < speed**2 / 16.0 + 0.25 * speed + 0.1, "a quarter of a second more than ideal"


def test_a_signal_tells_where_the_ego_is() -> None:
    simulator, ticks = drive(EMPTY, 125)
    signals = simulator.signals(ticks)
    s = 50.0 + signals["progress"]
    zone = (s + 2.5 > 100.0) & (s - 2.5 < 122.0)
    assert (signals["in_conflict_zone"] == zone).all()
    assert zone.any()
    assert (signals["cleared"] == (s - 2.5 >= 122.0)).all()
    first_goal = next(tick for tick in ticks if tick.goal)
    assert s[first_goal.index - 1] <= 147.0 < s[first_goal.index]


@pytest.mark.parametrize("turn", ["left", "straight", "right"])
def test_the_ego_keeps_its_lane_and_lateral_acceleration_is_centripetal(turn: str) -> None:
    world = {"ego": {"distance": 30.0, "speed": 5.0, "turn": turn}}
    simulator, ticks = drive(world, 120, always("proceed_cautiously"))
    signals = simulator.signals(ticks)
    lateral = max(abs(tick.truth["ego"].lateral) for tick in ticks)
    assert lateral < 0.8
    radius = {"left": 13.0, "right": 9.0, "straight": math.inf}[turn]
    sign = -1.0 if turn == "left" else 1.0
    middle = np.argmin(np.abs(signals["progress"] - 30.0 - route(0, turn).inside / 2))
    expected = sign * signals["speed"][middle] ** 2 / radius
    assert signals["lateral_acceleration"][middle] == pytest.approx(expected, rel=0.15, abs=0.01)
    assert np.diff(signals["lateral_acceleration"]) / 0.1 == pytest.approx(
        signals["lateral_jerk"][1:]
    )
    assert signals["cleared"][-1] == 1.0


def test_gap_and_ttc_are_capped_on_an_empty_road() -> None:
    simulator, ticks = drive(EMPTY, 5)
    signals = simulator.signals(ticks)
    assert set(signals["gap"]) == {GAP_CAP}
    assert set(signals["ttc"]) == {TTC_CAP}


def test_gap_and_ttc_of_a_standing_car_ahead() -> None:
    ahead = {"id": "A", "arm": "south", "distance": 10.0, "speed": 0.0}
    world = {"ego": {"distance": 50.0, "speed": 8.0}, "vehicles": [ahead]}
    simulator, ticks = begin(world)
    signals = simulator.signals(ticks)
    assert signals["gap"][0] == pytest.approx(35.0)
    assert signals["ttc"][0] == pytest.approx(35.0 / 8.0)


def test_the_time_to_collision_knows_far_and_fast_cars() -> None:
    # 70 m apart and on course to meet in 5 s: the gap is capped, the time is not.
    simulator, ticks = drive(EMPTY, 1)
    far = ticks[0].truth["ego"]
    meeting = {**ticks[0].truth}
    meeting["bodies"] = BodyList.of([car("X", far.x, far.y - 75.0, math.pi / 2, 6.0)])
    meeting["routes"] = (NOT_A_CAR,)
    signals = simulator.signals([replace(ticks[0], truth=meeting)])
    assert signals["gap"][0] == GAP_CAP
    assert signals["ttc"][0] == pytest.approx(70.0 / 14.0)


@pytest.mark.parametrize(
    "world, told",
    [
        ({"vehicles": [{"id": "EGO", "arm": "west", "distance": 9}]}, "EGO"),
        (
            {
                "vehicles": [{"id": "A", "arm": "west", "distance": 9}],
                "pedestrians": [{"id": "A"}],
            },
            "same id",
        ),
        (
            {"traffic": {}, "vehicles": [{"id": "V3", "arm": "west", "distance": 9}]},
            "ids of this form",
        ),
        ({"pedestrians": [{"id": "R0"}]}, "ids of this form"),
        ({"pedestrians": [{"id": "S1"}]}, "ids of this form"),
    ],
)
def test_an_id_stands_for_one_body(world: dict[str, Any], told: str) -> None:
    with pytest.raises(ConfigurationError, match=told):
        HighwaySimulator.check_scenario(world)
    with pytest.raises(ConfigurationError, match=told):
        HighwaySimulator().reset({"world": world}, 1)


@pytest.mark.parametrize(
    "world",
    [
        {"ego": {"distance": 0.0}},
        {"ego": {"speed": -1.0}},
        {"ego": {"turn": "back"}},
        {"ego": {"distanz": 40.0}},
        {"traffic": {"headway": 0.0}},
        {"traffic": {"headway": math.nan}},
        {"traffic": {"headway": 2.0}},
        {"traffic": {"headway": 5.0, "minimum_headway": 5.0}},
        {"traffic": {"arms": ["Up!"]}},
        {"vehicles": [{"id": "a", "arm": "west", "distance": 9}]},
        {"pedestrians": [{"speed": 9.0}]},
        {"courtesy": "always"},
        {"weather": "rain"},
    ],
    ids=str,
)
def test_a_world_that_cannot_be_is_refused(world: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        HighwaySimulator.check_scenario(world)


def test_the_checked_world_is_complete_and_checks_to_itself() -> None:
    once = HighwaySimulator.check_scenario(BUSY)
    assert once["courtesy"] == "occupied"
    assert once["traffic"]["minimum_headway"] == 2.5
    assert HighwaySimulator.check_scenario(once) == once
    _, given = drive(BUSY, 3)
    _, filled = drive(once, 3)
    assert bodies_at(given[-1]) == bodies_at(filled[-1])


def test_the_fallback_keeps_the_speed() -> None:
    simulator = HighwaySimulator()
    assert isinstance(simulator, Simulator)
    simulator.reset({"world": EMPTY}, 1)
    tick = simulator.step(simulator.fallback_action())
    assert tick.truth["ego"].speed == 8.0
