"""Wald's test against the figures of its exact dynamic programming, and its levels and ties."""

from __future__ import annotations

from dataclasses import FrozenInstanceError
from fractions import Fraction

import pytest
from characteristics import operating_characteristics

from pytest_dura.core import ConfigurationError
from pytest_dura.requirements import Sprt, rate_tests
from pytest_dura.requirements.rate_tests import _Ratio
from pytest_dura.requirements.sequential import decimal_fraction


def wald(limit, p0, level):
    alpha = decimal_fraction(level)
    return _Ratio(
        decimal_fraction(limit), decimal_fraction(p0), alpha / (1 - alpha), (1 - alpha) / alpha
    )


@pytest.mark.parametrize(
    "rate, mean, supported, percentile",
    [
        (0.0, 72, 1.0, 72),
        (0.005, 89.4, 0.9967, 192),
        (0.01, 112.6, 0.9711, 349),
        (0.02, 155.6, 0.7384, 560),
        (0.0258, 156.4, 0.5091, 592),
        (0.05, 78.7, 0.0499, 309),
        (0.1, 29.6, 0.0006, 105),
        (0.3, 7.5, 0.0, 25),
    ],
)
def test_the_cost_of_five_percent_against_one(rate, mean, supported, percentile) -> None:
    found = operating_characteristics(Sprt(0.05, 0.01), rate, budget=4000)
    assert found.mean_episodes == pytest.approx(mean, abs=0.05)
    assert found.supported == pytest.approx(supported, abs=5e-5)
    assert found.percentile(0.99) == percentile
    assert found.undecided < 1e-12


def test_the_mean_cost_is_greatest_between_the_two_rates() -> None:
    test, rates = Sprt(0.05, 0.01), [thousandths / 1000 for thousandths in range(15, 35)]
    cost = {rate: operating_characteristics(test, rate, 3000).mean_episodes for rate in rates}
    assert max(cost, key=lambda rate: cost[rate]) == 0.023
    assert cost[0.023] == pytest.approx(158.8, abs=0.05)


def test_a_test_of_five_percent_against_fifteen_does_not_certify_five() -> None:
    loose = operating_characteristics(Sprt(limit=0.15, p0=0.05), 0.075, budget=4000)
    assert loose.supported == pytest.approx(0.75, abs=0.05)


@pytest.mark.parametrize(
    "limit, p0, level",
    [(0.01, 0.002, 0.05), (0.01, 0.005, 0.05), (0.1, 0.02, 0.1)],
)
def test_where_walds_boundaries_break_a_level_the_test_takes_others(limit, p0, level) -> None:
    budget = 20_000
    approximate = wald(limit, p0, level)
    broken = [
        operating_characteristics(approximate, limit, budget).supported > level,
        operating_characteristics(approximate, p0, budget).violated > level,
    ]
    assert any(broken)
    test = Sprt(limit, p0, alpha=level)
    at_limit, at_p0 = (operating_characteristics(test, p, budget) for p in (limit, p0))
    assert at_limit.supported + at_limit.undecided <= level
    assert at_p0.violated + at_p0.undecided <= level


def test_the_two_levels_are_kept_apart() -> None:
    test = Sprt(0.05, 0.01, alpha=0.01, beta=0.2)
    assert 0.005 < operating_characteristics(test, 0.05, 9000).supported <= 0.01
    assert 0.05 < operating_characteristics(test, 0.01, 9000).violated <= 0.2


def test_a_ratio_that_equals_a_boundary_has_crossed_it() -> None:
    # A violation multiplies the ratio by 3, a clean episode halves it.
    rates, tiny = (Fraction(3, 5), Fraction(1, 5)), Fraction(1, 10**30)
    on_it = _Ratio(*rates, accept=Fraction(1, 4), reject=Fraction(9))
    assert on_it.verdict(0, 2) == "supported"
    assert on_it.verdict(2, 2) == "violated"
    beside = _Ratio(*rates, accept=Fraction(1, 4) - tiny, reject=Fraction(9) + tiny)
    assert beside.verdict(0, 2) is None
    assert beside.verdict(2, 2) is None
    assert beside.verdict(0, 3) == "supported"
    assert beside.verdict(3, 3) == "violated"


def test_bounds_come_with_the_decision_only() -> None:
    test = Sprt(0.05, 0.01)
    for _ in range(71):
        assert test.update(False) is None
        assert (test.upper, test.lower) == (None, None)
    assert test.update(False) == "supported"
    assert (test.upper, test.lower) == (0.05, None)
    bad = Sprt(0.05, 0.01)
    assert [bad.update(True), bad.update(True)] == [None, "violated"]
    assert (bad.upper, bad.lower, bad.hopeless) == (None, 0.01, True)
    assert (bad.violations, bad.episodes) == (2, 2)


def test_the_decision_is_final() -> None:
    test = Sprt(0.05, 0.01)
    test.update(True)
    test.update(True)
    with pytest.raises(RuntimeError, match="decided 'violated' at 2 violations in 2 episodes"):
        test.update(False)
    assert (test.decision, test.violations, test.episodes) == ("violated", 2, 2)


@pytest.mark.parametrize("word", [None, "satisfied", "violated", float("nan")])
def test_what_is_no_truth_value_does_not_count(word) -> None:
    test = Sprt(0.05, 0.01)
    with pytest.raises(TypeError, match="says neither"):
        test.update(word)
    assert test.episodes == 0


def test_the_parameters_stay_as_they_were_declared() -> None:
    test = Sprt(0.05, 0.01)
    with pytest.raises(FrozenInstanceError):
        test.limit = 0.2


@pytest.mark.parametrize(
    "arguments, key",
    [
        ({"limit": 1.0, "p0": 0.01}, "limit"),
        ({"limit": 0.05, "p0": 0.05}, "p0"),
        ({"limit": 0.05, "p0": 0.0}, "p0"),
        ({"limit": 0.05, "p0": float("nan")}, "p0"),
        ({"limit": 0.05, "p0": 0.01, "alpha": 0.5}, "alpha"),
        ({"limit": 0.05, "p0": 0.01, "beta": 0.0}, "beta"),
    ],
)
def test_parameters_that_make_no_sense(arguments, key) -> None:
    with pytest.raises(ConfigurationError) as caught:
        Sprt(**arguments)
    assert caught.value.key == key


def test_what_levels_the_boundaries_keep_is_found_out_once(monkeypatch: pytest.MonkeyPatch) -> None:
    first = Sprt(0.05, 0.02, alpha=0.1).verdict(0, 60)
    monkeypatch.setattr(rate_tests, "walk", None)
    assert Sprt(0.05, 0.02, alpha=0.1).verdict(0, 60) == first
