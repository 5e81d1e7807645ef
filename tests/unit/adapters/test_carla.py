"""CARLA: roads by the real client library, the rest against a stand-in for the server."""

from __future__ import annotations

import re
import socket
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from pytest_dura import ConfigurationError, RoleSpec, check_simulator
from pytest_dura.driving.lanes import routes_of
from pytest_dura.driving.roads import BUILT_IN, FOUR_WAY, Arm, Road
from pytest_dura.driving.scenario import RoadData
from pytest_dura.execution import run_episode
from pytest_dura.library import load_library
from pytest_dura.library.cases import expand_cases
from pytest_dura.library.scenario import Scenario, check_world

pytest.importorskip("carla", reason="the extra carla is not installed")

import carla
from carla_stand_in import Blueprint, StandIn, World
from free_ports import free_port

from pytest_dura.adapters.carla.__main__ import main
from pytest_dura.adapters.carla.maps import difference, junctions_of, place_of
from pytest_dura.adapters.carla.opendrive import opendrive_of
from pytest_dura.adapters.carla.simulator import CarlaSimulator
from pytest_dura.adapters.carla.world import CONNECTIONS, CarlaError, Connection, Sensor

SKEW = Road(
    "custom",
    (
        Arm("south", 170.0, 1, 80.0, 14.0, 3.5),
        Arm("west", 265.0, 3, 120.0, 14.0, 4.0, lanes="in"),
        Arm("north_east", 38.0, 3, 90.0, 16.0, 3.2),
    ),
)
ROADS = [*BUILT_IN.values(), SKEW]
EGO = {"distance": 40.0, "speed": 8.0}


@pytest.mark.parametrize("road", ROADS, ids=[*BUILT_IN, "skew"])
def test_a_road_that_carla_builds_has_the_lanes_of_driving_and_is_read_back(road) -> None:
    built = carla.Map(road.name, opendrive_of(road))
    for plan in routes_of(road):
        # Nearer than a decimetre to where two roads join, the library may name either.
        for s in np.arange(1.0, plan.length - 1.0, 1.7):
            x, y = plan.point(s)
            lane = built.get_waypoint(carla.Location(x=x, y=y))
            place = lane.transform.location
            assert np.hypot(place.x - x, place.y - y) < 0.01, (plan, s)
    (junction,) = junctions_of(built)
    place = place_of(built, junction, road.speed_limit)
    assert (place.x, place.y) == pytest.approx((0.0, 0.0), abs=1e-3)
    assert difference(road, place.road) == difference(place.road, road) == ""
    by_bearing = sorted(road.arms, key=lambda arm: (arm.bearing - 180.0) % 360.0)
    signs = [road.sign(road.arm(arm.name)) == "give_way" for arm in by_bearing]
    assert [arm.priority == 1 for arm in place.road.arms] == signs


def test_what_is_no_road_of_driving_is_refused_in_words() -> None:
    text = opendrive_of(FOUR_WAY)
    with pytest.raises(ConfigurationError, match="the junction 5 of four is no road") as caught:
        place_of(carla.Map("four", text), 5)
    assert caught.value.expected == "1000"
    wide = BUILT_IN["four_way_wide"]
    assert (
        difference(FOUR_WAY, wide) == "stop_line of south is 17.0 there, and 11.0 in the scenario"
    )
    assert difference(FOUR_WAY, BUILT_IN["t_junction"]) == "no arm at 0 degrees for north"
    assert difference(BUILT_IN["t_junction"], FOUR_WAY) == "it has 4 arms"
    turned = replace(FOUR_WAY, arms=tuple(
        replace(arm, priority=4 - arm.priority) for arm in FOUR_WAY.arms
    ))  # fmt: skip
    assert difference(FOUR_WAY, turned).startswith("the sign of south is priority_road there")
    # A second lane towards the junction, from which a way leads straight on.
    lane = text[text.index('<lane id="-1"') : text.index("</lane></right>")] + "</lane>"
    second = text.replace(lane + "</right>", lane + lane.replace('"-1"', '"-2"') + "</right>", 1)
    way = routes_of(FOUR_WAY)[1].number
    link = f'<connection id="{way}" incomingRoad="0"'
    head, tail = second.split(link)
    second = head + link + tail.replace('<laneLink from="-1"', '<laneLink from="-2"', 1)
    begin = f'id="{4 + way}" junction="1000"'
    head, tail = second.split(begin)
    second = head + begin + tail.replace('x="2.0"', 'x="6.0"', 1)
    with pytest.raises(ConfigurationError, match="several lanes in one direction"):
        place_of(carla.Map("four", second), 1000)


def test_a_map_is_printed_as_a_scenario_has_its_road(tmp_path, capsys) -> None:
    (tmp_path / "skew.xodr").write_text(opendrive_of(SKEW))
    assert main(["road", "--opendrive", str(tmp_path / "skew.xodr")]) == 0
    data = yaml.safe_load(capsys.readouterr().out)["road"]
    assert difference(RoadData.model_validate(data).road(), SKEW) == ""


def spec_of(case="intersection/nominal", **parameters):
    found = next(c for c in expand_cases(load_library([]).scenarios) if c.id == case)
    path = "pytest_dura.adapters.carla.simulator:CarlaSimulator"
    return found.spec(0, 0, simulator=RoleSpec(path, parameters))


def test_no_server_and_one_that_does_not_answer_are_infrastructure(monkeypatch) -> None:
    port = free_port()
    episode = run_episode(spec_of(port=port))
    assert episode.validity == "missing"
    assert f"no server of CARLA answers at 127.0.0.1:{port}: [Errno" in episode.failure
    monkeypatch.setattr("pytest_dura.adapters.carla.world._LOOK", 0.3)
    with socket.create_server(("127.0.0.1", port)):
        episode = run_episode(spec_of(port=port))
    assert "time-out of 300ms while waiting for the simulator" in episode.failure


@pytest.fixture
def server(monkeypatch):
    """A stand-in that listens, so that a look finds it."""
    made = StandIn()
    monkeypatch.setattr(carla, "Client", made.client)
    with socket.create_server(("127.0.0.1", 0), backlog=64) as listening:
        made.port = listening.getsockname()[1]
        yield made
        CONNECTIONS.close()


@pytest.fixture
def simulator(server):
    made = CarlaSimulator(port=server.port)
    yield made
    made.close()


def drive(simulator, world, action="proceed", ticks=200, seed=3):
    seen = [simulator.reset({"world": world, "duration": 60.0}, seed)]
    while len(seen) < ticks and not (seen[-1].goal or seen[-1].critical):
        command = action(seen[-1]) if callable(action) else action
        seen.append(simulator.step(simulator.check_action(command)))
    return seen


def test_it_keeps_the_contract_of_simulators(server) -> None:
    world = {"ego": EGO, "traffic": {"headway": 8.0}, "pedestrians": [{"id": "P1", "offset": 30.0}]}
    spec = RoleSpec("pytest_dura.adapters.carla.simulator:CarlaSimulator", {"port": server.port})
    report = check_simulator(spec, {"world": world, "duration": 20.0}, ["proceed"] * 15)
    assert report.not_supported == ("snapshot and restore",)


@pytest.mark.parametrize("turn", ["straight", "left", "right"])
def test_the_ego_follows_its_route_and_what_its_actuator_wants(simulator, turn) -> None:
    ticks = drive(simulator, {"ego": {**EGO, "turn": turn}}, "proceed_cautiously", 400)
    assert ticks[-1].goal
    egos = [tick.truth["ego"] for tick in ticks]
    assert (egos[0].speed, egos[0].s) == (8.0, 60.0)
    assert max(abs(ego.lateral) for ego in egos) < 0.3
    assert all(a.s < b.s for a, b in pairwise(egos))


def test_pedals_are_corrected_by_the_speed_that_is_missing(simulator) -> None:
    ticks = drive(simulator, {"ego": {**EGO, "distance": 90.0, "speed": 4.0}},
                  lambda _: {"maneuver": "proceed", "acceleration": 1.0}, 30)  # fmt: skip
    speeds = [tick.truth["ego"].speed for tick in ticks]
    assert speeds[-1] - speeds[10] == pytest.approx(1.9, abs=0.15)
    stop = drive(simulator, {"ego": EGO}, "emergency_brake", 30)
    assert stop[-1].truth["ego"].speed == 0.0
    assert min(tick.truth["ego"].acceleration for tick in stop) < -6.0


def test_other_cars_and_pedestrians_are_bodies_of_their_own_size(simulator, server) -> None:
    world = {
        "ego": {**EGO, "speed": 0.0},
        "vehicles": [{"id": "CAR", "arm": "west", "turn": "right", "distance": 60.0, "speed": 8.0}],
        "pedestrians": [{"id": "P1", "arm": "north", "offset": 40.0, "start": 0.0, "speed": 1.0}],
    }
    ticks = drive(simulator, world, "wait", 51)
    car, walker = (ticks[0].truth["bodies"].get(name) for name in ("CAR", "P1"))
    assert (car.length, car.width) == pytest.approx((4.8, 1.9))
    gone = ticks[-1].truth["bodies"].get("CAR")
    assert np.hypot(gone.x - car.x, gone.y - car.y) > 30.0
    later = ticks[-1].truth["bodies"].get("P1")
    assert np.hypot(later.x - walker.x, later.y - walker.y) == pytest.approx(5.0, abs=0.15)
    there = {actor.type_id: (actor.x, actor.y) for actor in server.actors.values()}
    assert there["walker.pedestrian.0001"] == pytest.approx((later.x, later.y), abs=0.11)


def test_a_contact_is_found_and_attributed(simulator) -> None:
    person = {"id": "P1", "arm": "south", "offset": 8.0, "start": 0.0, "speed": 1.3}
    ticks = drive(simulator, {"ego": {**EGO, "distance": 35.0}, "pedestrians": [person]})
    assert "ran into P1" in ticks[-1].critical
    assert [tick.truth["contact"] for tick in ticks[-2:]] == [0, 1]


def test_a_contact_that_only_carla_sees_counts(simulator, server) -> None:
    drive(
        simulator,
        {"ego": EGO, "vehicles": [{"id": "CAR", "arm": "north", "distance": 60.0}]},
        ticks=3,
    )
    ego, car = (next(a for a in server.actors.values() if a.id == body.actor.id)
                for body in simulator._road.vehicles)  # fmt: skip
    bumper = next(a for a in server.actors.values() if a.type_id == "sensor.other.collision")
    bumper.heard(SimpleNamespace(frame=server.frame, actor=ego, other_actor=car))
    tick = simulator.step(simulator.check_action("proceed"))
    assert "CAR" in tick.critical


def test_a_wall_that_only_carla_knows_is_a_contact(simulator, server) -> None:
    drive(simulator, {"ego": EGO}, ticks=3)
    bumper = next(a for a in server.actors.values() if a.type_id == "sensor.other.collision")
    wall = SimpleNamespace(id=0, type_id="static.wall")
    ego = SimpleNamespace(id=simulator._road.vehicles[0].actor.id)
    bumper.heard(SimpleNamespace(frame=server.frame, actor=ego, other_actor=wall))
    tick = simulator.step(simulator.check_action("proceed"))
    assert "static.wall" in tick.critical


def test_one_server_serves_many_episodes_in_step_and_by_their_seeds(simulator, server) -> None:
    world = {"ego": EGO, "vehicles": [{"id": "CAR", "arm": "east", "distance": 60.0}]}
    server.load(opendrive_of(FOUR_WAY))
    blueprint = Blueprint("vehicle.of.another.client")
    World(server).try_spawn_actor(blueprint, carla.Transform(carla.Location(x=2.0, y=51.0)))
    server.loads.clear()
    for seed in (1, 2, 1):
        drive(simulator, {**world, "courtesy": "none"}, ticks=5, seed=seed)
    assert len(server.loads) == 1
    assert len([a for a in server.actors.values() if a.type_id.startswith("vehicle")]) == 2
    assert len({actor for actor, _, detect in server.ignoring if not detect}) == 3
    (first, second, third) = (server.seeds[i : i + 2] for i in (0, 2, 4))
    assert first == third
    assert [name for name, _ in first] == ["world", "traffic"]
    assert all(a != b for a, b in zip(first, second, strict=True))
    settings = server.settings
    assert (settings.synchronous_mode, settings.fixed_delta_seconds) == (True, pytest.approx(0.1))
    assert settings.max_substeps * settings.max_substep_delta_time >= 0.1 - 1e-6
    assert settings.deterministic_ragdolls
    simulator.close()
    assert not server.actors
    turning = {"ego": {**EGO, "turn": "left"}, "road": "t_junction"}
    drive(simulator, turning, ticks=2)
    assert len(server.loads) == 2
    simulator.close()
    CONNECTIONS.close()
    assert not server.settings.synchronous_mode


def test_a_server_that_is_lost_in_an_episode_is_found_again_for_the_next(server) -> None:
    server.dies_at = server.frame + 30
    spec = spec_of(port=server.port)
    lost = run_episode(spec)
    assert lost.validity == "missing"
    assert "simulator at tick 29" in lost.failure
    assert "make a step: the server of CARLA at 127.0.0.1" in lost.failure
    assert "time-out of 20000ms" in lost.failure
    server.dies_at = np.inf
    found = run_episode(spec)
    assert (found.failure, found.termination) == (None, "goal")
    assert len(server.loads) == 2


def test_another_version_and_another_client_that_steps_are_refused(server, simulator) -> None:
    simulator.reset({"world": {}, "duration": 5.0}, 1)
    held = simulator._road.held
    stepping = held.world.tick
    held.world.tick = lambda seconds: stepping(seconds) - 1
    with pytest.raises(CarlaError, match="who steps it"):
        simulator.step(simulator.check_action("proceed"))
    server.version = "0.9.15"
    with pytest.raises(ConfigurationError, match="have different versions") as caught:
        simulator.reset({"world": {}, "duration": 5.0}, 1)
    assert "pip install carla==0.9.15" in caught.value.remedy
    Connection("127.0.0.1", free_port(), 8000, "", 1.0).close()


def test_the_camera_is_that_of_the_tick(server) -> None:
    simulator = CarlaSimulator(port=server.port, front_camera=True)
    tick = simulator.reset({"world": {}, "duration": 5.0}, 1)
    for _ in range(3):
        picture = tick.channels["camera_front"].get()
        assert picture.shape == (128, 128, 3)
        assert picture[0, 0].tolist() == [server.frame % 256, 2, 1]
        tick = simulator.step(simulator.check_action("proceed"))
    assert not server.settings.no_rendering_mode
    server.late = 1
    simulator._timeout = simulator._road._timeout = 0.2
    with pytest.raises(
        CarlaError, match=r"sensor.camera.rgb gave no frame \d+ within 0.2 s: frame"
    ):
        simulator.step(simulator.check_action("proceed"))
    simulator.close()


def test_a_sensor_drops_older_frames_and_refuses_later_ones() -> None:
    sensor = Sensor(SimpleNamespace(listen=lambda _: None, type_id="sensor.x"))
    for frame in (1, 2, 3, 5):
        sensor._data.put(SimpleNamespace(frame=frame))
    assert sensor.at(3, 1.0).frame == 3
    with pytest.raises(CarlaError, match="gave frame 5 in place of 4"):
        sensor.at(4, 1.0)
    with pytest.raises(CarlaError, match=r"gave no frame 6 within 0\.05 s: nothing so far"):
        sensor.at(6, 0.05)


def test_a_junction_of_a_town_is_used_where_it_is_the_scenarios_road(server) -> None:
    text = re.sub(
        ' x="([^"]*)" y="([^"]*)" hdg',
        lambda place: f' x="{float(place[1]) + 300.0!r}" y="{float(place[2]) + 20.0!r}" hdg',
        opendrive_of(BUILT_IN["t_junction"]),
    )
    server.towns = {"Town01": text}
    town = {"port": server.port, "town": "Town01", "junction": 1000}
    simulator = CarlaSimulator(**town)
    ticks = drive(simulator, {"road": "t_junction", "ego": {**EGO, "turn": "right"}})
    assert ticks[-1].goal
    assert server.loads == ["Town01"]
    ego, actor = ticks[-1].truth["ego"], simulator._ego.actor
    assert (ego.x, ego.y) == pytest.approx((actor.x - 300.0, actor.y + 20.0), abs=1e-3)
    with pytest.raises(
        ConfigurationError, match="1000 of Town01 is not the scenario's road: no arm"
    ):
        drive(simulator, {"ego": EGO})
    simulator.close()


@pytest.mark.parametrize(
    "key, value, words",
    [
        ("obstacles", [{"id": "O1", "kind": "cones", "offset": 30.0, "beside": 2.0}], "obstacles"),
        ("vehicles", [{"id": "A", "arm": "east", "distance": 20.0, "gives_way": False}], "know no"),
    ],
)
def test_what_it_cannot_simulate_is_refused_before_anything_runs(key, value, words) -> None:
    scenario = Scenario.model_validate(
        {"name": "x/y", "simulator": "driving.carla", "duration": 9.0, "world": {key: value}}
    )
    role = RoleSpec("pytest_dura.adapters.carla.simulator:CarlaSimulator")
    with pytest.raises(ConfigurationError, match=words):
        check_world(scenario, role, scenario.world)


def test_check_says_in_a_line_each_what_works_and_what_to_do(server, capsys, monkeypatch) -> None:
    assert main(["check", "--port", str(server.port)]) == 0
    lines = capsys.readouterr().out.splitlines()
    names = ["client", "server", "road", "ego", "brake", "traffic", "camera", "repeats"]
    assert [line.split()[:2] for line in lines] == [["ok", f"{name}:"] for name in names]
    assert main(["check", "--port", str(free_port())]) == 1
    out = capsys.readouterr().out.splitlines()
    assert out[-1].startswith("FAIL  server: CarlaError: no server of CARLA answers at 127.0.0.1:")
    assert "remedy: start CarlaUE4.sh first" in out[-1]
    assert len(out) == 2
    monkeypatch.setattr("carla_stand_in.LOCKED", 0.02)  # a car that hardly turns
    assert main(["check", "--port", str(server.port)]) == 1
    assert "FAIL  ego: ValueError: left" in capsys.readouterr().out
