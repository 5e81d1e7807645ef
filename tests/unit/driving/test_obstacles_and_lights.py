"""Static obstacles and traffic lights: what sensors report, and what traffic makes of them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from roads import always, begin, bodies_at, drive, events_of

from pytest_dura import ConfigurationError
from pytest_dura.driving import HighwaySimulator, Sign, percept_at, route, route_map
from pytest_dura.driving.sensors import WAYPOINT_SPACING

CONES = {"id": "K1", "kind": "cones", "offset": 20.0, "beside": 2.0}


def test_lidar_and_radar_report_an_obstacle_like_any_object() -> None:
    _, ticks = drive({"ego": {"distance": 50.0}, "obstacles": [CONES]}, 5)
    for tick in ticks:
        (seen,) = tick.channels["lidar"]
        assert (seen.id, seen.length, seen.width) == ("K1", 3.0, 0.4)
        assert (seen.x, seen.y, seen.vx, seen.vy) == pytest.approx((2.0, 31.0, 0.0, 0.0))
        ego = tick.truth["ego"]
        ((distance, azimuth, rate),) = tick.channels["radar"].tolist()
        assert distance == pytest.approx(ego.y - 31.0)
        assert (azimuth, rate) == pytest.approx((0.0, -ego.speed), abs=0.01)
        assert percept_at(tick.channels)["gap"] == pytest.approx(distance - 2.5 - 1.5)


@pytest.mark.parametrize("arm", ["south", "west", "north", "east"])
def test_an_obstacle_is_right_of_the_middle_of_its_arm(arm: str) -> None:
    island = {"id": "K1", "kind": "island", "arm": arm, "offset": 10.0, "beside": 2.0}
    (body,) = bodies_at(begin({"obstacles": [island]})[1][0])
    lane = route(("south", "west", "north", "east").index(arm), "straight")
    s, lateral = lane.project(body.x, body.y)
    assert (s, lateral) == pytest.approx((90.0, 0.0))
    assert body.heading == pytest.approx(lane.heading_at(s))


def test_running_into_an_obstacle_is_a_collision_of_the_ego() -> None:
    simulator, ticks = drive({"obstacles": [CONES]}, 80)
    last = ticks[-1]
    assert last.critical is not None
    assert "ran into K1" in last.critical
    assert [event[1] for event in events_of(ticks, "collision")] == ["K1"]
    signals = simulator.signals(ticks)
    assert signals["gap"][-1] == 0.0 < signals["gap"][-2]
    assert signals["struck"][-1] == 0.0
    beside = {**CONES, "kind": "parked_car", "beside": 5.2}
    _, ticks = drive({"obstacles": [beside]}, 80)
    assert ticks[-1].critical is None


def test_drivers_stop_before_what_is_in_their_way_and_pass_what_is_beside_it() -> None:
    def world(beside: float) -> dict[str, Any]:
        return {
            "ego": {"distance": 90.0, "speed": 0.0},
            "vehicles": [{"id": "A", "arm": "west", "distance": 60.0}],
            "obstacles": [{**CONES, "kind": "island", "arm": "west", "beside": beside}],
        }

    def last(beside: float) -> tuple[float, float]:
        _, ticks = drive(world(beside), 150, always("emergency_brake"))
        assert not events_of(ticks, "background_crash")
        car = bodies_at(ticks[-1]).get("A")
        assert car is not None
        return route(1, "straight").project(car.x, car.y)[0], math.hypot(car.vx, car.vy)

    s, speed = last(2.0)
    assert speed < 0.1
    # Its front, 80 m along the arm less half the island and half the car, and IDM's distance.
    assert 80.0 - 3.0 - 2.5 - 4.0 < s < 80.0 - 3.0 - 2.5
    for beside in (0.0, 4.0):
        s, speed = last(beside)
        assert s > 110.0
        assert speed > 5.0


def test_a_struck_obstacle_stays_where_it_is() -> None:
    car = {"id": "A", "arm": "west", "distance": 24.0, "speed": 10.0}
    wall = {**CONES, "kind": "island", "arm": "west", "offset": 15.0}
    ego = {"ego": {"distance": 90.0, "speed": 0.0}}
    _, ticks = drive({**ego, "vehicles": [car], "obstacles": [wall]}, 60, always("wait"))
    assert [event[1] for event in events_of(ticks, "background_crash")] == ["A+K1"]
    assert bodies_at(ticks[-1]).ids == ("K1",), "the wreck is cleared away"
    assert ticks[-1].critical is None


def test_worlds_without_obstacles_and_lights_are_told_as_before() -> None:
    checked = HighwaySimulator.check_scenario({})
    assert not {"obstacles", "controls"} & set(checked)
    world = {"obstacles": [CONES], "controls": {"signals": [LIGHT]}}
    once = HighwaySimulator.check_scenario(world)
    assert once["obstacles"][0] == {**CONES, "arm": "south"}
    assert HighwaySimulator.check_scenario(once) == once


@pytest.mark.parametrize(
    "world, key, found",
    [
        ({"obstacles": [CONES], "ego": {"distance": 21.0}}, "world.obstacles.0", "K1"),
        (
            {
                "obstacles": [{**CONES, "offset": 9.0}, {**CONES, "id": "K2", "arm": "west"}],
                "vehicles": [{"id": "A", "arm": "west", "distance": 24.0}],
            },
            "world.obstacles.1", "K2",
        ),
        ({"obstacles": [CONES, CONES]}, "world.vehicles", "K1"),
    ],
)  # fmt: skip
def test_an_obstacle_has_a_place_and_an_id_of_its_own(
    world: dict[str, Any], key: str, found: str
) -> None:
    with pytest.raises(ConfigurationError) as caught:
        HighwaySimulator.check_scenario(world)
    assert (caught.value.key, caught.value.found) == (key, found)


PHASES = [
    {"state": "red", "lasts": 2.0}, {"state": "green", "lasts": 1.0},
    {"state": "yellow", "lasts": 0.5},
]  # fmt: skip
LIGHT = {"arms": ["south", "north"], "phases": PHASES}


@pytest.mark.parametrize(
    "world",
    [
        {"controls": {"signals": [LIGHT, {"arms": ["north"], "phases": PHASES}]}},
        {"controls": {"signals": [{**LIGHT, "phases": []}]}},
        {"controls": {"signals": [{**LIGHT, "phases": [{"state": "blue", "lasts": 1.0}]}]}},
        {"controls": {"signals": [{**LIGHT, "phases": [{"state": "red", "lasts": 0.0}]}]}},
        {"obstacles": [{**CONES, "kind": "elk"}]},
        {"obstacles": [{**CONES, "beside": 40.0}]},
    ],
    ids=str,
)
def test_what_cannot_be_is_refused(world: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        HighwaySimulator.check_scenario(world)


@pytest.mark.parametrize("offset, begins", [(0.0, "red"), (2.5, "green"), (10.4, "yellow")])
def test_controls_report_what_the_light_of_the_ego_s_arm_shows(offset: float, begins: str) -> None:
    light = {**LIGHT, "offset": offset}
    _, ticks = drive({"controls": {"signals": [light]}}, 40)
    states = []
    for tick in ticks:
        sign, signal = tick.channels["controls"]
        assert sign == Sign("give_way", 100.0)
        assert (signal.kind, signal.at, signal.text) == ("traffic_light", 100.0, "")
        states.append(signal.state)
    cycle = ["red"] * 20 + ["green"] * 10 + ["yellow"] * 5
    first = round(offset * 10)
    assert states == [cycle[(first + index) % 35] for index in range(41)]
    assert states[0] == begins


def test_a_light_of_another_arm_is_no_matter_of_the_ego_s_controls() -> None:
    light = {**LIGHT, "arms": ["west"]}
    _, ticks = drive({"controls": {"signals": [light]}}, 2)
    assert all(tick.channels["controls"] == (Sign("give_way", 100.0),) for tick in ticks)


def test_drivers_stop_at_red_and_go_at_green() -> None:
    phases = [{"state": "red", "lasts": 8.0}, {"state": "green", "lasts": 30.0}]
    world = {
        "ego": {"distance": 90.0, "speed": 0.0},
        "vehicles": [{"id": "A", "arm": "west", "distance": 40.0}],
        "controls": {"signals": [{"arms": ["west", "east"], "phases": phases}]},
    }
    _, ticks = drive(world, 160, always("emergency_brake"))
    cars = [bodies_at(tick).get("A") for tick in ticks]
    along = np.array([route(1, "straight").project(car.x, car.y)[0] for car in cars if car])
    assert len(along) == len(ticks)
    assert along[79] + 2.5 <= 100.0, "behind its stop line while it is red"
    assert along[-1] > 110.0
    del world["controls"]
    _, free = drive(world, 79, always("emergency_brake"))
    passed = bodies_at(free[-1]).get("A")
    assert passed is not None
    assert route(1, "straight").project(passed.x, passed.y)[0] > 110.0


def test_the_imu_has_a_heading_and_the_map_waypoints_of_the_lane() -> None:
    _, ticks = drive({"ego": {"distance": 20.0, "turn": "left"}}, 60, always("proceed"))
    for tick in ticks:
        assert tick.channels["imu"].heading == tick.truth["ego"].heading
    headings = [tick.channels["imu"].heading for tick in ticks]
    assert headings[0] == pytest.approx(-math.pi / 2)
    assert headings[-1] == pytest.approx(-math.pi, abs=0.1)
    on_map = ticks[0].channels["map"]
    assert on_map is ticks[-1].channels["map"] is route_map(route(0, "left"))
    points = on_map.waypoints
    assert (points[0].s, points[-1].s) == (0.0, on_map.route.length)
    gaps = np.diff([point.s for point in points])
    assert gaps[:-1] == pytest.approx(WAYPOINT_SPACING)
    for point in points:
        assert on_map.route.project(point.x, point.y) == pytest.approx((point.s, 0.0), abs=0.05)
