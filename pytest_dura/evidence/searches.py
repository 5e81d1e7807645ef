"""Searches for violations in the record, and their collection in a session."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from operator import attrgetter

from pytest_dura.core.codec import encode
from pytest_dura.evidence.item_verdicts import Waiver
from pytest_dura.requirements.searches import Falsification


@dataclass(frozen=True, kw_only=True)
class RecordedSearch(Falsification):
    """A search for violations of some requirements on a case.

    Its simulations were chosen where violations were expected: they are part of no verdict, and no
    rate can be made of them.
    """

    scenario: str
    """Name of the scenario of the case."""
    simulator: str
    """Import path of the simulator."""
    roles: Mapping[str, str]
    """Import path of each role."""
    item: str = ""
    """Node id of the test that searched."""
    waiver: Waiver | None = None
    """What excused its failure; null if nothing did."""


_sort_key = attrgetter("case", "component", "item", "seed")


def searched_claims(searches: Iterable[RecordedSearch]) -> set[tuple[str, str, str]]:
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

    _searches: dict[str, RecordedSearch] = field(default_factory=dict)

    def add(self, item: str, searches: Iterable[RecordedSearch]) -> None:
        """Take in the searches that an item reports."""
        for search in searches:
            self.adopt(replace(search, item=item))

    def adopt(self, search: RecordedSearch) -> None:
        """Take over a search of another session, with its item and its waiver."""
        question = encode(replace(search, waiver=None))
        self._searches.setdefault(json.dumps(question, sort_keys=True), search)

    @property
    def answered(self) -> set[tuple[str, str, str]]:
        """Claims that items searched instead of deciding them: they get no verdict."""
        return searched_claims(self._searches.values())

    def entries(self, waivers: Mapping[str, Waiver]) -> list[RecordedSearch]:
        """List the entries of the record's key ``searches``, sorted.

        Args:
            waivers: By the node id of the item that each excuses.
        """
        ordered = sorted(
            self._searches.items(),
            key=lambda entry: (*_sort_key(entry[1]), entry[0]),
        )
        return [
            replace(search, waiver=waivers.get(search.item, search.waiver)) for _, search in ordered
        ]
