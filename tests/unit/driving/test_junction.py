"""Routes against highway-env's own lanes, and where they conflict."""

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

from pytest_dura.driving import ARM_LENGTH, Route, all_routes, conflict, route

ROUTES = all_routes()


@pytest.fixture(scope="module")
def network() -> Any:
    settings = {"show_trajectories": False, "neighbour_vehicles_connected_lanes": False}
    stage = SimpleNamespace(np_random=None, config=settings, road=None)
    IntersectionEnv._make_road(stage)
    return stage.road.network


def lanes_of(network: Any, way: Route) -> list[Any]:
    a, b = way.origin, way.destination
    names = [f"o{a}", f"ir{a}", f"il{b}", f"o{b}"]
    return [network.get_lane((x, y, 0)) for x, y in itertools.pairwise(names)]


def lane_pose(lanes: list[Any], s: float) -> tuple[float, float, float]:
    for lane in lanes[:-1]:
        if s <= lane.length:
            break
        s -= lane.length
    else:
        lane = lanes[-1]
    x, y = lane.position(s, 0.0)
    return float(x), float(y), float(lane.heading_at(s))


@pytest.mark.parametrize("way", ROUTES, ids=str)
def test_a_route_is_highway_env_s_lanes(network: Any, way: Route) -> None:
    lanes = lanes_of(network, way)
    assert sum(lane.length for lane in lanes) == pytest.approx(way.length)
    for s in np.linspace(0.0, way.length, 371):
        x, y, heading = lane_pose(lanes, s)
        mine = way.pose(s)
        # The grid's chords of half a metre leave the arc by at most 4 mm.
        assert math.hypot(mine[0] - x, mine[1] - y) < 0.005
        assert abs(math.remainder(mine[2] - heading, 2 * math.pi)) < 0.03


@pytest.mark.parametrize("way", ROUTES, ids=str)
def test_priorities_are_highway_env_s(network: Any, way: Route) -> None:
    approach, inside, _ = lanes_of(network, way)
    assert way.priority == inside.priority
    assert way.priority == approach.priority - (way.turn == "left")


@pytest.mark.parametrize("way", ROUTES, ids=str)
def test_project_is_the_inverse_of_pose(way: Route) -> None:
    for s in np.linspace(0.0, way.length, 203):
        x, y, heading = (float(value) for value in way.pose(s))
        found, lateral = way.project(x, y)
        assert found == pytest.approx(s, abs=0.02)
        assert lateral == pytest.approx(0.0, abs=0.005)
        # One metre to the right, which is clockwise since y points south.
        found, lateral = way.project(x - math.sin(heading), y + math.cos(heading))
        assert lateral == pytest.approx(1.0, abs=0.01)
        assert found == pytest.approx(s, abs=0.15)


def test_the_arms_and_turns_lead_where_a_driver_expects() -> None:
    from_south = {way.turn: way.destination for way in ROUTES if way.origin == 0}
    assert from_south == {"left": 1, "straight": 2, "right": 3}
    x, y, heading = (float(value) for value in route(0, "straight").pose(0.0))
    assert (x, y) == pytest.approx((2.0, 111.0))
    assert math.cos(heading) == pytest.approx(0.0, abs=1e-12)
    assert math.sin(heading) == pytest.approx(-1.0)


def test_conflict_is_symmetric() -> None:
    for one in ROUTES:
        for other in ROUTES:
            there, back = conflict(one, other), conflict(other, one)
            if there is None:
                assert back is None
            else:
                assert back == (*there[2:], *there[:2])


def test_conflicts_lie_where_the_lanes_come_near_each_other() -> None:
    for one in ROUTES:
        for other in ROUTES:
            if one.origin == other.origin:
                assert conflict(one, other) is None
                continue
            s = np.linspace(ARM_LENGTH, one.exit, 400)
            t = np.linspace(ARM_LENGTH, other.exit, 400)
            a, b = np.stack(one.pose(s)[:2]), np.stack(other.pose(t)[:2])
            least = np.hypot(*(a[:, :, None] - b[:, None, :])).min()
            found = conflict(one, other)
            if found is None:
                assert least > 2.9
            else:
                assert least < 3.1 or one.destination == other.destination
                assert ARM_LENGTH <= found[0] <= found[1] <= one.exit + 5.0


def test_opposite_straight_routes_do_not_conflict_and_crossing_ones_do() -> None:
    assert conflict(route(0, "straight"), route(2, "straight")) is None
    assert conflict(route(0, "right"), route(2, "right")) is None
    crossing = conflict(route(0, "straight"), route(1, "straight"))
    assert crossing is not None
    # The near lane of the east-west road lies 2 m south of the centre: 9 m behind the line.
    assert crossing[0] < ARM_LENGTH + 9.0 < crossing[1]
    far = conflict(route(0, "straight"), route(3, "straight"))
    assert far is not None
    assert far[0] < ARM_LENGTH + 13.0 < far[1]


def test_copies_of_a_route_are_the_route() -> None:
    way = route(2, "left")
    assert copy.deepcopy(way) is way
    assert pickle.loads(pickle.dumps(way)) is way
    assert not way.grid.flags.writeable
