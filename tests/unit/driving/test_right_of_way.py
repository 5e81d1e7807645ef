"""What the ego's entry into the junction demands of cars with priority."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from roads import always, car_on, drive

from pytest_dura.core import Tick
from pytest_dura.driving import ARM_LENGTH, BodyList, Command, Maneuver, conflict, route
from pytest_dura.driving.traffic_rules import BRAKING_CAP, CAP, demanded_braking, right_of_way


def crossing(
    away: float, *, arm: str = "west", turn: str = "straight", act: Any = None, **ego: Any
) -> dict[str, Any]:
    """Signals of an ego 20 m before its line at 8 m/s that meets one car."""
    other = {"id": "OTHER", "arm": arm, "turn": turn, "distance": away, "speed": 8.0}
    start = {"distance": 22.5, "speed": 8.0, **ego}
    world = {"ego": start, "vehicles": [other], "courtesy": "none"}
    act = act or always("proceed", 0.0)
    simulator, ticks = drive(world, 120, act)
    return simulator.signals(ticks)


def test_a_car_that_comes_in_time_need_not_brake() -> None:
    assert demanded_braking(40.0, 8.0, 3.0) == 0.0


def test_the_braking_brings_the_car_a_second_behind_the_ego() -> None:
    # 20 m at 8 m/s while the ego needs 2 s: 16.8 m are left for the 2.6 s after the reaction.
    braking = demanded_braking(20.0, 8.0, 2.0)
    assert 8.0 * 0.4 + 8.0 * 2.6 - braking * 2.6**2 / 2 == pytest.approx(20.0)


def test_a_car_that_would_stand_before_that_stops_before_the_conflict() -> None:
    braking = demanded_braking(20.0, 8.0, math.inf)
    assert 8.0 * 0.4 + 8.0**2 / (2 * braking) == pytest.approx(20.0)
    assert demanded_braking(20.0, 8.0, 100.0) == pytest.approx(braking)


@pytest.mark.parametrize("left", [2.0, 3.5, 3.7, 5.7, 7.5, 20.0])
def test_under_the_demanded_braking_the_car_keeps_off_and_under_less_it_does_not(
    left: float,
) -> None:
    def arrives(braking: float) -> float:
        """Metres that the car drives until a second after the ego has left; 20 m are there."""
        time = min(left + 0.6, 8.0 / braking)
        return 8.0 * 0.4 + 8.0 * time - braking * time**2 / 2

    braking = demanded_braking(20.0, 8.0, left)
    assert arrives(braking) <= 20.0 + 1e-9
    assert arrives(0.999 * braking) > 20.0


def test_who_cannot_stop_any_more_is_asked_for_the_cap() -> None:
    assert demanded_braking(3.0, 8.0, 2.0) == BRAKING_CAP
    assert demanded_braking(4.0, 8.0, 20.0) == BRAKING_CAP


def test_entering_close_before_a_car_with_priority_demands_hard_braking() -> None:
    found = crossing(33.0)
    assert found["priority_braking"].max() > 3.0
    assert found["gap_time"].min() < 1.0
    begins = int(np.argmax(found["priority_braking"] > 0.0))
    assert found["in_conflict_zone"][begins] == 1.0
    assert found["in_conflict_zone"][begins - 1] == 0.0


@pytest.mark.parametrize("distance", [10.0, 75.0], ids=["behind it", "long before it"])
def test_passing_behind_or_long_before_demands_nothing(distance: float) -> None:
    found = crossing(distance)
    assert found["priority_braking"].max() == 0.0
    assert not found["collided"].any()
    assert found["priority_arrival"].min() < CAP, "it was there all the same"


def test_a_car_without_priority_is_owed_nothing() -> None:
    for found in (crossing(33.0, arm="north"), crossing(33.0, arm="north", turn="left")):
        assert found["priority_braking"].max() == 0.0
        assert found["priority_arrival"].min() == CAP


def test_a_car_that_turns_off_before_the_ego_is_owed_nothing() -> None:
    assert crossing(33.0, turn="right")["priority_arrival"].min() == CAP


def test_merging_before_a_car_counts_and_driving_on_before_it_does_not() -> None:
    close, far = crossing(37.0, turn="left"), crossing(60.0, turn="left")
    assert close["priority_braking"].max() > 3.0
    assert far["priority_braking"].max() == 0.0
    last = int(np.flatnonzero(close["priority_braking"])[-1])
    assert close["cleared"][last] == 0.0, "behind the merging point it is following"


def stop_inside(tick: Tick) -> Command:
    """Into the junction, and stand there."""
    return Command(Maneuver.EMERGENCY_BRAKE if tick.truth["ego"].s > 106.0 else Maneuver.PROCEED)


def test_standing_in_the_way_demands_a_stop() -> None:
    found = crossing(60.0, act=stop_inside)
    assert found["gap_time"].min() == -CAP
    assert found["priority_braking"].max() > 0.5


def wait_inside(tick: Tick) -> Command:
    """Past the line, stand before the lane of the others, and go when the car is near."""
    ego, other = tick.truth["ego"], tick.truth["bodies"].get("OTHER")
    if other.x > -27.0:
        return Command(Maneuver.ACCELERATE)
    stop = ego.s > 99.0
    return Command(Maneuver.EMERGENCY_BRAKE if stop else Maneuver.PROCEED_CAUTIOUSLY)


def test_who_waits_inside_and_then_goes_is_judged_when_it_goes() -> None:
    found = crossing(75.0, act=wait_inside, speed=5.0)
    assert ((found["speed"] < 0.1) & (found["in_conflict_zone"] > 0)).any()
    assert found["priority_braking"].max() > 3.0


def test_arrival_counts_down_while_the_ego_has_to_decide() -> None:
    found = crossing(50.0, distance=60.0)["priority_arrival"]
    assert found[0] == CAP, "the ego is still far from its line"
    begins = int(np.argmax(found < CAP))
    assert found[begins + 1] < found[begins] < 6.5


@pytest.mark.parametrize("behind", [0.4, 1.3, 3.0, -0.6])
def test_the_gap_time_is_from_when_the_ego_has_left_to_when_the_other_arrives(
    behind: float,
) -> None:
    mine, theirs, dt, speed = route(0, "straight"), route(1, "straight"), 0.1, 8.0
    meeting = conflict(mine, theirs)
    assert meeting is not None
    _, ends, other_begins, _ = meeting
    s = 80.0 + speed * dt * np.arange(80)
    line, left = (int(np.argmax(s + half > at)) for half, at in ((2.5, ARM_LENGTH), (-2.5, ends)))
    arrives = left * dt + behind
    other = other_begins - 2.5 - speed * (arrives - dt * np.arange(80))
    bodies = [BodyList.of([car_on(1, "straight", float(at), speed)]) for at in other]
    found = right_of_way(mine, s, np.full(80, speed), bodies, [(theirs.number,)] * 80, dt=dt)
    assert found.gap_time[line:left] == pytest.approx(behind)
    assert (found.gap_time[:line] == CAP).all()
    assert (found.gap_time[left:] == CAP).all()
    assert (found.braking[line:left] > 0.0).all() == (behind < 1.0)
    assert not found.braking[:line].any()
    assert not found.braking[left:].any()


def test_of_a_car_that_stands_nothing_is_demanded() -> None:
    mine, theirs = route(0, "straight"), route(1, "straight")
    meeting = conflict(mine, theirs)
    assert meeting is not None
    s = 80.0 + 0.8 * np.arange(80)
    for speed, demanded in ((0.0, False), (0.4, False), (8.0, True)):
        bodies = [BodyList.of([car_on(1, "straight", meeting[2] - 4.5, speed)])] * 80
        found = right_of_way(mine, s, np.full(80, 8.0), bodies, [(theirs.number,)] * 80, dt=0.1)
        assert bool(found.braking.any()) == demanded
        assert bool((found.gap_time < CAP).any()) == demanded
        assert bool((found.arrival < CAP).any()) == demanded
