"""Commands: what is accepted, and what each maneuver asks of the car."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pytest_dura.core import ActionError
from pytest_dura.driving import MAX_ACCELERATION, MAX_BRAKING, Command, Maneuver, acceleration_for
from pytest_dura.driving.maneuvers import COMFORT_BRAKING, stop_at

NAMES = ["wait", "yield", "proceed_cautiously", "proceed", "accelerate", "emergency_brake"]


def asked(name: str, speed: float, to_line: float = 30.0, given: float | None = None) -> float:
    return acceleration_for(Command(Maneuver(name), given), speed, to_line)


def test_the_six_maneuvers() -> None:
    assert [maneuver.value for maneuver in Maneuver] == NAMES


@pytest.mark.parametrize(
    "action",
    [
        "wait",
        Maneuver.WAIT,
        Command(Maneuver.WAIT),
        {"maneuver": "wait"},
        {"maneuver": Maneuver.WAIT},
    ],
    ids=["name", "maneuver", "command", "mapping", "mapping of maneuver"],
)
def test_a_command_may_be_written_in_several_ways(action: object) -> None:
    assert Command.of(action) == Command(Maneuver.WAIT, None)


@pytest.mark.parametrize(
    "number", [1, 1.0, np.float32(1.0), np.float64(1.0), np.int64(1)], ids=repr
)
def test_an_acceleration_is_any_real_number(number: Any) -> None:
    command = Command.of({"maneuver": "proceed", "acceleration": number})
    assert command == Command(Maneuver.PROCEED, 1.0)
    assert type(command.acceleration) is float


@pytest.mark.parametrize(
    "action, told",
    [
        (None, ["None is not a maneuver", *NAMES]),
        ("", ["'' is not a maneuver", "wait, yield"]),
        ("brake", ["'brake' is not a maneuver", "emergency_brake"]),
        ("WAIT", ["'WAIT' is not a maneuver", "wait"]),
        (3, ["3 is not a maneuver"]),
        (True, ["True is not a maneuver"]),
        (math.nan, ["nan is not a maneuver"]),
        (math.inf, ["inf is not a maneuver"]),
        (["wait"], ["an object of type list is not a maneuver"]),
        (object(), ["an object of type object is not a maneuver"]),
        (np.array([1.0]), ["an object of type ndarray is not a maneuver"]),
        ({}, ["maneuver and acceleration", "not nothing"]),
        ({"acceleration": 1.0}, ["maneuver and acceleration", "not 'acceleration'"]),
        ({"maneuver": "wait", "speed": 3}, ["not 'maneuver', 'speed'"]),
        ({1: 2}, ["not 1"]),
        ({"maneuver": "stop"}, ["'stop' is not a maneuver"]),
        ({"maneuver": "wait", "acceleration": "1"}, ["number of m/s2, not '1'"]),
        ({"maneuver": "wait", "acceleration": True}, ["number of m/s2, not True"]),
        ({"maneuver": "wait", "acceleration": math.nan}, ["nan, not a finite number of m/s2"]),
        ({"maneuver": "wait", "acceleration": -math.inf}, ["-inf, not a finite number"]),
        ({"maneuver": "wait", "acceleration": 10**400}, ["not a finite number of m/s2"]),
        ({"maneuver": "wait", "acceleration": [1.0]}, ["not an object of type list"]),
        (Command("stop"), ["'stop' is not a maneuver"]),  # type: ignore[arg-type]
        (Command(Maneuver.WAIT, math.nan), ["nan, not a finite number"]),
        ("x" * 5000, ["is not a maneuver"]),
    ],
    ids=lambda value: type(value).__name__,
)
def test_what_is_no_command_is_refused_with_what_is_expected(
    action: object, told: list[str]
) -> None:
    with pytest.raises(ActionError) as caught:
        Command.of(action)
    message = str(caught.value)
    for part in told:
        assert part in message
    assert len(message) < 400
    assert "0x" not in message, "an address differs between processes and would enter the digest"


def test_emergency_brake_is_full_braking_wherever_the_car_is() -> None:
    for to_line in (-10.0, 0.0, 50.0):
        for speed in (0.0, 3.0, 10.0):
            assert asked("emergency_brake", speed, to_line) == -MAX_BRAKING


@pytest.mark.parametrize(
    "name, target, limit",
    [("proceed_cautiously", 5.0, 1.5), ("proceed", 9.0, 2.0), ("accelerate", 10.0, 3.5)],
)
def test_driving_on_tracks_a_speed(name: str, target: float, limit: float) -> None:
    assert asked(name, 0.0) == limit
    assert asked(name, target) == 0.0
    assert asked(name, target - 0.5) == pytest.approx(0.5)
    assert asked(name, target + 0.5) == pytest.approx(-0.5)
    assert asked(name, target + 9.0) == -COMFORT_BRAKING
    assert asked(name, 0.0, -5.0) == limit, "the stop line is no matter"


def rolled(name: str, speed: float, to_line: float) -> tuple[float, float]:
    """Where a point mass under this maneuver comes to stand, and its hardest braking."""
    hardest, dt = 0.0, 0.02
    for _ in range(3000):
        a = asked(name, speed, to_line)
        hardest = min(hardest, a)
        new = max(speed + a * dt, 0.0)
        to_line -= (speed + new) / 2 * dt
        speed = new
    assert speed < 0.05
    return to_line, hardest


@pytest.mark.parametrize("name", ["wait", "yield"])
def test_wait_and_yield_stop_before_the_line(name: str) -> None:
    for speed in (0.0, 3.0, 8.0, 10.0):
        for to_line in (8.0, 20.0, 45.0):
            left, hardest = rolled(name, speed, to_line)
            assert 0.0 < left < 2.5
            assert hardest >= -MAX_BRAKING


def test_yield_approaches_no_faster_than_wait_and_at_walking_pace() -> None:
    assert asked("yield", 6.0, 60.0) == pytest.approx(-2.0)
    for speed in np.linspace(0.0, 10.0, 21):
        assert asked("yield", speed, 40.0) <= asked("wait", speed, 40.0)


@pytest.mark.parametrize("name", ["wait", "yield"])
def test_past_the_point_of_no_return_they_brake_comfortably(name: str) -> None:
    assert asked(name, 8.0, -1.0) == -COMFORT_BRAKING
    assert asked(name, 10.0, 2.0) == -COMFORT_BRAKING, "6.25 m are needed"


def test_a_given_acceleration_is_used_within_the_envelope() -> None:
    for name in NAMES:
        assert asked(name, 5.0, 20.0, 1.25) == 1.25
        assert asked(name, 5.0, 20.0, 99.0) == MAX_ACCELERATION
        assert asked(name, 5.0, 20.0, -99.0) == -MAX_BRAKING


def test_stop_at_holds_once_there() -> None:
    assert stop_at(0.2, 0.0) == -COMFORT_BRAKING
    assert stop_at(-2.0, 1.0) == -2.0 * COMFORT_BRAKING
    assert stop_at(50.0, 0.0) > 0.0


@settings(derandomize=True, deadline=None, max_examples=300)
@given(
    name=st.sampled_from(NAMES),
    given_acceleration=st.none() | st.floats(allow_nan=False, allow_infinity=False),
    speed=st.floats(0.0, 40.0),
    to_line=st.floats(-300.0, 300.0),
)
def test_no_command_leaves_the_envelope(
    name: str, given_acceleration: float | None, speed: float, to_line: float
) -> None:
    found = asked(name, speed, to_line, given_acceleration)
    assert -MAX_BRAKING <= found <= MAX_ACCELERATION


@settings(derandomize=True, deadline=None, max_examples=200)
@given(
    st.recursive(
        st.none()
        | st.booleans()
        | st.floats()
        | st.integers()
        | st.text(max_size=8)
        | st.sampled_from([*NAMES, "maneuver", "acceleration"]),
        lambda inner: (
            st.lists(inner, max_size=2)
            | st.dictionaries(st.sampled_from(["maneuver", "acceleration", "x"]), inner, max_size=3)
        ),
        max_leaves=6,
    )
)
def test_anything_is_a_command_or_refused_as_one(action: object) -> None:
    try:
        command = Command.of(action)
    except ActionError:
        return
    assert isinstance(command.maneuver, Maneuver)
    assert command.acceleration is None or math.isfinite(command.acceleration)
    assert Command.of(command) == command
