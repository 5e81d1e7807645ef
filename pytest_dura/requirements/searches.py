"""Searches: what a search for violations came to, as plain data.

Its episodes were chosen where violations were expected: no rate can be made of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from pytest_dura.core.codec import LEFT_OUT, Count, Limit, Number, Positive, Sha256, Share
from pytest_dura.core.display import Shown, short_repr

SearchStatus = Literal["falsified", "not repeatable", "undecided", "nothing found"]


@dataclass(frozen=True, slots=True)
class ReplayCount:
    """What came of replaying a violation."""

    runs: Count
    """Replays."""
    violated: Count
    """Those of them that violated the requirement again."""
    equal: Count
    """Those of them that had the digest of the first run."""

    @property
    def confirmed(self) -> bool:
        """Whether every replay was the same run again, and violated."""
        return 0 < self.runs == self.violated == self.equal


@dataclass(frozen=True, slots=True)
class ParameterChange:
    """A parameter of a counterexample that is not as the case has it."""

    path: str
    """Such as `world.ego.speed`, or `faults.delay`."""
    value: Any
    """What it is; null for what was left out."""
    nominal: Any
    """What the case has there; null for nothing."""
    unit: str = field(default="", metadata=LEFT_OUT)
    """Unit of the value; absent where none is declared."""


@dataclass(frozen=True, slots=True)
class Shrinking:
    """How a counterexample was made simpler."""

    before: Count
    """Parameters that were not as the case has them."""
    after: Count
    """Those that still are not."""
    simulations: Count
    """Simulations that it took; they are part of no other count."""
    budget: Count
    """Simulations that it was allowed."""
    finished: bool
    """Whether nothing was left to try before the budget ended."""


@dataclass(frozen=True, slots=True)
class FoundCounterexample:
    """A violation that a search found, and what confirms it.

    Its episode was chosen, and is none of `episodes`.
    """

    case: Annotated[str, Limit(pattern=r"@")]
    """Id of the searched case: the scenario, then `@` and a digest of what was chosen."""
    scenario: Mapping[str, Any]
    """The scenario as plain data, with nothing left to draw but by its seed."""
    seed: Count
    """Seed of the episode."""
    digest: Sha256
    """SHA-256 of the episode."""
    margin: Number | None
    """Robustness; null for a check that gives none."""
    time: Number | None
    """When it was violated first, in s."""
    detail: str
    """Why, in words."""
    repeats: ReplayCount
    """What came of replaying it."""
    changes: tuple[ParameterChange, ...] = ()
    """Its parameters that are not as the case has them."""
    shrinking: Shrinking | None = None
    """How it was made simpler; null if that was not asked for."""
    file: Annotated[str | None, Limit(pattern=r"^[^/\\]")] = None
    """The scenario file that keeps it, relative to the project; null for none."""
    name: str | None = None
    """The name of the scenario in that file."""


@dataclass(frozen=True, slots=True)
class SearchOutcome:
    """What a search came to for one requirement.

    It is no verdict: what finds nothing supports nothing.
    """

    requirement: str
    """Id of the requirement."""
    check: str
    """The formula or function that was searched."""
    status: SearchStatus
    """`falsified` for a violation that was confirmed, `not repeatable` for one whose replays
    differ, `undecided` where more than a fifth of the simulations decided nothing, `nothing found`
    otherwise: never that it holds."""
    simulations: Count
    """Up to the first violation; all of them where there was none."""
    searcher: str | None
    """Which searcher proposed the violation; null for none."""
    best: Number | None
    """Least robustness of all simulations; null where none was measured."""
    counterexample: FoundCounterexample | None = None
    """The violation; null for none."""


@dataclass(frozen=True, slots=True)
class SearcherReport:
    """What one searcher, or one baseline, did."""

    name: str
    """Its name."""
    trivial: bool
    """Whether it learns nothing from what it has seen; every baseline is."""
    simulations: Count
    """Its own simulations."""
    best: Mapping[str, Number | None]
    """Least robustness by requirement; null where none was measured."""
    first: Mapping[str, Positive | None]
    """By requirement, its own simulations up to its first violation; null for none."""


@dataclass(frozen=True, slots=True)
class SearchParameter:
    """What a search could change of its case."""

    path: str
    """Its name: `world.ego.speed`, or `faults.search-1` for room for a fault."""
    low: Number | None = field(default=None, metadata=LEFT_OUT)
    """Least value of a number, or of each number of an input over time."""
    high: Number | None = field(default=None, metadata=LEFT_OUT)
    """Greatest value."""
    pieces: Positive | None = field(default=None, metadata=LEFT_OUT)
    """Numbers of an input over time; absent for a single one."""
    choice: list[Any] | None = field(default=None, metadata=LEFT_OUT)
    """The values of a choice."""
    unit: str = field(default="", metadata=LEFT_OUT)
    """Unit of its numbers, as the scenario, the domain's world or the fault type declares it;
    absent where none does."""
    faults: Mapping[str, tuple[SearchParameter, ...]] | None = field(
        default=None, metadata=LEFT_OUT
    )
    """The faults that may be added there by their ids, and what could be changed of each."""


@dataclass(frozen=True, slots=True)
class SpaceCoverage:
    """Which part of the space was simulated."""

    parameters: Mapping[str, Share]
    """By name, the share of its parts with any simulation: tenths of a range, single choices."""
    pairs: Share | None
    """Of each two coordinates, in fifths: the mean share of their parts with any; null for a space
    of one."""


@dataclass(frozen=True)
class Falsification(Shown):
    """A search for violations of some requirements on a case.

    Its simulations were chosen where violations were expected: they are part of no verdict, and no
    rate can be made of them.
    """

    case: str
    """Id of the case: the scenario, then `+` and its faults where they differ from the scenario's
    own, then `~` and a role that is switched off."""
    component: str
    """Name of the component under test."""
    seed: Count
    """From which all draws follow."""
    budget: Count
    """Simulations that it was allowed."""
    simulations: Count
    """Those that it took."""
    refused: Count
    """Points whose values contradict each other; none of them was simulated."""
    unknown: Count
    """Simulations that decided nothing of some requirement."""
    not_manifested: Count
    """Simulations in which an added fault never came to act; they say what the case does without
    it."""
    rule: str
    """How the budget is shared over the searchers."""
    parameters: tuple[SearchParameter, ...]
    """What it could change."""
    searchers: tuple[SearcherReport, ...]
    """What each searcher did."""
    baselines: tuple[SearcherReport, ...]
    """What the trivial searchers come to by themselves, each with as many simulations as the search
    took."""
    coverage: SpaceCoverage
    """Which part of the space was simulated."""
    outcomes: tuple[SearchOutcome, ...]
    """Requirement by requirement."""

    __repr__ = short_repr

    def _figures(self) -> Iterator[tuple[str, object]]:
        """Yield what a notebook shows."""
        yield "searched", self.case
        yield "component", self.component
        yield "simulations", f"{self.simulations} of {self.budget}"
        for outcome in self.outcomes:
            counterexample = outcome.counterexample
            detail = "" if counterexample is None else f": {counterexample.detail}"
            yield outcome.requirement, outcome.status + detail

    @property
    def violations(self) -> tuple[SearchOutcome, ...]:
        """The outcomes with a violation, confirmed or not."""
        return tuple(outcome for outcome in self.outcomes if outcome.counterexample is not None)
