"""Searches: what a search for violations came to, as plain data.

Its episodes were chosen where violations were expected: no rate can be made of them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import PurePosixPath, PureWindowsPath
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pytest_dura.core.codec import LEFT_OUT, Count, Limit, Number, Positive, Sha256, Share
from pytest_dura.core.display import Shown, short_repr

if TYPE_CHECKING:
    from typing_extensions import Self

SEARCHED_MARK = "@"
"""In the id of a case that a search chose, between the scenario's name and the digest of the case;
part of no scenario's name."""
MAX_UNKNOWN_SHARE = 0.2
"""Share of simulations that decided nothing above which a search is undecided."""
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

    def contradictions(self, scenario: str) -> Iterator[str]:
        """Yield what its fields cannot say together.

        Args:
            scenario: Name of the searched scenario.
        """
        if not self.case.startswith(f"{scenario}{SEARCHED_MARK}"):
            yield f"its counterexample {self.case} is of another scenario than {scenario}"
        recorded = self.scenario.get("name"), self.scenario.get("seed")
        if recorded != (scenario, self.seed):
            yield f"its counterexample is {scenario} with seed {self.seed}, and says {recorded}"
        paths = [change.path for change in self.changes]
        if len(set(paths)) < len(paths):
            yield "a parameter of its counterexample changed twice"
        if not max(self.repeats.violated, self.repeats.equal) <= self.repeats.runs:
            yield f"more repeats than {self.repeats.runs}"
        shrinking = self.shrinking
        if shrinking is not None and shrinking.simulations > shrinking.budget:
            spent = shrinking.simulations
            yield f"{spent} simulations to make it simpler, and {shrinking.budget} were allowed"
        if shrinking is not None and shrinking.after > shrinking.before:
            yield f"made simpler from {shrinking.before} to {shrinking.after} parameters"
        if (self.file is None) != (self.name is None):
            yield f"its counterexample is kept in {self.file} as {self.name}"
        if self.file is None:
            return
        if PurePosixPath(self.file).is_absolute() or PureWindowsPath(self.file).is_absolute():
            yield f"it is kept in {self.file}, which is a path of one machine"
        if self.repeats.equal != self.repeats.runs:
            yield f"it is kept in {self.file}, and was never confirmed"


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

    def contradictions(self, requirements: Collection[str]) -> Iterator[str]:
        """Yield what its fields cannot say together.

        Args:
            requirements: Ids of those that were searched.
        """
        if set(self.best) != set(requirements) or set(self.first) != set(requirements):
            yield f"{self.name}: its figures are of other requirements"
        for name, first in self.first.items():
            if first is not None and first > self.simulations:
                where = f"at {first} of its {self.simulations} simulations"
                yield f"{self.name}: violated {name} {where}"


def first_violations(searchers: Iterable[SearcherReport], requirement: str) -> dict[str, int]:
    """Number of the first violating simulation of each searcher that violated a requirement."""
    firsts = {each.name: each.first.get(requirement) for each in searchers}
    return {name: first for name, first in firsts.items() if first is not None}


def search_status(
    counterexample: FoundCounterexample | None, unknown: int, simulations: int
) -> SearchStatus:
    """Status of what a search came to for one requirement.

    Args:
        counterexample: The violation, if one was found.
        unknown: Simulations that decided nothing of some requirement.
        simulations: All of them.
    """
    if counterexample is not None:
        return "falsified" if counterexample.repeats.confirmed else "not repeatable"
    return "undecided" if unknown > MAX_UNKNOWN_SHARE * simulations else "nothing found"


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

    def concluded(self) -> Self:
        """Copy with all that follows from its searchers and its counterexamples."""
        simulations = sum(searcher.simulations for searcher in self.searchers)
        outcomes = tuple(self._concluded(outcome, simulations) for outcome in self.outcomes)
        return replace(self, simulations=simulations, outcomes=outcomes)

    def _concluded(self, outcome: SearchOutcome, simulations: int) -> SearchOutcome:
        known = [searcher.best.get(outcome.requirement) for searcher in self.searchers]
        violated = outcome.counterexample is not None
        return replace(
            outcome,
            status=search_status(outcome.counterexample, self.unknown, simulations),
            simulations=outcome.simulations if violated else simulations,
            searcher=outcome.searcher if violated else None,
            best=min((best for best in known if best is not None), default=None),
        )

    def contradictions(self, scenario: str) -> Iterator[str]:
        """Yield what its fields cannot say together, apart from what follows from others.

        Args:
            scenario: Name of the scenario of its case.
        """
        total = self.simulations
        if not 0 < total <= self.budget:
            yield f"{total} simulations, and its budget is {self.budget}"
        if self.unknown > total:
            yield f"{self.unknown} of {total} simulations decided nothing"
        if self.not_manifested > total:
            share = f"{self.not_manifested} of {total} simulations"
            yield f"an added fault never came to act in {share}"
        names = [outcome.requirement for outcome in self.outcomes]
        if not names or len(set(names)) < len(names):
            yield f"it is for the requirements {', '.join(names) or 'of none'}"
        for kind, searchers in (("searchers", self.searchers), ("baselines", self.baselines)):
            if max(Counter(searcher.name for searcher in searchers).values(), default=0) > 1:
                yield f"one of its {kind} is listed twice"
            for searcher in searchers:
                yield from searcher.contradictions(names)
        for baseline in self.baselines:
            if not baseline.trivial:
                yield f"{baseline.name} learns, and is no baseline"
            if baseline.simulations > total:
                yield f"{baseline.name}: a baseline of {baseline.simulations} simulations"
        for outcome in self.outcomes:
            for problem in self._contradictions_of(outcome):
                yield f"{outcome.requirement}: {problem}"
            if outcome.counterexample is not None:
                for problem in outcome.counterexample.contradictions(scenario):
                    yield f"{outcome.requirement}: {problem}"

    def _contradictions_of(self, outcome: SearchOutcome) -> Iterator[str]:
        """Compare an outcome with the violations of searchers and baselines."""
        found = first_violations(self.searchers, outcome.requirement)
        of_baselines = first_violations(self.baselines, outcome.requirement)
        if outcome.counterexample is None:
            for name, first in found.items():
                why = "and there is no counterexample"
                yield f"{name} violated it at its simulation {first}, {why}"
            return
        if not self.baselines:
            yield f"{outcome.status}, and no baseline stands beside it"
        if not found and outcome.searcher in of_baselines:
            if outcome.simulations != of_baselines[outcome.searcher]:
                yield f"violated at simulation {outcome.simulations} of a baseline"
        elif outcome.searcher not in found:
            yield f"{outcome.searcher} found it, and violated nothing"
        elif not found[outcome.searcher] <= outcome.simulations <= self.simulations:
            yield f"violated at simulation {outcome.simulations} of {self.simulations}"
