"""A simulation study: looking after every episode, no method errs more often than it says.

Each point is 10,000 synthetic campaigns; a share may exceed its level by what a binomial count of
exactly that level exceeds once in a thousand studies. The seeds are fixed. That the study can fail
is shown with the bound for a fixed number of episodes, looked at after each of them.
"""

from __future__ import annotations

import numpy as np
import pytest
from characteristics import Boundaries, operating_characteristics, simulate
from scipy.stats import binom

from pytest_dura.requirements import METHODS, lower_bound, make_test, upper_bound
from pytest_dura.requirements.sequential import error_level

CAMPAIGNS, BUDGET = 10_000, 600


def allowance(level):
    """The share that a test of exactly this level exceeds in one study of a thousand."""
    return binom.ppf(0.999, CAMPAIGNS, level) / CAMPAIGNS


def boundaries(method, limit, confidence):
    p0 = limit / 5 if method == "sprt" else None
    return Boundaries.of(make_test(method, limit, confidence, p0=p0, planned=BUDGET), BUDGET)


def generator(*point):
    return np.random.default_rng([round(1000 * value) for value in point])


class Peeking:
    """What users do: the bounds for a fixed number of episodes, looked at after each of them."""

    def __init__(self, limit, confidence):
        self.limit, self.confidence = limit, confidence

    def verdict(self, violations, episodes):
        if upper_bound(violations, episodes, self.confidence) <= self.limit:
            return "supported"
        lower = lower_bound(violations, episodes, self.confidence)
        return "violated" if lower > self.limit else None


@pytest.mark.parametrize("confidence", [0.95, 0.9])
@pytest.mark.parametrize("limit", [0.05, 0.1])
@pytest.mark.parametrize("method", METHODS)
def test_no_rate_at_or_above_the_limit_is_supported_too_often(method, limit, confidence) -> None:
    table, level = boundaries(method, limit, confidence), error_level(confidence)
    for times in (1.0, 1.5, 2.0, 4.0):
        rate = times * limit
        found = simulate(table, rate, CAMPAIGNS, generator(limit, confidence, times))
        assert found.supported <= allowance(level), times
        assert operating_characteristics(table, rate, BUDGET).supported <= level, times


@pytest.mark.parametrize("confidence", [0.95, 0.9])
@pytest.mark.parametrize("limit", [0.05, 0.1])
@pytest.mark.parametrize("method", METHODS)
def test_no_rate_that_ought_to_pass_is_violated_too_often(method, limit, confidence) -> None:
    table, level = boundaries(method, limit, confidence), error_level(confidence)
    greatest = limit / 5 if method == "sprt" else limit
    for times in (0.25, 0.5, 1.0):
        rate = times * greatest
        found = simulate(table, rate, CAMPAIGNS, generator(limit, confidence, times, 1))
        assert found.violated <= allowance(level), times
        assert operating_characteristics(table, rate, BUDGET).violated <= level, times


@pytest.mark.parametrize("confidence", [0.95, 0.9])
@pytest.mark.parametrize("limit", [0.05, 0.1])
def test_the_study_finds_out_who_peeks(limit, confidence) -> None:
    table, level = Boundaries.of(Peeking(limit, confidence), BUDGET), error_level(confidence)
    found = simulate(table, limit, CAMPAIGNS, generator(limit, confidence))
    assert found.supported > 2 * allowance(level)
    assert found.violated > 2 * allowance(level)


@pytest.mark.parametrize("episodes, share", [(100, 0.075), (200, 0.117), (500, 0.183)])
def test_peeking_certifies_a_component_at_the_limit_ever_more_often(episodes, share) -> None:
    """With certifying alone, as a campaign that goes on past what looks like a violation."""

    class CertifyOnly(Peeking):
        def verdict(self, violations, episodes):
            found = super().verdict(violations, episodes)
            return found if found == "supported" else None

    table = Boundaries.of(CertifyOnly(0.05, 0.95), episodes)
    found = operating_characteristics(table, 0.05, episodes)
    assert found.supported == pytest.approx(share, abs=5e-4)


@pytest.mark.parametrize("method", METHODS)
def test_a_budget_that_ends_leaves_the_campaign_undecided(method) -> None:
    short, p0 = 28, 0.01 if method == "sprt" else None
    test = make_test(method, 0.05, 0.95, p0=p0, planned=short)
    found = simulate(Boundaries.of(test, short), 0.01, CAMPAIGNS, generator(0.01))
    assert found.supported == 0.0
    assert found.violated < 0.05
    assert found.undecided == pytest.approx(1.0 - found.violated)
    for _ in range(short):
        test.update(False)
    assert test.decision is None
