"""The leader on the ego's path, the safe distance to it, and the grace after a cut-in."""

from __future__ import annotations

import numpy as np
import pytest
from roads import always, car, car_on, drive, walker

from pytest_dura.driving import Body, BodyList, route
from pytest_dura.driving.traffic_rules import (
    CUT_IN_GRACE,
    LEADER_CAP,
    Leaders,
    find_leaders,
    following_margin,
    safe_distance,
)


def leader_of(*bodies: Body, s: float = 50.0, turn: str = "straight") -> tuple[float, float, str]:
    found = find_leaders(route(0, turn), np.array([s]), [BodyList.of(bodies)])
    return float(found.gap[0]), float(found.speed[0]), found.ids[0]


def test_the_leader_is_the_nearest_car_ahead_with_its_speed() -> None:
    far, near = car_on(0, "straight", 80.0, 3.0, "FAR"), car_on(0, "straight", 70.0, 6.0, "NEAR")
    assert leader_of(far, near) == (pytest.approx(15.0), pytest.approx(6.0), "NEAR")


@pytest.mark.parametrize("turn", ["left", "right"])
def test_a_leader_is_found_round_a_bend(turn: str) -> None:
    gap, speed, _ = leader_of(car_on(0, turn, 112.0, 5.0), s=95.0, turn=turn)
    assert gap == pytest.approx(12.0, abs=0.5)
    assert speed == pytest.approx(5.0, abs=0.1)


@pytest.mark.parametrize(
    "other",
    [
        car_on(0, "straight", 40.0, 8.0),  # behind
        car_on(2, "straight", 130.0, 8.0),  # oncoming, on its own lane
        car("V1", 2.0, 30.0, np.pi / 2, 5.0),  # wrong way on the ego's lane
        car("V1", 2.0, 2.0, 0.0, 8.0),  # crosses
        walker("P1", 2.0, 40.0, 0.0, -1.0),  # walks along
        car_on(0, "straight", 110.0, 8.0),  # beyond the cap
    ],
    ids=["behind", "oncoming", "wrong way", "crossing", "pedestrian", "far"],
)
def test_others_are_no_leaders(other: Body) -> None:
    assert leader_of(other) == (LEADER_CAP, 0.0, "")


def test_who_reaches_into_the_lane_is_a_leader() -> None:
    half_in = car("V1", 2.0 + 1.9, 40.0, -np.pi / 2, 5.0)
    beside = car("V1", 2.0 + 2.1, 40.0, -np.pi / 2, 5.0)
    assert leader_of(half_in)[2] == "V1"
    assert leader_of(beside)[2] == ""


def test_the_safe_distance_is_that_of_responsibility_sensitive_safety() -> None:
    speeds, ahead = np.array([8.0, 8.0, 0.0, 2.0]), np.array([8.0, 0.0, 0.0, 10.0])
    braked = np.array([10.0, 10.0, 2.0, 4.0]) ** 2 / (2 * 6.43)
    expected = speeds * 0.5 + 0.5 * 4.0 * 0.25 + braked - ahead**2 / 16.0
    found = safe_distance(speeds, ahead)
    assert found == pytest.approx(np.maximum(expected, 0.0))
    assert found[3] == 0.0, "never negative"
    assert found[0] == pytest.approx(8.28, abs=0.01)


def margins(gaps: list[float], ids: list[str], collided: list[int] | None = None) -> list[float]:
    count = len(gaps)
    found = Leaders(np.array(gaps), np.full(count, 8.0), ids)
    hit = np.zeros(count) if collided is None else np.array(collided, float)
    return following_margin(found, np.full(count, 8.0), hit, 0.1).tolist()


SAFE, UNSAFE = 20.0, 5.0
MARGIN = UNSAFE - 8.276


def test_an_empty_lane_has_the_cap_for_a_margin() -> None:
    assert margins([LEADER_CAP], [""]) == [LEADER_CAP]


def test_a_leader_that_is_approached_gets_no_grace() -> None:
    found = margins([SAFE, UNSAFE], ["V1", "V1"])
    assert found == [pytest.approx(11.724, abs=0.01), pytest.approx(MARGIN, abs=0.01)]


def test_a_cut_in_is_excused_for_the_grace_and_no_longer() -> None:
    count = round(CUT_IN_GRACE / 0.1)
    found = margins([LEADER_CAP] + [UNSAFE] * (count + 2), [""] + ["V1"] * (count + 2))
    assert found[1 : count + 1] == [0.0] * count
    assert found[count + 1 :] == [pytest.approx(MARGIN, abs=0.01)] * 2


def test_the_grace_ends_when_the_distance_was_safe() -> None:
    found = margins([UNSAFE, UNSAFE, SAFE, UNSAFE], ["V1"] * 4)
    assert found[:2] == [0.0, 0.0]
    assert found[3] == pytest.approx(MARGIN, abs=0.01)


def test_a_car_that_is_lost_and_found_gets_no_second_grace() -> None:
    found = margins([UNSAFE, LEADER_CAP, UNSAFE], ["V1", "", "V1"])
    assert found[0] == 0.0
    assert found[2] == pytest.approx(MARGIN, abs=0.01)


def test_a_car_that_another_one_hid_gets_no_second_grace() -> None:
    found = margins([UNSAFE] * 4, ["V1", "V2", "V1", "V2"])
    assert found == [0.0, 0.0, *[pytest.approx(MARGIN, abs=0.01)] * 2]


def test_contact_is_excused_by_nothing() -> None:
    assert margins([UNSAFE, 0.0], ["V1", "V1"], [0, 1])[1] < -8.0


def test_in_the_simulator_who_does_not_mind_a_braking_leader_loses_its_margin() -> None:
    leader = {"id": "LEADER", "arm": "south", "distance": 40.0, "speed": 8.0}
    crossing = {"id": "WEST", "arm": "west", "distance": 60.0, "speed": 8.0}
    world = {"ego": {"distance": 70.0, "speed": 8.0}, "vehicles": [leader, crossing]}
    simulator, ticks = drive(world, 60, always("accelerate"))
    found = simulator.signals(ticks)
    assert found["leader_gap"][0] == pytest.approx(25.0)
    assert found["following_margin"][0] > 0.0
    assert found["following_margin"].min() < -5.0
    assert found["leader_gap"][:30] == pytest.approx(found["gap"][:30], abs=0.05)
