"""The laws of the two-sided CUSUM test."""

from __future__ import annotations

import math
from itertools import accumulate

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pytest_dura.driving.roles.residuals import Cusum

LAWS = settings(derandomize=True, deadline=None, max_examples=100)
drifts = st.floats(0.0, 10.0)
thresholds = st.floats(0.01, 100.0)
samples = st.lists(st.floats(-20.0, 20.0), max_size=60)


def alarms(drift: float, threshold: float, residuals: list[float]) -> list[int]:
    test = Cusum(drift, threshold)
    return [index for index, residual in enumerate(residuals) if test.update(residual)]


@LAWS
@given(drifts, thresholds, st.lists(st.floats(-1.0, 1.0), max_size=60))
def test_what_stays_within_the_drift_never_alarms(drift, threshold, shares) -> None:
    assert alarms(drift, threshold, [share * drift for share in shares]) == []


@LAWS
@given(drifts, thresholds, st.floats(0.01, 50.0), st.sampled_from([1.0, -1.0]))
def test_a_lasting_shift_alarms_in_time_and_not_sooner(drift, threshold, more, sign) -> None:
    shift = sign * (drift + more)
    due = math.ceil(threshold / (abs(shift) - drift) * (1 - 1e-8))
    first = alarms(drift, threshold, [shift] * (due + 1))[0] + 1
    assert first in (due, math.ceil(threshold / (abs(shift) - drift)))


def test_rounding_costs_no_sample() -> None:
    # Step by step, as the test adds: `sum` compensates from Python 3.12 on.
    assert list(accumulate([0.1] * 8))[-1] < 0.8
    assert alarms(0.0, 0.8, [0.1] * 8) == [7]


@LAWS
@given(drifts, thresholds, samples)
def test_it_is_the_same_for_both_signs(drift, threshold, residuals) -> None:
    mirrored = [-residual for residual in residuals]
    assert alarms(drift, threshold, residuals) == alarms(drift, threshold, mirrored)


@LAWS
@given(drifts, thresholds, samples)
def test_it_begins_anew_after_an_alarm(drift, threshold, residuals) -> None:
    found = alarms(drift, threshold, residuals)
    if found:
        after = found[0] + 1
        assert found[1:] == [after + index for index in alarms(drift, threshold, residuals[after:])]


@LAWS
@given(drifts, thresholds, samples)
def test_it_alarms_where_pages_formula_says(drift, threshold, residuals) -> None:
    """Page's other form: the sum since the last alarm, above its least value so far."""
    expected, start = [], 0
    for index in range(len(residuals)):
        since = residuals[start : index + 1]
        highest = 0.0
        for sign in (1.0, -1.0):
            sums = [0.0]
            for residual in since:
                sums.append(sums[-1] + sign * residual - drift)
            highest = max(highest, sums[-1] - min(sums))
        if abs(highest - threshold) < 1e-6 * threshold:
            return  # the two forms round differently
        if highest >= threshold:
            expected.append(index)
            start = index + 1
    assert alarms(drift, threshold, residuals) == expected


@pytest.mark.parametrize("residual", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_alarms_at_once_and_leaves_nothing_behind(residual) -> None:
    test = Cusum(1.0, 5.0)
    test.update(5.0)
    assert test.update(residual)
    assert (test.upper, test.lower, test.level) == (0.0, 0.0, 0.0)


def test_the_level_is_the_share_of_the_threshold() -> None:
    test = Cusum(1.0, 8.0)
    test.update(-3.0)
    assert test.level == 0.25


@pytest.mark.parametrize(
    "drift, threshold", [(-0.1, 1.0), (1.0, 0.0), (1.0, -1.0), (math.nan, 1.0), (1.0, math.nan)]
)
def test_limits_that_are_none(drift, threshold) -> None:
    with pytest.raises(ValueError, match="drift must be at least 0"):
        Cusum(drift, threshold)
