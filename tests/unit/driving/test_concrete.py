"""Worlds written out: the same episode with nothing left to the seed; cars that enter."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from roads import SCENARIOS, always, begin, bodies_at, drive, run

from pytest_dura import ConfigurationError, RoleSpec
from pytest_dura.driving import ARM_LENGTH, HighwaySimulator, concrete_world, route
from pytest_dura.library import case_with_faults, load_scenarios


@pytest.mark.parametrize(
    "name, seed",
    [("congested", 1), ("nominal", 2), ("conflicting-traffic", 3), ("pedestrian-crossing", 4)],
)
def test_the_world_written_out_gives_the_same_episode(name: str, seed: int) -> None:
    case = case_with_faults(
        load_scenarios([SCENARIOS / "intersection"])[f"intersection/{name}"], "none"
    )
    spec = case.spec(seed, 9, {"generator": RoleSpec("reactive")})
    spec = replace(spec, termination=replace(spec.termination, time_limit=12.0))
    world = concrete_world(spec.scenario["world"], spec.scenario["duration"], spec.seed)
    assert world["traffic"] is None
    assert len(world["vehicles"]) > len(spec.scenario["world"]["vehicles"])
    drawn = run(spec)
    written = run(replace(spec, scenario={**spec.scenario, "world": world}))
    assert {key: column.tobytes() for key, column in written.signals.items()} == {
        key: column.tobytes() for key, column in drawn.signals.items()
    }
    assert written.events == drawn.events


def test_a_world_without_random_traffic_is_written_out_already() -> None:
    world = concrete_world({"traffic": {"headway": 5.0}}, 30.0, 1)
    assert concrete_world(world, 60.0, 2) == world == HighwaySimulator.check_scenario(world)


def test_cars_without_room_at_the_start_are_not_written_out() -> None:
    world = {
        "traffic": {"headway": 4.0, "minimum_headway": 0.1, "arms": ["west"]},
        "vehicles": [{"id": "WEST", "arm": "west", "distance": 60.0}],
    }
    absent = 0
    for seed in range(20):
        written = concrete_world(world, 1.0, seed)
        _, (first,) = begin(world, seed=seed, duration=1.0)
        _, (second,) = begin(written, seed=seed, duration=1.0)
        assert bodies_at(first) == bodies_at(second)
        there = {one["id"] for one in written["vehicles"] if one.get("enters", 0.0) <= 0.0}
        assert there == set(bodies_at(first).ids)
        numbers = [int(name[1:]) for name in there - {"WEST"}]
        absent += max(numbers, default=0) - len(numbers)
    assert absent > 0


def car(**more: Any) -> dict[str, Any]:
    return {
        "ego": {"distance": 90.0, "speed": 0.0},
        "vehicles": [{"id": "A", "arm": "west", **more}],
    }


def test_a_car_enters_at_the_outer_end_of_its_arm_when_it_is_told() -> None:
    _, ticks = drive(car(enters=2.0, speed=6.0), 40, always("emergency_brake"))
    first = next(i for i, tick in enumerate(ticks) if bodies_at(tick).ids)
    assert first == 20
    (body,) = bodies_at(ticks[first])
    assert route(1, "straight").project(body.x, body.y)[0] == pytest.approx(0.0, abs=1e-9)
    assert np.hypot(body.vx, body.vy) == pytest.approx(6.0)


def test_a_car_that_entered_before_the_start_has_driven_on_at_its_speed() -> None:
    _, (tick,) = begin(car(enters=-5.0, speed=6.0))
    (body,) = bodies_at(tick)
    assert route(1, "straight").project(body.x, body.y)[0] == pytest.approx(30.0)
    _, (same,) = begin(car(distance=ARM_LENGTH - 30.0, speed=6.0))
    assert bodies_at(same)[0] == body


def test_a_car_that_has_no_room_waits_outside() -> None:
    world = car(enters=1.0, speed=6.0)
    world["vehicles"].append({"id": "B", "arm": "west", "enters": 1.5, "speed": 6.0})
    _, ticks = drive(world, 60, always("emergency_brake"))
    enters = [next(i for i, t in enumerate(ticks) if name in bodies_at(t).ids) for name in "AB"]
    assert enters[0] == 10
    assert enters[1] > 20


def test_the_exponent_is_the_drivers() -> None:
    speeds = []
    for exponent in (1.0, 4.0, None):
        more = {} if exponent is None else {"exponent": exponent}
        _, ticks = drive(car(distance=99.0, speed=5.0, **more), 20, always("emergency_brake"))
        speeds.append(bodies_at(ticks[-1])[0].vx)
    assert speeds[0] != pytest.approx(speeds[1], abs=0.1)
    assert speeds[1] == speeds[2]


@pytest.mark.parametrize(
    "world, told",
    [
        (car(), "needs one of `distance`"),
        (car(distance=20.0, enters=1.0), "needs one of `distance`"),
        (car(enters=-9.5), "greater than or equal to -9"),
    ],
)
def test_a_car_is_somewhere(world: dict[str, Any], told: str) -> None:
    with pytest.raises(ValueError, match=told):
        HighwaySimulator.check_scenario(world)


def test_two_cars_cannot_have_entered_at_one_place() -> None:
    world = car(enters=-5.0, speed=6.0)
    world["vehicles"].append({"id": "B", "arm": "west", "distance": 65.0})
    with pytest.raises(ConfigurationError, match="no room"):
        HighwaySimulator.check_scenario(world)


def test_worlds_without_the_newer_keys_stay_as_they_were() -> None:
    (vehicle,) = HighwaySimulator.check_scenario(car(distance=20.0))["vehicles"]
    assert vehicle == {"id": "A", "arm": "west", "turn": "straight", "distance": 20.0, "speed": 8.0}
