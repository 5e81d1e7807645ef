"""Searches: what each search came to, from what its searchers did and what its replays gave.

No episode of a search is in the record, and no rate is made of one.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

from pytest_dura.core.episode import canonical
from pytest_dura.evidence.conclusions.conclusion import Conclusion
from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.evidence.model import RecordHead
from pytest_dura.requirements.searches import SEARCHED_MARK


class Searches(Conclusion):
    """Concludes the key ``searches``."""

    def add(self, episode: EpisodeEntry) -> None:
        """Take no episode in: those of the record are none of a search."""

    def concluded(self, head: RecordHead) -> Mapping[str, Any]:
        """Conclude them from what is recorded of their simulations."""
        return {"searches": [search.concluded() for search in head.searches]}

    def check(self, episode: EpisodeEntry) -> Iterator[str]:
        """Yield that a search chose a run of a plan."""
        if episode.planned and SEARCHED_MARK in episode.case:
            yield f"episode {episode.id}: a search chose it, and it is planned"

    def check_head(self) -> Iterator[str]:
        """Yield the contradictions within searches, and with what the head lists."""
        requirements = {requirement.id: requirement for requirement in self.head.requirements}
        described = {component.name for component in self.head.components()}
        for case in self.head.cases:
            if SEARCHED_MARK in case.id and (case.planned or case.metrics.run):
                yield f"case {case.id}: a search chose it, and there are metrics of it"
        counts = Counter(canonical(replace(search, waiver=None)) for search in self.head.searches)
        if max(counts.values(), default=0) > 1:
            yield "searches: one of them is listed twice"
        for search in self.head.searches:
            place = f"search by {search.item} on {search.case}"
            if search.component not in described:
                yield f"{place}: {search.component} is not described"
            for problem in search.contradictions(search.scenario):
                yield f"{place}: {problem}"
            for outcome in search.outcomes:
                listed = requirements.get(outcome.requirement)
                if listed is None:
                    yield f"{place}: {outcome.requirement}: the requirement is not listed"
                elif listed.check not in ("", outcome.check):
                    searched = f"searched {outcome.check!r}, which is not its check"
                    yield f"{place}: {outcome.requirement}: {searched}"
