"""Sequential tests of a rate: what they share, and how often each decides at a true rate.

A test counts valid episodes and decides at the first crossing of its boundaries; the decision is
final. A budget that ends before a crossing leaves the campaign undecided: no test here turns an
exhausted budget into a decision.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from itertools import islice
from typing import TYPE_CHECKING, Literal, Protocol

from pytest_dura.core.errors import ConfigurationError

if TYPE_CHECKING:
    import numpy as np


Decision = Literal["supported", "violated"]


class Rule(Protocol):
    """A decision rule on counts of violations.

    Every rule here is monotone: more violations in as many episodes, or fewer clean episodes with
    as many violations, never turn ``violated`` into anything else nor anything else into
    ``supported``. Two campaigns that draw the same uniform numbers but differ in their rates
    therefore cannot cross the other way round: the probability of ``supported`` falls as the rate
    grows, also under a budget, and each error level needs to be shown at one end of its range only.
    """

    def verdict(self, violations: int, episodes: int) -> Decision | None:
        """The decision at these counts, given none at the counts before them."""
        ...


@dataclass
class Tally:
    """The counts of a campaign, and where its direction turned.

    ``turns`` holds the counts ``(violations, episodes)`` before each change between clean and
    violating episodes: whatever rises with each clean and falls with each violating episode, or
    the other way round, was at its extremes there or is so now.
    """

    violations: int = 0
    episodes: int = 0
    decision: Decision | None = None
    turns: list[tuple[int, int]] = field(default_factory=list)
    _last: bool | None = None

    def count(self, violated: bool) -> None:
        """Count an episode."""
        if self._last is not None and violated != self._last:
            self.turns.append((self.violations, self.episodes))
        self._last = violated
        self.violations += violated
        self.episodes += 1


class SequentialTest(ABC):
    """A test of one campaign's rate of violations that may be looked at after every episode.

    It is a :class:`Rule`. The decision falls at the first crossing of its boundaries, and is final.
    """

    tally: Tally

    @abstractmethod
    def verdict(self, violations: int, episodes: int) -> Decision | None:
        """The decision at these counts, given none at the counts before them."""

    @property
    @abstractmethod
    def method(self) -> str:
        """Name of the method, for reports."""

    @property
    @abstractmethod
    def upper(self) -> float | None:
        """Upper confidence bound on the rate, valid whenever one stops; ``None`` where none is."""

    @property
    @abstractmethod
    def lower(self) -> float | None:
        """Lower confidence bound on the rate, valid whenever one stops; ``None`` where none is."""

    @property
    def violations(self) -> int:
        """Violations so far."""
        return self.tally.violations

    @property
    def episodes(self) -> int:
        """Valid episodes so far."""
        return self.tally.episodes

    @property
    def decision(self) -> Decision | None:
        """The decision at the first crossing, ``None`` before."""
        return self.tally.decision

    @property
    def hopeless(self) -> bool:
        """Whether no further episode can make the decision ``supported``."""
        return self.decision == "violated"

    def update(self, violated: bool) -> Decision | None:
        """Count one valid episode and return the decision, if there is one now.

        Raises:
            RuntimeError: After the decision, which nothing may change any more.
            TypeError: For anything but a truth value: an episode that is neither satisfied nor
                violated must not count as a clean one.
        """
        if violated not in (True, False):
            raise TypeError(f"an episode violated or did not, and {violated!r} says neither")
        if self.decision is not None:
            counts = f"{self.violations} violations in {self.episodes} episodes"
            raise RuntimeError(f"the test decided {self.decision!r} at {counts}, which is final")
        self.tally.count(bool(violated))
        self.tally.decision = self.verdict(self.violations, self.episodes)
        return self.decision


def decimal_fraction(value: float) -> Fraction:
    """The decimal number that was written, such as 1/20 for ``0.05``, and not its binary image."""
    return Fraction(repr(float(value)))


def error_level(confidence: float) -> float:
    """``1 - confidence`` without the rounding of the subtraction."""
    return float(1 - decimal_fraction(confidence))


def require_between(key: str, value: float, low: float, high: float) -> None:
    """Refuse a share that does not lie strictly between two others.

    Raises:
        ConfigurationError: If it does not.
    """
    if not low < value < high:
        raise ConfigurationError(
            f"{key} does not lie strictly between {low:g} and {high:g}",
            key=key,
            found=value,
            expected=f"a number between {low:g} and {high:g}, both excluded",
        )


@dataclass(frozen=True, slots=True)
class Step:
    """Probabilities after some episodes; the three of them add up to 1."""

    episodes: int
    supported: float
    violated: float
    open: float


def walk(rule: Rule, rate: float) -> Iterator[Step]:
    """The probabilities after 1, 2, ... independent episodes, until no campaign is open.

    Exact dynamic programming over the number of violations, up to floating-point rounding. A rule
    whose campaigns can stay open for ever never ends the iteration: the caller has a budget.
    """
    alive, episodes, supported, violated = {0: 1.0}, 0, 0.0, 0.0
    while alive:
        episodes += 1
        reached: dict[int, float] = {}
        for violations, mass in alive.items():
            reached[violations] = reached.get(violations, 0.0) + mass * (1.0 - rate)
            reached[violations + 1] = mass * rate
        alive = {}
        for violations, mass in reached.items():
            decision = rule.verdict(violations, episodes)
            if decision == "supported":
                supported += mass
            elif decision == "violated":
                violated += mass
            elif mass > 0.0:
                alive[violations] = mass
        yield Step(episodes, supported, violated, sum(alive.values()))


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
    import numpy as np

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
