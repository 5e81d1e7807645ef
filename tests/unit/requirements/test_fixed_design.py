"""Curtailment changes no decision of the full design."""

from __future__ import annotations

from itertools import product

import pytest
from characteristics import operating_characteristics
from scipy.stats import binom

from pytest_dura.core import ConfigurationError
from pytest_dura.requirements import FixedN, lower_bound, upper_bound


def full_design(violations, planned, limit, confidence):
    if upper_bound(violations, planned, confidence) <= limit:
        return "supported"
    return "violated" if lower_bound(violations, planned, confidence) > limit else None


@pytest.mark.parametrize("limit, confidence", [(0.3, 0.8), (0.4, 0.95), (0.1, 0.9)])
def test_every_campaign_ends_as_in_the_full_design(limit, confidence) -> None:
    planned, words, early = 10, set(), 0
    for outcomes in product([False, True], repeat=planned):
        expected = full_design(sum(outcomes), planned, limit, confidence)
        test = FixedN(limit, confidence, planned)
        for number, violated in enumerate(outcomes, 1):
            seen, rest = sum(outcomes[:number]), planned - number
            ends = {full_design(seen + k, planned, limit, confidence) for k in range(rest + 1)}
            found = test.update(violated)
            assert found == (ends.pop() if len(ends) == 1 else None)
            assert test.hopeless == (full_design(seen, planned, limit, confidence) != "supported")
            if found is not None:
                early += rest > 0
                break
        assert test.decision == expected
        words.add(expected)
    assert words >= {"violated", None}
    assert early


def test_the_design_of_181_episodes() -> None:
    test = FixedN(0.05, 0.95, 181)
    at_limit = operating_characteristics(test, 0.05, 181)
    assert at_limit.supported == pytest.approx(binom.cdf(4, 181, 0.05), rel=1e-9)
    assert at_limit.supported <= 0.05
    assert 1 - operating_characteristics(test, 0.01, 181).supported <= 0.05
    assert at_limit.violated == pytest.approx(binom.sf(14, 181, 0.05), rel=1e-9)


def test_without_a_violation_it_ends_when_the_rest_cannot_matter() -> None:
    test = FixedN(0.05, 0.95, 181)
    decisions = [test.update(False) for _ in range(177)]
    assert decisions == [None] * 176 + ["supported"]
    assert test.upper == upper_bound(4, 181, 0.95) <= 0.05


def test_five_violations_are_hopeless_and_not_yet_violated() -> None:
    test = FixedN(0.05, 0.95, 181)
    for _ in range(4):
        test.update(True)
    assert not test.hopeless
    test.update(True)
    assert test.hopeless
    assert test.decision is None
    for _ in range(9):
        test.update(True)
    assert test.decision is None
    assert test.update(True) == "violated"
    assert test.lower == lower_bound(15, 181, 0.95) > 0.05


def test_past_the_plan_nothing_counts() -> None:
    test = FixedN(0.05, 0.95, 2)
    assert test.hopeless
    test.update(False)
    test.update(False)
    assert test.decision is None
    assert test.upper == upper_bound(0, 2, 0.95)
    with pytest.raises(RuntimeError, match="2 planned episodes are over, undecided"):
        test.update(False)
    with pytest.raises(ValueError, match="3 episodes are more than the 2 planned"):
        test.verdict(0, 3)


@pytest.mark.parametrize("planned", [0, -3, 2.5])
def test_a_plan_that_makes_no_sense(planned) -> None:
    with pytest.raises(ConfigurationError, match="whole number of episodes"):
        FixedN(0.05, 0.95, planned)
