"""Near misses: how close to a violation the satisfied runs of each case came."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

from pytest_dura.evidence.conclusions.tables import ConcludedColumn, Table
from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.evidence.model import CellValue, RecordHead

CLOSE = 0.5
"""Margin below which a satisfied run is a near miss, in the unit of the requirement."""


class NearMisses(Table):
    """Counts the valid runs of each case that satisfied a requirement by a small margin."""

    name = "near_misses"
    title = "Near misses"
    about = f"Valid runs that satisfied a requirement by a margin below {CLOSE}."
    columns = (
        ConcludedColumn("case"),
        ConcludedColumn("requirement"),
        ConcludedColumn("near", "runs that satisfied it by less than this"),
        ConcludedColumn("satisfied", "runs that satisfied it"),
        ConcludedColumn("least", "least margin of a satisfied run"),
    )

    def __init__(self, head: RecordHead) -> None:
        super().__init__(head)
        self._margins: dict[tuple[str, str], list[float]] = defaultdict(list)

    def add(self, episode: EpisodeEntry) -> None:
        """Add an episode."""
        for requirement, verdict in episode.verdicts.items():
            if episode.planned and verdict.status == "satisfied" and verdict.margin is not None:
                self._margins[episode.case, requirement].append(verdict.margin)

    def rows(self) -> Iterator[tuple[CellValue, ...]]:
        """Return a row for each case and requirement with a near miss."""
        for (case, requirement), margins in sorted(self._margins.items()):
            near = sum(margin < CLOSE for margin in margins)
            if near:
                yield case, requirement, near, len(margins), min(margins)
