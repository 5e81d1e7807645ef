"""Sequential tests of a rate: what they share, and the probabilities of their decisions.

A test counts valid episodes and decides at the first crossing of its boundaries; the decision is
final. A budget that ends before a crossing leaves the campaign undecided: no test here turns an
exhausted budget into a decision.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Literal, Protocol

from pytest_dura.core.errors import ConfigurationError

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
            f"{key} lies strictly between {low:g} and {high:g}",
            key=key,
            found=value,
            expected=f"a number between {low:g} and {high:g}, both excluded",
            remedy=f"correct {key}",
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
