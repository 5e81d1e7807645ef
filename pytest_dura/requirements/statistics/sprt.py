"""Wald's sequential probability ratio test of a rate."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property, lru_cache
from itertools import islice

from pytest_dura.requirements.statistics.characteristics import walk
from pytest_dura.requirements.statistics.sequential import (
    CountingTest,
    Decision,
    Tally,
    as_written,
    require_between,
)

_DOUBT = 1e-6
"""Distance of log-likelihoods below which they are compared as fractions; their rounding error
stays below it for any count under 1e8."""
_STEPS = 100_000
"""Episodes after which a boundary whose level is still open counts as not shown."""


@dataclass(frozen=True, eq=False)
class Sprt(CountingTest):
    """Decides between a rate of ``p0`` or less and one of ``limit`` or more, in few episodes.

    Wald, "Sequential Tests of Statistical Hypotheses", Annals of Mathematical Statistics 16
    (1945). The likelihood ratio of ``limit`` to ``p0`` is compared with two boundaries after each
    episode; at or below the lower one the limit is supported, at or above the upper one it is
    violated. A ratio that equals a boundary has crossed it. Rates, levels and ratios are the
    decimal numbers as written, and ratios too close to a boundary for floating point are compared
    as fractions.

    The boundaries are Wald's, ``alpha / (1 - beta)`` and ``(1 - alpha) / beta``. Those keep the
    levels only approximately, so the test computes both error probabilities exactly, without a
    budget, and falls back to Ville's boundaries ``alpha`` and ``1 / beta``, which always keep them,
    where Wald's would exceed a level or it takes more than 100,000 episodes to tell.

    What ``supported`` and ``violated`` mean is not symmetric. ``supported`` says that the rate is
    below ``limit``. ``violated`` says only that it is above ``p0``: between the two, the test may
    say either, and a component that is better than the limit but worse than ``p0`` is often
    rejected. That is the price of few runs; the e-process has no such zone.

    Args:
        limit: Greatest acceptable rate.
        p0: A lower rate at which the component ought to pass; declared before the campaign.
        alpha: Probability of ``supported`` at any rate of ``limit`` or above is at most this.
        beta: Probability of ``violated`` at any rate of ``p0`` or below is at most this;
            ``alpha`` where it is left out.

    Raises:
        ConfigurationError: Unless ``0 < p0 < limit < 1`` and both levels lie below one half.
    """

    limit: float
    p0: float
    alpha: float = 0.05
    beta: float | None = None
    tally: Tally = field(default_factory=Tally, init=False, repr=False)

    def __post_init__(self) -> None:
        require_between("limit", self.limit, 0.0, 1.0)
        require_between("p0", self.p0, 0.0, self.limit)
        require_between("alpha", self.alpha, 0.0, 0.5)
        require_between("beta", self.alpha if self.beta is None else self.beta, 0.0, 0.5)

    @property
    def method(self) -> str:
        """Name of the method, for reports."""
        return f"Wald's SPRT of rate {self.limit:g} against {self.p0:g}"

    @property
    def upper(self) -> float | None:
        """``limit`` once supported; a SPRT yields no other upper bound."""
        return self.limit if self.decision == "supported" else None

    @property
    def lower(self) -> float | None:
        """``p0`` once violated, at confidence ``1 - beta``; a SPRT yields no other lower bound."""
        return self.p0 if self.decision == "violated" else None

    def verdict(self, violations: int, episodes: int) -> Decision | None:
        """The decision at these counts, given none at the counts before them."""
        return self._rule.verdict(violations, episodes)

    @cached_property
    def _rule(self) -> _Ratio:
        alpha = as_written(self.alpha)
        beta = alpha if self.beta is None else as_written(self.beta)
        return _boundaries(as_written(self.limit), as_written(self.p0), alpha, beta)


@dataclass(frozen=True)
class _Ratio:
    """The likelihood ratio of two rates, between two boundaries."""

    limit: Fraction
    p0: Fraction
    accept: Fraction
    reject: Fraction

    def verdict(self, violations: int, episodes: int) -> Decision | None:
        worse, better, accept, reject = self._logs
        log_ratio = violations * worse + (episodes - violations) * better
        if min(abs(log_ratio - accept), abs(log_ratio - reject)) > _DOUBT:
            supported, violated = log_ratio < accept, log_ratio > reject
        else:
            clean = (1 - self.limit) / (1 - self.p0)
            ratio = (self.limit / self.p0) ** violations * clean ** (episodes - violations)
            supported, violated = ratio <= self.accept, ratio >= self.reject
        if supported:
            return "supported"
        return "violated" if violated else None

    @cached_property
    def _logs(self) -> tuple[float, float, float, float]:
        worse = math.log(self.limit / self.p0)
        better = math.log1p(-self.limit) - math.log1p(-self.p0)
        return worse, better, math.log(self.accept), math.log(self.reject)


@lru_cache(maxsize=64)
def _boundaries(limit: Fraction, p0: Fraction, alpha: Fraction, beta: Fraction) -> _Ratio:
    """Wald's where they keep both levels, and Ville's elsewhere; rates that are close take long."""
    wald = _Ratio(limit, p0, alpha / (1 - beta), (1 - alpha) / beta)
    if _keeps(wald, float(limit), "supported", float(alpha)) and _keeps(
        wald, float(p0), "violated", float(beta)
    ):
        return wald
    return _Ratio(limit, p0, alpha, 1 / beta)


def _keeps(rule: _Ratio, rate: float, wrong: Decision, level: float) -> bool:
    """Whether the wrong decision at the rate is shown to be at most as probable as the level."""
    for step in islice(walk(rule, rate), _STEPS):
        if getattr(step, wrong) > level:
            return False
        if getattr(step, wrong) + step.open <= level:
            return True
    return False
