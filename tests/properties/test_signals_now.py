"""The signals of one percept against the columns, and routes point by point against arrays."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from pytest_dura.core import Percept
from pytest_dura.driving import (
    PERCEPT_NAMES,
    Body,
    BodyList,
    Odometry,
    Pose,
    all_routes,
    percept_at,
    percept_signals,
    route,
    route_map,
)
from pytest_dura.driving.traffic_rules import SAME_DIRECTION

places = st.floats(-60.0, 60.0)
angles = st.sampled_from([0.0, math.pi / 2, math.pi, -math.pi / 2]) | st.floats(-4.0, 4.0)
sizes = st.sampled_from([(5.0, 2.0), (0.6, 0.6), (12.0, 2.5)])
bodies = st.lists(
    st.tuples(places, places, angles, st.floats(-12.0, 12.0), st.floats(-12.0, 12.0), sizes),
    max_size=6,
)
ahead = st.tuples(st.floats(-20.0, 60.0), st.floats(-3.0, 3.0), st.floats(-1.2, 1.2), sizes)


@st.composite
def percepts(draw: Any) -> Percept:
    way = route(draw(st.integers(0, 3)), draw(st.sampled_from(["left", "straight", "right"])))
    s, speed = draw(st.floats(40.0, 130.0)), draw(st.floats(0.0, 12.0))
    x, y, heading = (float(value) for value in way.pose(s))
    listed = [Body(f"V{i}", *one[:5], *one[5]) for i, one in enumerate(draw(bodies))]
    for further, aside, turned, size in draw(st.lists(ahead, max_size=2)):
        px, py, path = (float(value) for value in way.pose(s + further))
        px, py = px - aside * math.sin(path), py + aside * math.cos(path)
        listed.append(Body(f"A{len(listed)}", px, py, path + turned, 3.0, -2.0, *size))
    return Percept({
        "localisation": Pose(x + draw(st.floats(-1.0, 1.0)), y, heading),
        "odometry": Odometry(speed),
        "map": route_map(way),
        "lidar": BodyList.of(listed),
    })  # fmt: skip


@settings(derandomize=True, deadline=None, max_examples=300)
@given(percepts())
def test_one_percept_gives_what_the_columns_hold(percept: Percept) -> None:
    way = percept["map"].route
    for body in percept["lidar"]:
        turned = body.heading - way.heading_at(way.project(body.x, body.y)[0])
        # At the very angle that parts leaders from others, rounding decides.
        assume(abs(math.cos(turned) - SAME_DIRECTION) > 1e-9)
    columns = percept_signals([percept, percept])
    assert tuple(columns) == PERCEPT_NAMES
    expected = {name: float(column[1]) for name, column in columns.items()}
    assert percept_at(percept) == pytest.approx(expected, abs=1e-9)


@settings(derandomize=True, deadline=None, max_examples=100)
@given(st.lists(st.tuples(places, places), min_size=1, max_size=5))
def test_many_points_are_projected_as_one(points: Any) -> None:
    for way in all_routes():
        s, lateral, heading = way.project_all(np.array(points))
        for i, point in enumerate(points):
            assert (s[i], lateral[i]) == pytest.approx(way.project(*point), abs=1e-9)
            assert heading[i] == pytest.approx(way.heading_at(s[i]), abs=1e-9)


def test_the_heading_of_a_route_is_that_of_its_poses() -> None:
    for way in all_routes():
        for s in np.linspace(80.0, 140.0, 25):
            assert way.heading_at(s) == pytest.approx(float(way.pose(s)[2]), abs=0.01)


def test_routes_are_numbered_as_they_are_listed() -> None:
    assert [way.number for way in all_routes()] == list(range(12))
