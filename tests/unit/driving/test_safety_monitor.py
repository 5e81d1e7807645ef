"""SeparationMonitor on percepts made by hand."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from roads import Views, car, car_on, channels_of, run, spec_of_drive, walker

from pytest_dura.core import Assessed, Assessment, RoleContext, check_role
from pytest_dura.driving import (
    SEPARATION_CAP,
    Command,
    HighwaySimulator,
    Maneuver,
    SeparationMonitor,
)


def judge(percept: Any, action: Any, before: Any = None) -> Assessment:
    """The assessment of one proposal; ``before`` is the percept of the tick before."""
    monitor, views = SeparationMonitor(), Views()
    monitor.reset(RoleContext(1, 0.1))
    if before is not None:
        monitor.run(views.role(before, action))
    return monitor.run(views.role(percept, action))


def test_it_keeps_the_contract_of_a_role() -> None:
    world = {"traffic": {"headway": 6.0}, "pedestrians": [{"id": "P1"}]}
    check_role(SeparationMonitor, simulator=HighwaySimulator, scenario={"world": world})


@pytest.mark.parametrize("maneuver", list(Maneuver))
def test_an_empty_road_is_safe_for_everything(maneuver: Maneuver) -> None:
    found = judge(channels_of(), maneuver)
    assert found.verdict is Assessed.SAFE
    assert found.score == SEPARATION_CAP
    assert found.reasons == ()


STANDING_AHEAD = car("V1", 2.0, 42.0, -math.pi / 2)  # 11 m from bumper to bumper at s = 53


def test_it_judges_the_proposed_maneuver() -> None:
    percept = channels_of(STANDING_AHEAD, s=52.0, speed=8.0)
    braking, going = judge(percept, "emergency_brake"), judge(percept, "accelerate")
    assert braking.verdict is Assessed.SAFE
    assert going.verdict is Assessed.UNSAFE
    assert going.score < 0.0 < braking.score
    assert any("V1" in reason for reason in going.reasons)


def test_an_own_acceleration_is_judged_and_not_the_maneuver_s_name() -> None:
    percept = channels_of(STANDING_AHEAD, s=52.0, speed=8.0)
    assert judge(percept, Command(Maneuver.PROCEED, -8.0)).verdict is Assessed.SAFE
    assert judge(percept, Command(Maneuver.EMERGENCY_BRAKE, 2.0)).verdict is Assessed.UNSAFE


def test_the_nearer_the_worse() -> None:
    verdicts = []
    for beside in (2.3, 2.9, 3.6, 6.0):
        other = car("V1", 2.0 + beside, 50.0, math.pi / 2, 8.0)
        verdicts.append(judge(channels_of(other, s=52.0, speed=8.0), "proceed"))
    assert [found.verdict for found in verdicts] == sorted(
        (found.verdict for found in verdicts), reverse=True
    )
    assert {found.verdict for found in verdicts} == set(Assessed)
    assert np.all(np.diff([found.score for found in verdicts]) > 0.0)
    warned = next(found for found in verdicts if found.verdict is Assessed.WARNING)
    assert warned.reasons[0].startswith("comes within")
    assert "of V1" in warned.reasons[0]


def test_oncoming_traffic_on_its_own_lane_is_safe() -> None:
    for y in (61.0, 50.0, 40.0, 30.0):
        other = car("V1", -2.0, y, math.pi / 2, 9.0)
        assert judge(channels_of(other, s=52.0, speed=9.0), "proceed").verdict is Assessed.SAFE


def test_who_drives_away_is_no_danger() -> None:
    other = car("V1", 2.0, 40.0, -math.pi / 2, 9.0)
    assert judge(channels_of(other, s=52.0, speed=8.0), "proceed").verdict is Assessed.SAFE


def test_following_too_close_is_unsafe_though_nobody_brakes_yet() -> None:
    near = car("V1", 2.0, 61.0 - 6.0, -math.pi / 2, 8.0)  # 1 m behind the other, same speed
    found = judge(channels_of(near, s=50.0, speed=8.0), "proceed")
    assert found.verdict is Assessed.UNSAFE
    assert any(reason.startswith("follows V1 at 1.0 m, needs") for reason in found.reasons)
    far = car("V1", 2.0, 61.0 - 12.0, -math.pi / 2, 8.0)
    assert judge(channels_of(far, s=50.0, speed=8.0), "proceed").verdict is Assessed.SAFE


def test_braking_hard_is_no_fault_of_following() -> None:
    near = channels_of(car("V1", 2.0, 61.0 - 6.0, -math.pi / 2, 5.0), s=50.0, speed=8.0)
    for action, told in (("emergency_brake", False), (Command(Maneuver.YIELD, -7.0), True)):
        assert any("follows" in reason for reason in judge(near, action).reasons) == told


def test_a_standing_ego_may_stand_close_behind() -> None:
    near = car("V1", 2.0, 61.0 - 7.0, -math.pi / 2, 0.0)
    standing = channels_of(near, s=50.0, speed=0.0)
    assert judge(standing, "emergency_brake").verdict is not Assessed.UNSAFE
    assert judge(standing, "wait").verdict is Assessed.UNSAFE, "to wait is to roll up to the line"


def test_who_stands_and_goes_on_standing_is_warned_of_who_comes_and_not_refused() -> None:
    coming = car("V1", 2.0, 40.0, math.pi / 2, 8.0)  # towards the ego, in its lane
    standing = channels_of(coming, s=60.0, speed=0.0)
    for action in ("wait", "emergency_brake"):
        stays = judge(standing, Command(Maneuver(action), -3.0))
        assert stays.verdict is Assessed.WARNING
        assert stays.score < 0.0
    assert judge(standing, Command(Maneuver.WAIT, 0.5)).verdict is Assessed.UNSAFE
    rolling = channels_of(coming, s=60.0, speed=2.0)
    assert judge(rolling, Command(Maneuver.WAIT, -3.0)).verdict is Assessed.UNSAFE


def test_entering_in_front_of_a_car_takes_its_right_of_way() -> None:
    coming = car_on(1, "straight", 85.0, 8.0)  # from the west, 2 s from the ego's lane
    percept = channels_of(coming, s=95.5, speed=4.0)
    found = judge(percept, "accelerate")
    assert found.verdict is Assessed.UNSAFE
    assert "takes the right of way of V1" in found.reasons
    waiting = judge(percept, "emergency_brake")
    assert waiting.verdict is Assessed.SAFE
    assert waiting.reasons == ()


@pytest.mark.parametrize("speed", [2.0, 4.0, 6.0, 8.0, 10.0])
def test_the_right_of_way_is_told_while_the_ego_could_still_stop(speed: float) -> None:
    coming = car_on(1, "straight", 85.0, 8.0)
    told = []
    for tick in range(60):
        s = 97.5 - (60 - tick) * 0.1 * speed
        found = judge(channels_of(coming, s=s, speed=speed), Command(Maneuver.PROCEED, 0.0))
        could_stop = 97.5 - s > speed**2 / 16.0
        told.append(could_stop and any("right of way" in reason for reason in found.reasons))
    assert 3 <= sum(told) <= 6, "from half a second before it is too late"


@pytest.mark.parametrize(
    "other",
    [
        car_on(1, "straight", 10.0, 8.0),  # far away
        car_on(1, "straight", 125.0, 8.0),  # has passed
        car_on(1, "straight", 97.0, 0.0),  # stands
        car_on(1, "straight", 106.0, 0.9),  # creeps
        car_on(2, "straight", 85.0, 8.0),  # comes from the other minor road
    ],
    ids=["far", "past", "standing", "creeping", "opposite"],
)
def test_who_is_not_hindered_keeps_its_right_of_way(other: Any) -> None:
    found = judge(channels_of(other, s=96.5, speed=4.0), "accelerate")
    assert not any("right of way" in reason for reason in found.reasons)


def test_a_turning_car_is_predicted_on_its_curve() -> None:
    # It turns left towards the north, away from the ego: straight on it would hit the ego's path.
    def at(s: float) -> Any:
        return channels_of(car_on(1, "left", s, 6.0), s=104.0, speed=2.0)

    straight = judge(at(104.0), "proceed_cautiously").score
    turning = judge(at(104.0), "proceed_cautiously", before=at(103.4)).score
    assert turning != straight


def test_a_pedestrian_on_the_path_is_seen() -> None:
    percept = channels_of(walker("P1", 2.0, 45.0), s=52.0, speed=8.0)
    assert judge(percept, "proceed").verdict is Assessed.UNSAFE
    assert judge(percept, "emergency_brake").verdict is not Assessed.UNSAFE


def test_without_a_proposal_there_is_nothing_to_judge() -> None:
    views = Views()
    assert not SeparationMonitor().trigger(views.role(channels_of()))


def test_it_believes_the_percept() -> None:
    ghost = {"type": "ghost-obstacle", "activation": {"at": 1.0}, "duration": 2.0}
    world = {"ego": {"distance": 70.0, "speed": 8.0}}
    clean = run(spec_of_drive(world, generator="aggressive"))
    attacked = run(spec_of_drive(world, generator="aggressive", faults=[ghost]))
    assert not clean.flagged
    flagged = np.flatnonzero(attacked.decisions["verdict"] == 2)
    assert flagged[0] == 10
    assert flagged[-1] <= 29
