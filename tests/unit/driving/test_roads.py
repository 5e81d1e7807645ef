"""Roads as data: routes, lanes, drivers and roles on each geometry, and what is refused."""

from __future__ import annotations

import copy
import itertools
import math
import pickle
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from highway_env.envs.intersection_env import IntersectionEnv
from pydantic import ValidationError
from roads import Views, always, begin, drive, run, spec_of_drive

from pytest_dura.core import ConfigurationError, Percept, RoleContext, RoleSpec
from pytest_dura.domains import DOMAINS
from pytest_dura.driving import (
    BUILT_IN,
    CAR_LENGTH,
    FOUR_WAY,
    Body,
    BodyList,
    HighwaySimulator,
    PlausibilityAssessor,
    Route,
    Scene,
    camera,
    conflict,
    routes_of,
)
from pytest_dura.driving.highway import _network
from pytest_dura.driving.percepts import with_unexplained_returns
from pytest_dura.driving.scene import crossing

ROUTES = [route for road in BUILT_IN.values() for route in routes_of(road)]
OTHERS = [route for route in ROUTES if route.road is not FOUR_WAY]
HALF = CAR_LENGTH / 2


def arm(name: str, bearing: float, **numbers: Any) -> dict[str, Any]:
    return {"name": name, "bearing": bearing, **numbers}


CROSSED: dict[str, Any] = {
    "arms": [
        arm("south", 180.0, priority=3),
        arm("west", 270.0),
        arm("north", 0.0, priority=3),
        arm("east", 90.0),
    ]
}
"""The four-way junction, turned by a quarter: the north-south road has priority."""
SKEW: dict[str, Any] = {
    "speed_limit": 8.0,
    "arms": [
        arm("lane", 200.0, stop_line=16.0, length=80.0, lane_width=3.5),
        arm("town", 290.0, priority=3, stop_line=16.0, lane_width=3.5),
        arm("lake", 110.0, priority=3, stop_line=16.0, lane_width=3.5),
        arm("hill", 340.0, stop_line=18.0, length=90.0, lane_width=3.0),
    ],
}
"""A road with none of the built-in numbers; from the lane to the hill is no quarter."""


def world_of(route: Route, **world: Any) -> dict[str, Any]:
    ego = {"arm": route.arm.name, "to": route.leaves.name, "distance": 40.0}
    return {"road": route.road.name, "ego": ego, **world}


def it_is_the_lanes_that_are_driven(route: Route) -> None:
    network = _network(route.road)
    nodes = network.shortest_path(f"o{route.origin}", f"o{route.destination}")
    lanes = [network.get_lane((a, b, 0)) for a, b in itertools.pairwise(nodes)]
    assert sum(lane.length for lane in lanes) == pytest.approx(route.length)
    start = 0.0
    for lane in lanes:
        for along in np.linspace(0.0, lane.length, 40):
            x, y = lane.position(along, 0.0)
            s, lateral = route.project(float(x), float(y))
            assert s == pytest.approx(start + along, abs=0.01)
            assert lateral == pytest.approx(0.0, abs=1e-6)
            turned = route.heading_at(s) - float(lane.heading_at(along))
            assert math.remainder(turned, 2 * math.pi) == pytest.approx(0.0, abs=1e-3)
        start += lane.length


def test_the_lanes_of_the_four_way_junction_are_highway_env_s_to_the_last_bit() -> None:
    settings = {"show_trajectories": False, "neighbour_vehicles_connected_lanes": False}
    stage = SimpleNamespace(np_random=None, config=settings, road=None)
    IntersectionEnv._make_road(stage)  # type: ignore[arg-type]
    published = stage.road.network.lanes_dict()  # type: ignore[attr-defined]
    built = _network(FOUR_WAY).lanes_dict()
    assert list(built) == list(published)
    figures = ("start", "end", "center", "radius", "start_phase", "end_phase", "direction")
    for index, lane in published.items():
        assert type(built[index]) is type(lane)
        for name in (*figures, "length", "width", "speed_limit"):
            if hasattr(lane, name):
                assert np.array_equal(getattr(built[index], name), getattr(lane, name)), name


def test_a_road_of_data_has_lead_and_tail_where_a_turn_needs_them() -> None:
    model = begin({"road": SKEW})[0]._route
    assert isinstance(model, Route)
    ways = routes_of(model.road)
    assert any(way.curve.lead > 1.0 for way in ways)
    assert any(way.curve.tail > 1.0 for way in ways)
    for way in ways:
        for s in np.linspace(0.0, way.length, 300):
            x, y, _ = (float(value) for value in way.pose(s))
            at, lateral = way.project(x, y)
            assert at == pytest.approx(s, abs=0.02)
            assert lateral == pytest.approx(0.0, abs=0.01)
        ends = way.pose(np.array([0.0, way.length]))
        for place, s in zip(np.stack(ends[:2], axis=1), (0.0, way.length), strict=True):
            assert way.project(*place.tolist())[0] == pytest.approx(s, abs=1e-6)
        points = np.random.default_rng(3).uniform(-90.0, 90.0, (200, 2))
        all_at, all_lateral, _ = way.project_all(points)
        one_by_one = np.array([way.project(x, y) for x, y in points.tolist()])
        assert all_at == pytest.approx(one_by_one[:, 0])
        assert all_lateral == pytest.approx(one_by_one[:, 1])


def test_copies_of_a_route_are_the_route() -> None:
    for way in OTHERS:
        assert copy.deepcopy(way) is way
        assert pickle.loads(pickle.dumps(way)) is way


def the_rule_based_planner_crosses_it_without_contact(route: Route) -> None:
    world = world_of(route, traffic={"headway": 12.0})
    episode = run(
        spec_of_drive(world, generator="rule_based", seed=3, duration=60.0, policy="recover")
    )
    assert episode.failure is None
    assert not episode.collided
    assert episode.signal("background_crashes")[-1] == 0
    assert episode.termination == "goal"
    assert episode.signal("gap").min() >= 0.5


@pytest.mark.parametrize("road", [CROSSED, SKEW], ids=["crossed", "skew"])
def test_it_crosses_a_road_of_data(road: dict[str, Any]) -> None:
    for way in routes_of(begin({"road": road})[0]._route.road):
        world = {**world_of(way, traffic={"headway": 12.0}), "road": road}
        spec = spec_of_drive(world, generator="rule_based", duration=60.0, policy="recover")
        episode = run(spec)
        assert (episode.failure, episode.collided) == (None, False)
        assert episode.termination == "goal", way
        if road is SKEW:
            assert episode.signal("speed").max() <= 9.0, "which the start has 8 m/s of"


def who_waits_stops_at_the_stop_line_of_its_arm(route: Route) -> None:
    _, ticks = drive(world_of(route), 120, always("wait"))
    ego = ticks[-1].truth["ego"]
    assert ego.speed < 0.05
    assert 0.0 <= route.stop_line - ego.front <= 1.5
    x, y = ego.x, ego.y
    beyond = route.arm.along(x, y) - HALF - route.arm.stop_line
    assert 0.0 <= beyond <= 1.5, "measured on the ground"
    assert route.arm.beside(x, y) == pytest.approx(route.arm.lane_width / 2, abs=0.1)


@pytest.mark.parametrize("name", [name for name in BUILT_IN if name != "four_way"])
def test_drivers_stop_at_the_stop_lines_at_red(name: str) -> None:
    road = BUILT_IN[name]
    others = [entry for entry in road.entries if entry != road.names[0]]
    cars = []
    for entry in others:
        number = road.arm(entry)
        way = road.names[road.destinations(number)[0]]
        car = {"id": entry.upper(), "arm": entry, "to": way, "distance": 40.0}
        cars.append(car)
    lights = [{"arms": others, "phases": [{"state": "red", "lasts": 60.0}]}]
    ego = {"to": road.names[road.destinations(0)[0]], "speed": 0.0}
    world = {"road": name, "ego": ego, "vehicles": cars, "controls": {"signals": lights}}
    _, ticks = drive(world, 150, always("wait"))
    for entry in others:
        body = ticks[-1].truth["bodies"].get(entry.upper())
        arm = road.arms[road.arm(entry)]
        assert math.hypot(body.vx, body.vy) < 0.1
        assert 0.0 <= arm.along(body.x, body.y) - HALF - arm.stop_line <= 2.5


def arrival(route: Route, at: float) -> dict[str, Any]:
    """A car with right of way that insists on it, from the arm of a route."""
    return {
        "id": "OTHER",
        "arm": route.arm.name,
        "to": route.leaves.name,
        "distance": at,
        "speed": 8.0,
    }


def the_rule_based_planner_gives_way_on_it(way: Route) -> None:
    for other in routes_of(way.road):
        meeting = conflict(way, other)
        if other.priority <= way.priority or meeting is None:
            continue
        # At 8 m/s both come to the conflict together.
        at = 40.0 + (meeting[0] - way.stop_line) - (meeting[2] - other.stop_line)
        world = world_of(way, vehicles=[arrival(other, at)], courtesy="none")
        episode = run(spec_of_drive(world, generator="rule_based", duration=40.0))
        assert (episode.failure, episode.collided) == (None, False), other
        assert episode.signal("priority_braking").max() <= 3.0, other
        assert episode.termination == "goal", other


def scene_of(way: Route, s: float, *bodies: Body) -> Scene:
    x, y, _ = (float(value) for value in way.pose(s))
    others = BodyList.of(bodies)
    return Scene(way, s, x, y, 8.0, way.stop_line, way.exit, others)


def body_on(way: Route, s: float, speed: float = 8.0) -> Body:
    x, y, heading = (float(value) for value in way.pose(s))
    vx, vy = speed * math.cos(heading), speed * math.sin(heading)
    return Body("V1", x, y, heading, vx, vy, 5.0, 2.0)


def test_a_car_on_another_road_is_measured_by_that_road_s_numbers() -> None:
    for name, stop_line in (("four_way", 11.0), ("four_way_wide", 17.0)):
        road = BUILT_IN[name]
        way, other = (
            next(r for r in routes_of(road) if (r.origin, r.turn) == (number, "straight"))
            for number in (0, 1)
        )
        (approach,) = crossing(scene_of(way, 60.0, body_on(other, other.stop_line)))
        # From its stop line to the ego's lane, which is half a lane's width beyond the middle.
        lane = road.arms[0].lane_width / 2
        assert approach.distance == pytest.approx(stop_line + lane - 2.5 - 1.0 - 0.5)
        assert approach.meets == pytest.approx(way.stop_line + stop_line - lane)


def test_who_joins_and_who_turns_left_sees_who_goes_first() -> None:
    ramp, main = routes_of(BUILT_IN["merge"])
    (approach,) = crossing(scene_of(ramp, 60.0, body_on(main, 60.0)))
    assert approach.arm == "west"
    assert approach.distance == pytest.approx(conflict(ramp, main)[2] - 60.0 - 2.5)  # type: ignore[index]
    assert crossing(scene_of(main, 60.0, body_on(ramp, 60.0))) == []
    ways = {(way.origin, way.turn): way for way in routes_of(BUILT_IN["t_junction"])}
    left, oncoming = ways[2, "left"], ways[1, "straight"]
    (against,) = crossing(scene_of(left, 60.0, body_on(oncoming, 60.0)))
    assert against.arm == "west"
    assert crossing(scene_of(ways[2, "straight"], 60.0, body_on(oncoming, 60.0))) == []


def test_a_radar_return_alone_is_a_car_that_drives_on_its_own_road() -> None:
    way = next(way for way in routes_of(BUILT_IN["four_way_wide"]) if way.origin == 1)
    simulator, ticks = begin(world_of(way))
    percept = {**ticks[0].channels}
    pose = percept["localisation"]
    for lane, course in ((2.5, -math.pi / 2), (-2.5, math.pi / 2)):
        # On the wide road's lanes, 30 m south of the centre; then where no road is.
        for x, speed in ((lane, 9.0), (9.0, 0.0)):
            dx, dy = x - pose.x, 30.0 - pose.y
            azimuth = pose.heading - math.atan2(dy, dx)
            percept["radar"] = np.array([[math.hypot(dx, dy), azimuth, 0.0]])
            (body,) = with_unexplained_returns(percept)
            assert math.hypot(body.vx, body.vy) == pytest.approx(speed)
            if speed:
                assert body.heading == pytest.approx(course)
    simulator.close()


def traffic_of(*arms: str) -> list[dict[str, Any]]:
    return [
        {"id": f"CAR{n}", "arm": arm, "turn": turn, "distance": at, "speed": 7.93}
        for n, (arm, turn, at) in enumerate(
            zip(arms, ("straight", "straight", "left"), (60.37, 80.71, 70.13), strict=True)
        )
    ]


@pytest.mark.parametrize("planner", ["rule_based", "tactical", "reactive", "aggressive"])
@pytest.mark.parametrize("turn", ["left", "straight", "right"])
def test_a_road_turned_by_a_quarter_gives_the_same_episode(planner: str, turn: str) -> None:
    # No round numbers: at a tie, rounding would decide what a driver does.
    ego = {"distance": 49.61, "speed": 8.07, "turn": turn}
    south = {"ego": ego, "vehicles": traffic_of("west", "east", "north")}
    west = {
        "road": CROSSED,
        "ego": {**ego, "arm": "west"},
        "vehicles": traffic_of("north", "south", "east"),
    }
    southern, western = (
        run(spec_of_drive(world, generator=planner, duration=30.0, policy="recover"))
        for world in (south, west)
    )
    assert southern.termination == western.termination
    assert southern.flagged == western.flagged
    assert western.signals.keys() == southern.signals.keys()
    for name, signal in southern.signals.items():
        # Steering divides by the speed, so that rounding grows where somebody comes to a stop.
        assert western.signal(name)[:40] == pytest.approx(signal[:40], abs=1e-9, nan_ok=True), name
    for name in ("gap", "leader_gap", "gap_time"):
        assert western.signal(name).min() == pytest.approx(southern.signal(name).min(), abs=0.05), (
            name
        )
    assert abs(len(western.time) - len(southern.time)) <= 1


def without_faults_no_assessor_is_alarmed_on_it(route: Route) -> None:
    if route.road is FOUR_WAY:
        return  # whose assessors have tests of their own
    for assessor in (
        DOMAINS["driving"].default_roles["security_assessor"],
        "pytest_dura.driving.roles.residuals:ResidualMonitor",
    ):
        spec = spec_of_drive(
            world_of(route, traffic={"headway": 12.0}),
            generator="rule_based",
            duration=20.0,
            roles={"security_assessor": RoleSpec(assessor)},
        )
        episode = run(spec)
        assert episode.failure is None
        assert [event for event in episode.events if event.kind == "alert"] == []


QUESTIONS = (
    it_is_the_lanes_that_are_driven,
    the_rule_based_planner_crosses_it_without_contact,
    who_waits_stops_at_the_stop_line_of_its_arm,
    the_rule_based_planner_gives_way_on_it,
    without_faults_no_assessor_is_alarmed_on_it,
)


@pytest.mark.parametrize("route", ROUTES, ids=str)
def test_a_route_keeps_what_every_route_owes(route: Route) -> None:
    for question in QUESTIONS:
        question(route)


@pytest.mark.parametrize("route", ROUTES, ids=str)
def test_the_heading_at_one_place_is_that_of_the_pose_to_the_last_bit(route: Route) -> None:
    drawn = np.random.default_rng(3).uniform(-2.0, route.length + 2.0, 300).tolist()
    for s in (*drawn, *route.grid[::7, 0].tolist(), 0.0, route.length):
        assert route.sampled_heading(s) == route.pose(s)[2]


@pytest.mark.parametrize("road", [*BUILT_IN, SKEW], ids=lambda road: str(road)[:20])
def test_the_picture_and_the_player_show_the_lanes(road: Any) -> None:
    to = {"ego": {"turn": "left"}} if road in ("t_junction", SKEW) else {}
    simulator, ticks = begin({"road": road, **to})
    picture = ticks[0].channels["camera_third_person"].get()
    grey = np.array(camera.COLOURS["road"])
    assert (np.abs(picture.astype(int) - grey).max(axis=-1) < 4).sum() > 4000
    geometry = simulator._route.road
    for way in routes_of(geometry):
        s = np.linspace(0.0, way.length, 400)
        x, y, _ = way.pose(s)
        surface = camera._ground(x.astype(np.float32), y.astype(np.float32), geometry)
        assert np.isin(surface, (3, 4)).all(), f"{way} leaves the road that is drawn"
    scene = simulator.scene(ticks, [Percept(tick.channels) for tick in ticks])
    stop_lines = [line.points for line in scene.lines if line.kind == "stop_line"]
    assert len(stop_lines) == len(geometry.entries)


def test_no_maneuver_aims_above_the_speed_limit_of_the_road() -> None:
    for road, limit in (({**SKEW, "speed_limit": 6.0}, 6.0), ("four_way", 10.0)):
        to = {"to": "hill"} if road != "four_way" else {}
        world = {"road": road, "ego": {**to, "distance": 60.0, "speed": 3.0}}
        _, ticks = drive(world, 100, always("accelerate"))
        assert ticks[-1].truth["ego"].speed == pytest.approx(limit, abs=0.1)


def test_an_object_from_nowhere_is_one_before_the_ends_of_the_road_s_own_arms() -> None:
    """100 m from the centre is well within the wide crossing, and near the end of the other one."""
    for name, far_from_end in (("four_way_wide", True), ("four_way", False)):
        _, ticks = begin({"road": name, "ego": {"distance": 70.0}})
        percept = {**ticks[0].channels}
        views, assessor = Views(), PlausibilityAssessor()
        assessor.reset(RoleContext(1, 0.1))
        assert assessor.run(views.role(percept)).alerts == ()
        percept["lidar"] = BodyList.of([Body("V1", -2.0, 100.0, 1.57, 0.0, 8.0, 5.0, 2.0)])
        alerts = assessor.run(views.role(percept)).alerts
        patterns = [alert.pattern for alert in alerts]
        assert ("object_from_nowhere" in patterns) == far_from_end


REFUSED: list[tuple[dict[str, Any], str, str]] = [
    ({"road": "four_wya"}, "world.road", "did you mean 'four_way'"),
    ({"ego": {"arm": "sout"}}, "world.ego.arm", "did you mean 'south'"),
    ({"ego": {"to": "up"}}, "world.ego.to", "one of south, west, north, east"),
    ({"ego": {"to": "south"}}, "world.ego.to", "one of west, north, east"),
    ({"road": "t_junction"}, "world.ego.turn", "left (to west), right (to east)"),
    ({"road": "merge", "ego": {"arm": "east"}}, "world.ego.arm", "one of ramp, west"),
    ({"ego": {"distance": 96.0}}, "world.ego.distance", "at most 95 m"),
    (
        {"vehicles": [{"id": "A", "arm": "eas", "distance": 9.0}]},
        "world.vehicles.0.arm",
        "did you mean 'east'",
    ),
    (
        {"vehicles": [{"id": "A", "arm": "west", "distance": 99.5}]},
        "world.vehicles.0.distance",
        "at most 99 m",
    ),
    (
        {"road": "merge", "pedestrians": [{"offset": 3.0}]},
        "world.pedestrians.0.arm",
        "one of ramp, west, east",
    ),
    (
        {"road": "merge", "traffic": {"arms": ["east"]}},
        "world.traffic.arms",
        "some of ramp, west",
    ),
    (
        {"controls": {"signals": [{"arms": ["up"], "phases": [{"state": "red", "lasts": 1.0}]}]}},
        "world.controls.signals.0.arms",
        "one of south",
    ),
    (
        {"road": {"arms": [arm("south", 180.0), arm("south", 0.0)]}},
        "world.road.arms",
        "names that are unique",
    ),
    (
        {"road": {"arms": [arm("south", 180.0), arm("near", 200.0), arm("north", 0.0)]}},
        "world.road.arms.",
        "at least 30 degrees",
    ),
    (
        {
            "road": {
                "arms": [
                    arm("south", 180.0, lanes="in"),
                    arm("skew", 215.0, lanes="in", stop_line=30.0),
                    arm("north", 0.0),
                ]
            }
        },
        "world.road.arms.0.stop_line",
        "at least 12.7",
    ),
    (
        {"road": {"arms": [arm("south", 180.0), arm("north", 0.0, lane_width=3.0)]}},
        "world.road.arms.0",
        "at least 5 m",
    ),
    (
        {"road": {"arms": [arm("south", 180.0, lanes="in"), arm("north", 0.0, lanes="in")]}},
        "world.road.arms",
        "another with one away",
    ),
]


@pytest.mark.parametrize("world, key, expected", REFUSED, ids=lambda value: str(value)[:40])
def test_a_road_that_cannot_be_is_refused(world: dict[str, Any], key: str, expected: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        HighwaySimulator.check_scenario(world)
    assert (caught.value.key or "").startswith(key)
    assert caught.value.found is not None
    assert expected in str(caught.value)


@pytest.mark.parametrize(
    "world",
    [
        {"road": {"arms": [arm("south", 180.0)]}},
        {"road": {"arms": [arm("south", 180.0), arm("north", 360.0)]}},
        {"road": {"arms": [arm("South", 180.0), arm("north", 0.0)]}},
        {"road": {"arms": [arm("south", 180.0), arm("north", 0.0)], "speed_limit": 0.0}},
        {"road": {"name": "four_way"}},
        {"road": 4},
        {"ego": {"turn": "left", "to": "west"}},
    ],
    ids=str,
)
def test_data_that_describe_no_road_are_refused(world: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        HighwaySimulator.check_scenario(world)


def test_a_pose_beside_the_route_is_refused_at_reset(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if the ego were put beside the route that it is given."""

    def beside(_: Route, s: float) -> tuple[float, float, float]:
        return 4.0, 111.0 - s, -math.pi / 2

    monkeypatch.setattr(Route, "pose", beside)
    with pytest.raises(ConfigurationError, match="does not start on its route"):
        begin({})


def test_a_checked_world_checks_to_itself() -> None:
    worlds: list[dict[str, Any]] = [
        {"road": SKEW, "traffic": {}, "ego": {"to": "lake"}},
        {"road": "merge", "traffic": {}},
        {"road": "t_junction", "ego": {"arm": "east", "turn": "left"}, "traffic": {}},
    ]
    for world in worlds:
        once = HighwaySimulator.check_scenario(world)
        assert HighwaySimulator.check_scenario(once) == once
    assert HighwaySimulator.check_scenario(worlds[2])["traffic"]["arms"] == ["south", "west"]
    assert "road" not in HighwaySimulator.check_scenario({})
