"""The quick road against highway-env's own: the same lanes, the same angles, the same episodes."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from published_road import network, published_road

from pytest_dura.core import Orchestrator, Policy, RoleSpec
from pytest_dura.driving import FOUR_WAY
from pytest_dura.driving.highway import _network
from pytest_dura.library import expand_cases, load_library

PUBLISHED = network()
LANES = PUBLISHED.lanes_dict()
POINTS = st.floats(-130.0, 130.0)
HEADINGS = st.floats(-10.0, 10.0)
NUDGES = st.sampled_from([0.0, 1e-15, -1e-15, 1e-9, -1e-9, 1e-6, -1e-6, 0.01, -0.01])


@st.composite
def critical_places(draw):
    """Beside a lane, its ends included, and nearly along it: where lanes meet and part."""
    lane = LANES[draw(st.sampled_from(sorted(LANES)))]
    s = draw(st.sampled_from([0.0, 0.5, 1.0, -0.1, 1.1])) * lane.length + draw(NUDGES)
    position = lane.position(s, draw(st.sampled_from([0.0, 2.0, -2.0, 3.0])) + draw(NUDGES))
    return *position.tolist(), float(lane.heading_at(s)) + draw(NUDGES)


@st.composite
def places_opposite_to_an_arc(draw):
    """On the ray from an arc's centre where the way along it jumps from one end to the other."""
    arcs = [index for index, lane in sorted(LANES.items()) if hasattr(lane, "radius")]
    lane = LANES[draw(st.sampled_from(arcs))]
    angle = lane.start_phase + math.pi + draw(NUDGES)
    radius = draw(st.sampled_from([0.0, 1.0, 0.9, 2.0])) * lane.radius
    x, y = (lane.center + radius * np.array([math.cos(angle), math.sin(angle)])).tolist()
    return x, y, draw(HEADINGS)


PLACES = st.one_of(
    st.tuples(POINTS, POINTS, HEADINGS), critical_places(), places_opposite_to_an_arc()
)


@given(place=PLACES)
@example(place=(0.0, 0.0, 0.0))
@settings(derandomize=True, deadline=None, max_examples=600)
def test_the_nearest_lane_is_highway_env_s(place) -> None:
    x, y, heading = place
    position = np.array([x, y])
    expected = PUBLISHED.get_closest_lane_index(position, heading)
    assert _network(FOUR_WAY).get_closest_lane_index(position, heading) == expected
    unheaded = PUBLISHED.get_closest_lane_index(position)
    assert _network(FOUR_WAY).get_closest_lane_index(position) == unheaded


@pytest.mark.parametrize("x", [math.nan, math.inf, -math.inf])
def test_a_place_that_is_none_is_left_to_highway_env(x) -> None:
    position = np.array([x, 3.0])
    with np.errstate(invalid="ignore"):
        expected = PUBLISHED.get_closest_lane_index(position, 0.1)
        assert _network(FOUR_WAY).get_closest_lane_index(position, 0.1) == expected


def test_highway_env_is_rarely_asked() -> None:
    places = np.random.default_rng(4).uniform((-60, -60, -4), (60, 60, 4), (2000, 3)).tolist()
    assert sum(_network(FOUR_WAY)._nearest(*place) is None for place in places) == 0


@given(place=PLACES, margin=st.sampled_from([0.0, 1.0]))
@settings(derandomize=True, deadline=None, max_examples=200)
def test_a_lane_that_may_not_hold_a_place_does_not(place, margin) -> None:
    x, y, _ = place
    for index, lane in LANES.items():
        on = bool(lane.on_lane(np.array([x, y]), margin=margin))
        assert _network(FOUR_WAY).may_hold(index, x, y, margin) or not on


def test_a_lane_of_another_kind_is_refused() -> None:
    from highway_env.road.lane import SineLane
    from highway_env.road.road import RoadNetwork

    from pytest_dura.driving.traffic import LaneNetwork

    winding = RoadNetwork()
    winding.add_lane("a", "b", SineLane([0, 0], [50, 0], 1.0, 0.1, 0.0))
    with pytest.raises(TypeError, match="SineLane"):
        LaneNetwork(winding)


@given(
    place=critical_places(),
    speed=st.one_of(st.floats(-3.0, 15.0), st.sampled_from([0.0, -0.0, 1e-3, 0.01, 0.5])),
    lane=st.sampled_from(sorted(LANES)),
)
@settings(derandomize=True, deadline=None, max_examples=300)
def test_the_steering_angle_is_highway_env_s_to_the_last_bit(place, speed, lane) -> None:
    from highway_env.vehicle.controller import ControlledVehicle

    from pytest_dura.driving import Ego
    from pytest_dura.driving.traffic import JunctionRoad

    x, y, heading = place
    ego = Ego(JunctionRoad(_network(FOUR_WAY)), [x, y], heading=heading, speed=speed)
    assert ego.steering_control(lane) == ControlledVehicle.steering_control(ego, lane)


def test_episodes_are_the_same_on_highway_env_s_own_road() -> None:
    planner = RoleSpec("pytest_dura.driving.roles.planners:Aggressive")
    endings = set()
    for case in expand_cases(load_library([]).scenarios):
        spec = case.spec(1, base_seed=5)
        roles = {**spec.roles, "generator": planner}
        spec = replace(spec, roles=roles, policy=Policy("log_only"))
        quick = Orchestrator.build(spec).run(spec)
        with published_road():
            published = Orchestrator.build(spec).run(spec)
        assert quick.digest == published.digest
        endings.add(quick.termination)
    assert endings == {"critical", "goal"}
