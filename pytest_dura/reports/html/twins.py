"""Twins: runs of the same seed without the faults or without a role, beside an episode."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pytest_dura.core.errors import describe_error
from pytest_dura.evidence.episode_model import TraceEntry
from pytest_dura.evidence.model import SessionRecord
from pytest_dura.evidence.text import name, visible
from pytest_dura.evidence.traces import Trace, first_difference
from pytest_dura.reports.columns import role_name
from pytest_dura.reports.scene import track_data
from pytest_dura.reports.twin_cases import TwinCase, twin_cases
from pytest_dura.requirements.model import FAULTS

CaseKey = tuple[str, str]
"""Id of a case, and the component's name."""
_TIME_TOLERANCE = 1e-6
"""Seconds within which two times are the same tick's."""


@dataclass(frozen=True)
class Twin:
    """The run of the same seed without something, to be seen beside an episode.

    Args:
        without: What it lacks: ``faults``, or a role.
        trace: Its trace; ``None`` where there is none.
        problem: Why there is none.
    """

    without: str
    trace: Trace | None
    problem: str = ""

    @property
    def label(self) -> str:
        """What it lacks, in words: ``without faults``."""
        what = self.without if self.without == FAULTS else role_name(self.without)
        return f"without {name(what)}"


@dataclass
class TwinTraces:
    """Which traces of a bundle are those of twins.

    Args:
        cases: Of a case and component, the cases of its twins.
        files: Traces of the runs of these, by case, component and seed.
    """

    cases: dict[CaseKey, list[TwinCase]]
    files: dict[tuple[str, str, int], TraceEntry] = field(default_factory=dict)

    @classmethod
    def of(cls, record: SessionRecord) -> TwinTraces:
        """Look for twins in a record."""
        # The run of a reference is another component's.
        every = twin_cases(record.head.cases)
        twins = cls(
            {key: [each for each in own if not each.reference] for key, own in every.items()}
        )
        wanted = {(each.id, each.component) for those in twins.cases.values() for each in those}
        for episode in record.episodes() if wanted else ():
            key = episode.case, episode.component
            if key in wanted and episode.trace is not None:
                twins.files[key[0], key[1], episode.seed] = episode.trace
        return twins

    def of_seed(
        self, case: str, component: str, seed: int, read: Callable[[TraceEntry], Trace]
    ) -> list[Twin]:
        """The twins of a run whose traces were kept.

        Args:
            case: The case of the run.
            component: Its component.
            seed: Its seed, which those of its twins are.
            read: Reads a trace of the bundle; what it raises is the problem of that twin.
        """
        twins = []
        for other in self.cases.get((case, component), ()):
            file = self.files.get((other.id, component, seed))
            if file is None:
                continue
            try:
                twins.append(Twin(other.without, read(file)))
            except Exception as error:  # shown in the twin's place
                twins.append(Twin(other.without, None, describe_error(error)))
        return twins


def twin_data(trace: Trace, twin: Twin) -> dict[str, Any]:
    """A twin at the ticks of an episode: its ego's way, and where the two part."""
    data: dict[str, Any] = {
        "without": name(twin.without), "label": twin.label, "id": "",
        "problem": visible(twin.problem), "ended": "", "last": None, "runs": [],
        "difference": None, "acted": None,
    }  # fmt: skip
    other = twin.trace
    if other is None or not len(other.time) or not len(trace.time):
        return data
    ticks = np.searchsorted(other.time, trace.time + _TIME_TOLERANCE, side="right") - 1
    present = (ticks >= 0) & (trace.time <= other.time[-1] + _TIME_TOLERANCE)
    scene = other.recording.scene
    if scene is not None and scene.ego in scene.truth.ids:
        way = scene.truth.poses[np.clip(ticks, 0, None), scene.truth.ids.index(scene.ego)].copy()
        way[~present] = np.nan
        data["runs"] = track_data(way)
    ended = f"{visible(str(other.about.get('termination') or ''))} at {other.time[-1]:.2f} s"
    return data | {
        "id": name(str(other.about.get("id") or "")),
        "ended": ended,
        "last": None if present.all() else int(np.flatnonzero(present)[-1]),
        "difference": _first_difference(trace, other),
        "acted": _first_other_action(trace, other),
    }


def _first_difference(trace: Trace, other: Trace) -> list[Any] | None:
    """Tick and words of the first difference of what the digest covers."""
    difference = first_difference(trace, other, covered=True)
    if difference is None or difference.tick is None or difference.tick >= len(trace.time):
        return None
    kind, _, column = difference.column.partition(".")
    named = column if kind in ("signals", "decisions") else difference.column
    values = [_shown_value(value) for value in (difference.recorded, difference.replayed)]
    return [difference.tick, f"{name(named)}: {values[0]} here, {values[1]} there"]


def _shown_value(text: str) -> str:
    """A value as :func:`first_difference` writes it; numbers with four digits."""
    try:
        return f"{float(text):.4g}"
    except ValueError:
        return visible(text)


def _first_other_action(trace: Trace, other: Trace) -> list[Any] | None:
    """Tick and words of the first decision after which another action was executed."""
    columns = [each.decisions.get("executed") for each in (trace, other)]
    if columns[0] is None or columns[1] is None:
        return None
    own, twins = columns[0].tolist(), columns[1].tolist()
    for tick, (here, there) in enumerate(zip(own, twins, strict=False)):
        if here != there:
            return [tick, f"{visible(str(here))} here, {visible(str(there))} there"]
    return None
