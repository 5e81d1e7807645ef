"""Models of searches for violations in the record, and their collection in a session."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Annotated, Any, Literal

from pydantic import Field

from pytest_dura.evidence.entry import (
    Absent,
    Coded,
    Count,
    Entry,
    JsonObject,
    Number,
    Positive,
    Sha256,
    Share,
)
from pytest_dura.evidence.item_verdicts import Waiver


class ParameterChangeEntry(Entry):
    """A parameter of a counterexample that is not as the case has it."""

    path: str
    """Such as `world.ego.speed`, or `faults.delay`."""
    value: Any
    """What it is; null for what was left out."""
    nominal: Any
    """What the case has there; null for nothing."""


class ReplayEntry(Entry):
    """What came of replaying it."""

    runs: Count
    """Replays."""
    violated: Count
    """Those of them that violated the requirement again."""
    equal: Count
    """Those of them that had the digest of the first run."""


class ShrinkingEntry(Entry):
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


class FoundCounterexample(Entry):
    """A violation that a search found, and what confirms it.

    Its episode was chosen, and is none of `episodes`.
    """

    case: Annotated[str, Field(pattern=r"@")]
    """Id of the searched case: the scenario, then `@` and a digest of what was chosen."""
    scenario: JsonObject
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
    repeats: ReplayEntry
    """What came of replaying it."""
    changes: list[ParameterChangeEntry]
    """Its parameters that are not as the case has them."""
    shrinking: ShrinkingEntry | None
    """How it was made simpler; null if that was not asked for."""
    file: Annotated[str, Field(pattern=r"^[^/\\]")] | None
    """The scenario file that keeps it, relative to the project; null for none."""
    name: str | None
    """The name of the scenario in that file."""


class SearchOutcomeEntry(Entry):
    """What a search came to for one requirement.

    It is no verdict: what finds nothing supports nothing.
    """

    requirement: str
    """Id of the requirement."""
    check: str
    """The formula or function that was searched."""
    word: Literal["falsified", "not repeatable", "undecided", "nothing found"]
    """`falsified` for a violation that was confirmed, `not repeatable` for one whose replays
    differ, `undecided` where more than a fifth of the simulations said nothing, `nothing found`
    otherwise."""
    simulations: Count
    """Up to the first violation; all of them where there was none."""
    searcher: str | None
    """Who proposed the violation; null for none."""
    best: Number | None
    """Least robustness of all simulations; null where none was measured."""
    counterexample: FoundCounterexample | None
    """The violation; null for none."""


class SearcherEntry(Entry):
    """What one searcher, or one baseline, did."""

    name: str
    """Its name."""
    trivial: bool
    """Whether it learns nothing from what it has seen; every baseline is."""
    simulations: Count
    """Its own simulations."""
    best: dict[str, Number | None]
    """Least robustness by requirement; null where none was measured."""
    first: dict[str, Positive | None]
    """By requirement, its own simulations up to its first violation; null for none."""


class SearchParameterEntry(Entry):
    """What a search could change of its case."""

    path: str
    """Its name: `world.ego.speed`, or `faults.search-1` for room for a fault."""
    low: Absent[Number] = None
    """Least value of a number, or of each number of an input over time."""
    high: Absent[Number] = None
    """Greatest value."""
    pieces: Positive | None = None
    """Numbers of an input over time; null for a single one."""
    choice: Absent[list[Any]] = None
    """The values of a choice."""
    faults: Absent[dict[str, list[SearchParameterEntry]]] = None
    """The faults that may be added there by their ids, and what could be changed of each."""


class SearchCoverage(Entry):
    """Which part of the space was simulated."""

    parameters: dict[str, Share]
    """By name, the share of its parts with any simulation: tenths of a range, single choices."""
    pairs: Share | None
    """Of each two coordinates, in fifths: the mean share of their parts with any; null for a space
    of one."""


class SearchEntry(Entry):
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
    """Simulations that said nothing of some requirement."""
    idle: Count
    """Simulations in which an added fault never came to act; they say what the case does without
    it."""
    rule: str
    """How the budget is shared over the searchers."""
    parameters: list[SearchParameterEntry]
    """What it could change."""
    searchers: list[SearcherEntry]
    """What each searcher did."""
    baselines: list[SearcherEntry]
    """What the trivial searchers come to by themselves, each with as many simulations as the search
    took."""
    coverage: SearchCoverage
    """Which part of the space was simulated."""
    outcomes: list[SearchOutcomeEntry]
    """Requirement by requirement."""
    scenario: str
    """Name of the scenario of the case."""
    simulator: str
    """Import path of the simulator."""
    roles: dict[str, str]
    """Import path of each role."""
    item: str
    """Node id of the test that searched."""
    waiver: Coded[Waiver] | None
    """What excused its failure; null if nothing did."""


_sort_key = attrgetter("case", "component", "item", "seed")


def searched_claims(searches: Iterable[SearchEntry]) -> set[tuple[str, str, str]]:
    """Item, requirement and case of what was searched instead of decided."""
    return {
        (search.item, outcome.requirement, search.case)
        for search in searches
        for outcome in search.outcomes
    }


@dataclass
class SearchRecords:
    """Collects the searches of a session.

    A search is a function of its case, its seed and its budget: if it is reported twice, it is
    recorded once. Of one that came out differently the second time, both results are recorded.
    """

    _searches: dict[str, SearchEntry] = field(default_factory=dict)

    def add(self, item: str, searches: Iterable[Mapping[str, Any]]) -> None:
        """Take in the searches that an item reports."""
        for search in searches:
            entry = SearchEntry.model_validate({**search, "item": item, "waiver": None})
            self.adopt(entry)

    def adopt(self, entry: SearchEntry) -> None:
        """Take over a search of another session, with its item and its waiver."""
        question = entry.to_json(exclude={"waiver"})
        self._searches.setdefault(json.dumps(question, sort_keys=True), entry)

    @property
    def answered(self) -> set[tuple[str, str, str]]:
        """Claims that items searched instead of deciding them: they get no verdict."""
        return searched_claims(self._searches.values())

    def entries(self, waivers: Mapping[str, Waiver]) -> list[SearchEntry]:
        """List the entries of the record's key ``searches``, sorted.

        Args:
            waivers: By the node id of the item that each excuses.
        """
        ordered = sorted(
            self._searches.items(),
            key=lambda entry: (*_sort_key(entry[1]), entry[0]),
        )
        return [
            search.replace(waiver=waivers.get(search.item, search.waiver)) for _, search in ordered
        ]
