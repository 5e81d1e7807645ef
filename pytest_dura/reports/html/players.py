"""Players of a report: the episodes that can be played in the page, and their traces."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pytest_dura.core.errors import describe_error
from pytest_dura.evidence.episode_model import TraceEntry
from pytest_dura.evidence.files import file_entry
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.model import SessionRecord
from pytest_dura.reports.contents import (
    BriefEpisode,
    CaseKey,
    ListedEpisode,
    episode_anchor,
    player_anchor,
    verdict_key,
)
from pytest_dura.reports.html.twins import Twin, TwinTraces

if TYPE_CHECKING:
    from markupsafe import Markup

    from pytest_dura.evidence.traces import Trace

Data = Mapping[str, Any]

MAX_PLAYERS = 12
MAX_CHARACTERS = 6_000_000
_MAX_KEPT = 24
"""Traces in memory, of which players and pictures need the same ones."""


@dataclass
class Players:
    """The players of a report, and the traces that could not be read.

    Args:
        rows: In the page's order: the episode with ``anchor``, ``packed`` (the player's text, or
            ``None``) and ``problem``.
        shown: Id and component of those with a player.
        script: The player's own.
        style: The player's own.
    """

    rows: list[Data] = field(default_factory=list)
    shown: list[CaseKey] = field(default_factory=list)
    script: str = ""
    style: str = ""


class Traces:
    """The traces of a record, of which the first ones read are kept.

    Args:
        record: The record, in whose directory the traces lie.
    """

    def __init__(self, record: SessionRecord) -> None:
        self._record = record
        self._kept: dict[str, Trace] = {}

    def read(self, entry: TraceEntry) -> Trace:
        """Read a trace.

        Raises:
            ValueError: If the file is not the one that was written, or lies outside the bundle.
        """
        from pytest_dura.evidence.mcap import read_trace

        if entry.sha256 in self._kept:
            return self._kept[entry.sha256]
        file = _file_inside(self._record.directory, entry.file)
        digest = file_entry(file)["sha256"]
        if digest != entry.sha256:
            raise ValueError(f"its SHA-256 is {digest[:12]}..., and the record says another")
        trace = read_trace(file)
        if len(self._kept) < _MAX_KEPT:
            self._kept[entry.sha256] = trace
        return trace

    def twins_of(self, episode: BriefEpisode) -> list[Twin]:
        """Read the traces of an episode's twins that were kept."""
        return self._twins.of_seed(episode.case, episode.component, episode.seed, self.read)

    @cached_property
    def _twins(self) -> TwinTraces:
        return TwinTraces.of(self._record)


def embed_players(
    record: SessionRecord, candidates: Sequence[ListedEpisode], traces: Traces
) -> Players:
    """Players of the first episodes whose traces can be read, up to the bounds.

    Args:
        record: The record.
        candidates: Episodes with a trace, those that show most first.
        traces: Of the record.
    """
    players = Players()
    room, panels = MAX_CHARACTERS, set[str]()
    for candidate in candidates:
        if len(players.shown) == MAX_PLAYERS:
            break
        trace = candidate.episode.trace
        if candidate.key in players.shown or trace is None:
            continue
        packed, problem, own = None, "", set[str]()
        try:
            beside = traces.twins_of(candidate.episode)
            packed, own = _packed_trace(record, candidate, traces.read(trace), beside)
        except Exception as error:  # shown in the trace's place
            problem = describe_error(error)
        if packed is not None and len(packed) > room:
            continue
        players.rows.append(
            {
                **vars(candidate.episode),
                "violates": candidate.violates,
                "problem": problem,
                "packed": None if packed is None else plain_base64(packed),
                "anchor": player_anchor(*candidate.key),
                "listed": episode_anchor(*candidate.key),
            }
        )
        if packed is not None:
            room -= len(packed)
            panels |= own
            players.shown.append(candidate.key)
    if players.shown:
        from pytest_dura.reports.html.player import player_assets

        players.script, players.style = player_assets(frozenset(panels))
    return players


def _packed_trace(
    record: SessionRecord, episode: ListedEpisode, trace: Trace, twins: Sequence[Twin]
) -> tuple[str, set[str]]:
    """The player's text of an episode's trace, with those of its twins, and names of panels."""
    from pytest_dura.reports.html.player import pack_data, player_data

    verdicts = _verdicts_on_episode(record, episode)
    data = player_data(trace, verdicts, record.head.measures, twins)
    return pack_data(data), set(data["panels"])


def _verdicts_on_episode(record: SessionRecord, episode: ListedEpisode) -> list[Data]:
    """The verdicts on an episode, its violations first."""
    violated: list[Data] = []
    others: list[Data] = []
    kinds = {requirement.id: requirement.kind for requirement in record.head.requirements}
    for verdict in record.head.verdicts:
        if verdict_key(verdict) != (episode.episode.case, episode.episode.component):
            continue
        row: dict[str, Any] = {"requirement": verdict.requirement, "check": verdict.check}
        row["kind"] = kinds.get(verdict.requirement)
        violations = [
            counterexample
            for counterexample in verdict.counterexamples
            if counterexample.episode == episode.episode.id
        ]
        if violations and episode.violates:
            row |= {"time": violations[0].time, "margin": violations[0].margin}
            note = "" if violations[0].valid else "without effect of the fault"
            violated.append({**row, "verdict": "violated", "note": note})
        else:
            status, note = _satisfied_verdict(verdict, episode.episode)
            others.append({**row, "verdict": status, "note": note})
    return violated + others


def _satisfied_verdict(verdict: ItemVerdict, episode: BriefEpisode) -> tuple[str, str]:
    """A verdict's status on an episode that is none of its counterexamples, and a note on it.

    The record names single episodes where they violate; of others it has the sums.
    """
    # Another requirement on the case may have needed more runs than this one looked at.
    beyond = verdict.check and episode.run >= verdict.run
    if not episode.planned or beyond:
        return "not judged", "the verdict rests on other runs"
    if episode.validity != "valid":
        return episode.validity, ""
    if episode.id in verdict.open:
        return "open", "the episode ended before it was decided"
    if verdict.pairs is not None:
        return "not violated", "judged on pairs of runs"
    if verdict.invalid or verdict.missing or verdict.saved:
        return "not violated", "or not decided: of some of its runs the verdict knows no more"
    return "satisfied", ""


def plain_base64(text: str) -> Markup:
    """What was packed, for a script element, in which it is not escaped.

    Raises:
        ValueError: If it holds anything but letters, digits and ``+/=``.
    """
    from markupsafe import Markup

    if not re.fullmatch(r"[A-Za-z0-9+/=]*", text):
        raise ValueError("what was packed is not base64")
    return Markup(text)  # noqa: S704 - it was just looked at


def _file_inside(directory: Path, name: str) -> Path:
    file = (directory / name).resolve()
    if not file.is_relative_to(directory.resolve()):
        raise ValueError("the file lies outside the evidence")
    return file
