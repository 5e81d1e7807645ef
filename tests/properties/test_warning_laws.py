"""Whether a monitor warned in time of a near miss: what counts as a warning, and as in time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from handmade import SPEC, handmade

from pytest_dura import DependabilityMetrics, RoleSpec
from pytest_dura.driving.warning import HORIZON, LEAD, warned_in_time

HELPED = replace(
    SPEC, roles={"generator": RoleSpec("a:Planner"), "recovery_planner": RoleSpec("a:Recovery")}
)
TICKS = 100
NEAR_FROM = 80
"""8 s, at 0.1 s a tick."""


def episode(*flags: int, gap: float = 0.4, spec=HELPED):
    """A near miss from 8 s on, if the gap is small, and an assessment at each tick."""
    metrics = DependabilityMetrics()
    for tick in range(TICKS):
        metrics.log_score("safety_monitor", tick * 0.1, 1.0)
    if flags:
        metrics.flags["safety_monitor"] = list(flags)
    column = [9.0] * NEAR_FROM + [gap] * (TICKS - NEAR_FROM)
    decisions = {"source": np.full(TICKS - 1, "proposal"), "attempts": np.zeros(TICKS - 1)}
    return handmade(TICKS, spec=spec, metrics=metrics, decisions=decisions, gap=column)


@pytest.mark.parametrize(
    "flags, margin",
    [
        ((75,), 0.0),  # exactly the lead
        ((76,), -0.1),
        ((), -LEAD),
        ((80, 81), -LEAD),  # at the very moment
        ((60, 61, 62), 1.5),
        ((60, 76), 1.5),  # that it was taken back in between does not make it later
        ((39,), -LEAD),  # taken back more than the horizon before: of something else
        (tuple(range(20, 80)), HORIZON - LEAD),
    ],
)
def test_a_warning_is_in_time_by_the_first_alarm_that_belongs_to_the_near_miss(flags, margin):
    found = warned_in_time(episode(*flags))
    assert found.margin == pytest.approx(margin, abs=1e-9)
    assert found.holds == (margin >= 0)
    assert found.time == pytest.approx(8.0)


def test_the_worst_of_several_near_misses_counts():
    run = episode(20)
    run.signals["gap"][30:35] = 0.3
    assert warned_in_time(run).time == pytest.approx(8.0)
    assert not warned_in_time(run).holds


def test_half_a_metre_is_no_near_miss():
    assert warned_in_time(episode(gap=0.5)).holds


@pytest.mark.parametrize("spec", [SPEC, replace(HELPED, policy="log_only")])
def test_where_no_recovery_acts_each_near_miss_is_one_to_warn_of(spec):
    assert not warned_in_time(episode(60, spec=spec)).holds
    assert warned_in_time(episode(60, gap=0.6, spec=spec)).holds
