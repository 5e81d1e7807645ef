"""Table of how well episodes kept their time, where thinking takes time in their world."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

from pytest_dura.core.clock import Timeliness
from pytest_dura.evidence.conclusions.tables import ConcludedColumn, Table
from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.evidence.model import CellValue, RecordHead


class TimelinessTable(Table):
    """Sums ticks over the planned, valid episodes of a case and component."""

    name = "timeliness"
    title = "Commands in time"
    about = (
        "Commands that were due at a tick while the component was still computing them. By the "
        "wall clock neither these figures nor the runs repeat exactly"
    )
    columns = (
        ConcludedColumn("case"),
        ConcludedColumn("clock"),
        ConcludedColumn("runs"),
        ConcludedColumn("ticks", "ticks at which a command was due"),
        ConcludedColumn("late", "ticks at which it was not there"),
        ConcludedColumn("expired", "ticks at which no earlier command was in force any more"),
        ConcludedColumn("longest", "longest time without a new command that was due", "s"),
        ConcludedColumn("period", "mean time between ticks", "ms"),
        ConcludedColumn("jitter", "95 % of these differ by no more, in the worst run", "ms"),
        ConcludedColumn("worst", "greatest difference from the nominal time", "ms"),
    )

    def __init__(self, head: RecordHead) -> None:
        super().__init__(head)
        self._kept: dict[tuple[str, str], dict[int, Timeliness]] = defaultdict(dict)

    def add(self, episode: EpisodeEntry) -> None:
        """Add an episode."""
        kept = episode.outcome.timeliness
        if kept is not None and episode.planned and episode.validity == "valid":
            self._kept[episode.case, episode.component][episode.spec.run] = kept

    def rows(self) -> Iterator[tuple[CellValue, ...]]:
        """Return a row for each case, and for each component where there are several."""
        several = len({component for _, component in self._kept}) > 1
        for (case, component), runs in sorted(self._kept.items()):
            kept = [runs[run] for run in sorted(runs)]
            ticks = sum(each.ticks for each in kept)
            mean = sum(each.period * each.ticks for each in kept) / max(ticks, 1)
            yield (
                f"{case} ({component})" if several else case,
                kept[0].clock,
                len(kept),
                ticks,
                sum(each.late for each in kept),
                sum(each.expired for each in kept),
                f"{max(each.longest for each in kept):.3g}",
                f"{1000 * mean:.2f}",
                f"{1000 * max(each.jitter for each in kept):.2f}",
                f"{1000 * max(each.worst for each in kept):.2f}",
            )
