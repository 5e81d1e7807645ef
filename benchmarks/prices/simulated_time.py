"""Simulated time: how long the runs of each case lasted, as a plot."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.evidence.model import RecordHead
from pytest_dura.reports.document import Picture, Plot
from pytest_dura.reports.plots.plot import PlotKind
from pytest_dura.reports.plots.strips import Frame, Strip, dots_of, five_numbers, strip_plot

TITLE = "Simulated time by case"


class SimulatedTime(PlotKind):
    """Draws the simulated time of the planned runs of each case."""

    def __init__(self, head: RecordHead) -> None:
        super().__init__(head)
        self._seconds: dict[str, list[float]] = defaultdict(list)

    def add(self, episode: EpisodeEntry) -> None:
        """Add an episode."""
        if episode.planned:
            self._seconds[episode.case].append(episode.timings.simulated_seconds)

    def plots(self) -> Iterator[Plot]:
        """Draw a row for each case."""
        rows = sorted(self._seconds.items())
        strips = [Strip(case, five_numbers(times), dots_of(times)) for case, times in rows]
        words = [f"{case}: {min(times):.1f} to {max(times):.1f} s" for case, times in rows]
        if rows:
            picture = strip_plot(strips, Frame("simulated-time", TITLE, "time in s"))
            yield Plot(TITLE, (Picture("All planned runs", picture),), lines=tuple(words))
