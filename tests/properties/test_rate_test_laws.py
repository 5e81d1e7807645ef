"""Laws of the tests of a rate: each decision is that of its definition, computed another way."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq
from scipy.stats import binom, binomtest, fisher_exact

from pytest_dura.requirements import (
    SequentialTest,
    advised_plan,
    compare_counts,
    compare_pairs,
    holm,
    make_test,
    mcnemar,
    runs_needed,
)

lawful = settings(derandomize=True, deadline=None, max_examples=100)
ANGLES, WEIGHTS = np.polynomial.legendre.leggauss(80)


def counts(episodes: int) -> Iterator[tuple[int, int]]:
    """All counts ``(violations, episodes)`` of at most so many episodes."""
    for n in range(1, episodes + 1):
        for violations in range(n + 1):
            yield violations, n


@pytest.mark.parametrize(
    "limit, confidence, planned", [(0.05, 0.95, 100), (0.2, 0.9, 40), (0.5, 0.6, 9), (0.9, 0.99, 3)]
)
def test_a_fixed_plan_decides_once_no_further_episode_can_change_its_end(
    limit: float, confidence: float, planned: int
) -> None:
    test = make_test("fixed", limit, confidence, planned=planned)

    def end(violations: int) -> str | None:
        if binom.cdf(violations, planned, limit) <= 1 - confidence:
            return "supported"
        return "violated" if binom.sf(violations - 1, planned, limit) < 1 - confidence else None

    ends = [end(violations) for violations in range(planned + 1)]
    for violations, episodes in counts(planned):
        possible = {ends[violations + more] for more in range(planned - episodes + 1)}
        expected = possible.pop() if len(possible) == 1 else None
        assert test.verdict(violations, episodes) == expected, (violations, episodes)


def log_evidence(violations: int, episodes: int, rate: float, side: str) -> float:
    """The e-value by quadrature: Jeffreys' prior of a rate ``sin(x)**2`` is uniform in ``x``."""
    edge = math.asin(math.sqrt(rate))
    first, last = (0.0, edge) if side == "below" else (edge, math.pi / 2)
    angles = first + (ANGLES + 1) / 2 * (last - first)
    other = np.sin(angles) ** 2
    ratios = violations * np.log(other / rate)
    ratios += (episodes - violations) * np.log((1 - other) / (1 - rate))
    return float(np.log(np.sum(WEIGHTS / 2 * np.exp(ratios - ratios.max()))) + ratios.max())


@pytest.mark.parametrize("limit, confidence", [(0.05, 0.95), (0.3, 0.9), (0.7, 0.99)])
def test_the_e_process_decides_where_the_averaged_likelihood_ratio_reaches_its_threshold(
    limit: float, confidence: float
) -> None:
    test, threshold = (
        make_test("e-process", limit, confidence, planned=60),
        -math.log1p(-confidence),
    )
    for violations, episodes in counts(90):
        below, above = (
            log_evidence(violations, episodes, limit, side) for side in ("below", "above")
        )
        expected = "supported" if below >= threshold else "violated" if above >= threshold else None
        assert test.verdict(violations, episodes) == expected, (violations, episodes)


@settings(derandomize=True, deadline=None, max_examples=25)
@given(st.lists(st.sampled_from([False] * 7 + [True]), min_size=1, max_size=60))
def test_the_bound_of_the_e_process_is_the_best_of_all_looks_so_far(episodes: list[bool]) -> None:
    test, threshold = make_test("e-process", 0.01, 0.9, planned=60), -math.log1p(-0.9)
    best, violations = 1.0, 0
    for number, violated in enumerate(episodes, 1):
        violations += violated
        if test.update(violated) is not None:
            break
        low, high = max(violations / number, 1e-9), 1 - 1e-9

        def gap(rate: float, look: tuple[int, int] = (violations, number)) -> float:
            return log_evidence(*look, rate, "below") - threshold

        if gap(high) > 0:
            best = min(best, float(brentq(gap, low, high, xtol=1e-12)))
        assert test.upper == pytest.approx(best, rel=1e-4)


@pytest.mark.parametrize(
    "limit, confidence, episodes, decision",
    # Wald's boundaries are 1/9 and 9 at 0.9, and 1/4 and 4 at 0.8. A violation multiplies the ratio
    # of 0.6 to 0.2 by 3, and that of 0.8 to 0.2 by 4; a clean episode divides the latter by 4.
    [
        (0.6, 0.9, [True, True], [None, "violated"]),
        (0.8, 0.8, [True], ["violated"]),
        (0.8, 0.8, [False], ["supported"]),
    ],
)
def test_a_likelihood_ratio_that_equals_a_boundary_of_the_sprt_has_crossed_it(
    limit: float, confidence: float, episodes: list[bool], decision: list[str | None]
) -> None:
    test = make_test("sprt", limit, confidence, p0=0.2, planned=99)
    assert [test.update(violated) for violated in episodes] == decision


def wrongly_decided(test: SequentialTest, rate: float, wrong: str, budget: int) -> float:
    """Probability of a decision at a true rate, or of no decision within the budget."""
    going, wrongly = {0: 1.0}, 0.0
    for episodes in range(1, budget + 1):
        following: dict[int, float] = {}
        for violations, share in going.items():
            for more, chance in ((0, 1 - rate), (1, rate)):
                decision = test.verdict(violations + more, episodes)
                if decision is None:
                    known = following.get(violations + more, 0.0)
                    following[violations + more] = known + share * chance
                elif decision == wrong:
                    wrongly += share * chance
        going = following
    return wrongly + sum(going.values())


@pytest.mark.parametrize(
    "limit, p0, confidence",
    # In the first two Wald's own boundaries break a level.
    [(0.1, 0.02, 0.9), (0.4, 0.05, 0.9), (0.3, 0.05, 0.95)],
)
def test_the_sprt_keeps_both_of_its_error_levels(
    limit: float, p0: float, confidence: float
) -> None:
    test = make_test("sprt", limit, confidence, p0=p0, planned=99)
    for rate, wrong in ((limit, "supported"), (p0, "violated")):
        assert wrongly_decided(test, rate, wrong, 450) <= 1 - confidence + 1e-6


@lawful
@given(st.floats(0.01, 0.9), st.sampled_from([0.6, 0.9, 0.95, 0.99]), st.integers(0, 4))
def test_the_runs_needed_are_the_least_that_support_a_rate(
    limit: float, confidence: float, violations: int
) -> None:
    runs = runs_needed(limit, confidence, violations)
    assert binom.cdf(violations, runs, limit) <= (1 - confidence) * (1 + 1e-9)
    assert runs > violations
    if runs > violations + 1:
        assert binom.cdf(violations, runs - 1, limit) > (1 - confidence) * (1 - 1e-9)


def closed_bonferroni(p_values: Sequence[float], i: int) -> float:
    """The largest Bonferroni p-value of all sets of hypotheses that this one belongs to."""
    others = [p for j, p in enumerate(p_values) if j != i]
    sets = (some for size in range(len(p_values)) for some in itertools.combinations(others, size))
    return max(min(1.0, (len(some) + 1) * min((*some, p_values[i]))) for some in sets)


@lawful
@given(st.lists(st.sampled_from([0.0, 0.01, 0.02, 0.021, 0.2, 1.0]) | st.floats(0, 1), max_size=6))
def test_holms_p_values_are_those_of_the_closure_of_bonferronis_test(
    p_values: list[float],
) -> None:
    expected = [closed_bonferroni(p_values, i) for i in range(len(p_values))]
    assert holm(p_values) == pytest.approx(expected, rel=1e-12)


@lru_cache
def tail(successes: int, trials: int, alternative: str) -> float:
    return float(binomtest(successes, trials, alternative=alternative).pvalue) if trials else 1.0


@lawful
@given(st.integers(0, 40), st.integers(0, 40))
def test_pairs_are_compared_by_the_exact_binomial_test(new: int, old: int) -> None:
    result = compare_pairs(new, old)
    assert result.p_worse == pytest.approx(tail(new, new + old, "greater"), rel=1e-9)
    assert result.p_better == pytest.approx(tail(old, new + old, "greater"), rel=1e-9)
    assert mcnemar(new, old) == pytest.approx(tail(new, new + old, "two-sided"), rel=1e-9)


@lawful
@given(st.lists(st.integers(0, 25), min_size=4, max_size=4))
def test_counts_are_compared_by_fishers_exact_test(cells: list[int]) -> None:
    (bad, good, old_bad, old_good) = cells
    result = compare_counts(bad, bad + good, old_bad, old_bad + old_good)
    table = [[bad, good], [old_bad, old_good]]
    for p_value, alternative in ((result.p_worse, "greater"), (result.p_better, "less")):
        expected = fisher_exact(table, alternative=alternative).pvalue
        assert p_value == pytest.approx(expected, rel=1e-7)
    level = min(result.p_worse, result.p_better) <= 0.05
    assert (result.status == "no evidence of a change") == (not level)


@lawful
@given(
    st.floats(0.005, 0.9),
    st.sampled_from([0.8, 0.9, 0.95, 0.99]),
    st.floats(0, 1, exclude_max=True),
)
def test_an_advised_plan_supports_the_rate_as_often_as_it_says(
    at_most: float, confidence: float, rate: float
) -> None:
    plan = advised_plan(at_most, confidence, rate)
    if plan is None:
        # The rate is above the limit, or so near below it that thousands of runs are too few.
        assert rate > 0.4 * at_most
        return
    assert rate < at_most
    assert plan.power >= 0.8
    assert plan.power == pytest.approx(binom.cdf(plan.violations, plan.runs, rate), rel=1e-9)
    assert binom.cdf(plan.violations, plan.runs, at_most) <= 1 - confidence + 1e-9
