"""Searches for violations in the record."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
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


def searched_question(search: RecordedSearch) -> str:
    """Identify a search, which is a function of its case, its seed and its budget.

    Of one that came out differently the second time, both results are recorded.
    """
    return json.dumps(encode(replace(search, waiver=None)), sort_keys=True)


def search_entries(
    searches: Iterable[RecordedSearch], waivers: Mapping[str, Waiver]
) -> list[RecordedSearch]:
    """List the entries of the record's key ``searches``, sorted.

    Args:
        searches: The searches.
        waivers: By the node id of the item that each excuses.
    """
    ordered = sorted(searches, key=lambda search: (*_sort_key(search), searched_question(search)))
    return [replace(search, waiver=waivers.get(search.item, search.waiver)) for search in ordered]
