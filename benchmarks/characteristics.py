"""How often a sequential test of a rate decides, and after how many episodes."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np

from pytest_dura.requirements.sequential import Decision, Rule, Step, walk


@dataclass(frozen=True, slots=True)
class Boundaries:
    """A rule as a table; itself a rule.

    Args:
        accept: After n episodes, at entry n - 1: so many violations or fewer are ``supported``;
            -1 where none are few enough.
        reject: So many violations or more are ``violated``; n + 1 where none are enough.
    """

    accept: tuple[int, ...]
    reject: tuple[int, ...]

    @classmethod
    def of(cls, rule: Rule, budget: int) -> Boundaries:
        """The table of a rule for the first ``budget`` episodes.

        With one more episode each boundary stays or moves, never back (see :class:`Rule`).
        """
        accept, reject, most, least = [], [], -1, 0
        for n in range(1, budget + 1):
            while most < n and rule.verdict(most + 1, n) == "supported":
                most += 1
            least = max(least, most + 1)
            while least <= n and rule.verdict(least, n) != "violated":
                least += 1
            accept.append(most)
            reject.append(least)
        return cls(tuple(accept), tuple(reject))

    def verdict(self, violations: int, episodes: int) -> Decision | None:
        """The decision at these counts.

        Raises:
            IndexError: Past the budget of the table.
        """
        if violations <= self.accept[episodes - 1]:
            return "supported"
        return "violated" if violations >= self.reject[episodes - 1] else None


@dataclass(frozen=True, slots=True)
class Characteristics:
    """Characteristics of a test at one true rate within a budget.

    Args:
        rate: The true rate.
        supported: Share of campaigns that end so.
        violated: Share of campaigns that end so.
        undecided: Share of campaigns whose budget ends first.
        mean_episodes: Mean number of episodes, undecided campaigns counting the whole budget.
        decided: Share of campaigns that are decided after n episodes, at entry n - 1.
    """

    rate: float
    supported: float
    violated: float
    undecided: float
    mean_episodes: float
    decided: tuple[float, ...]

    def percentile(self, share: float) -> int | None:
        """Episodes after which so great a share is decided; ``None`` if the budget ends first."""
        index = bisect_left(self.decided, share)
        return index + 1 if index < len(self.decided) else None


def operating_characteristics(rule: Rule, rate: float, budget: int) -> Characteristics:
    """The exact characteristics of a test or of its :class:`Boundaries`, see :func:`walk`."""
    steps = list(islice(walk(rule, rate), budget))
    return _characteristics(rate, steps, budget)


def simulate(
    boundaries: Boundaries, rate: float, campaigns: int, generator: np.random.Generator
) -> Characteristics:
    """The characteristics as observed in synthetic campaigns of independent episodes."""
    violations = np.zeros(campaigns, dtype=int)
    steps, supported, violated = [], 0, 0
    for n, (most, least) in enumerate(zip(boundaries.accept, boundaries.reject, strict=True), 1):
        violations += generator.random(violations.size) < rate
        accepted, rejected = violations <= most, violations >= least
        supported += int(accepted.sum())
        violated += int(rejected.sum())
        violations = violations[~(accepted | rejected)]
        steps.append(
            Step(n, supported / campaigns, violated / campaigns, violations.size / campaigns)
        )
    return _characteristics(rate, steps, len(steps))


def _characteristics(rate: float, steps: Sequence[Step], budget: int) -> Characteristics:
    last = steps[-1]
    return Characteristics(
        rate=rate,
        supported=last.supported,
        violated=last.violated,
        undecided=last.open,
        # The mean is the sum of the probabilities to be still open before each episode.
        mean_episodes=1.0 + sum(step.open for step in steps[: budget - 1]),
        decided=tuple(step.supported + step.violated for step in steps),
    )
