"""Exact bounds on a rate, against published figures and against scipy's own interval."""

from __future__ import annotations

import pytest
from scipy.stats import binomtest

from pytest_dura.requirements import lower_bound, runs_needed, upper_bound


def test_nothing_in_fifteen_runs_supports_18_percent() -> None:
    assert upper_bound(0, 15, 0.95) == pytest.approx(0.1810, abs=5e-5)
    assert upper_bound(0, 15, 0.95) == pytest.approx(1 - 0.05 ** (1 / 15), rel=1e-12)


@pytest.mark.parametrize(
    "at_most, violations, runs",
    [(0.1, 0, 29), (0.05, 0, 59), (0.01, 0, 299), (0.001, 0, 2995), (0.05, 1, 93), (0.05, 2, 124)],
)
def test_the_runs_that_a_rate_needs(at_most: float, violations: int, runs: int) -> None:
    assert runs_needed(at_most, 0.95, violations) == runs
    assert upper_bound(violations, runs, 0.95) <= at_most
    assert upper_bound(violations, runs - 1, 0.95) > at_most


@pytest.mark.parametrize("k, n", [(0, 1), (1, 1), (3, 20), (7, 200), (199, 200), (200, 200)])
@pytest.mark.parametrize("confidence", [0.9, 0.95, 0.99])
def test_the_bounds_are_clopper_and_pearsons(k: int, n: int, confidence: float) -> None:
    two_sided = binomtest(k, n).proportion_ci(2 * confidence - 1, method="exact")
    assert upper_bound(k, n, confidence) == pytest.approx(two_sided.high, rel=1e-9)
    assert lower_bound(k, n, confidence) == pytest.approx(two_sided.low, rel=1e-9)


@pytest.mark.parametrize("k, n, c", [(0, 0, 0.9), (2, 1, 0.9), (-1, 3, 0.9), (1, 3, 1.0)])
def test_counts_that_make_no_sense(k: int, n: int, c: float) -> None:
    for bound in (upper_bound, lower_bound):
        with pytest.raises(ValueError, match=r"is not a count|confidence lies between"):
            bound(k, n, c)
    with pytest.raises(ValueError, match="between 0 and 1"):
        runs_needed(0.0, 0.95)
