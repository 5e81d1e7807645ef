"""The exact dynamic programming, the boundary tables and the simulator tell the same."""

from __future__ import annotations

import math

import numpy as np
import pytest
from characteristics import Boundaries, operating_characteristics, simulate
from scipy.stats import binom

from pytest_dura.requirements import make_test
from pytest_dura.requirements.sequential import walk

BUDGET = 120


def fresh(method):
    p0 = 0.02 if method == "sprt" else None
    return make_test(method, 0.1, 0.9, p0=p0, planned=BUDGET)


METHODS = pytest.mark.parametrize("method", ["fixed", "sprt", "e-process"])


@METHODS
def test_the_table_decides_as_the_test_does(method) -> None:
    table, random, decisions = Boundaries.of(fresh(method), BUDGET), np.random.default_rng(7), set()
    for rate in (0.0, 0.02, 0.07, 0.1, 0.15, 0.3, 1.0) * 20:
        test = fresh(method)
        for _ in range(BUDGET):
            found = test.update(bool(random.random() < rate))
            assert found == table.verdict(test.violations, test.episodes)
            if found:
                break
        decisions.add(test.decision)
    assert decisions == {"supported", "violated", None}


@METHODS
def test_the_table_holds_every_count(method) -> None:
    test, table = fresh(method), Boundaries.of(fresh(method), BUDGET)
    for n in range(1, BUDGET + 1):
        for k in range(n + 1):
            assert table.verdict(k, n) == test.verdict(k, n), (k, n)


@METHODS
def test_the_probabilities_make_one(method) -> None:
    table = Boundaries.of(fresh(method), BUDGET)
    for rate in (0.0, 0.05, 0.1, 1.0):
        found = operating_characteristics(table, rate, BUDGET)
        total = found.supported + found.violated + found.undecided
        assert total == pytest.approx(1.0, abs=1e-12)
        decided = found.supported + found.violated
        assert found.decided[-1] == pytest.approx(decided, abs=1e-12)


@pytest.mark.parametrize("rate", [0.05, 0.1, 0.2])
def test_the_fixed_design_has_the_binomial_distributions_shares(rate) -> None:
    table = Boundaries.of(fresh("fixed"), BUDGET)
    found = operating_characteristics(table, rate, BUDGET)
    most, least = table.accept[-1], table.reject[-1]
    assert found.supported == pytest.approx(binom.cdf(most, BUDGET, rate), rel=1e-9)
    assert found.violated == pytest.approx(binom.sf(least - 1, BUDGET, rate), rel=1e-9)


@METHODS
@pytest.mark.parametrize("rate", [0.03, 0.1, 0.3])
def test_simulated_campaigns_agree_with_the_exact_shares(method, rate) -> None:
    table, campaigns = Boundaries.of(fresh(method), BUDGET), 4000
    exact = operating_characteristics(table, rate, BUDGET)
    found = simulate(table, rate, campaigns, np.random.default_rng(3))
    for name in ("supported", "violated", "undecided"):
        share = getattr(exact, name)
        deviation = math.sqrt(share * (1 - share) / campaigns)
        assert getattr(found, name) == pytest.approx(share, abs=4.5 * deviation + 1e-9)
    assert found.mean_episodes == pytest.approx(exact.mean_episodes, rel=0.05)


def test_more_violations_never_help_to_be_supported() -> None:
    for method in ("fixed", "sprt", "e-process"):
        table = Boundaries.of(fresh(method), BUDGET)
        rates = np.linspace(0, 1, 21)
        found = [operating_characteristics(table, rate, BUDGET) for rate in rates]
        assert all(np.diff([one.supported for one in found]) <= 1e-12)
        assert all(np.diff([one.violated for one in found]) >= -1e-12)


def test_a_certain_outcome_has_certain_characteristics() -> None:
    clean = operating_characteristics(make_test("sprt", 0.05, p0=0.01), 0.0, 100)
    assert (clean.supported, clean.mean_episodes, clean.percentile(0.99)) == (1.0, 72.0, 72)
    assert clean.undecided == 0.0
    short = operating_characteristics(make_test("sprt", 0.05, p0=0.01), 0.0, 71)
    assert (short.undecided, short.mean_episodes, short.percentile(0.5)) == (1.0, 71.0, None)


def test_the_walk_ends_when_no_campaign_is_open() -> None:
    steps = list(walk(make_test("e-process", 0.05), 1.0))
    assert [step.episodes for step in steps] == [1, 2]
    assert [step.violated for step in steps] == [0.0, 1.0]
