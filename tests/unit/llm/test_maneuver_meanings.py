"""What the prompt says of each maneuver, held to what carrying it out does."""

from __future__ import annotations

import re

import pytest
from models import llm_episode, said

from pytest_dura.driving import Command, Maneuver
from pytest_dura.driving.bodies import CAR_LENGTH, CAR_WIDTH
from pytest_dura.driving.maneuvers import (
    COMFORT_BRAKING,
    MAX_ACCELERATION,
    MAX_BRAKING,
    acceleration_for,
)
from pytest_dura.llm import MANEUVERS, driving_templates
from pytest_dura.llm.driving.planner import TEMPLATES

DT = 0.1
FAR = 150.0


def drive(maneuver: str, speed: float, to_line: float, seconds: float = 60.0):
    """Speeds and accelerations of a car, and how far before the line it ends."""
    speeds, accelerations = [speed], []
    for _ in range(round(seconds / DT)):
        accelerations.append(acceleration_for(Command(Maneuver(maneuver)), speed, to_line))
        after = max(speed + accelerations[-1] * DT, 0.0)
        to_line -= (speed + after) / 2 * DT
        speed = after
        speeds.append(speed)
    return speeds, accelerations, to_line


def numbers(maneuver: str) -> list[float]:
    """The numbers in a maneuver's meaning, without those of units."""
    return [float(found) for found in re.findall(r"[\d.]+(?= m/s\b| m/s2)", MANEUVERS[maneuver])]


def test_wait_rolls_up_to_the_line_as_fast_as_told_and_stands_before_it() -> None:
    top, gain, _ = numbers("wait")
    speeds, accelerations, left = drive("wait", 0.0, FAR)
    assert max(speeds) == pytest.approx(top, abs=0.1)
    assert max(accelerations) == gain
    assert speeds[-1] < 0.05
    assert 0.0 < left < 1.0


def test_yield_is_that_at_the_speed_told_to_which_it_brakes_at_once() -> None:
    top, brake = numbers("yield")
    speeds, _, left = drive("yield", 0.0, FAR)
    assert max(speeds) == pytest.approx(top, abs=0.1)
    assert 0.0 < left < 1.0
    _, (first, *_), _ = drive("yield", 9.0, FAR)
    assert first == -brake


@pytest.mark.parametrize("maneuver", ["wait", "yield"])
@pytest.mark.parametrize("speed, to_line", [(5.0, -3.0), (9.0, 4.0)])
def test_past_the_line_or_too_near_to_stop_both_brake_as_told(maneuver, speed, to_line) -> None:
    brake = numbers(maneuver)[-1]
    _, (first, *_), _ = drive(maneuver, speed, to_line)
    assert first == -brake


@pytest.mark.parametrize("maneuver", ["proceed_cautiously", "proceed", "accelerate"])
def test_the_others_drive_at_the_speed_told_with_no_more_than_told(maneuver) -> None:
    target, gain = numbers(maneuver)[:2]
    brake = float(MANEUVERS[maneuver].rsplit(" ", 1)[-1])
    speeds, accelerations, _ = drive(maneuver, 0.0, FAR)
    assert speeds[-1] == pytest.approx(target, abs=0.1)
    assert max(accelerations) == gain
    _, slower, _ = drive(maneuver, 20.0, FAR)
    assert min(slower) == -brake


def test_emergency_brake_brakes_as_told_and_stands() -> None:
    (brake,) = numbers("emergency_brake")
    speeds, accelerations, _ = drive("emergency_brake", 9.0, FAR, 3.0)
    assert set(accelerations) == {-brake}
    assert speeds[-1] == 0.0


def system(templates=None, wording: str = "") -> str:
    from pytest_dura.llm import Prompt

    return (templates or driving_templates()).messages(Prompt((), wording=wording))[0].text


@pytest.mark.parametrize("wording", ["", "paraphrased"])
def test_the_car_is_told_as_it_is(wording) -> None:
    text = system(wording=wording)
    car = next(line for line in text.splitlines() if str(CAR_LENGTH) in line)
    for value in (CAR_LENGTH, CAR_WIDTH, MAX_ACCELERATION, MAX_BRAKING, COMFORT_BRAKING):
        assert f"{value} m" in car or f" {value}" in car


@pytest.mark.parametrize("every, hold", [(10, "1.0 s"), (5, "0.5 s"), (3, "0.3 s")])
@pytest.mark.parametrize("clock", ["frozen", "realtime"])
def test_how_long_a_decision_holds_is_told(every, hold, clock) -> None:
    _, model = llm_episode(
        lambda *_: said(), {"decide_every": every, "clock": clock}, seconds=1.0
    )  # fmt: skip
    text = model.requests[0].messages[0].text
    assert f"A maneuver holds for {hold}" in text
    assert ("until your next answer" in text) == (clock == "realtime")
    assert hold in system(driving_templates(None, None, hold=every / 10), "paraphrased")


def test_the_user_can_leave_all_that_to_a_template_of_his_own(tmp_path) -> None:
    (tmp_path / "system.j2").write_text("{{ hold }} {{ waits }} {{ car.braking }} {{ later }}")
    assert TEMPLATES.joinpath("system.j2").exists()
    assert system(driving_templates(tmp_path, hold=0.5, waits=False)) == "0.5 0 8.0 20.0"
