"""Who comes nearest: the least of all predicted separations, to the last bit."""

from __future__ import annotations

import random

import numpy as np
import pytest

from pytest_dura.driving import SPEED_LIMIT, BodyList, Scene, all_routes, route
from pytest_dura.driving.prediction import Predictor
from pytest_dura.driving.roles.safety import nearest

CAP = 10.0


def drawn(rng: random.Random, count: int) -> BodyList:
    rows = []
    for _ in range(count):
        far = rng.choice([10.0, 60.0])
        length, width = rng.choice([(5.0, 2.0), (0.6, 0.6), (12.3, 2.5), (30.0, 0.1)])
        x, y, heading = rng.uniform(-far, far), rng.uniform(-far, far), rng.uniform(-9, 9)
        vx, vy = rng.choice([0.0, 1.0]) * rng.uniform(-14, 14), rng.uniform(-14, 14)
        rows.append((x, y, heading, vx, vy, length, width))
    ids = tuple(f"V{number}" for number in range(count))
    return BodyList(ids, np.array(rows, float).reshape(-1, 7))


def scene_at(rng: random.Random, bodies: BodyList) -> Scene:
    way = rng.choice(all_routes())
    s = rng.uniform(-30.0, 260.0)
    x, y = way.point(s)
    speed = rng.choice([0.0, rng.uniform(0.0, 15.0)])
    return Scene(way, s, x + rng.gauss(0, 2), y + rng.gauss(0, 2), speed, 100.0, way.exit, bodies)


@pytest.mark.parametrize("turning", [True, False])
def test_it_is_the_least_of_all_separations_bit_by_bit(turning: bool) -> None:
    rng = random.Random(5)
    found = 0
    for _ in range(400):
        bodies = drawn(rng, rng.randrange(9))
        predictor = Predictor(2.0, 0.25)
        if turning:
            predictor.observe(0, drawn(rng, 9))
        predictor.observe(1, bodies)
        scene, acceleration = scene_at(rng, bodies), rng.uniform(-8.0, 4.0)
        every, within = predictor.separations(scene, [acceleration], 0.1)
        least = every[0].min(axis=0, initial=np.inf)
        got = nearest(predictor, scene, acceleration, 0.1, CAP)
        if least.min(initial=np.inf) > CAP:
            assert got is None or got.separation > CAP
        else:
            found += 1
            assert got == (least.min(), within.ids[int(least.argmin())])
    assert found > 50


def test_of_two_that_come_equally_near_it_names_the_first() -> None:
    twice = np.array([[6.0, 20.0, 0.0, 0.0, 0.0, 5.0, 2.0]] * 2)
    for ids in (("A", "B"), ("B", "A")):
        bodies, way = BodyList(ids, twice.copy()), route(0, "straight")
        predictor = Predictor(2.0, 0.25)
        predictor.observe(0, bodies)
        scene = Scene(way, 90.0, *way.point(90.0), SPEED_LIMIT, 100.0, way.exit, bodies)
        got = nearest(predictor, scene, 0.0, 0.1, CAP)
        assert got is not None
        assert got.body == ids[0]


@pytest.mark.parametrize("way", all_routes(), ids=lambda way: f"{way.origin}-{way.turn}")
def test_a_point_of_a_route_is_that_of_all_points(way: object) -> None:
    s = np.linspace(-20.0, 260.0, 97)
    points = way.points(s).tolist()  # type: ignore[attr-defined]
    assert [list(way.point(one)) for one in s.tolist()] == points  # type: ignore[attr-defined]
    assert [list(one) for one in way.trail(s.tolist())] == points  # type: ignore[attr-defined]
