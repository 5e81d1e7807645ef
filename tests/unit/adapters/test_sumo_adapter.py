"""SumoSimulator: driving's junction with SUMO's drivers. Skipped where libsumo is not installed."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pytest_dura import ConfigurationError, RoleSpec, check_simulator
from pytest_dura.driving import ARM_LENGTH, CAR_LENGTH, all_routes, box_gap
from pytest_dura.driving.highway import JunctionSimulator
from pytest_dura.execution import run_episode
from pytest_dura.library import load_library
from pytest_dura.library.cases import expand_cases
from pytest_dura.library.scenario import Scenario, check_world

libsumo = pytest.importorskip("libsumo")

from pytest_dura.adapters import sumo  # noqa: E402 - it is of use only with the library
from pytest_dura.adapters.sumo import SumoSimulator  # noqa: E402 - it is of use only with the library

SUMO = RoleSpec("pytest_dura.adapters.sumo:SumoSimulator")
EMPTY: dict[str, Any] = {"ego": {"distance": 40.0, "speed": 8.0}}


@pytest.fixture
def simulator():
    made = SumoSimulator()
    yield made
    made.close()


def cross(simulator, world, action="proceed", ticks=120, seed=3):
    """Drive on until something ends it; returns the ticks."""
    seen = [simulator.reset({"world": world, "duration": 60.0}, seed)]
    while len(seen) < ticks and seen[-1].critical is None and not seen[-1].goal:
        command = action(seen[-1]) if callable(action) else action
        seen.append(simulator.step(simulator.check_action(command)))
    return seen


def speeds(ticks, name):
    bodies = [tick.truth["bodies"].get(name) for tick in ticks]
    return [float(np.hypot(body.vx, body.vy)) for body in bodies if body is not None]


def test_it_keeps_the_contract_of_simulators():
    world = {**EMPTY, "traffic": {"headway": 8.0}, "pedestrians": [{"id": "P1", "offset": 8.0}]}
    report = check_simulator(SumoSimulator, {"world": world, "duration": 20.0}, ["proceed"] * 15)
    assert report.not_supported == ("snapshot and restore",)


def test_the_network_has_the_lines_of_the_junctions_routes():
    tree = ET.parse(Path(sumo.__file__).with_name(sumo.NETWORK))
    lanes = {lane.get("id"): lane for lane in tree.iter("lane")}
    links = {(link.get("from"), link.get("to")): link for link in tree.iter("connection")}
    for plan in all_routes():
        origin = sumo.route_name(plan).split("_")[0]
        link = next(
            link for (start, end), link in links.items()
            if start == f"{origin}_in" and link.get("dir") == plan.turn[0]
        )  # fmt: skip
        assert float(lanes[f"{origin}_in_0"].get("length")) == ARM_LENGTH
        points = np.array([[float(c) for c in p.split(",")] for p in link.get("shape").split()])
        s = np.linspace(ARM_LENGTH, plan.exit, len(points))
        x, y, _ = plan.pose(s)
        assert np.hypot(points[:, 0] - x, points[:, 1] + y).max() < 0.01, plan


def test_positions_are_those_of_the_centre_and_advance_by_the_speed(simulator):
    car = {"id": "CAR", "arm": "east", "distance": 60.0, "speed": 6.0}
    ticks = cross(simulator, {**EMPTY, "vehicles": [car]}, ticks=100)
    first = ticks[0].truth["bodies"].get("CAR")
    assert (first.x, first.y) == pytest.approx((60.0 + 11.0, -2.0), abs=0.01)
    simulator.reset({"world": {**EMPTY, "vehicles": [car]}, "duration": 9.0}, 3)
    later = simulator.step(simulator.check_action("proceed")).truth
    front = libsumo.vehicle.getLanePosition("CAR")  # SUMO's own, of the bumper
    assert front == pytest.approx(100.0 - (later["bodies"].get("CAR").x - 11.0) + 2.5, abs=1e-6)
    assert libsumo.vehicle.getLanePosition("EGO") == pytest.approx(later["ego"].front, abs=1e-6)
    for before, tick in pairwise(ticks):
        here, there = (each.truth["bodies"].get("CAR") for each in (before, tick))
        if there is None:
            break
        way = np.hypot(there.x - here.x, there.y - here.y)
        assert way == pytest.approx(np.hypot(there.vx, there.vy) * 0.1, abs=1e-6)
        ego, now = before.truth["ego"], tick.truth["ego"]
        assert now.s - ego.s == pytest.approx(now.speed * 0.1, abs=1e-6)


def test_the_ego_has_the_actuator_of_driving(simulator):
    ticks = cross(simulator, EMPTY, "emergency_brake", ticks=25)
    signals = simulator.signals(ticks)
    assert signals["acceleration"].min() == pytest.approx(-8.0, abs=0.01)
    assert np.abs(signals["jerk"]).max() <= 40.0 + 1e-6
    assert ticks[-1].truth["ego"].speed == 0.0


@pytest.mark.parametrize("turn", ["left", "right"])
def test_the_ego_turns_on_its_route_to_the_goal(simulator, turn):
    ticks = cross(simulator, {"ego": {**EMPTY["ego"], "turn": turn}}, "proceed_cautiously", 400)
    assert ticks[-1].goal
    signals = simulator.signals(ticks)
    assert np.abs(signals["lateral_acceleration"]).max() < 3.0
    assert max(abs(tick.truth["ego"].lateral) for tick in ticks) == pytest.approx(0.0, abs=0.02)


def stand_inside(tick):
    """Drive into the junction and stop there, in the way of who comes from the east."""
    return "emergency_brake" if tick.truth["ego"].s > ARM_LENGTH + 8.0 else "proceed"


@pytest.mark.parametrize("courtesy,struck", [("occupied", False), ("none", True)])
def test_courtesy_decides_whether_drivers_brake_for_an_ego_in_their_way(
    simulator, courtesy, struck
):
    cars = [{"id": "CAR", "arm": "east", "distance": 80.0, "speed": 8.0}]
    world = {"ego": {"distance": 20.0, "speed": 8.0}, "vehicles": cars, "courtesy": courtesy}
    ticks = cross(simulator, world, stand_inside, ticks=200)
    assert (ticks[-1].critical is not None) is struck
    assert ticks[-1].truth["contact"] == (3 if struck else 0)
    if struck:
        assert "was struck while standing by CAR" in ticks[-1].critical
    else:
        assert speeds(ticks, "CAR")[-1] < 0.5


def test_contacts_are_those_of_our_boxes_and_are_attributed(simulator):
    person = {"id": "P1", "arm": "south", "offset": 8.0, "start": 0.0, "speed": 1.3}
    walk = {"ego": {"distance": 35.0, "speed": 8.0}, "pedestrians": [person]}
    ticks = cross(simulator, walk, ticks=80)
    last = ticks[-1]
    assert last.truth["contact"] == 1
    assert "ran into P1" in last.critical
    ego, hit = last.truth["ego"], last.truth["bodies"].get("P1")
    mine = np.array([[ego.x, ego.y, ego.heading, CAR_LENGTH, 2.0]])
    other = np.array([[hit.x, hit.y, hit.heading, hit.length, hit.width]])
    assert box_gap(mine, other)[0] == 0.0
    assert all(tick.truth["contact"] == 0 for tick in ticks[:-1])


def test_drivers_stop_for_a_pedestrian_in_their_way(simulator):
    person = {"id": "P1", "arm": "east", "offset": 30.0, "start": 0.0, "speed": 0.6}
    car = {"id": "CAR", "arm": "east", "distance": 90.0, "speed": 8.0}
    world = {**EMPTY, "vehicles": [car]}
    free = cross(simulator, world, "wait", ticks=150)
    held_up = cross(simulator, {**world, "pedestrians": [person]}, "wait", ticks=150)
    assert min(speeds(free, "CAR")) == 8.0
    assert min(speeds(held_up, "CAR")) < 4.0
    assert not any(tick.events for tick in held_up)


CONES = {"id": "O1", "kind": "cones", "offset": 30.0, "beside": 2.0}
LIGHT = {"arms": ["south"], "phases": [{"state": "red", "lasts": 9}]}


@pytest.mark.parametrize(
    "key,value,problem",
    [
        ("obstacles", [CONES], "lacks obstacles: SUMO's drivers would not see them"),
        ("controls", {"signals": [LIGHT]}, "lacks controls.signals: its network has signs"),
    ],
)
def test_worlds_that_it_cannot_simulate_are_refused_before_anything_runs(key, value, problem):
    scenario = Scenario.model_validate(
        {"name": "x/y", "simulator": "driving.sumo", "duration": 9.0, "world": {key: value}}
    )
    with pytest.raises(ConfigurationError, match=problem) as caught:
        check_world(scenario, SUMO, scenario.world)
    assert str(caught.value.key).startswith(f"world.{key}")


def test_a_world_with_anything_else_that_it_does_not_know_is_refused(monkeypatch):
    checked = JunctionSimulator.check_scenario({})
    monkeypatch.setattr(
        JunctionSimulator, "check_scenario", classmethod(lambda *_: {**checked, "map": "merge"})
    )
    with pytest.raises(ConfigurationError, match="SUMO has no network for a world with 'map'"):
        SumoSimulator.check_scenario({})


def test_a_second_simulation_replaces_the_first_which_says_so():
    first, second = SumoSimulator(), SumoSimulator()
    scenario = {"world": EMPTY, "duration": 10.0}
    first.reset(scenario, 1)
    second.reset(scenario, 1)
    with pytest.raises(RuntimeError, match="another simulation has replaced this one"):
        first.step(first.check_action("proceed"))
    first.close()  # leaves the second alone
    assert second.step(second.check_action("proceed")).index == 1
    second.close()


def test_a_built_in_scenario_runs_with_the_same_roles_and_repeats_to_the_last_bit():
    case = next(
        case for case in expand_cases(load_library([]).scenarios)
        if case.id == "intersection/pedestrian-crossing"
    )  # fmt: skip
    spec = case.spec(0, 0, simulator=SUMO)
    own = case.spec(0, 0)
    assert dict(spec.roles) == dict(own.roles)
    first = run_episode(spec)
    run_episode(case.spec(1, 0, simulator=SUMO))
    again, highway = run_episode(spec), run_episode(own)
    assert first.failure is None
    assert first.termination == "goal"
    assert first.digest == again.digest != highway.digest
    assert first.signals.keys() == highway.signals.keys()
    assert first.described_measures == highway.described_measures
    assert first.clearance_time is not None
