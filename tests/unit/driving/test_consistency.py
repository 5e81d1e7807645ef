"""Whether what a simulator reports agrees with itself, as ``SIM-1`` asks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pytest_dura.campaign.runner import Runner
from pytest_dura.driving.consistency import consistent_signals

CASE = "intersection/conflicting-traffic"


@pytest.fixture(scope="module")
def episode():
    return Runner.of(generator="aggressive").run(CASE)


def reporting(episode, **columns):
    return replace(episode, signals={**episode.signals, **columns})


def test_sound_simulators_agree_however_they_integrate(episode) -> None:
    assert consistent_signals(episode).margin == pytest.approx(1.0)
    speed, step = episode.signal("speed"), np.diff(episode.time)
    for mean in (speed[1:], speed[:-1], (speed[1:] + speed[:-1]) / 2):
        progress = np.concatenate([[0.0], np.cumsum(mean * step)])
        assert consistent_signals(reporting(episode, progress=progress)).holds


@pytest.mark.parametrize("factor", [-1.0, 1.5])
@pytest.mark.parametrize(
    "signal, seen",
    [
        ("speed", "speed is not what percepts show"),
        ("acceleration", "speed does not change by acceleration"),
        ("progress", "progress does not change by speed"),
        ("jerk", "acceleration does not change by jerk"),
        ("gap", "gap is not what percepts show"),
        ("leader_gap", "leader_gap is not what percepts show"),
        ("ttc", "ttc leaves its range"),
        ("priority_arrival", "priority_arrival leaves its range"),
        ("cleared", "cleared leaves its range"),
    ],
)
def test_a_signal_of_the_wrong_sign_or_unit_is_seen(episode, signal, seen, factor) -> None:
    found = consistent_signals(reporting(episode, **{signal: factor * episode.signal(signal)}))
    assert not found.holds
    assert found.margin < 0.0
    assert seen in found.detail


@pytest.mark.parametrize("factor", [0.8, 1.2])
def test_a_clock_that_is_off_is_seen(episode, factor) -> None:
    found = consistent_signals(replace(episode, time=factor * episode.time))
    assert not found.holds
    assert "progress does not change by speed" in found.detail


def test_a_gap_that_is_a_little_too_large_is_seen(episode) -> None:
    found = consistent_signals(reporting(episode, gap=episode.signal("gap") + 0.3))
    assert not found.holds
    assert "gap is not what percepts show: off by 0.3, 0.1 allowed" in found.detail
    assert found.time == 0.0


def test_what_a_fault_shows_to_sensors_is_no_defect_of_the_simulator() -> None:
    episode = Runner.of().run(f"{CASE}+gain")
    apart = np.abs(episode.signal("percept.speed") - episode.signal("speed"))
    assert apart.max() > 0.1
    assert consistent_signals(episode).holds
    earlier = replace(episode, faults=())
    assert not consistent_signals(earlier).holds


def test_what_a_sensor_does_not_know_hides_no_difference(episode) -> None:
    """A value that is not a number is one of the truth's faults, and none of a sensor's."""
    unknown = episode.signal("percept.gap").copy()
    unknown[:3] = np.nan
    assert consistent_signals(reporting(episode, **{"percept.gap": unknown})).holds
    wrong = {"percept.gap": unknown, "gap": 0.7 * episode.signal("gap")}
    assert "gap is not what percepts show" in consistent_signals(reporting(episode, **wrong)).detail
    speed = episode.signal("speed").copy()
    speed[5] = np.nan
    assert not consistent_signals(reporting(episode, speed=speed)).holds


@pytest.mark.parametrize("ticks", [0, 1, 2, 5])
def test_short_episodes_are_compared_as_far_as_they_go(episode, ticks) -> None:
    short = {name: column[:ticks] for name, column in episode.signals.items()}
    found = consistent_signals(replace(episode, time=episode.time[:ticks], signals=short))
    assert (found.holds, found.vacuous) == (True, ticks == 0)
    percepts = {name: column[: len(column) - 1] for name, column in episode.signals.items()
                if name.startswith("percept.")}  # fmt: skip
    assert consistent_signals(reporting(episode, **percepts)).holds


def test_nothing_to_compare_is_vacuous(episode) -> None:
    found = consistent_signals(replace(episode, signals={}))
    assert (found.holds, found.vacuous) == (True, True)
