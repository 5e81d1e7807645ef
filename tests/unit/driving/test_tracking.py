"""Bodies, tracking and predictions, which the roles rest on."""

from __future__ import annotations

import math

import numpy as np
import pytest
from roads import car, car_on, channels_of, walker

from pytest_dura.driving import NO_BODIES, Body, BodyList, Scene, box_gap, prediction, route
from pytest_dura.driving.percepts import CrossCheck, compare_sensors, with_unexplained_returns
from pytest_dura.driving.roles.security import Tracker
from pytest_dura.driving.scene import crossing, time_to_cover

A, B, P = car("A", 1.0, 2.0, 0.5, 3.0), car("B", 4.0, 5.0), walker("P1", 0.0, 0.0, 1.0)


def test_a_body_list_is_a_sequence_of_bodies() -> None:
    bodies = BodyList.of([A, B, P])
    assert list(bodies) == [A, B, P]
    assert bodies[1] == B
    assert list(bodies[1:]) == [B, P]
    assert bodies.get("P1") == P
    assert bodies.get("nobody") is None
    assert [body.is_pedestrian for body in bodies] == [False, False, True]
    assert bodies == BodyList.of([A, B, P])
    assert bodies != BodyList.of([B, A, P])
    assert len(NO_BODIES) == len(BodyList.of([])) == 0


def test_a_body_is_added_or_replaced_in_its_place() -> None:
    bodies = BodyList.of([A, B])
    assert list(bodies.with_body(P)) == [A, B, P]
    elsewhere = A._replace(x=99.0)
    assert list(bodies.with_body(elsewhere)) == [elsewhere, B]
    assert list(bodies) == [A, B], "the list itself is unchanged"
    assert list(NO_BODIES.with_body(A)) == [A]


def test_a_tracker_matches_by_id() -> None:
    tracker = Tracker()
    tracker.update(0, BodyList.of([A, B]))
    assert tracker.newcomers() == []
    tracker.update(1, BodyList.of([P, B._replace(x=5.5), A._replace(heading=0.6)]))
    assert tracker.newcomers() == [0]
    assert tracker.displacements() == [(1, 1.5, 0.0), (2, 0.0, 0.0)]


def test_a_tracker_takes_a_tick_once() -> None:
    tracker = Tracker()
    tracker.update(0, BodyList.of([A]))
    tracker.update(1, BodyList.of([A, B]))
    tracker.update(1, BodyList.of([P]))
    assert tracker.newcomers() == [1]
    tracker.reset()
    tracker.update(0, BodyList.of([B]))
    assert tracker.newcomers() == []


@pytest.mark.parametrize("turned,rate", [(0.04, 0.4), (-0.04, -0.4), (0.5, 1.0), (0.0, 0.0)])
def test_a_predictor_turns_what_turns_the_short_way_round(turned: float, rate: float) -> None:
    """A body at (0, 20) that drives at 5 m/s; the last percept shows its heading past pi."""
    before = Body("V1", 0.0, 20.0, math.pi - 0.01, -5.0, 0.0, 5.0, 2.0)
    after = before._replace(heading=(before.heading + turned + math.pi) % (2 * math.pi) - math.pi)
    scene = Scene(route(0, "straight"), 80.0, 2.0, 31.0, 5.0, 100.0, 122.0, BodyList.of([after]))
    predictor = prediction.Predictor(2.0, 0.5)
    predictor.observe(0, BodyList.of([before]))
    predictor.observe(1, scene.bodies)
    predictor.observe(1, NO_BODIES)  # a tick counts once
    apart, near = predictor.separations(scene, [0.0, -8.0], 0.1)
    assert near.ids == ("V1",)
    driven = prediction.advance(5.0, [0.0, -8.0], predictor.times.tolist(), 10.0)
    expected = prediction.separations(
        prediction.ego_discs(scene.route, scene.s + driven),
        prediction.moving(scene.bodies, predictor.times, np.array([rate])),
        prediction.radii(scene.bodies),
    )
    assert apart == pytest.approx(expected)


def test_a_predictor_leaves_out_who_is_out_of_reach() -> None:
    far = Body("V2", -90.0, 2.0, 0.0, 5.0, 0.0, 5.0, 2.0)
    scene = Scene(route(0, "straight"), 80.0, 2.0, 31.0, 5.0, 100.0, 122.0, BodyList.of([far]))
    predictor = prediction.Predictor(2.0, 0.5)
    predictor.observe(0, scene.bodies)
    apart, near = predictor.separations(scene, [0.0], 0.1)
    assert apart.shape == (1, 4, 0)
    assert near.ids == ()


def test_the_ego_s_advance_is_that_of_small_steps() -> None:
    accelerations = np.array([3.5, 0.0, -3.0, -8.0])
    times = np.array([0.5, 1.0, 2.0, 3.0])
    for speed in (0.0, 4.0, 9.9):
        found = prediction.advance(speed, accelerations, times, 10.0)
        for i, a in enumerate(accelerations):
            s, v, dt = 0.0, speed, 1e-3
            steps = {}
            for k in range(1, 3001):
                new = min(max(v + a * dt, 0.0), 10.0)
                s += (v + new) / 2 * dt
                v = new
                steps[k] = s
            expected = [steps[round(t / dt)] for t in times]
            assert found[i] == pytest.approx(expected, abs=0.01)


def test_moving_bodies_keep_their_speed_and_turn() -> None:
    bodies = BodyList.of([car("A", 0.0, 0.0, 0.0, 5.0)])
    straight = prediction.moving(bodies, np.array([2.0]))
    assert straight[0, 0, 1] == pytest.approx([10.0, 0.0])
    turned = prediction.moving(bodies, np.array([1.0]), np.array([0.4]))
    radius = 5.0 / 0.4
    arc = [radius * math.sin(0.4), radius * (1 - math.cos(0.4))]
    assert turned[0, 0, 1] == pytest.approx(arc, abs=0.05)


def test_predicted_separation_is_never_more_than_the_gap() -> None:
    rng = np.random.default_rng(5)
    way = route(0, "straight")
    for _ in range(200):
        s = float(rng.uniform(40, 150))
        other = car("A", *rng.uniform(-15, 15, 2), float(rng.uniform(-4, 4)), 0.0)
        bodies = BodyList.of([other])
        ego = prediction.ego_discs(way, np.array([[s]]))
        discs = prediction.moving(bodies, np.zeros(1))
        apart = float(prediction.separations(ego, discs, prediction.radii(bodies))[0, 0, 0])
        x, y, heading = (float(value) for value in way.pose(s))
        mine = np.array([[x, y, heading, 5.0, 2.0]])
        box = np.array([[other.x, other.y, other.heading, 5.0, 2.0]])
        gap = float(box_gap(mine, box)[0])
        assert apart <= gap + 1e-9, "discs cover the boxes: it errs to the safe side"
        assert apart >= gap - 2.6 or gap == 0.0


def test_who_cannot_be_reached_is_left_out() -> None:
    bodies = BodyList.of([car("NEAR", 10.0, 0.0), car("FAR", 200.0, 0.0)])
    assert [bodies.ids[row] for row in prediction.near(bodies, 0.0, 0.0, 8.0, 2.0)] == ["NEAR"]


def test_radar_and_lidar_are_compared_by_place_and_rate() -> None:
    seen = car("V1", 2.0, 40.0, -math.pi / 2, 5.0)
    confirmed, explained = compare_sensors(channels_of(seen))
    assert confirmed.all()
    assert explained.all()
    confirmed, explained = compare_sensors(channels_of(seen, radar=[]))
    assert confirmed.tolist() == [False]
    assert explained.shape == (0,)
    confirmed, explained = compare_sensors(channels_of(radar=[seen]))
    assert explained.tolist() == [False]
    confirmed, explained = compare_sensors(channels_of(seen, radar=[B, seen]))
    assert confirmed.tolist() == [True]
    assert explained.tolist() == [False, True]


def test_what_radar_alone_reports_becomes_a_car_where_it_is() -> None:
    coming = car_on(1, "straight", 70.0, 8.0)
    bodies = with_unexplained_returns(channels_of(A, radar=[A, coming]))
    assert bodies.ids[0] == "A"
    (found,) = bodies[1:]
    assert (found.x, found.y) == pytest.approx((coming.x, coming.y))
    assert found.vx > 5.0, "on the crossing road it is taken to drive on its lane"
    standing = with_unexplained_returns(channels_of(radar=[car("S", 2.0, 30.0)]))[0]
    assert standing.vx == standing.vy == 0.0
    percept = channels_of(A)
    assert with_unexplained_returns(percept) is percept["lidar"]


def test_a_scene_knows_where_the_ego_is() -> None:
    scene = Scene.of(channels_of(s=90.0, speed=7.0))
    assert (scene.s, scene.to_stop_line, scene.speed) == pytest.approx((90.0, 7.5, 7.0))
    assert not scene.entered
    assert Scene.of(channels_of(s=98.0)).entered
    assert not Scene.of(channels_of(s=124.0)).cleared
    assert Scene.of(channels_of(s=125.0)).cleared


def test_the_leader_is_the_nearest_on_the_path() -> None:
    ahead = car("NEAR", 2.0, 45.0, -math.pi / 2, 4.0)
    others = [
        car("FARTHER", 2.0, 30.0, -math.pi / 2, 4.0),
        car("BEHIND", 2.0, 80.0, -math.pi / 2, 4.0),
        car("ONCOMING", -2.0, 50.0, math.pi / 2, 8.0),
        car("CROSSING", 2.0, 52.0, 0.0, 8.0),
    ]
    leader = Scene.of(channels_of(*others, ahead, s=52.0)).leader()
    assert leader is not None
    assert leader.body.id == "NEAR"
    assert leader.distance == pytest.approx(59.0 - 45.0 - 5.0)
    assert leader.speed == pytest.approx(4.0)
    assert Scene.of(channels_of(*others[1:], s=52.0)).leader() is None


def test_crossing_traffic_is_who_has_yet_to_cross_the_ego_s_lane() -> None:
    bodies = [
        car_on(1, "straight", 80.0, 8.0, "WEST"),
        car_on(3, "straight", 80.0, 6.0, "EAST"),
        car_on(1, "straight", 125.0, 8.0, "GONE"),
        car_on(2, "straight", 80.0, 8.0, "NORTH"),
        walker("P1", -10.0, 2.0, 1.0),
    ]
    found = {one.body.id: one for one in crossing(Scene.of(channels_of(*bodies, s=95.0)))}
    assert set(found) == {"WEST", "EAST"}
    assert found["EAST"].speed == pytest.approx(6.0)
    # From the west at x = -31: its front at -28.5, the ego's left side at 1, half a metre spare.
    assert found["WEST"].distance == pytest.approx(29.0)


@pytest.mark.parametrize("distance, speed", [(0.0, 3.0), (5.0, 0.0), (60.0, 4.0), (30.0, 12.0)])
def test_time_to_cover_is_that_of_small_steps(distance: float, speed: float) -> None:
    s, v, t, dt = 0.0, speed, 0.0, 1e-3
    while s < distance:
        new = max(min(v + 2.0 * dt, 10.0), speed if speed > 10.0 else 0.0)
        s += (v + new) / 2 * dt
        v, t = new, t + dt
    assert time_to_cover(distance, speed, 2.0, 10.0) == pytest.approx(t, abs=0.01)


def test_an_object_that_radar_denies_is_not_believed_for_long() -> None:
    ghost, real = car("V9", 2.0, 30.0), car("V1", -2.0, -10.0, math.pi / 2, 8.0)
    check = CrossCheck(confirm=3)
    shown = [check.update(channels_of(ghost, real, radar=[real])).ids for _ in range(4)]
    assert shown == [("V9", "V1")] * 2 + [("V1",)] * 2
    assert check.update(channels_of(ghost, real)).ids == ("V9", "V1"), "confirmed at last"
    assert check.update(channels_of(ghost, real, radar=[real])).ids == ("V9", "V1"), "counted anew"


def test_a_car_on_a_false_course_is_taken_to_be_where_radar_sees_it() -> None:
    real, false = car("V1", -2.0, -10.0, math.pi / 2, 8.0), car("V1", 2.0, 20.0)
    other = car("V2", 40.0, -2.0, math.pi)
    check = CrossCheck(confirm=1)
    (kept, seen) = check.update(channels_of(false, other, radar=[real, other]))
    assert kept.id == "V2"
    assert (seen.x, seen.y) == pytest.approx((-2.0, -10.0))


@pytest.mark.parametrize("radar", [[], [car("R", 30.0, 40.0)]], ids=["silent", "elsewhere"])
def test_a_radar_that_confirms_nothing_denies_nothing(radar: list[Body]) -> None:
    first, second = car("V1", 2.0, 30.0), car("V2", -2.0, -10.0)
    check = CrossCheck(confirm=1)
    for _ in range(5):
        assert check.update(channels_of(first, second, radar=radar)).ids[:2] == ("V1", "V2")
