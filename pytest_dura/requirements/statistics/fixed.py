"""The design of a fixed number of episodes, ended early only where nothing can change any more."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, field
from functools import cached_property

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.requirements.statistics.exact import METHOD, lower_bound, upper_bound
from pytest_dura.requirements.statistics.sequential import (
    CountingTest,
    Decision,
    Tally,
    require_between,
)


@dataclass(frozen=True, eq=False)
class FixedN(CountingTest):
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
        return METHOD

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
        found = bisect_right(
            counts, self.limit, key=lambda k: upper_bound(k, self.planned, self.confidence)
        )
        return found - 1

    @cached_property
    def _least(self) -> int:
        """The fewest violations in all planned episodes that violate the limit."""
        counts = range(self.planned + 1)
        return bisect_right(
            counts, self.limit, key=lambda k: lower_bound(k, self.planned, self.confidence)
        )
