"""Lists of bodies: what they make of themselves once, for all who ask."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

from pytest_dura.core import first_difference, leaves, mutable_parts
from pytest_dura.driving import (
    NO_BODIES,
    Body,
    BodyList,
    Odometry,
    Pose,
    all_routes,
    route,
    route_map,
)
from pytest_dura.driving.scene import ego_of

CARS = [
    Body("A", 2.0, 30.0, 0.1, 1.0, -2.0, 5.0, 2.0),
    Body("B", -40.0, 2.0, 3.0, 9.0, 0.0, 12.0, 2.5),
    Body("P", 5.0, -15.0, 1.5, 0.0, 1.3, 0.6, 0.6),
]


def test_its_numbers_are_those_of_its_array() -> None:
    bodies = BodyList.of(CARS)
    assert bodies.numbers == tuple(tuple(row) for row in bodies.data.tolist())
    assert bodies.numbers is bodies.numbers
    assert list(bodies) == CARS
    assert [bodies[0], bodies[-1]] == [CARS[0], CARS[-1]]
    assert bodies[1:].numbers == bodies.numbers[1:]
    assert NO_BODIES.numbers == ()


def test_beside_is_the_projection_of_each_on_the_route_that_is_asked_for() -> None:
    bodies = BodyList.of(CARS)
    for way in [*all_routes(), route(0, "left"), route(1, "left")]:
        assert bodies.beside(way) == tuple(way.project(body.x, body.y) for body in CARS)
        assert bodies.beside(way) is bodies.beside(way)


def test_a_list_with_another_body_has_numbers_of_its_own() -> None:
    bodies, way = BodyList.of(CARS), route(0, "straight")
    before = bodies.numbers, bodies.beside(way)
    moved = bodies.with_body(CARS[0]._replace(x=9.0))
    assert moved.numbers[0][0] == 9.0
    assert moved.beside(way) != before[1]
    assert (bodies.numbers, bodies.beside(way)) == before


def test_what_it_has_made_is_no_part_of_its_value() -> None:
    bodies = BodyList.of(CARS)
    before = leaves(bodies)
    _ = bodies.numbers, bodies.beside(route(0, "straight"))
    assert first_difference(before, leaves(bodies)) is None
    assert mutable_parts(bodies) == []
    assert bodies == BodyList.of(CARS)
    for copied in (copy.deepcopy(bodies), pickle.loads(pickle.dumps(bodies))):
        assert copied == bodies
        assert copied.beside(route(1, "right")) == bodies.beside(route(1, "right"))


@pytest.mark.parametrize("turn", ["left", "straight", "right"])
def test_the_ego_is_where_its_own_sensors_place_it_on_its_route(turn: str) -> None:
    way = route(0, turn)
    x, y, heading = (float(np.asarray(value)) for value in way.pose(95.0))
    percept = {
        "localisation": Pose(x, y, heading), "odometry": Odometry(7.0), "map": route_map(way),
    }  # fmt: skip
    ego = ego_of(percept)
    assert ego.s == pytest.approx(95.0)
    assert ego.to_stop_line == pytest.approx(2.5)
    assert (ego.pose, ego.speed, ego.way) == (
        percept["localisation"], 7.0, percept["map"],
    )  # fmt: skip
