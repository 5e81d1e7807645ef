"""Measures of a driving episode: one number each, NaN where there is none."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from handmade import handmade
from roads import always, drive, run, spec_of_drive

from pytest_dura import ConfigurationError, Episode, RoleSpec
from pytest_dura.core import Generator, GeneratorView, Proposal
from pytest_dura.driving import Command, Maneuver, clearance_time, route
from pytest_dura.driving.measures import minimum_gap, peak_deceleration, time_stopped
from pytest_dura.driving.measures.comfort import uncomfortable

MEASURES = (clearance_time, minimum_gap, peak_deceleration, time_stopped)


def episode(*, dt: float = 0.5, **signals: Any) -> Episode:
    return handmade(len(next(iter(signals.values()))), dt=dt, **signals)


class Stopper(Generator):
    """Brakes to a stand within 2 s, stands, and drives on after 4 s."""

    def propose(self, view: GeneratorView) -> Proposal:
        view.percept["odometry"]
        if view.time < 4.0:
            return Proposal(Command(Maneuver.EMERGENCY_BRAKE, -5.0))
        return Proposal(Command(Maneuver.PROCEED, 3.0))


def test_the_clearance_time_is_when_it_cleared_first() -> None:
    assert clearance_time(episode(cleared=[0, 0, 1, 1])) == 1.0
    assert clearance_time(episode(cleared=[1, 1])) == 0.0
    assert math.isnan(clearance_time(episode(cleared=[0, 0, 0])))


def test_the_minimum_gap_is_the_least_there_ever_was() -> None:
    assert minimum_gap(episode(gap=[50.0, 3.0, 0.5, 7.0])) == 0.5
    assert minimum_gap(episode(gap=[4.0, 0.0])) == 0.0


def test_the_peak_deceleration_is_positive_and_zero_for_who_never_slows_down() -> None:
    assert peak_deceleration(episode(acceleration=[1.0, -2.0, -6.5, 3.0])) == 6.5
    assert peak_deceleration(episode(acceleration=[1.0, 2.0])) == 0.0
    assert str(peak_deceleration(episode(acceleration=[0.0]))) == "0.0"


def test_the_time_stopped_adds_up_all_stands_each_until_the_next_tick() -> None:
    assert time_stopped(episode(speed=[5.0, 0.05, 0.0, 3.0, 0.0, 0.1, 2.0])) == 1.5
    assert time_stopped(episode(speed=[5.0, 0.0])) == 0.0


def test_an_episode_without_ticks_has_no_values() -> None:
    empty = episode(cleared=[], gap=[], acceleration=[], speed=[])
    assert all(math.isnan(measure(empty)) for measure in MEASURES)


@pytest.mark.parametrize("measure", MEASURES)
def test_another_domain_is_told_which_signal_it_lacks(measure: Any) -> None:
    with pytest.raises(ConfigurationError, match="has no signal"):
        measure(episode(temperature=[1.0, 2.0]))


@pytest.mark.parametrize("felt, expected", [([], None), ([0.1, 1.0], False), ([1.01, 0.1], True)])
def test_comfort_fails_where_a_limit_is_passed_and_an_oracle_measures_it(
    felt: list[float], expected: bool | None
) -> None:
    driven = episode(speed=[1.0, 2.0])
    if felt:
        driven.metrics.performance["discomfort"] = ([0.0, 0.1], felt)
    assert uncomfortable(driven) is expected


def test_they_measure_a_real_drive() -> None:
    world = {"ego": {"speed": 8.0, "distance": 30.0}}
    spec = spec_of_drive(world, generator=RoleSpec.of(Stopper), duration=15.0)
    found = run(spec)
    assert found.metrics.valid_proposals == found.metrics.proposals > 0
    assert peak_deceleration(found) == pytest.approx(5.0, abs=0.5)
    assert 1.5 < time_stopped(found) < 3.0
    assert 4.0 < clearance_time(found) < 15.0
    at = round(clearance_time(found) / 0.1)
    assert found.signal("cleared")[at - 1 : at + 1].tolist() == [0.0, 1.0]
    assert minimum_gap(found) == found.signal("gap").min()


def test_who_has_cleared_the_junction_has_cleared_it_wherever_it_is_pushed_to() -> None:
    simulator, ticks = drive({"ego": {"distance": 10.0, "speed": 8.0}}, 70, always("proceed"))
    there = simulator.signals(ticks)["cleared"]
    assert (there[0], there[-1]) == (0.0, 1.0)
    assert (simulator.signals(ticks[::-1])["cleared"] == 1.0).all()
    first = ticks[int(np.argmax(there))].truth["ego"].s
    assert 0.0 <= first - 2.5 - route(0, "straight").exit < 1.5, "its rear has left"
