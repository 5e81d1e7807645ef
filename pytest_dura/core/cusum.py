"""Two-sided CUSUM: sees a small lasting shift of a residual's mean sooner than any single value.

E. S. Page, "Continuous inspection schemes", Biometrika 41 (1954), pp. 100-115: with the residual
x, which has mean 0 as long as all is well, the drift k and the threshold h, ::

    upper = max(0, upper + x - k)        lower = max(0, lower - x - k)

and an alarm as soon as one of the two reaches h. Both start at 0, and again after each alarm. Half
the smallest shift worth an alarm is the usual k; h is set by the false alarms that are acceptable.
"""

from __future__ import annotations

import math

_ROUNDING = 1.0 - 1e-9
"""Sums of equal shifts that reach the threshold exactly must not fail to by their rounding."""


class Cusum:
    """One two-sided test.

    Args:
        drift: k: what each sample may be off for free; in the residual's unit, at least 0.
        threshold: h: the sum at which it alarms; in the residual's unit, above 0.

    Attributes:
        upper: Sum of what the samples were too great by.
        lower: The same for too small.

    Raises:
        ValueError: For a drift or threshold out of range.

    A lasting shift by d > k alarms after at most ``ceil(h / (d - k))`` samples, and residuals
    within plus or minus k never do.
    """

    __slots__ = ("drift", "lower", "threshold", "upper")

    def __init__(self, drift: float, threshold: float) -> None:
        if not (0.0 <= drift < math.inf and threshold > 0.0):
            raise ValueError(
                f"drift must be at least 0 and threshold above it, not {drift:g} and {threshold:g}"
            )
        self.drift, self.threshold = float(drift), float(threshold)
        self.reset()

    def reset(self) -> None:
        """Begin anew."""
        self.upper = self.lower = 0.0

    def update(self, residual: float) -> bool:
        """Take in one sample; whether it alarms. A residual that is not finite always does."""
        if not math.isfinite(residual):
            self.reset()
            return True
        self.upper = max(0.0, self.upper + residual - self.drift)
        self.lower = max(0.0, self.lower - residual - self.drift)
        if max(self.upper, self.lower) < self.threshold * _ROUNDING:
            return False
        self.reset()
        return True

    @property
    def level(self) -> float:
        """How near it is to an alarm: 0 for not at all, 1 for an alarm."""
        return max(self.upper, self.lower) / self.threshold
