"""Laws of monitors: alarms tick by tick, and what they are worth as warnings of a violation."""

from __future__ import annotations

from collections import Counter
from itertools import accumulate
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from loops import Says, doing, run_loop

from pytest_dura import Assessed, Assessment, EpisodeVerdict, Proposal, SafetyMonitor
from pytest_dura.requirements import MonitorTimeline, judge_monitor, monitor_timeline
from pytest_dura.requirements.monitoring.quality import Stretch

STEP = 0.1
TICKS = 30
TIMES = [0.0, *accumulate([STEP] * TICKS)]
"""As a simulator adds them up: not the nearest floats to whole tenths."""

ticks = st.sets(st.integers(0, TICKS - 1), max_size=8)


def stretches(standing: set[int]) -> tuple[Stretch, ...]:
    """Neighbouring ticks together, each stretch with its first and its last time."""
    first = [tick for tick in sorted(standing) if tick - 1 not in standing]
    last = [tick for tick in sorted(standing) if tick + 1 not in standing]
    return tuple((TIMES[a], TIMES[b]) for a, b in zip(first, last, strict=True))


def spread(starts: set[int], length: int) -> set[int]:
    """Alarms that stand for so many ticks."""
    return {tick for start in starts for tick in range(start, min(start + length, TICKS))}


@settings(derandomize=True, deadline=None, max_examples=300)
@given(ticks, st.integers(1, 6), st.integers(0, TICKS - 1), st.integers(1, 12))
def test_an_alarm_warns_if_it_stands_within_the_horizon_before_the_violation(
    starts: set[int], length: int, violated_at: int, horizon: int
) -> None:
    standing = spread(starts, length)
    verdict = EpisodeVerdict(
        "R", "case#0", "planner", "violated", -1.0, TIMES[violated_at], "", 10, 10
    )
    seen = MonitorTimeline(
        "case#0", "planner", "valid", TIMES[-1], {"monitor": stretches(standing)}
    )
    result = judge_monitor("monitor", [(verdict, seen)], horizon=horizon * STEP)

    warning = [tick for tick in standing if violated_at - horizon <= tick < violated_at]
    assert (result.true_positives, result.false_negatives) == (bool(warning), not warning)
    begun = [tick for tick in standing if tick - 1 not in standing]
    if warning:
        first = max(tick for tick in begun if tick <= min(warning))
        lead = min(violated_at - first, horizon) * STEP
        assert result.lead_times == (pytest.approx(lead),)
    else:
        late = any(tick >= violated_at for tick in begun)
        assert result.late == late
        assert result.early == (bool(standing) and not late)


@settings(derandomize=True, deadline=None, max_examples=60)
@given(st.lists(ticks, min_size=1, max_size=6))
def test_without_a_violation_each_alarm_is_a_false_one(several: list[set[int]]) -> None:
    pairs = [
        (
            EpisodeVerdict("R", f"case#{run}", "planner", "satisfied", 1.0, None, "", 10, 10),
            MonitorTimeline(
                f"case#{run}", "planner", "valid", 3.0, {"monitor": stretches(standing)}
            ),
        )
        for run, standing in enumerate(several)
    ]
    result = judge_monitor("monitor", pairs)
    counts = Counter(bool(standing) for standing in several)
    assert (result.false_positives, result.true_negatives) == (counts[True], counts[False])
    assert result.false_alarms == sum(len(stretches(standing)) for standing in several)
    assert result.hours == pytest.approx(3.0 * len(several) / 3600)


@settings(derandomize=True, deadline=None, max_examples=40)
@given(st.sets(st.integers(0, 9)), st.sets(st.integers(0, 9), min_size=1))
def test_an_alarm_stands_until_the_monitor_is_asked_again_and_takes_it_back(
    unsafe: set[int], asked: set[int]
) -> None:
    def assess(view: Any) -> Assessment:
        return Assessment(Assessed.UNSAFE if view.index in unsafe else Assessed.SAFE, 0.0)

    monitor = doing(SafetyMonitor, assess, trigger=lambda _, view: view.index in asked)
    heating = Says(lambda _: Proposal(1.0))
    episode = run_loop(heating, seconds=1.0, policy="log_only", safety_monitor=monitor)
    standing, expected = False, set()
    for tick in range(episode.ticks):
        if tick in asked:
            standing = tick in unsafe
        if standing:
            expected.add(tick)
    alarms = monitor_timeline(episode).alarms["safety_monitor"]
    assert alarms == tuple(
        (pytest.approx(first), pytest.approx(last)) for first, last in stretches(expected)
    )
