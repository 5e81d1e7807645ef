"""Exact comparisons of two campaigns: paired seeds, or two counts apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import comb
from typing import Any, Literal

from pytest_dura.core.codec import Count, Sha256, Share
from pytest_dura.requirements.sequential import error_level, require_between

ComparisonStatus = Literal["better", "worse", "no evidence of a change"]


@dataclass(frozen=True, slots=True)
class Comparison:
    """Result of comparing two counts.

    Args:
        status: ``better`` or ``worse`` at the given confidence, or no evidence of a change.
        p_better: One-sided p-value against "the rate is not lower than the baseline's".
        p_worse: One-sided p-value against "the rate is not higher than the baseline's".
    """

    status: ComparisonStatus
    p_better: float
    p_worse: float


BaselineStatus = Literal[
    "better", "worse", "no evidence of a change", "new", "gone", "no comparison"
]


@dataclass(frozen=True, slots=True)
class BaselineComparison:
    """One requirement on one case, now and in the baseline."""

    requirement: str
    """Id of the requirement."""
    case: str
    """Id of the case: the scenario, then `+` and its faults where they differ from the scenario's
    own, then `~` and a role that is switched off."""
    component: str | None
    """Name of the component under test; null for what is gone."""
    baseline_component: str | None
    """The baseline's component; null for what is new."""
    status: BaselineStatus
    """What follows, after the correction."""
    reason: str = ""
    """Why there is no comparison."""
    uncorrected: ComparisonStatus | None = None
    """The status that this comparison alone would have got."""
    confidence: Share | None = None
    """Of the statuses: the requirement's own."""
    violations: Count | None = None
    """Violating episodes now."""
    episodes: Count | None = None
    """Valid episodes now."""
    baseline_violations: Count | None = None
    """Violating episodes of the baseline."""
    baseline_episodes: Count | None = None
    """Valid episodes of the baseline."""
    test: Literal["McNemar", "Fisher"] | None = None
    """Exact test: McNemar for runs of equal seeds, Fisher for others."""
    only_now: Count | None = None
    """For McNemar, seeds that violate it now alone."""
    only_baseline: Count | None = None
    """For McNemar, seeds that violated it in the baseline alone."""
    p_worse: Share | None = None
    """One-sided p-value against `the rate is not higher`; 1 where the outcome itself kept the two
    from being compared."""
    p_better: Share | None = None
    """One-sided p-value against `the rate is not lower`."""
    p_worse_holm: Share | None = None
    """Adjusted for all comparisons of the session."""
    p_better_holm: Share | None = None
    """Adjusted for all comparisons of the session."""


@dataclass(frozen=True, slots=True)
class ComparedBaseline:
    """An earlier record that the session is compared with."""

    path: str
    """As the user gave it."""
    sha256: Sha256
    """SHA-256 of its file."""
    created: str
    """When its session began, in ISO 8601."""
    status: Literal["complete", "interrupted"]
    """How its session ended."""
    base_seed: Count
    """Its base seed."""
    component: dict[str, Any]
    """Its component under test, as it is recorded there."""
    correction: str = "Holm"
    """How the statuses hold together."""
    tests: Count = 0
    """How many comparisons the correction counts."""
    comparisons: tuple[BaselineComparison, ...] = ()
    """Verdict by verdict."""


def mcnemar(only_first: int, only_second: int) -> float:
    """Two-sided p-value of the exact McNemar test of paired outcomes.

    Under "no difference" each of the discordant pairs goes either way with probability 1/2
    (McNemar, Psychometrika 12, 1947). The distribution is symmetric, so that the p-value is twice
    the smaller tail, 1 at most. Pairs that agree do not count; without discordant pairs it is 1.

    Args:
        only_first: Pairs in which the first alone violated.
        only_second: Pairs in which the second alone violated.

    Raises:
        ValueError: For a negative count.
    """
    more, fewer = max(only_first, only_second), min(only_first, only_second)
    return min(1.0, 2.0 * mcnemar_one_sided(more, fewer))


def mcnemar_one_sided(only_first: int, only_second: int) -> float:
    """P-value of the exact McNemar test against "the first violates no more often".

    Args:
        only_first: As in :func:`mcnemar`.
        only_second: As in :func:`mcnemar`.

    Raises:
        ValueError: For a negative count.
    """
    if min(only_first, only_second) < 0:
        raise ValueError(f"{only_first} and {only_second} are not counts of pairs")
    pairs = only_first + only_second
    as_many = sum(comb(pairs, k) for k in range(only_first, pairs + 1))
    return float(Fraction(as_many, 1 << pairs))


def compare_counts(
    violations: int,
    n: int,
    baseline_violations: int,
    baseline_n: int,
    confidence: float = 0.95,
) -> Comparison:
    """Whether a rate of violations changed against a baseline of other, independent episodes.

    Fisher's exact test, once in each direction: given the sum of both counts, the violations among
    the new episodes are hypergeometric if nothing changed (Fisher, "Statistical Methods for
    Research Workers", 1925). Boschloo's test has more power, but its p-value is a supremum over
    the unknown rate that must be searched for numerically, and a search that misses it errs
    towards "worse" and "better" alike. Fisher's is a sum of whole numbers that can be checked by
    hand, its level holds for every rate, and here it is computed without any rounding.

    "Better" and "worse" have level ``1 - confidence`` each. "No evidence of a change" is not
    evidence of no change: two small campaigns always come to it, and one without episodes does with
    p-values of 1.

    Args:
        violations: Violating episodes of the new campaign.
        n: All its valid episodes.
        baseline_violations: Violating episodes of the baseline.
        baseline_n: All its valid episodes.
        confidence: Above one half.

    Raises:
        ValueError: For counts that make no sense.
        ConfigurationError: For a confidence outside (0.5, 1).
    """
    require_between("confidence", confidence, 0.5, 1.0)
    for some, of in ((violations, n), (baseline_violations, baseline_n)):
        if not 0 <= some <= of:
            raise ValueError(f"{some} violations in {of} episodes is not a count")
    p_better = float(_as_few(violations, n, baseline_violations, baseline_n))
    p_worse = float(_as_few(baseline_violations, baseline_n, violations, n))
    return Comparison(comparison_status(p_better, p_worse, confidence), p_better, p_worse)


def compare_pairs(only_new: int, only_baseline: int, confidence: float = 0.95) -> Comparison:
    """Whether a rate of violations changed against a baseline of episodes with the same seeds.

    The exact McNemar test, once in each direction (:func:`mcnemar_one_sided`). It needs no
    independence of the two outcomes of one seed, which :func:`compare_counts` assumes.

    Args:
        only_new: Seeds of which the new episode alone violated.
        only_baseline: Seeds of which the baseline's episode alone violated.
        confidence: Above one half.

    Raises:
        ValueError: For a negative count.
        ConfigurationError: For a confidence outside (0.5, 1).
    """
    require_between("confidence", confidence, 0.5, 1.0)
    p_better = mcnemar_one_sided(only_baseline, only_new)
    p_worse = mcnemar_one_sided(only_new, only_baseline)
    return Comparison(comparison_status(p_better, p_worse, confidence), p_better, p_worse)


def comparison_status(p_better: float, p_worse: float, confidence: float) -> ComparisonStatus:
    """Status from two one-sided p-values; above one half, better and worse exclude each other."""
    level = error_level(confidence)
    if p_better <= level:
        return "better"
    return "worse" if p_worse <= level else "no evidence of a change"


def holm(p_values: Sequence[float]) -> list[float]:
    """P-values adjusted for as many tests as there are, in the order given.

    Holm's step-down procedure: the smallest p-value is multiplied by the number of tests, the
    next by one less and so on, and none becomes smaller than one before it (Holm, "A simple
    sequentially rejective multiple test procedure", Scandinavian Journal of Statistics 6, 1979).
    Rejecting where the adjusted value is at most ``a`` rejects any true hypothesis at all with a
    probability of at most ``a``, however the tests depend on each other.

    Args:
        p_values: Each between 0 and 1.

    Raises:
        ValueError: For anything else.
    """
    adjusted = [0.0] * len(p_values)
    largest = 0.0
    for done, i in enumerate(sorted(range(len(p_values)), key=p_values.__getitem__)):
        if not 0.0 <= p_values[i] <= 1.0:
            raise ValueError(f"{p_values[i]!r} is not a p-value")
        largest = max(largest, min(1.0, (len(p_values) - done) * p_values[i]))
        adjusted[i] = largest
    return adjusted


def _as_few(violations: int, n: int, others: int, other_n: int) -> Fraction:
    """Probability of so few violations among the n, given the sum of both counts."""
    total = violations + others
    fewest = max(0, total - other_n)
    ways, as_few = comb(n, fewest) * comb(other_n, total - fewest), 0
    for k in range(fewest, violations + 1):
        as_few += ways
        # From C(n, k) C(m, t - k) to k + 1; the division leaves no remainder.
        ways = ways * (n - k) * (total - k) // ((k + 1) * (other_n - total + k + 1))
    return Fraction(as_few, comb(n + other_n, total))
