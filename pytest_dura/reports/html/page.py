"""The report's page: sections and players put into the templates."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pytest_dura.core.errors import describe_error
from pytest_dura.evidence.episode_model import TraceEntry
from pytest_dura.evidence.files import file_entry
from pytest_dura.evidence.model import SessionRecord
from pytest_dura.evidence.text import LINE, name, one_line, visible
from pytest_dura.evidence.verdict_model import VerdictEntry
from pytest_dura.reports.columns import (
    measure_label,
    number_text,
    role_name,
    seconds_text,
    share_text,
)
from pytest_dura.reports.html import episode_sections, plot_sections, verdict_sections
from pytest_dura.reports.html.contents import (
    BriefEpisode,
    CaseKey,
    EpisodeLinks,
    ListedEpisode,
    ReportContents,
    player_anchor,
    verdict_key,
)
from pytest_dura.reports.html.player import content_hash
from pytest_dura.reports.svg import tag
from pytest_dura.reports.wording import model_options, replay_command

if TYPE_CHECKING:
    from jinja2 import Environment
    from markupsafe import Markup


Data = Mapping[str, Any]


def _size_text(count: int) -> str:
    """Size of a file: ``12 kB``."""
    if count < 1000:
        return f"{count} B"
    return f"{count / 1000:.0f} kB" if count < 1_000_000 else f"{count / 1e6:.1f} MB"


def _time_text(text: str) -> str:
    """A point in time as it is read: ``2026-01-02 03:04:05 UTC``."""
    if not re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\+00:00", text):
        return one_line(text)
    return text.replace("T", " ").replace("+00:00", " UTC")


def _line_text(text: str, limit: int = LINE) -> str:
    """A text on one line; of a very long text only the beginning is looked at."""
    return one_line(text, limit) if len(text) < 50_000 else visible(text, limit)


def _replay_text(episode: str, session: str) -> str:
    """The command that runs an episode again, with ``DIR`` for the folder of the evidence."""
    return replay_command(episode, "DIR", model_options(session))


_FILTERS: Mapping[str, Any] = {
    "name": name,
    "line": _line_text,
    "prose": visible,
    "number": number_text,
    "percent": share_text,
    "seconds": seconds_text,
    "moment": _time_text,
    "size": _size_text,
    "replay": _replay_text,
    "role": role_name,
    "label": measure_label,
}
"""Filters of the templates."""

MAX_PLAYERS = 12
MAX_CHARACTERS = 6_000_000


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


def embed_players(record: SessionRecord, candidates: Sequence[ListedEpisode]) -> Players:
    """Players of the first episodes whose traces can be read, up to the bounds.

    Args:
        record: The record, in whose directory the traces lie.
        candidates: Episodes with a trace, those that show most first.
    """
    players = Players()
    room = MAX_CHARACTERS
    for candidate in candidates:
        if len(players.shown) == MAX_PLAYERS:
            break
        trace = candidate.episode.trace
        if candidate.key in players.shown or trace is None:
            continue
        packed, problem = None, ""
        try:
            packed = _packed_trace(record, candidate, trace)
        except Exception as error:  # shown in the trace's place
            problem = describe_error(error)
        if packed is not None and len(packed) > room:
            continue
        players.rows.append(
            {
                **vars(candidate.episode),
                "violates": candidate.violates,
                "problem": problem,
                "packed": None if packed is None else _plain_base64(packed),
                "anchor": player_anchor(*candidate.key),
            }
        )
        if packed is not None:
            room -= len(packed)
            players.shown.append(candidate.key)
    if players.shown:
        from pytest_dura.reports.html.player import player_assets

        players.script, players.style = player_assets()
    return players


def _packed_trace(record: SessionRecord, episode: ListedEpisode, trace: TraceEntry) -> str:
    """The player's text of an episode's trace.

    Raises:
        ValueError: If the file is not the one that was written, or lies outside the bundle.
    """
    from pytest_dura.evidence.mcap import read_trace
    from pytest_dura.reports.html.player import pack_data, player_data

    file = _file_inside(record.directory, trace.file)
    digest = file_entry(file)["sha256"]
    if digest != trace.sha256:
        raise ValueError(f"its SHA-256 is {digest[:12]}..., and the record says another")
    verdicts = _verdicts_on_episode(record, episode)
    measures = [measure.to_json() for measure in record.head.measures]
    return pack_data(player_data(read_trace(file), verdicts, measures))


def _verdicts_on_episode(record: SessionRecord, episode: ListedEpisode) -> list[Data]:
    """The verdicts on an episode, its violations first."""
    violated: list[Data] = []
    others: list[Data] = []
    for verdict in record.head.verdicts:
        if verdict_key(verdict) != (episode.episode.case, episode.episode.component):
            continue
        row: dict[str, Any] = {"requirement": verdict.requirement, "check": verdict.check}
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


def _satisfied_verdict(verdict: VerdictEntry, episode: BriefEpisode) -> tuple[str, str]:
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


def _plain_base64(text: str) -> Markup:
    """The player's text for a script element, which is not escaped.

    Raises:
        ValueError: If it holds anything but letters, digits and ``+/=``.
    """
    from markupsafe import Markup

    if not re.fullmatch(r"[A-Za-z0-9+/=]*", text):
        raise ValueError("the player's text is not base64")
    return Markup(text)  # noqa: S704 - it was just looked at


def _file_inside(directory: Path, name: str) -> Path:
    file = (directory / name).resolve()
    if not file.is_relative_to(directory.resolve()):
        raise ValueError("the file lies outside the evidence")
    return file


FILE = "report.html"
_DIRECTORY = Path(__file__).parent

Section = Callable[[SessionRecord, ReportContents, EpisodeLinks], Mapping[str, Any]]
_SECTIONS: Mapping[str, Section] = {
    "gate": verdict_sections.gate_section,
    "requirements": verdict_sections.requirement_section,
    "searches": verdict_sections.search_section,
    "scenarios": episode_sections.scenario_section,
    "failure_modes": episode_sections.failure_mode_section,
    "faults": episode_sections.fault_section,
    "coverage": episode_sections.coverage_section,
    "traceability": verdict_sections.traceability_section,
    "plots": plot_sections.plot_section,
    "monitors": verdict_sections.monitor_section,
    "episodes": episode_sections.episode_section,
    "provenance": verdict_sections.provenance_section,
}
"""Sections by the name of their template, in the order of the page."""


def render(record: SessionRecord) -> str:
    """The page as a text. It reads the bundle's traces, and names those that it cannot read."""
    contents = ReportContents.of(record)
    players = embed_players(record, contents.candidates)
    links = EpisodeLinks.of(contents, players.shown)
    scripts = [_asset("report.js")]
    styles = [_asset("report.css")]
    if players.shown:
        scripts.insert(0, players.script)
        styles.insert(0, players.style)
    sections = {name: section(record, contents, links) for name, section in _SECTIONS.items()}
    template = _environment().get_template("report.html")
    return template.render(
        record=record.head,
        review=record.review,
        links=links,
        players=players,
        contents=contents,
        scripts=_inline(scripts),
        styles=_inline(styles),
        policy=_content_policy(scripts, styles),
        **sections,
    )


@cache
def _environment() -> Environment:
    """Templates in which every value is made visible, bounded and escaped."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(_DIRECTORY / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_finalized,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(_FILTERS)
    environment.globals["svg"] = tag
    return environment


def _finalized(value: Any) -> Any:
    """A value as a template writes it; markup that a template made stays as it is."""
    if value is None:
        return ""
    if type(value) is str:
        return visible(value)
    return value


def _asset(file: str) -> str:
    return (_DIRECTORY / file).read_text(encoding="utf-8")


def _inline(texts: list[str]) -> list[Any]:
    """Our own scripts and styles, which are no values and must not be escaped.

    Raises:
        ValueError: If one of them could end the element that holds it.
    """
    from markupsafe import Markup

    for text in texts:
        if "</" in text or "<!--" in text:
            raise ValueError("a script or style of the report holds what ends its element")
    return [Markup(text) for text in texts]  # noqa: S704 - files of this package, never a value


def _content_policy(scripts: list[str], styles: list[str]) -> str:
    """A Content-Security-Policy under which nothing but our own scripts runs, and nothing loads."""
    return "; ".join(
        [
            "default-src 'none'",
            f"script-src {' '.join(map(content_hash, scripts))}",
            f"style-src {' '.join(map(content_hash, styles))}",
            "img-src data:",
            "base-uri 'none'",
            "form-action 'none'",
        ]
    )
