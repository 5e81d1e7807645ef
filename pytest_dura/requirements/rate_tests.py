"""Tests of a rate: a fixed number of episodes with exact bounds, Wald's SPRT, and the e-process.

The e-process is anytime-valid and has a confidence sequence. The test of a fixed number ends early
only where no further episode can change its decision. ``make_test`` chooses one by its name.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property, lru_cache
from itertools import islice
from typing import Literal, NamedTuple

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.requirements.model import METHODS
from pytest_dura.requirements.sequential import (
    Decision,
    SequentialTest,
    Tally,
    decimal_fraction,
    error_level,
    require_between,
    walk,
)

EXACT_METHOD = "Clopper-Pearson, one-sided, fixed n"


@lru_cache(maxsize=1024)  # each item of a session asks for that of its single run
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

    return float(betaincinv(violations, episodes - violations + 1, error_level(confidence)))


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


class Plan(NamedTuple):
    """A fixed number of runs that supports a rate with at most so many violations among them.

    Args:
        runs: Its valid runs.
        violations: The most that may be among them.
        power: Probability that it supports the rate, at an assumed true rate of violations.
    """

    runs: int
    violations: int
    power: float


ADVISED_POWER = 0.8
"""Probability of success that an advised plan has."""
MAX_ADVISED_RUNS = 10_000


def plan_allowing(violations: int, at_most: float, confidence: float, rate: float) -> Plan:
    """The least plan that allows so many violations, with its power at a true rate."""
    from scipy.special import bdtr

    runs = runs_needed(at_most, confidence, violations)
    return Plan(runs, violations, float(bdtr(violations, runs, rate)))


def advised_plan(at_most: float, confidence: float, rate: float) -> Plan | None:
    """A plan that supports ``at_most`` with a probability of 80 % at a true rate.

    ``None`` if no plan of :data:`MAX_ADVISED_RUNS` has that power, as where the rate is above it.
    """
    violations = 0
    while rate < at_most:
        plan = plan_allowing(violations, at_most, confidence, rate)
        if plan.runs > MAX_ADVISED_RUNS:
            return None
        if plan.power >= ADVISED_POWER:
            return plan
        violations += 1 + violations // 16
    return None


def _check(violations: int, episodes: int, confidence: float) -> None:
    if not 0 <= violations <= episodes or episodes == 0:
        raise ValueError(f"{violations} violations in {episodes} episodes is not a count")
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"a confidence lies between 0 and 1, not {confidence}")


@dataclass(frozen=True, eq=False)
class FixedN(SequentialTest):
    """The exact one-sided bounds after ``planned`` episodes, with curtailment.

    The full design says ``supported`` if the Clopper-Pearson upper bound after all planned
    episodes is at most ``limit``, ``violated`` if the lower bound is above it, and nothing
    otherwise. A decision falls early only where no outcome of the remaining episodes can change
    it. It therefore equals that of the full design in every campaign, and so do the error levels:
    looking after each episode costs nothing. Both bounds count the remaining episodes at their
    worst; they hold together with those of the full design, whenever one stops.

    Args:
        limit: Greatest acceptable rate.
        confidence: One-sided confidence of each bound.
        planned: Episodes of the full design.

    Raises:
        ConfigurationError: For a limit outside (0, 1), a confidence outside (0.5, 1), and less
            than one planned episode.
    """

    limit: float
    confidence: float
    planned: int
    tally: Tally = field(default_factory=Tally, init=False, repr=False)

    def __post_init__(self) -> None:
        require_between("limit", self.limit, 0.0, 1.0)
        require_between("confidence", self.confidence, 0.5, 1.0)
        if not isinstance(self.planned, int) or self.planned < 1:
            raise ConfigurationError(
                "a fixed design plans a whole number of episodes",
                key="planned",
                found=self.planned,
                expected="1 or more",
            )

    @property
    def method(self) -> str:
        """Name of the method, for reports."""
        return EXACT_METHOD

    @property
    def hopeless(self) -> bool:
        """Whether no further episode can make the decision ``supported``; a runner may stop."""
        return self.violations > self._most

    @property
    def upper(self) -> float:
        """Upper confidence bound on the rate, every remaining episode counted as violating."""
        worst = self.violations + self.planned - self.episodes
        return upper_bound(worst, self.planned, self.confidence)

    @property
    def lower(self) -> float:
        """Lower confidence bound on the rate, every remaining episode counted as clean."""
        return lower_bound(self.violations, self.planned, self.confidence)

    def update(self, violated: bool) -> Decision | None:
        """Count one valid episode and return the decision, if there is one now.

        Raises:
            RuntimeError: After the decision and after the last planned episode.
        """
        if self.decision is None and self.episodes == self.planned:
            raise RuntimeError(f"the {self.planned} planned episodes are over, undecided")
        return super().update(violated)

    def verdict(self, violations: int, episodes: int) -> Decision | None:
        """The decision at these counts, given none at the counts before them.

        Raises:
            ValueError: Past the planned episodes.
        """
        if episodes > self.planned:
            raise ValueError(f"{episodes} episodes are more than the {self.planned} planned")
        if violations + self.planned - episodes <= self._most:
            return "supported"
        return "violated" if violations >= self._least else None

    @cached_property
    def _most(self) -> int:
        """The most violations in all planned episodes that support the limit; -1 for none."""
        counts = range(self.planned + 1)
        right = bisect_right(
            counts, self.limit, key=lambda k: upper_bound(k, self.planned, self.confidence)
        )
        return right - 1

    @cached_property
    def _least(self) -> int:
        """The fewest violations in all planned episodes that violate the limit."""
        counts = range(self.planned + 1)
        return bisect_right(
            counts, self.limit, key=lambda k: lower_bound(k, self.planned, self.confidence)
        )


_DOUBT = 1e-6
"""Distance of log-likelihoods below which they are compared as fractions; their rounding error
stays below it for any count under 1e8."""
_STEPS = 100_000
"""Episodes after which a boundary whose level is still open counts as not shown."""


@dataclass(frozen=True, eq=False)
class Sprt(SequentialTest):
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
        alpha = decimal_fraction(self.alpha)
        beta = alpha if self.beta is None else decimal_fraction(self.beta)
        return _boundaries(decimal_fraction(self.limit), decimal_fraction(self.p0), alpha, beta)


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


_Side = Literal["below", "above"]


@dataclass(frozen=True, eq=False)
class EProcess(SequentialTest):
    r"""Is the rate below ``limit`` (supported) or above it (violated)? Without a second hypothesis.

    Against "the rate is at least t", after k violations in n episodes the e-value is the
    likelihood ratio to t, averaged over the rates q below t::

        E_n(t) = integral over q < t of (q/t)^k ((1-q)/(1-t))^(n-k) d prior(q | q < t)

    The prior is Jeffreys' Beta(1/2, 1/2), the reference prior of a rate, truncated to the
    alternative and normalised there; nothing is tuned. The mirrored process, against "the rate is
    at most t", averages over q > t. ``limit`` is supported once the first reaches
    ``1 / (1 - confidence)`` at t = limit, and violated once the second does; equality counts.

    Why this covers all rates p >= t and not p = t alone: with q < t, the next episode multiplies
    the ratio by q/t < 1 or by (1-q)/(1-t) > 1, in the mean by p q/t + (1-p) (1-q)/(1-t). That is 1
    at p = t and falls as p grows. So for each p >= t the ratio, and with it the average over q, is
    a nonnegative supermartingale that starts at 1, also if p varies from episode to episode and
    depends on the past. By Ville's inequality it ever reaches 1/a with probability of at most a,
    whenever and for whatever reason one stops looking. (Ville 1939; Robbins, Annals of
    Mathematical Statistics 41, 1970; Howard, Ramdas, McAuliffe and Sekhon, Annals of Statistics
    49, 2021; Ramdas and Wang, "Hypothesis testing with e-values", 2025.)

    Why the bounds agree with the decision: ``upper`` is the least t that has been rejected, over
    all looks so far. With h the density over the distribution function of the prior,
    d log E / dt = (nt - k) / (t (1-t)) - h (1 - 1/E), and t (1-t) h <= 1/2 for this prior, so that
    E grows in t wherever nt - k >= 1/2. Elsewhere E <= 2: for t <= k/n no q < t is likelier than
    t, and up to (k + 1/2)/n the likelihood ratio of the best q to t is at most 2. A confidence
    above 1/2 asks for more than that, hence the rejected t at any look are all above some number,
    and ``limit`` is among them if and only if ``upper <= limit``.

    Args:
        limit: Greatest acceptable rate.
        confidence: Each wrong decision has probability of at most ``1 - confidence``, and so has
            each of the events that the rate exceeds ``upper`` or falls below ``lower``, ever.

    Raises:
        ConfigurationError: For a limit outside (0, 1) and a confidence outside (0.5, 1).
    """

    limit: float
    confidence: float
    tally: Tally = field(default_factory=Tally, init=False, repr=False)

    def __post_init__(self) -> None:
        require_between("limit", self.limit, 0.0, 1.0)
        require_between("confidence", self.confidence, 0.5, 1.0)

    @property
    def method(self) -> str:
        """Name of the method, for reports."""
        return "e-process, truncated Beta(1/2, 1/2) mixture, anytime-valid"

    @property
    def upper(self) -> float:
        """The least rate that was rejected as too great at any look so far; 1 if none was."""
        return self._bound("below", 1.0)

    @property
    def lower(self) -> float:
        """The greatest rate that was rejected as too small at any look so far; 0 if none was."""
        return self._bound("above", 0.0)

    def verdict(self, violations: int, episodes: int) -> Decision | None:
        """The decision at these counts, given none at the counts before them."""
        if self._rejects("below", violations, episodes, self.limit):
            return "supported"
        return "violated" if self._rejects("above", violations, episodes, self.limit) else None

    def _rejects(self, side: _Side, violations: int, episodes: int, rate: float) -> bool:
        threshold = -math.log(error_level(self.confidence))
        return log_e_value(violations, episodes, rate, side) >= threshold

    def _bound(self, side: _Side, bound: float) -> float:
        looks = [*self.tally.turns, (self.violations, self.episodes)]
        for violations, episodes in looks:
            clean = episodes - violations
            # Without a single event of the favourable kind no rate is rejected.
            if (clean if side == "below" else violations) and (
                bound in (0.0, 1.0) or self._rejects(side, violations, episodes, bound)
            ):
                bound = self._invert(side, violations, episodes, bound)
        return bound

    def _invert(self, side: _Side, violations: int, episodes: int, rejected: float) -> float:
        """The rejected rate next to those that are not, by bisection down to neighbours.

        The limit is looked at first: whatever the rounding, the bound lies on its side of it.
        """
        accepted, middle = violations / episodes, self.limit
        if not min(accepted, rejected) < middle < max(accepted, rejected):
            middle = (accepted + rejected) / 2
        while middle not in (accepted, rejected):
            if self._rejects(side, violations, episodes, middle):
                rejected = middle
            else:
                accepted = middle
            middle = (accepted + rejected) / 2
        return rejected


@lru_cache(maxsize=2**16)  # campaigns of one requirement look at the same counts
def log_e_value(violations: int, episodes: int, rate: float, side: _Side = "below") -> float:
    """Natural logarithm of the e-value against "the true rate is not on this side of ``rate``".

    Minus infinity where the share of the prior's update on that side underflows; the e-value is
    below one there, since even the best rate of the side is less likely than ``rate``.

    Args:
        violations: Violating episodes.
        episodes: All valid episodes.
        rate: Between 0 and 1, both excluded.
        side: The alternative: rates below or above.
    """
    from scipy.special import betainc, betaincc, betaln

    a, b = violations + 0.5, episodes - violations + 0.5
    if side == "below":
        share, prior = betainc(a, b, rate), 2.0 * math.asin(math.sqrt(rate))
    else:
        share, prior = betaincc(a, b, rate), 2.0 * math.acos(math.sqrt(rate))
    if share == 0.0:
        return -math.inf
    # The incomplete beta function of the prior alone is twice the arc sine (or cosine) of the root.
    average = math.log(share) + float(betaln(a, b)) - math.log(prior)
    return average - violations * math.log(rate) - (episodes - violations) * math.log1p(-rate)


def make_test(
    method: str,
    limit: float,
    confidence: float = 0.95,
    p0: float | None = None,
    planned: int | None = None,
) -> SequentialTest:
    """A new test of "the rate of violations is at most ``limit``", with no episode counted.

    Args:
        method: ``fixed``, ``sprt`` or ``e-process``.
        limit: Greatest acceptable rate.
        confidence: One minus the level of each wrong decision; above one half, below which a
            confidence claims nothing and the inversion of the e-process is not an interval.
        p0: For ``sprt`` alone, which needs it: a rate below ``limit`` that ought to pass.
        planned: Needed by ``fixed``: the number of episodes. The others take it and need none;
            a campaign that ends before they decide is undecided.

    Raises:
        ConfigurationError: For an unknown method, a limit outside (0, 1), a confidence outside
            (0.5, 1), and a ``p0`` or a number of episodes that is missing or makes no sense.
    """
    if method not in METHODS:
        raise ConfigurationError(
            "there is no such method of testing a rate",
            key="method",
            found=method,
            expected=", ".join(METHODS),
        )
    require_between("limit", limit, 0.0, 1.0)
    require_between("confidence", confidence, 0.5, 1.0)
    if (planned is None and method == "fixed") or (planned is not None and planned < 1):
        raise ConfigurationError(
            f"the method {method} cannot plan this number of episodes",
            key="planned",
            found=planned,
            expected="a whole number of 1 or more",
        )
    if method == "sprt":
        if p0 is None:
            raise ConfigurationError(
                "a SPRT needs a rate at which the component ought to pass",
                key="p0",
                expected=f"a rate between 0 and the limit {limit:g}, both excluded",
                remedy="declare p0 before the campaign, or take the method e-process",
            )
        return Sprt(limit, p0, alpha=error_level(confidence))
    if p0 is not None:
        raise ConfigurationError(
            f"the method {method} has no second rate",
            key="p0",
            found=p0,
            remedy="leave p0 out, or take the method sprt",
        )
    if method == "e-process":
        return EProcess(limit, confidence)
    assert planned is not None
    return FixedN(limit, confidence, planned)
