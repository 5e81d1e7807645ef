"""Numbers that no sensor can have measured: how roles take them, and who says so."""

from __future__ import annotations

import math
import sys
from typing import Any

import numpy as np
import pytest
from roads import Views, car, car_on, channels_of, run, spec_of_drive

from pytest_dura.core import Assessed, Assessment, RoleContext
from pytest_dura.driving import (
    PLACE,
    SEPARATION_CAP,
    SIZE,
    BodyList,
    DrivingOracle,
    PlausibilityAssessor,
    SeparationMonitor,
    percept_at,
)
from pytest_dura.driving.percepts import (
    all_objects,
    implausible_values,
    out_of_range,
    own_motion,
    own_pose,
    own_speed,
    plausible_objects,
    plausible_returns,
)

AHEAD = car_on(0, "straight", 90.0, 5.0, "AHEAD")
OWN = [
    ("odometry", {"speed": 1e300}),
    ("odometry", {"speed": -1.1}),
    ("odometry", {"speed": 70.1}),
    ("localisation", {"x": -1e300}),
    ("localisation", {"y": 10_001.0}),
    ("localisation", {"heading": 1e18}),
]


def altered(channel: str, percept: Any = None, **change: float) -> dict[str, Any]:
    """A percept with some numbers of a channel changed."""
    percept = percept or channels_of(AHEAD)
    return {**percept, channel: percept[channel]._replace(**change)}


def with_object(**change: float) -> dict[str, Any]:
    """A percept with one car ahead, of which lidar reports other numbers than radar."""
    return {**channels_of(AHEAD), "lidar": BodyList.of([AHEAD._replace(**change)])}


def with_return(column: int, number: float) -> dict[str, Any]:
    """A percept with one car ahead, of which radar reports another number."""
    percept = channels_of(AHEAD)
    radar = percept["radar"].copy()
    radar[0, column] = number
    return {**percept, "radar": radar}


def judged(percept: Any) -> Assessment:
    """What the SeparationMonitor says of driving on."""
    monitor = SeparationMonitor()
    monitor.reset(RoleContext(1, 0.1, {}))
    return monitor.run(Views().role(percept, "proceed_cautiously"))


def patterns(percept: Any) -> list[tuple[str, str]]:
    """What the PlausibilityAssessor alerts at the first tick."""
    assessor = PlausibilityAssessor()
    assessor.reset(RoleContext(1, 0.1, {}))
    return [(one.pattern, one.subject) for one in assessor.run(Views().role(percept)).alerts]


def test_what_is_within_the_ranges_is_handed_on_as_it_is() -> None:
    percept = channels_of(AHEAD, car("EDGE", -70.0, 2.0, 99.0, -70.0, length=30.0, width=0.1))
    assert own_pose(percept) is percept["localisation"]
    assert own_motion(percept) is percept["imu"]
    assert plausible_objects(percept) is percept["lidar"]
    assert plausible_returns(percept) is percept["radar"]
    for speed in (-1.0, 0.0, 70.0):
        assert own_speed(altered("odometry", speed=speed)) == speed
    assert out_of_range(percept) == implausible_values(percept) == []
    assert patterns(percept) == []
    assert judged(percept).verdict is Assessed.SAFE


def test_what_is_beyond_saturates() -> None:
    assert own_speed(altered("odometry", speed=-1e300)) == -1.0
    assert own_pose(altered("localisation", x=-1e300))[:2] == (
        -PLACE,
        channels_of()["localisation"].y,
    )
    assert own_motion(altered("imu", acceleration=-51.0))[0] == -50.0
    assert own_motion(altered("imu", yaw_rate=1e9))[2] == 10.0
    assert plausible_returns(with_return(0, -1.0))[0, 0] == 0.0
    assert plausible_returns(with_return(2, 1e300))[0, 2] == 140.0
    (body,) = plausible_objects(with_object(vx=-1e300, y=1e300))
    assert (body.vx, body.y, body.x, body.vy) == (-70.0, PLACE, AHEAD.x, AHEAD.vy)


def test_of_an_angle_whole_turns_are_left_out() -> None:
    turned = 2 * math.pi * 1e6 + 1.0
    assert own_pose(altered("localisation", heading=turned)).heading == pytest.approx(1.0, abs=1e-6)
    assert plausible_returns(with_return(1, -turned))[0, 1] == pytest.approx(-1.0, abs=1e-6)
    assert plausible_objects(with_object(heading=turned))[0].heading == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("size", [-5.0, -1e-308, 0.0, 1e-308, 0.09])
def test_a_size_too_small_is_a_cars(size: float) -> None:
    (body,) = plausible_objects(with_object(length=size, width=size))
    assert (body.length, body.width) == (5.0, 2.0)
    (body,) = plausible_objects(with_object(length=1e300))
    assert (body.length, body.width) == (SIZE[1], 2.0)


def test_what_still_can_be_written_into_is_looked_at_again() -> None:
    percept = channels_of(AHEAD)
    percept["radar"] = percept["radar"].copy()
    assert out_of_range(percept) == []
    percept["radar"][0, 0] = 1e300
    assert [one.channel for one in out_of_range(percept)] == ["radar"]


@pytest.mark.parametrize("channel, change", OWN, ids=str)
def test_own_pose_and_speed_that_cannot_be_are_alerted_and_never_safe(
    channel: str, change: dict[str, float]
) -> None:
    percept = altered(channel, channels_of(), **change)
    assert patterns(percept) == [(f"out_of_range:{channel}", channel)]
    found = judged(percept)
    assert found.verdict is Assessed.UNSAFE
    assert found.score == 0.0, "of an empty road that is; the cap would look safe"
    assert found.reasons[0].startswith(f"cannot judge: {channel} reports {next(iter(change))} ")
    assert {percept_at(percept)[name] for name in ("gap", "ttc", "leader_gap")} == {0.0}


@pytest.mark.parametrize(
    "change", [{"vx": 1e300}, {"vy": -71.0}, {"length": -1.0}, {"heading": 1e9}]
)
def test_an_object_that_may_be_near_is_never_safe_with_absurd_numbers(
    change: dict[str, float],
) -> None:
    percept = with_object(**change)
    assert ("out_of_range:lidar", "AHEAD") in patterns(percept)
    assert judged(percept).verdict is Assessed.UNSAFE
    assert percept_at(percept)["gap"] == 0.0


def test_an_object_too_far_to_be_near_is_alerted_and_ignored() -> None:
    percept = with_object(x=1e300, vx=1e300)
    assert ("out_of_range:lidar", "AHEAD") in patterns(percept)
    found = judged(percept)
    assert (found.verdict, found.score) == (Assessed.SAFE, SEPARATION_CAP)
    assert percept_at(percept)["gap"] == 50.0


@pytest.mark.parametrize(
    "percept, channel, told",
    [
        (altered("imu", acceleration=50.1), "imu", "reports acceleration 50.1"),
        (altered("imu", lateral_acceleration=-1e300, yaw_rate=11.0), "imu",
         "reports lateral_acceleration -1e+300, yaw_rate 11"),
        (with_return(0, -0.1), "radar", "reports range -0.1"),
        (with_return(2, 141.0), "radar", "reports rate 141"),
    ],
)  # fmt: skip
def test_imu_and_radar_are_alerted_and_are_no_matter_of_safety(
    percept: Any, channel: str, told: str
) -> None:
    assert (f"out_of_range:{channel}", channel) in patterns(percept)
    assert [one.detail for one in out_of_range(percept)] == [told]
    assert implausible_values(percept) == []


def test_what_the_oracle_measures_stays_finite_and_fails() -> None:
    oracle, views = DrivingOracle(), Views()
    oracle.reset(RoleContext(1, 0.1, {}))
    oracle.run(views.role(altered("imu", acceleration=-sys.float_info.max)))
    found = oracle.run(views.role(altered("imu", acceleration=sys.float_info.max), "proceed"))
    assert found.values["acceleration"] == 50.0
    assert found.values["jerk"] == pytest.approx(1000.0)
    assert {"acceleration", "jerk"} <= set(found.performance_fail)


WORLD: dict[str, Any] = {
    "ego": {"distance": 40.0, "speed": 8.0},
    "traffic": {"headway": 5.0},
    "pedestrians": [{"id": "P1"}],
}
CHANNELS = ("lidar", "localisation", "odometry", "imu", "radar")


@pytest.mark.parametrize("bits", [1, 8, 20])
@pytest.mark.parametrize("channel", CHANNELS)
def test_no_episode_is_missing_for_a_corrupted_channel(channel: str, bits: int) -> None:
    corruption = {
        "type": "corruption",
        "target": channel,
        "activation": {"at": 0.5},
        "duration": None,
        "parameters": {"bits": bits},
    }
    told = set()
    for seed, generator in enumerate(("rule_based", "reactive"), 20 * bits):
        spec = spec_of_drive(
            WORLD, generator=generator, policy="recover", seed=seed, duration=6.0,
            faults=[corruption],
        )  # fmt: skip
        episode = run(spec)
        assert episode.failure is None
        told |= {event.detail.split(": ")[0] for event in episode.events if event.kind == "alert"}
    if bits > 1:  # a single bit makes few numbers absurd
        assert any(f"out_of_range:{channel}" in one for one in told)


def test_of_many_percepts_it_tells_the_same_as_of_each() -> None:
    rows = np.array([[2.0, 30.0, 0.0, 0.0, 0.0, 5.0, 2.0]])
    absurd, far = rows.copy(), rows.copy()
    absurd[0, 5], far[0, 0] = -1.0, 1e300
    lists = [BodyList(("V1",), data) for data in (rows, absurd, far)] + [BodyList.of([])]
    percepts = [{**channels_of(AHEAD), "lidar": one} for one in lists]
    percepts += [altered("odometry", speed=1e300), altered("localisation", x=1e300)]
    for some in (percepts, percepts[:1] + percepts[3:], percepts[3:4], []):
        bodies, doubts = all_objects(some)
        assert bodies == [plausible_objects(percept) for percept in some]
        assert doubts == [bool(implausible_values(percept)) for percept in some]
    assert all_objects(percepts)[1] == [False, True, False, False, True, True]
