"""Tactical: it decides seldom, on little, believes lidar, and misjudges gaps by its seed."""

from __future__ import annotations

import math
from typing import Any

import pytest
from roads import Views, car, car_on, channels_of, run, spec_of_drive, walker

from pytest_dura.core import Proposal, RoleContext, check_role
from pytest_dura.driving import HighwaySimulator, Maneuver
from pytest_dura.driving.roles.tactical import Tactical

WORLD: dict[str, Any] = {"ego": {"distance": 45.0, "speed": 8.0}, "traffic": {"headway": 8.0}}
SURE = {"gap_error": 0.0}


def decide(percept: Any, seed: int = 1, **params: Any) -> Proposal:
    """Its first decision."""
    planner = Tactical(**params)
    planner.reset(RoleContext(seed, 0.1))
    return planner.propose(Views().generator(percept))


def coming(seconds: float, *, speed: float = 8.0, name: str = "V1") -> Any:
    """A car from the west so many seconds before the ego's lane at a constant speed."""
    # Its front is half its length, half a car's width and 0.5 m nearer than its centre.
    return car_on(1, "straight", 113.0 - 4.0 - seconds * speed, speed, name)


def test_it_keeps_the_contract_of_a_role() -> None:
    check_role(Tactical, simulator=HighwaySimulator, scenario={"world": WORLD}, ticks=20)


def test_a_decision_holds_for_a_second_whatever_happens() -> None:
    planner, views = Tactical(), Views()
    planner.reset(RoleContext(1, 0.1))
    free, blocked = channels_of(s=60.0), channels_of(car("V1", 2.0, 45.0), s=60.0)
    shown = [free, *[blocked] * 19]
    maneuvers = [planner.propose(views.generator(one)).action.maneuver for one in shown]
    assert maneuvers == [Maneuver.PROCEED] * 10 + [Maneuver.EMERGENCY_BRAKE] * 10


@pytest.mark.parametrize("seconds, goes", [(5.5, False), (7.5, True)])
def test_it_goes_if_the_next_car_seems_to_leave_the_critical_gap(
    seconds: float, goes: bool
) -> None:
    proposal = decide(channels_of(coming(seconds), s=95.0, speed=1.0), **SURE)
    assert proposal.action.maneuver is (Maneuver.ACCELERATE if goes else Maneuver.WAIT)
    assert goes or "V1" in proposal.explanation


def test_it_misjudges_gaps_by_its_seed_alone() -> None:
    percept = channels_of(coming(6.5), s=95.0, speed=1.0)
    went = [decide(percept, seed).action.maneuver is Maneuver.ACCELERATE for seed in range(200)]
    assert 70 < sum(went) < 130, "at the critical gap it is right as often as wrong"
    assert went == [
        decide(percept, seed).action.maneuver is Maneuver.ACCELERATE for seed in range(200)
    ]


def test_an_object_more_shifts_no_other_estimate() -> None:
    far = car("V7", -2.0, -60.0, math.pi / 2)
    for seed in range(30):
        alone = decide(channels_of(coming(6.5), s=95.0, speed=1.0), seed)
        assert decide(channels_of(far, coming(6.5), s=95.0, speed=1.0), seed) == alone


def test_it_overlooks_what_is_not_among_the_nearest_objects() -> None:
    crowd = [walker(f"P{i}", 12.0, 20.0 + i) for i in range(4)]
    percept = channels_of(*crowd, coming(4.0), s=95.0, speed=1.0)
    assert decide(percept, **SURE).action.maneuver is Maneuver.ACCELERATE
    assert decide(percept, attention=5, **SURE).action.maneuver is Maneuver.WAIT


@pytest.mark.parametrize(
    "ahead, maneuver",
    [(50.0, Maneuver.PROCEED), (25.0, Maneuver.YIELD), (10.0, Maneuver.EMERGENCY_BRAKE)],
)
def test_it_believes_a_ghost_that_radar_denies(ahead: float, maneuver: Maneuver) -> None:
    ego_front = 111.0 - 60.0 - 2.5
    ghost = car("V9", 2.0, ego_front - ahead - 2.5, -math.pi / 2)
    proposal = decide(channels_of(ghost, s=60.0, radar=()), **SURE)
    assert proposal.action.maneuver is maneuver
    assert ("V9" in proposal.explanation) == (maneuver is not Maneuver.PROCEED)


def test_it_follows_who_drives_ahead_and_brakes_for_a_pedestrian_beside_its_lane() -> None:
    leader = car("V1", 2.0, 111.0 - 60.0 - 2.5 - 12.0 - 2.5, -math.pi / 2, 5.0)
    assert decide(channels_of(leader, s=60.0)).action.maneuver is Maneuver.PROCEED_CAUTIOUSLY
    pedestrian = walker("P1", 2.0 + 2.5, 111.0 - 60.0 - 2.5 - 12.0)
    assert decide(channels_of(pedestrian, s=60.0)).action.maneuver is Maneuver.EMERGENCY_BRAKE


def test_the_same_seed_gives_the_same_episode() -> None:
    spec = spec_of_drive(WORLD, generator="tactical", duration=12.0)
    first, second = run(spec), run(spec)
    assert first.failure is None
    assert first.digest == second.digest
