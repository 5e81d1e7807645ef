"""An anytime-valid test of a rate and the confidence sequence that belongs to it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Literal

from pytest_dura.requirements.statistics.sequential import (
    CountingTest,
    Decision,
    Tally,
    error_level,
    require_between,
)

_Side = Literal["below", "above"]


@dataclass(frozen=True, eq=False)
class EProcess(CountingTest):
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
        kept, middle = violations / episodes, self.limit
        if not min(kept, rejected) < middle < max(kept, rejected):
            middle = (kept + rejected) / 2
        while middle not in (kept, rejected):
            if self._rejects(side, violations, episodes, middle):
                rejected = middle
            else:
                kept = middle
            middle = (kept + rejected) / 2
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
