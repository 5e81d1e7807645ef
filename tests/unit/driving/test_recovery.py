"""RecoveryPlanners on scenes made by hand, and in the closed loop."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from roads import (
    Views,
    car,
    car_on,
    channels_of,
    run,
    spec_of_drive,
    truth_of,
    walker,
)

from pytest_dura import Episode, RoleSpec
from pytest_dura.core import (
    Alert,
    Assessed,
    Assessment,
    Recovery,
    RecoveryPlanner,
    RoleContext,
    SafetyMonitor,
    SecurityAssessment,
    check_role,
)
from pytest_dura.domains import DOMAINS
from pytest_dura.driving import (
    MAX_BRAKING,
    SPEED_LIMIT,
    Body,
    Command,
    EmergencyBrake,
    HighwaySimulator,
    Maneuver,
    SeparationMonitor,
)
from pytest_dura.driving.roles.recovery import (
    AlertOnly,
    IgnoreUntrusted,
    Replan,
    SafeStop,
    SecondOpinion,
)

PLANNERS = DOMAINS["driving"].short_names["recovery_planner"]
NORTH = -math.pi / 2
"""The heading of an ego that comes from the south; it drives on x = 2 and has y = 111 - s."""


def answer(
    planner: RecoveryPlanner,
    percept: Any,
    action: Any = "proceed",
    *,
    before: Any = None,
    alerts: tuple[tuple[float, Alert], ...] = (),
    outputs: Any = None,
) -> Recovery:
    """What a fresh planner does at the second of two ticks, at 0.1 s."""
    planner.reset(RoleContext(1, 0.1))
    views = Views()
    views.see(percept if before is None else before)
    view = views.role(percept, action)
    return planner.run(replace(view, alerts=alerts, outputs=outputs or {}))


@pytest.mark.parametrize("name", PLANNERS)
def test_each_keeps_the_contract_of_a_role(name: str) -> None:
    world = {
        "ego": {"distance": 20.0, "speed": 8.0},
        "vehicles": [{"id": "E", "arm": "east", "distance": 40.0}],
        "pedestrians": [{"id": "P1"}],
    }
    check_role(
        RoleSpec(PLANNERS[name]), simulator=HighwaySimulator, scenario={"world": world}, ticks=20
    )


# --- EmergencyBrake and AlertOnly


def test_the_emergency_brake_brakes() -> None:
    found = answer(EmergencyBrake(), channels_of())
    assert found.action == Command(Maneuver.EMERGENCY_BRAKE)


def test_an_alert_lets_the_proposal_stand() -> None:
    proposal = Command(Maneuver.ACCELERATE, 1.25)
    assert answer(AlertOnly(), channels_of(), proposal).action == proposal
    assert answer(AlertOnly(), channels_of(), None).action == HighwaySimulator().fallback_action()


# --- SafeStop


def stop(percept: Any) -> Recovery:
    return answer(SafeStop(), percept)


def test_with_room_it_brakes_comfortably() -> None:
    found = stop(channels_of(s=50.0, speed=8.0))
    assert found.action == Command(Maneuver.WAIT, -3.0)
    assert found.name == "safe_stop"


@pytest.mark.parametrize(
    "to_line, braking", [(12.1, 3.0), (7.7, 5.0), (6.3, 6.4), (4.5, 8.0), (3.81, 8.0)]
)
def test_it_brakes_as_hard_as_the_stop_line_asks_for(to_line: float, braking: float) -> None:
    found = stop(channels_of(s=97.5 - to_line, speed=8.0))
    assert found.action.acceleration == pytest.approx(-braking, abs=0.01)
    full = found.action.maneuver is Maneuver.EMERGENCY_BRAKE
    assert full == (braking == MAX_BRAKING)


@pytest.mark.parametrize("s, speed", [(93.8, 8.0), (100.0, 6.0), (110.0, 3.0), (120.0, 9.5)])
def test_who_cannot_stop_before_the_zone_leaves_it_if_the_way_is_free(
    s: float, speed: float
) -> None:
    found = stop(channels_of(s=s, speed=speed))
    assert found.name == "clear_zone"
    assert found.action == Command(Maneuver.ACCELERATE, min(4.0, SPEED_LIMIT - speed))


def test_who_stands_at_the_line_stays_there() -> None:
    for s, speed in ((97.5, 0.0), (97.9, 0.0), (97.4, 0.5)):
        found = stop(channels_of(s=s, speed=speed))
        assert found.name == "safe_stop"
        assert found.action.acceleration <= -3.0


def test_who_has_left_the_zone_stops() -> None:
    assert stop(channels_of(s=125.0, speed=8.0)).action.acceleration == -3.0


def test_a_way_out_that_is_blocked_is_not_taken() -> None:
    blocked = channels_of(car("V1", 2.0, -8.0, NORTH), s=101.0, speed=5.0)
    found = stop(blocked)
    assert found.name == "safe_stop"
    assert found.action.acceleration == -3.0, "13 m are enough for a comfortable stop from 5 m/s"
    across = channels_of(car_on(3, "straight", 95.0, 8.0), s=101.0, speed=2.0)
    assert stop(across).action.acceleration is not None
    assert stop(across).action.acceleration < 0.0


def test_who_drives_off_behind_the_ego_blocks_no_way_out() -> None:
    passed = channels_of(car("V1", 12.0, 2.0, 0.0, 8.0), s=104.0, speed=5.0)
    assert stop(passed).name == "clear_zone"


def test_what_comes_behind_the_zone_does_not_matter_for_leaving_it() -> None:
    beyond = car("V1", 2.0, -36.0, NORTH)  # 5 s would lead into it, 2 s lead out
    assert stop(channels_of(beyond, s=105.0, speed=8.0)).name == "clear_zone"


def test_a_way_out_that_takes_longer_than_is_predicted_is_not_taken() -> None:
    percept = channels_of(s=101.0, speed=0.0)
    assert answer(SafeStop(horizon=5.0), percept).name == "clear_zone"
    assert answer(SafeStop(horizon=2.0), percept).name == "safe_stop"


@pytest.mark.parametrize("leader, braking", [(0.0, 6.809), (8.0, 3.678)])
def test_a_leader_is_taken_to_brake_as_hard_as_it_can(leader: float, braking: float) -> None:
    # 7 m between the bumpers.
    ahead = car("V1", 2.0, 49.0, NORTH, leader)
    found = stop(channels_of(ahead, s=50.0, speed=8.0))
    assert found.action.acceleration == pytest.approx(-braking, abs=0.01)


def test_it_brakes_as_hard_as_a_pedestrian_on_the_path_asks_for_and_no_harder() -> None:
    # A comfortable stop would take 10.7 m and end on the walker's way, 9.2 m ahead.
    percept = channels_of(walker("P1", -0.5, 49.0, 0.8), s=50.0, speed=8.0)
    found = stop(percept)
    assert found.action.acceleration is not None
    assert -MAX_BRAKING < found.action.acceleration < -3.0


def test_where_nothing_helps_it_brakes_as_hard_as_it_can() -> None:
    for someone in (walker("P1", 2.0, 57.0), walker("P1", 1.0, 55.0, 1.5)):
        percept = channels_of(someone, s=50.0, speed=8.0)
        assert stop(percept).action == Command(Maneuver.EMERGENCY_BRAKE, -MAX_BRAKING)


class Refuses(SafetyMonitor):
    """Refuses everything."""

    def run(self, view: Any) -> Assessment:
        return Assessment(Assessed.UNSAFE, -1.0, ("refused",))


def refused(planner: str, **ego: float) -> Episode:
    """An episode on an empty road in which every proposal is refused."""
    roles: dict[str, RoleSpec | None] = {
        "safety_monitor": RoleSpec("test_recovery:Refuses"),
        "recovery_planner": RoleSpec(PLANNERS[planner]),
    }
    world = {"ego": ego, "traffic": {"headway": 900.0, "arms": []}}
    found = run(spec_of_drive(world, roles=roles, policy="recover", duration=12.0))
    assert found.failure is None
    return found


def test_in_the_loop_a_safe_stop_is_gentle_and_before_the_zone() -> None:
    found = refused("safe_stop", distance=30.0, speed=8.0)
    assert found.signal("speed")[-1] == 0.0
    assert found.signal("acceleration").min() >= -3.01
    assert not found.ever("in_conflict_zone")
    late = refused("safe_stop", distance=7.3, speed=8.0)  # just enough for a full stop
    assert late.signal("speed")[-1] == 0.0
    assert not late.ever("in_conflict_zone")
    assert late.signal("acceleration").min() < -7.0


def test_in_the_loop_it_leaves_a_zone_that_it_cannot_stop_before() -> None:
    found = refused("safe_stop", distance=6.0, speed=8.0)
    assert found.ever("cleared")
    assert found.signal("speed")[-1] == 0.0
    assert not refused("emergency_brake", distance=6.0, speed=8.0).ever("cleared")


# --- Replan


def test_on_a_free_road_progress_decides() -> None:
    found = answer(Replan(), channels_of(s=60.0, speed=8.0), "wait")
    assert found.action == Command(Maneuver.ACCELERATE)


def test_it_does_not_drive_into_what_stands_ahead() -> None:
    percept = channels_of(car("V1", 2.0, 40.0, NORTH), s=52.0, speed=8.0)
    found = answer(Replan(), percept)
    monitor, views = SeparationMonitor(), Views()
    monitor.reset(RoleContext(1, 0.1))
    assert monitor.run(views.role(percept, found.action)).verdict is not Assessed.UNSAFE
    assert monitor.run(views.again("proceed")).verdict is Assessed.UNSAFE


def test_it_leaves_before_it_is_struck_where_standing_does_not_help() -> None:
    # On the far lane of the crossing road, with a car 1.8 s away.
    percept = channels_of(car("V1", 20.0, -2.0, math.pi, 10.0), s=112.0, speed=3.0)
    assert answer(Replan(), percept).action == Command(Maneuver.ACCELERATE)


def test_it_gives_way_where_going_would_meet_somebody() -> None:
    percept = channels_of(car("V1", -22.0, 2.0, 0.0, 9.0), s=92.0, speed=4.0)
    found = answer(Replan(), percept, "accelerate")
    assert found.action.maneuver in (Maneuver.WAIT, Maneuver.YIELD, Maneuver.EMERGENCY_BRAKE)


def test_of_equal_gaps_the_greater_progress_wins_and_of_unequal_ones_the_greater_gap() -> None:
    # A car stands beside the path: every way passes it, the braking ones do not reach it.
    beside = channels_of(car("V1", 5.0, 30.0, NORTH), s=70.0, speed=4.0)
    near = answer(Replan(enough=0.1), beside).action.maneuver
    far = answer(Replan(enough=2.0), beside).action.maneuver
    assert near is Maneuver.ACCELERATE
    assert far in (Maneuver.EMERGENCY_BRAKE, Maneuver.WAIT, Maneuver.YIELD)


def test_where_contact_is_predicted_whatever_it_does_it_brakes() -> None:
    percept = channels_of(walker("P1", 1.0, 55.0, 1.5), s=50.0, speed=8.0)
    assert answer(Replan(), percept).action == Command(Maneuver.EMERGENCY_BRAKE)


def test_it_sees_turns_though_it_is_not_asked_at_every_tick() -> None:
    first, second = (
        channels_of(Body("V1", x, 2.0, turned, 6.0, 0.0, 5.0, 2.0), s=92.0, speed=5.0)
        for x, turned in ((-20.6, 0.0), (-20.0, 0.06))
    )
    planner, views = Replan(), Views()
    planner.reset(RoleContext(1, 0.1))
    planner.run(views.role(first, "proceed"))
    asked_twice = planner.run(views.role(second, "proceed"))
    assert answer(Replan(), second, before=first) == asked_twice
    assert answer(Replan(), second) != asked_twice, "without the tick before it turns nowhere"


def test_the_second_opinion_is_the_monitor_s_own_with_turns_and_all() -> None:
    first, second = (
        channels_of(Body("V1", x, 2.0, turned, 6.0, 0.0, 5.0, 2.0), s=92.0, speed=5.0)
        for x, turned in ((-9.6, 0.0), (-9.0, 0.06))
    )
    views, monitor = Views(), SeparationMonitor()
    monitor.reset(RoleContext(1, 0.1))
    unturned = monitor.run(views.role(second, "accelerate"))
    views = Views()
    monitor.reset(RoleContext(1, 0.1))
    monitor.run(views.role(first, "accelerate"))
    view = views.role(second, "wait")
    own = monitor.run(views.again("accelerate"))
    assert own != unturned
    assert SecondOpinion().judge(view, Command(Maneuver.ACCELERATE)) == own


def test_the_second_opinion_takes_the_monitor_s_parameters() -> None:
    view = Views().role(channels_of(car("V1", 2.0, 42.0, NORTH), s=52.0, speed=8.0), "proceed")
    brake = Command(Maneuver.EMERGENCY_BRAKE)
    assert SecondOpinion().judge(view, brake).verdict is not Assessed.UNSAFE
    careful = SecondOpinion({"unsafe": 9.0, "warning": 9.5})
    assert careful.judge(view, brake).verdict is Assessed.UNSAFE


# --- IgnoreUntrusted

GHOST = car("V912", 2.0, 44.0, NORTH)
AHEAD = {"s": 52.0, "speed": 8.0}
ALERT = Alert("object_from_nowhere", "V912")


def ignoring(
    *bodies: Body, radar: Any = (), alerts: Any = ((0.0, ALERT),), **options: Any
) -> Recovery:
    percept = channels_of(*bodies, radar=radar, **AHEAD)
    return answer(IgnoreUntrusted(), percept, alerts=alerts, **options)


def test_a_ghost_under_suspicion_is_driven_through() -> None:
    found = ignoring(GHOST)
    assert found.action == Command(Maneuver.PROCEED)
    assert found.name == "ignore_untrusted"
    assert "V912" in found.explanation


@pytest.mark.parametrize(
    "alerts",
    [(), ((0.0, Alert("object_from_nowhere", "V3")),), ((-4.95, ALERT),)],
    ids=["none", "about somebody else", "long ago"],
)
def test_without_suspicion_it_brakes(alerts: Any) -> None:
    assert ignoring(GHOST, alerts=alerts).action == Command(Maneuver.EMERGENCY_BRAKE)


def test_an_alert_counts_for_as_long_as_it_is_told_to() -> None:
    percept = channels_of(GHOST, radar=(), **AHEAD)
    old = ((-4.95, ALERT),)
    brakes = answer(IgnoreUntrusted(memory=5.0), percept, alerts=old)
    stands = answer(IgnoreUntrusted(memory=6.0), percept, alerts=old)
    assert (brakes.name, stands.name) == ("emergency_brake", "ignore_untrusted")


def test_somebody_else_in_the_way_is_not_ignored() -> None:
    other = car("V1", 2.0, 42.0, NORTH)
    found = ignoring(GHOST, other, radar=(other,))
    assert found.action == Command(Maneuver.EMERGENCY_BRAKE)
    assert "V1" in found.explanation


def test_what_radar_sees_as_well_is_not_driven_into() -> None:
    assert ignoring(GHOST, radar=(GHOST,)).action == Command(Maneuver.EMERGENCY_BRAKE)


def test_it_can_be_abused_where_radar_is_blinded_too() -> None:
    """The documented weakness: a real car that is distrusted and that radar does not see."""
    assert ignoring(GHOST, radar=()).action == Command(Maneuver.PROCEED)


@pytest.mark.parametrize(
    "outputs",
    [
        {"safety_monitor": Assessment(Assessed.UNSAFE, critical=True)},
        {"watch": Assessment(Assessed.UNSAFE)},
        {"security_assessor": SecurityAssessment(Assessed.UNSAFE)},
    ],
    ids=["critical", "another role", "the assessor"],
)
def test_what_others_refuse_does_not_stand(outputs: Any) -> None:
    assert ignoring(GHOST, outputs=outputs).action == Command(Maneuver.EMERGENCY_BRAKE)
    mild = {"safety_monitor": Assessment(Assessed.UNSAFE), "watch": Assessment(Assessed.WARNING)}
    assert ignoring(GHOST, outputs=mild).action == Command(Maneuver.PROCEED)


def test_without_a_proposal_it_brakes() -> None:
    percept = channels_of(GHOST, radar=(), **AHEAD)
    found = answer(IgnoreUntrusted(), percept, None, alerts=((0.0, ALERT),))
    assert found.action == Command(Maneuver.EMERGENCY_BRAKE)


# --- in the closed loop

ATTACK = {
    "type": "ghost-obstacle",
    "activation": {"at": 2.0},
    "duration": 3.0,
    "parameters": {"ahead": 8.0},
}
WORLD = {"ego": {"distance": 60.0, "speed": 8.0}, "traffic": {"headway": 900.0, "arms": []}}


def attacked(planner: str, policy: str = "recover") -> Episode:
    found = run(
        spec_of_drive(
            WORLD,
            faults=[ATTACK],
            policy=policy,
            roles={"recovery_planner": RoleSpec(PLANNERS[planner])},
        )
    )
    assert found.failure is None
    return found


def test_in_the_loop_alerts_of_earlier_ticks_are_remembered() -> None:
    ignored, braked = attacked("ignore_untrusted"), attacked("emergency_brake")
    for found in (ignored, braked):
        assert found.metrics.recoveries
    assert ignored.signal("speed").min() > 5.0
    assert braked.signal("speed").min() < 5.0


def test_in_the_loop_an_alert_changes_nothing_but_the_record() -> None:
    told, silent = attacked("alert"), attacked("alert", policy="log_only")
    assert truth_of(told) == truth_of(silent)
    assert told.metrics.recoveries
    assert not silent.metrics.recoveries
    assert np.array_equal(told.decisions["executed"], silent.decisions["executed"])
