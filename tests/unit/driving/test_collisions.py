"""Who ran into whom, and what does not count as the ego's collision."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from roads import always, bodies_at, drive, events_of

from pytest_dura.core import Tick
from pytest_dura.driving import Command, HighwaySimulator, Maneuver, box_gap
from pytest_dura.driving.highway import WRECK_TIME


def go_until(s: float) -> Callable[[Tick], Command]:
    """Accelerate up to there, then brake and stand."""

    def act(tick: Tick) -> Command:
        going = tick.truth["ego"].s < s
        return Command(Maneuver.ACCELERATE if going else Maneuver.EMERGENCY_BRAKE)

    return act


def crossing(
    arm: str, distance: float, courtesy: str = "none", speed: float = 5.0
) -> dict[str, Any]:
    return {
        "ego": {"distance": 10.0, "speed": speed},
        "courtesy": courtesy,
        "vehicles": [{"id": "X", "arm": arm, "distance": distance, "speed": 8.0}],
    }


def gap_to(tick: Tick, name: str) -> float:
    """The distance of the footprints themselves, whatever the signal says."""
    ego, body = tick.truth["ego"], bodies_at(tick).get(name)
    assert body is not None
    mine = np.array([[ego.x, ego.y, ego.heading, 5.0, 2.0]])
    other = np.array([[body.x, body.y, body.heading, body.length, body.width]])
    return float(box_gap(mine, other)[0])


def check_contact(simulator: HighwaySimulator, ticks: list[Tick], code: int, partner: str) -> str:
    """What holds at every collision; returns the event's detail."""
    signals = simulator.signals(ticks)
    last = len(ticks) - 1
    assert ticks[-1].truth["contact"] == code
    assert signals["collided"].tolist() == [0.0] * last + [1.0]
    assert signals["struck"].tolist() == [0.0] * last + [float(code >= 2)]
    assert signals["struck_standing"].tolist() == [0.0] * last + [float(code == 3)]
    assert signals["gap"][-1] == signals["ttc"][-1] == 0.0
    assert (signals["gap"][:-1] > 0.0).all()
    assert gap_to(ticks[-1], partner) == 0.0, "a contact is an overlap of the footprints"
    ((index, subject, detail),) = events_of(ticks, "collision")
    assert (index, subject) == (last, partner)
    assert ticks[-1].critical == detail
    assert f"{ticks[-2].truth['ego'].speed:.1f} m/s" in detail, "the speed just before"
    assert not events_of(ticks, "background_crash")
    return detail


def test_the_ego_runs_into_a_car_ahead() -> None:
    slow = {"id": "AHEAD", "arm": "south", "distance": 32.0, "speed": 0.0}
    world = {"ego": {"distance": 42.0, "speed": 10.0}, "vehicles": [slow]}
    simulator, ticks = drive(world, 50, always("accelerate"))
    detail = check_contact(simulator, ticks, 1, "AHEAD")
    assert "ran into AHEAD" in detail
    assert "on its front, outside the conflict zone" in detail


def test_the_ego_runs_into_a_pedestrian() -> None:
    world = {"ego": {"distance": 50.0, "speed": 8.0}, "pedestrians": [{"id": "P1", "start": 1.6}]}
    simulator, ticks = drive(world, 80, always("accelerate"))
    detail = check_contact(simulator, ticks, 1, "P1")
    assert "ran into P1" in detail


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_pedestrian_is_hit_or_not_and_nothing_breaks(side: str) -> None:
    ends = set()
    for start in np.round(np.arange(0.2, 4.4, 0.3), 1).tolist():
        person = {"id": "P1", "start": start, "side": side}
        world = {"ego": {"distance": 50.0, "speed": 8.0}, "pedestrians": [person]}
        _, ticks = drive(world, 100, always("accelerate"))
        touched = min(gap_to(tick, "P1") for tick in ticks) == 0.0
        assert touched == (ticks[-1].critical is not None), start
        ends.add(touched)
    assert ends == {True, False}


def test_a_moving_ego_is_struck_on_its_side() -> None:
    world = crossing("west", 28.0)
    world["ego"] = {"distance": 30.0, "speed": 8.0}
    simulator, ticks = drive(world, 80, always("accelerate"))
    detail = check_contact(simulator, ticks, 2, "X")
    assert "was struck by X" in detail
    assert "on its left, inside the conflict zone" in detail


def test_an_ego_that_stands_in_the_conflict_zone_is_struck_without_courtesy() -> None:
    simulator, ticks = drive(crossing("east", 40.0), 80, go_until(106.0))
    detail = check_contact(simulator, ticks, 3, "X")
    assert "was struck while standing by X" in detail
    assert "on its right, inside the conflict zone" in detail
    assert "the ego (0.0 m/s)" in detail


def test_with_courtesy_the_same_driver_stops_for_it() -> None:
    _, ticks = drive(crossing("east", 40.0, "occupied"), 120, go_until(106.0))
    assert ticks[-1].critical is None
    body = bodies_at(ticks[-1]).get("X")
    assert body is not None
    assert abs(body.vx) < 0.1
    assert gap_to(ticks[-1], "X") > 1.0


def test_a_rear_end_is_a_strike_from_behind() -> None:
    behind = {"id": "BEHIND", "arm": "south", "distance": 58.5, "speed": 10.0}
    world = {"ego": {"distance": 51.0, "speed": 2.0}, "vehicles": [behind]}
    simulator, ticks = drive(world, 60, always("emergency_brake"))
    assert ticks[-1].truth["contact"] == 3
    assert "on its rear, outside the conflict zone" in (ticks[-1].critical or "")
    assert simulator.signals(ticks)["struck"][-1] == 1.0


@pytest.mark.parametrize("code", [1, 2, 3])
def test_a_collision_is_told_once_and_stays(code: int) -> None:
    worlds = {
        1: (crossing("west", 6.0), always("accelerate")),
        2: (crossing("west", 14.0), go_until(106.0)),
        3: (crossing("east", 40.0), go_until(106.0)),
    }
    world, act = worlds[code]
    simulator, ticks = drive(world, 100, act)
    if ticks[-1].critical is None:
        pytest.fail("this situation was meant to end in a contact")
    for _ in range(10):  # stepping on is allowed
        ticks.append(simulator.step(Command(Maneuver.EMERGENCY_BRAKE)))
    assert len(events_of(ticks, "collision")) == 1
    signals = simulator.signals(ticks)
    assert set(signals["collided"][-11:]) == {1.0}
    assert set(signals["gap"][-11:]) == {0.0}


PILE_UP: dict[str, Any] = {
    "ego": {"distance": 80.0, "speed": 0.0},
    "vehicles": [
        {"id": "FRONT", "arm": "west", "distance": 40.0, "speed": 0.0},
        {"id": "BACK", "arm": "west", "distance": 47.0, "speed": 10.0},
    ],
}


def test_a_crash_of_others_is_an_event_of_its_own() -> None:
    simulator, ticks = drive(PILE_UP, 60, always("emergency_brake"))
    ((index, subject, detail),) = events_of(ticks, "background_crash")
    assert set(subject.split("+")) == {"FRONT", "BACK"}
    assert "not a collision of the ego" in detail
    assert not events_of(ticks, "collision")
    signals = simulator.signals(ticks)
    assert not signals["collided"].any()
    assert ticks[-1].critical is None
    assert (signals["background_crashes"] == (np.arange(len(ticks)) >= index)).all()


def test_a_wreck_is_cleared_away_after_three_seconds() -> None:
    _, ticks = drive(PILE_UP, 80, always("emergency_brake"))
    ((index, _, _),) = events_of(ticks, "background_crash")
    there = [{"FRONT", "BACK"} & set(bodies_at(tick).ids) for tick in ticks]
    cleared = index + round(WRECK_TIME / 0.1)
    assert WRECK_TIME == 3.0
    assert there[cleared - 1] == {"FRONT", "BACK"}
    assert not any(there[cleared:])


def test_a_pedestrian_run_over_by_others_is_cleared_away_too() -> None:
    world = {
        "ego": {"distance": 90.0, "speed": 0.0},
        "vehicles": [{"id": "W", "arm": "west", "distance": 40.0, "speed": 10.0}],
        "pedestrians": [{"id": "P", "arm": "west", "offset": 5.0, "start": 2.4, "speed": 3.0}],
    }
    _, ticks = drive(world, 100, always("emergency_brake"))
    ((index, subject, _),) = events_of(ticks, "background_crash")
    assert subject == "W+P"
    lying = [bodies_at(tick).get("P") for tick in ticks[index:]]
    assert lying[1].vx == lying[1].vy == 0.0  # type: ignore[union-attr]
    assert lying[29] is not None
    assert not any(lying[30:])


def test_the_ego_and_a_wreck_that_is_just_cleared_away_do_not_confuse_the_books() -> None:
    for distance in np.arange(60.0, 20.0, -2.0):
        world = {**PILE_UP, "ego": {"distance": float(distance), "speed": 10.0}}
        world["vehicles"] = [{**one, "arm": "south"} for one in PILE_UP["vehicles"]]
        world["vehicles"][0]["distance"], world["vehicles"][1]["distance"] = 12.0, 18.9
        _, ticks = drive(world, 70, always("accelerate"))
        assert len(events_of(ticks, "collision")) == (ticks[-1].critical is not None)


def test_pedestrians_stop_for_a_car_within_a_metre_and_go_on_behind_it() -> None:
    person = {"id": "P1", "arm": "south", "offset": 6.0, "side": "right", "start": 0.0}
    world = {"ego": {"distance": 6.0, "speed": 0.0}, "pedestrians": [person]}

    def wait_then_go(tick: Tick) -> Command:
        return Command(Maneuver.EMERGENCY_BRAKE if tick.index < 60 else Maneuver.PROCEED)

    _, ticks = drive(world, 150, wait_then_go)
    assert ticks[-1].critical is None
    gaps = [gap_to(tick, "P1") for tick in ticks]
    standing = bodies_at(ticks[59]).get("P1")
    assert standing is not None
    assert standing.vx == 0.0
    assert 0.5 < gaps[59] < 1.3
    assert min(gaps) > 0.3
    across = bodies_at(ticks[-1]).get("P1")
    assert across is not None
    assert across.x == pytest.approx(-5.0, abs=0.2), "it goes on when the car has left"
