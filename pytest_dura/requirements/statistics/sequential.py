"""What every test of "the rate of violations is at most a limit" looks like, run after run.

A test counts valid episodes and decides at the first crossing of its boundaries; the decision is
final. A budget that ends before a crossing leaves the campaign undecided: no test here turns an
exhausted budget into a decision.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Literal, Protocol

from pytest_dura.core.errors import ConfigurationError

Decision = Literal["supported", "violated"]


class Rule(Protocol):
    """What counts of violations decide.

    Every rule here is monotone: more violations in as many episodes, or fewer clean episodes with
    as many violations, never turn ``violated`` into anything else nor anything else into
    ``supported``. Two campaigns that draw the same uniform numbers but differ in their rates
    therefore cannot cross the other way round: the probability of ``supported`` falls as the rate
    grows, also under a budget, and each error level needs to be shown at one end of its range only.
    """

    def verdict(self, violations: int, episodes: int) -> Decision | None:
        """The decision at these counts, given none at the counts before them."""
        ...


class SequentialTest(Rule, Protocol):
    """A test of one campaign's rate of violations that may be looked at after every episode."""

    @property
    def method(self) -> str:
        """Name of the method, for reports."""
        ...

    @property
    def violations(self) -> int:
        """Violations so far."""
        ...

    @property
    def episodes(self) -> int:
        """Valid episodes so far."""
        ...

    @property
    def decision(self) -> Decision | None:
        """The decision at the first crossing, ``None`` before."""
        ...

    @property
    def hopeless(self) -> bool:
        """Whether no further episode can make the decision ``supported``."""
        ...

    @property
    def upper(self) -> float | None:
        """Upper confidence bound on the rate, valid whenever one stops; ``None`` where none is."""
        ...

    @property
    def lower(self) -> float | None:
        """Lower confidence bound on the rate, valid whenever one stops; ``None`` where none is."""
        ...

    def update(self, violated: bool) -> Decision | None:
        """Count one valid episode and return the decision, if there is one now."""
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
        """One more episode."""
        if self._last is not None and violated != self._last:
            self.turns.append((self.violations, self.episodes))
        self._last = violated
        self.violations += violated
        self.episodes += 1


class CountingTest(ABC):
    """The part that all tests share: counting, and the first crossing that is final."""

    tally: Tally

    @abstractmethod
    def verdict(self, violations: int, episodes: int) -> Decision | None:
        """The decision at these counts, given none at the counts before them."""

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


def as_written(value: float) -> Fraction:
    """The decimal number that was written, such as 1/20 for ``0.05``, and not its binary image."""
    return Fraction(repr(float(value)))


def error_level(confidence: float) -> float:
    """``1 - confidence`` without the rounding of the subtraction."""
    return float(1 - as_written(confidence))


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
