"""Exact bounds on a rate, for a number of episodes that was fixed beforehand."""

from __future__ import annotations

METHOD = "Clopper-Pearson, one-sided, fixed n"


def upper_bound(violations: int, episodes: int, confidence: float) -> float:
    """The rate that the true one exceeds with probability of at most ``1 - confidence``.

    Raises:
        ValueError: If the counts or the confidence make no sense.
    """
    _check(violations, episodes, confidence)
    if violations == episodes:
        return 1.0
    from scipy.special import betaincinv

    return float(betaincinv(violations + 1, episodes - violations, confidence))


def lower_bound(violations: int, episodes: int, confidence: float) -> float:
    """The rate that the true one falls below with probability of at most ``1 - confidence``.

    Raises:
        ValueError: As :func:`upper_bound`.
    """
    _check(violations, episodes, confidence)
    if violations == 0:
        return 0.0
    from scipy.special import betaincinv

    return float(betaincinv(violations, episodes - violations + 1, 1.0 - confidence))


def runs_needed(at_most: float, confidence: float, violations: int = 0) -> int:
    """The least number of episodes that supports ``at_most`` with so many violations among them."""
    if not 0.0 < at_most < 1.0:
        raise ValueError(f"a rate to support lies between 0 and 1, not {at_most}")
    low, high = violations, violations + 1
    while upper_bound(violations, high, confidence) > at_most:
        low, high = high, 2 * high
    while high - low > 1:
        middle = (low + high) // 2
        if upper_bound(violations, middle, confidence) > at_most:
            low = middle
        else:
            high = middle
    return high


def _check(violations: int, episodes: int, confidence: float) -> None:
    if not 0 <= violations <= episodes or episodes == 0:
        raise ValueError(f"{violations} violations in {episodes} episodes is not a count")
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"a confidence lies between 0 and 1, not {confidence}")
