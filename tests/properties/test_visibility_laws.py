"""Laws of visibility: who sees is seen, and who stands behind another one is hidden."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from roads import begin, bodies_at, car

from pytest_dura.driving import Body, BodyList
from pytest_dura.driving.bodies import HEADING, LENGTH, WIDTH, X, Y
from pytest_dura.driving.prediction import Predictor
from pytest_dura.driving.scene import Scene
from pytest_dura.driving.visibility import is_seen, visible

laws = settings(derandomize=True, deadline=None, max_examples=100)

places = st.floats(-40.0, 40.0)
headings = st.floats(-math.pi, math.pi)
sizes = st.sampled_from([(5.0, 2.0), (0.6, 0.6), (60.0, 1.6), (1.8, 0.6), (6.0, 1.0)])
bodies = st.tuples(places, places, headings, sizes)


def boxes_of(several: list[tuple[float, float, float, tuple[float, float]]]) -> np.ndarray:
    return np.array([(x, y, heading, *size) for x, y, heading, size in several])


def seen_by(viewer: Body, others: list[Body]) -> tuple[str, ...]:
    box = BodyList.of([viewer]).data[0, [X, Y, HEADING, LENGTH, WIDTH]]
    return visible(box, BodyList.of(others)).ids


@laws
@given(bodies, bodies, st.lists(bodies, max_size=4))
def test_who_sees_is_seen(one: tuple, other: tuple, between: list) -> None:
    first, second = boxes_of([other, *between]), boxes_of([one, *between])
    hiding = np.array([False, *(min(size) >= 1.5 for *_, size in between)])
    there = is_seen(boxes_of([one])[0], first, 0, hiding)
    back = is_seen(boxes_of([other])[0], second, 0, hiding)
    assert there == back


@laws
@given(headings, st.floats(6.0, 20.0), st.floats(4.0, 20.0), st.floats(-0.3, 0.3))
def test_a_walker_behind_a_car_is_hidden_and_one_beside_it_is_not(
    course: float, ahead: float, behind: float, aside: float
) -> None:
    """The car stands across the line of sight, so that its length hides all of the walker."""

    def at(along: float, across: float) -> tuple[float, float]:
        c, s = math.cos(course), math.sin(course)
        return c * along - s * across, s * along + c * across

    viewer = car("EGO", 0.0, 0.0, course)
    parked = car("V1", *at(ahead, 0.0), course + math.pi / 2, length=12.0)
    hidden = Body("P1", *at(ahead + behind, aside), course, 0.0, 0.0, 0.6, 0.6)
    beside = Body("P2", *at(ahead, 9.0 + aside), course, 0.0, 0.0, 0.6, 0.6)
    assert seen_by(viewer, [parked, hidden, beside]) == ("V1", "P2")
    low = Body("V1", *at(ahead, 0.0), course + math.pi / 2, 0.0, 0.0, 12.0, 1.0)
    assert seen_by(viewer, [low, hidden, beside]) == ("V1", "P1", "P2")


VAN = {"id": "VAN", "kind": "parked_van", "offset": 40.0, "beside": 5.3}
WALKER = {"id": "P1", "offset": 36.2, "start": 20.0}


def test_a_world_hides_bodies_from_lidar_and_radar_alone_where_it_says_so() -> None:
    world = {"ego": {"distance": 80.0}, "obstacles": [VAN], "pedestrians": [WALKER]}
    for occlusion, seen in ((False, ("P1", "VAN")), (True, ("VAN",))):
        _, (tick,) = begin(world | {"occlusion": occlusion})
        assert bodies_at(tick).ids == ("P1", "VAN")
        assert tick.channels["lidar"].ids == seen
        assert len(tick.channels["radar"]) == len(seen)


@laws
@given(st.floats(30.0, 70.0), st.floats(5.4, 12.0), st.floats(20.0, 60.0))
def test_a_hedge_hides_as_one_body_and_is_on_nobodys_way(
    offset: float, beside: float, distance: float
) -> None:
    """In parts: three discs that cover 60 m in one piece would reach 9 m beside it."""
    hedge = {"id": "HEDGE", "kind": "hedge", "offset": offset, "beside": beside + 2.0}
    world = {"ego": {"distance": distance, "speed": 9.0}, "obstacles": [hedge], "occlusion": True}
    _, (tick,) = begin(world)
    parts = bodies_at(tick)
    assert parts.ids == ("HEDGE", "HEDGE.2", "HEDGE.3")
    lengths = parts.data[:, LENGTH]
    assert math.isclose(lengths.sum(), 60.0)
    reach = np.hypot(parts.data[:, X] - parts.data[0, X], parts.data[:, Y] - parts.data[0, Y])
    assert np.allclose(reach, [0.0, 20.0, 40.0])
    predictor, scene = Predictor(4.0, 0.1), Scene.of(tick.channels)
    predictor.observe(0, scene.bodies)
    apart, _ = predictor.separations(scene, (0.0,), 0.1)
    assert apart.size == 0 or apart.min() > 0.3
