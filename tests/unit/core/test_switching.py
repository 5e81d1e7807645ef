"""Switching: who was in control, how often that changed, and how long until it was safe again."""

from __future__ import annotations

from typing import Any

import pytest
from handmade import decided
from loops import Says, doing, run_loop
from thermostat import HeatMonitor, Overheater, SwitchOff

from pytest_dura import Assessed, Assessment, Episode, Proposal, SafetyMonitor
from pytest_dura.core import switching
from pytest_dura.core.loop_signals import Switching


def episode(sources: str, verdicts: str | None = None, *, dt: float = 0.5) -> Episode:
    """One letter per decision: p, r or f; verdicts 0, 1, 2, by default 2 where recovery acts."""
    verdicts = verdicts or sources.translate(str.maketrans("prf", "020"))
    return decided(sources, verdicts, dt=dt)


def unsafe_at(*ticks: int) -> Any:
    return doing(
        SafetyMonitor,
        lambda view: Assessment(Assessed.UNSAFE if view.index in ticks else Assessed.SAFE, 0.0),
    )


def test_a_component_that_is_never_refused_keeps_control() -> None:
    found = switching(episode("ppfp"))
    assert found == Switching(4, 0, 0.0, 0, 0, (), 0.0, 0, 0)
    assert (found.share, found.switches, found.censored) == (0.0, 0, 0)


def test_each_direction_of_a_change_of_control_is_counted() -> None:
    found = switching(episode("prrprp"))
    assert (found.takeovers, found.returns, found.switches) == (2, 2, 4)
    assert (found.decisions, found.recovered, found.share) == (6, 3, 0.5)
    assert found.recovery_time == 1.5
    assert found.time_to_safe == (1.0, 0.5)


def test_recovery_at_the_first_tick_has_taken_over_there() -> None:
    found = switching(episode("rp"))
    assert (found.takeovers, found.returns, found.time_to_safe) == (1, 1, (0.5,))


def test_a_stretch_that_the_episode_cuts_is_censored_not_zero() -> None:
    found = switching(episode("rpprr"))
    assert (found.takeovers, found.returns) == (2, 1)
    assert found.time_to_safe == (0.5, None)
    assert found.censored == 1


def test_a_warning_is_acceptable_and_an_unsafe_proposal_is_not_whoever_acts() -> None:
    assert switching(episode("rrrp", "2210")).time_to_safe == (1.0,)
    assert switching(episode("rffp", "2220")).time_to_safe == (1.5,)


def test_the_tick_of_the_takeover_itself_does_not_end_it() -> None:
    assert switching(episode("rrp", "020")).time_to_safe == (1.0,)


def test_an_episode_without_decisions_has_no_share() -> None:
    found = switching(episode(""))
    assert (found.decisions, found.share, found.time_to_safe) == (0, None, ())


def test_figures_follow_from_the_counts() -> None:
    found = switching(episode("prrprpr"))
    assert (found.share, found.switches, found.censored) == (4 / 7, 5, 1)
    assert found.time_to_safe == (1.0, 0.5, None)


def test_a_real_loop_switches_where_the_monitor_says_so() -> None:
    found = switching(
        run_loop(
            Says(lambda view: Proposal(1.0)),
            safety_monitor=unsafe_at(2, 3, 6),
            recovery_planner=SwitchOff(),
        )
    )
    assert (found.decisions, found.recovered) == (10, 3)
    assert (found.takeovers, found.returns) == (2, 2)
    assert found.time_to_safe == pytest.approx((0.2, 0.1))
    assert found.recovery_time == pytest.approx(0.3)


def test_it_agrees_with_the_recoveries_that_the_loop_counted() -> None:
    episode = run_loop(
        Overheater(),
        seconds=8.0,
        safety_monitor=HeatMonitor(limit=16.0),
        recovery_planner=SwitchOff(),
    )
    found, counted = switching(episode), episode.metrics.recoveries
    assert found.takeovers == len(counted) > 2
    assert found.recovered == sum(last - first + 1 for first, last, _ in counted)
    ended = [last < episode.ticks - 2 for _, last, _ in counted]
    assert [seconds is not None for seconds in found.time_to_safe] == ended
    lengths = [(last - first + 1) * 0.1 for first, last, _ in counted]
    assert [s for s in found.time_to_safe if s is not None] == pytest.approx(
        [length for length, over in zip(lengths, ended, strict=True) if over]
    )


def test_without_a_recovery_nobody_takes_over() -> None:
    episode = run_loop(Overheater(), policy="log_only", safety_monitor=unsafe_at(1, 2))
    assert switching(episode) == Switching(10, 0, 0.0, 0, 0, (), 0.0, 0, 0)
