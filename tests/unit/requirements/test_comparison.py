"""Exact comparisons against scipy, and what they say of few episodes."""

from __future__ import annotations

import math
from itertools import product

import pytest
from scipy.stats import binomtest, fisher_exact

from pytest_dura.core import ConfigurationError
from pytest_dura.requirements import compare_counts, compare_pairs, holm, mcnemar, mcnemar_one_sided


@pytest.mark.parametrize("first, second", [(11, 0), (4, 0), (3, 2), (5, 5), (40, 10), (158, 0)])
def test_mcnemar_is_the_binomial_test_of_the_discordant_pairs(first, second) -> None:
    pairs = first + second
    assert mcnemar(first, second) == pytest.approx(binomtest(first, pairs).pvalue, rel=1e-9)
    greater = binomtest(first, pairs, alternative="greater").pvalue
    assert mcnemar_one_sided(first, second) == pytest.approx(greater, rel=1e-9)


def test_mcnemar_without_discordant_pairs_says_nothing() -> None:
    assert mcnemar(0, 0) == mcnemar_one_sided(0, 0) == 1.0


def test_mcnemar_of_many_pairs_does_not_overflow() -> None:
    assert 0.0 < mcnemar(2600, 2400) < 0.01


def test_mcnemar_refuses_negative_counts() -> None:
    with pytest.raises(ValueError, match="not counts of pairs"):
        mcnemar(-1, 3)


@pytest.mark.parametrize(
    "k, n, base_k, base_n",
    [
        (1, 100, 12, 100),
        (12, 100, 1, 100),
        (3, 40, 30, 400),
        (0, 5, 5, 5),
        (7, 9, 0, 300),
        (2, 2, 3, 3),
    ],
)
def test_counts_are_compared_by_fishers_exact_test(k, n, base_k, base_n) -> None:
    table = [[k, n - k], [base_k, base_n - base_k]]
    found = compare_counts(k, n, base_k, base_n)
    assert found.p_better == pytest.approx(fisher_exact(table, "less").pvalue, rel=1e-9)
    assert found.p_worse == pytest.approx(fisher_exact(table, "greater").pvalue, rel=1e-9)


def test_the_words() -> None:
    assert compare_counts(1, 100, 12, 100).status == "better"
    assert compare_counts(12, 100, 1, 100).status == "worse"
    assert compare_counts(5, 100, 6, 100).status == "no evidence of a change"
    assert compare_counts(1, 100, 8, 100, confidence=0.99).status == "no evidence of a change"
    assert compare_counts(1, 100, 8, 100).status == "better"


def test_a_p_value_that_equals_the_level_counts() -> None:
    # 1 of C(6, 3) = 20 ways.
    assert compare_counts(0, 3, 3, 3).p_better == 0.05
    assert compare_counts(0, 3, 3, 3).status == "better"
    assert compare_counts(3, 3, 0, 3).status == "worse"
    assert compare_counts(0, 3, 3, 3, confidence=0.951).status == "no evidence of a change"


@pytest.mark.parametrize("counts", [(0, 0, 3, 10), (3, 10, 0, 0), (0, 0, 0, 0), (0, 50, 0, 50)])
def test_without_episodes_or_violations_there_is_no_evidence(counts) -> None:
    found = compare_counts(*counts)
    assert (found.status, found.p_better, found.p_worse) == ("no evidence of a change", 1.0, 1.0)


@pytest.mark.parametrize("rate", [0.02, 0.1, 0.5])
def test_the_words_keep_their_level_at_every_common_rate(rate) -> None:
    """By enumeration of both counts."""
    from scipy.stats import binom

    n, m = 20, 30
    wrong = {"better": 0.0, "worse": 0.0, "no evidence of a change": 0.0}
    for k in range(n + 1):
        for j in range(m + 1):
            word = compare_counts(k, n, j, m).status
            wrong[word] += binom.pmf(k, n, rate) * binom.pmf(j, m, rate)
    assert wrong["better"] <= 0.05
    assert wrong["worse"] <= 0.05


@pytest.mark.parametrize("counts", [(3, 2, 0, 5), (0, 5, -1, 5), (-1, 5, 0, 5)])
def test_counts_that_make_no_sense(counts) -> None:
    with pytest.raises(ValueError, match="is not a count"):
        compare_counts(*counts)
    with pytest.raises(ConfigurationError, match="confidence"):
        compare_counts(1, 2, 1, 2, confidence=0.4)


@pytest.mark.parametrize("new, old, word", [
    (5, 0, "worse"), (0, 5, "better"), (4, 0, "no evidence of a change"),
    (9, 1, "worse"), (8, 2, "no evidence of a change"), (0, 0, "no evidence of a change"),
])  # fmt: skip
def test_the_words_on_pairs(new, old, word) -> None:
    found = compare_pairs(new, old)
    assert found.status == word
    greater = binomtest(new, new + old, alternative="greater").pvalue if new + old else 1.0
    assert found.p_worse == pytest.approx(greater, rel=1e-9)
    assert found.p_better == compare_pairs(old, new).p_worse


def test_pairs_that_make_no_sense() -> None:
    with pytest.raises(ValueError, match="not counts of pairs"):
        compare_pairs(3, -1)
    with pytest.raises(ConfigurationError, match="confidence"):
        compare_pairs(3, 1, confidence=0.5)


def test_holm_on_an_example_by_hand() -> None:
    # 4 x 0.005, 3 x 0.01, 2 x 0.03, 1 x 0.04 which may not fall below the one before it.
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.03]) == [0.03]
    assert holm([]) == []
    assert holm([0.6, 0.7]) == [1.0, 1.0]


def test_holm_rejects_as_the_procedure_does_step_by_step() -> None:
    """Against the definition: go up the ordered p-values until one is above a / (m - i)."""
    grid = [0.001, 0.012, 0.0126, 0.02, 0.049, 0.06, 1.0]
    for p_values in product(grid, repeat=4):
        order = sorted(range(4), key=lambda i, p=p_values: p[i])
        rejected = set()
        for i, which in enumerate(order):
            if p_values[which] > 0.05 / (4 - i):
                break
            rejected.add(which)
        adjusted = holm(p_values)
        assert {i for i in range(4) if adjusted[i] <= 0.05} == rejected


@pytest.mark.parametrize("wrong", [-0.1, 1.1, math.nan])
def test_holm_refuses_what_is_no_p_value(wrong) -> None:
    with pytest.raises(ValueError, match="is not a p-value"):
        holm([0.2, wrong])
