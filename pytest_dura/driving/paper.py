"""The figures of the DURA-CPS paper, beside those of a session that ran its scenarios.

Source: Table II, Figure 4 and Section V of "DURA-CPS: A Multi-Role Orchestrator for Dependability
Assurance in LLM-Enabled Cyber-Physical Systems", 15 runs of each scenario in CARLA, planned by a
fine-tuned Llama 3.2 of 11 billion parameters.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from pytest_dura.evidence.conclusions.tables import ConcludedColumn, Table
from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.evidence.model import CellValue, RecordHead
from pytest_dura.requirements.rate_tests import lower_bound, upper_bound

CONFIDENCE = 0.95
"""Of the intervals on shares: exact, with both sides (Clopper and Pearson)."""
WITHOUT_RECOVERY = "~recovery_planner"
"""How the id of a case ends whose runs are without recovery."""


@dataclass(frozen=True)
class Published:
    """Results of the paper on a scenario.

    Args:
        flagged: Runs with a flag of the SafetyMonitor.
        collided: Runs with a collision.
        clearance: Mean and standard deviation of the time to clear the junction, in s.
        gridlock: Runs that never cleared it, where the paper names them.
        runs: All runs.
    """

    flagged: int
    collided: int
    clearance: tuple[float, float] | None
    gridlock: int | None = None
    runs: int = 15


PAPER = {
    "intersection/nominal": Published(1, 0, (5.4, 0.5)),
    "intersection/congested": Published(3, 1, (9.9, 1.0)),
    "intersection/conflicting-traffic": Published(5, 2, (12.8, 1.2)),
    "intersection/ghost-obstacle": Published(13, 1, (16.0, 4.8)),
    "intersection/trajectory-spoofing": Published(9, 3, (18.4, 5.3), gridlock=3),
    "intersection/pedestrian-crossing": Published(4, 1, (11.7, 0.9)),
}
"""Its percentages of 15 runs, as counts: 6.7 % is one run."""
PAPER_OVERALL = Published(
    flagged=sum(each.flagged for each in PAPER.values()),
    collided=sum(each.collided for each in PAPER.values()),
    clearance=None,
    runs=sum(each.runs for each in PAPER.values()),
)
"""35 and 8 of 90 runs: its 38.9 % and 8.9 %."""

Key = tuple[str, str]
"""Component and scenario."""


class PaperFigures(Table):
    """Puts the paper's figures beside those of the runs with the scenario's own faults.

    The terminal shows them where a language model plans, as in the paper, else with ``-v``.
    """

    name = "paper"
    title = "The paper's figures beside these"
    about = (
        "The scenarios follow the DURA-CPS paper (Srinivasan, Patapati and others), 15 runs each. "
        "Not comparable: another simulator, another model. In brackets: 95 % interval of the share"
    )
    columns = (
        ConcludedColumn("scenario"),
        ConcludedColumn("paper: flag", "runs with an unsafe proposal", "%"),
        ConcludedColumn("here: flag", unit="%"),
        ConcludedColumn("paper: coll", "runs with a collision", "%"),
        ConcludedColumn("here: coll", unit="%"),
        ConcludedColumn("paper: clearance", "time until the junction was cleared", "s"),
        ConcludedColumn("here: clearance", unit="s"),
        ConcludedColumn("paper: grid", "runs that never cleared it"),
        ConcludedColumn("here: grid"),
        ConcludedColumn(
            "here: prev/intro",
            "collisions that recovery prevented and introduced, on equal seeds without it",
        ),
    )

    def __init__(self, head: RecordHead) -> None:
        super().__init__(head)
        self._runs: dict[Key, dict[int, EpisodeEntry]] = defaultdict(dict)
        self._without: dict[Key, dict[int, bool]] = defaultdict(dict)

    def add(self, episode: EpisodeEntry) -> None:
        """Add an episode."""
        scenario = episode.case.removesuffix(WITHOUT_RECOVERY)
        if scenario not in PAPER or not episode.planned or episode.validity != "valid":
            return
        key = episode.component, scenario
        if scenario == episode.case:
            self._runs[key][episode.spec.run] = episode
        else:
            self._without[key][episode.spec.run] = _collided(episode)

    def rows(self) -> Iterator[tuple[CellValue, ...]]:
        """Return a row for each scenario of the paper, and one for all six where all were run."""
        asked = {fact.table for fact in self.head.facts or ()}
        self.detail = "language_models" not in asked
        for component in sorted({component for component, _ in self._runs}):
            keys = [(component, each) for each in PAPER if (component, each) in self._runs]
            several = len({name for name, _ in self._runs}) > 1
            after = f" ({component})" if several else ""
            for key in keys:
                name = key[1].partition("/")[2] + after
                yield self._row(name, PAPER[key[1]], [key])
            if len(keys) == len(PAPER):
                yield self._row(f"overall{after}", PAPER_OVERALL, keys)

    def _row(self, name: str, paper: Published, keys: Sequence[Key]) -> tuple[CellValue, ...]:
        runs = [episode for key in keys for episode in self._runs[key].values()]
        measures = [episode.outcome.measures for episode in runs]
        times = [float(time) for each in measures if (time := each.get("clearance_time"))]
        pairs = [
            (_collided(self._runs[key][run]), without)
            for key in keys
            for run, without in self._without[key].items()
            if run in self._runs[key]
        ]
        prevented = sum(without and not with_it for with_it, without in pairs)
        introduced = sum(with_it and not without for with_it, without in pairs)
        stuck = sum(bool(each.get("gridlock")) for each in measures)
        return (
            name,
            _percent(paper.flagged, paper.runs),
            _share(sum(episode.outcome.flagged for episode in runs), len(runs)),
            _percent(paper.collided, paper.runs),
            _share(sum(map(_collided, runs)), len(runs)),
            "-" if paper.clearance is None else "{:.1f} +- {:.1f}".format(*paper.clearance),
            _spread(times),
            "-" if paper.gridlock is None else f"{paper.gridlock} of {paper.runs}",
            f"{stuck} of {len(runs)}",
            f"{prevented} / {introduced}" if pairs else "-",
        )


def _collided(episode: EpisodeEntry) -> bool:
    return bool(episode.outcome.measures.get("collided"))


def _percent(count: int, runs: int) -> str:
    return f"{100 * count / runs:.1f}"


def _share(count: int, runs: int) -> str:
    """Write a share in % with its interval."""
    side = (1 + CONFIDENCE) / 2
    low = lower_bound(count, runs, side) if count else 0.0
    high = upper_bound(count, runs, side) if count < runs else 1.0
    return f"{_percent(count, runs)} ({100 * low:.0f}-{100 * high:.0f})"


def _spread(times: Sequence[float]) -> str:
    """Write mean and standard deviation of a sample."""
    if not times:
        return "-"
    mean = math.fsum(times) / len(times)
    if len(times) == 1:
        return f"{mean:.1f}"
    deviation = math.sqrt(math.fsum((time - mean) ** 2 for time in times) / (len(times) - 1))
    return f"{mean:.1f} +- {deviation:.1f}"
