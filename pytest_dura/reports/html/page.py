"""Page pen: writes the document of a session, with panels and players, by the templates."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from pytest_dura.evidence.bundle import RECORD_FILE
from pytest_dura.evidence.model import SessionRecord
from pytest_dura.evidence.text import LINE, name, one_line, visible
from pytest_dura.reports.columns import (
    Shown,
    measure_label,
    moment_text,
    number_text,
    role_name,
    seconds_text,
    share_text,
    shown_in,
)
from pytest_dura.reports.contents import (
    EpisodeLinks,
    ReportContents,
    anchor,
    case_anchor,
    requirement_anchor,
    verdict_anchor,
)
from pytest_dura.reports.document import (
    Card,
    Document,
    Facts,
    Level,
    Part,
    Plot,
    Table,
    Text,
    keep_worst,
)
from pytest_dura.reports.html import (
    bundle_sections,
    episode_sections,
    verdict_sections,
)
from pytest_dura.reports.html.cards import OPEN_CARDS, shown_cards
from pytest_dura.reports.html.player import content_hash, packed_text
from pytest_dura.reports.html.players import Traces, embed_players, plain_base64
from pytest_dura.reports.role_tables import has_fixed_n
from pytest_dura.reports.story import document_of
from pytest_dura.reports.verdicts import assertion_sentences
from pytest_dura.reports.wording import (
    entry_command,
    replay_command,
    replay_options,
    selection_text,
    shard_text,
)
from pytest_dura.requirements.campaign_verdicts import violation_text
from pytest_dura.requirements.pairs import PairTable

if TYPE_CHECKING:
    from jinja2 import Environment
    from markupsafe import Markup


FILE = "report.html"
Data = Mapping[str, Any]


def _size_text(count: int) -> str:
    """Size of a file: ``12 kB``."""
    if count < 1000:
        return f"{count} B"
    return f"{count / 1000:.0f} kB" if count < 1_000_000 else f"{count / 1e6:.1f} MB"


def _coded(text: str) -> Markup:
    """A text in which what stands between two backticks is code."""
    parts = text.split("`")
    marked: Markup = _texts().coded(parts if len(parts) % 2 else [text])
    return marked


_BREAKS = re.compile(r"(?<=[/+~#_=])(?=[A-Za-z])")


def _breakable(text: str) -> Markup:
    """A name that a narrow column breaks behind its separators."""
    marked: Markup = _texts().breakable(_BREAKS.split(text))
    return marked


@cache
def _texts() -> Any:
    """The macros of texts with marks."""
    return _environment().get_template("texts.html").module


def _line_text(text: str, limit: int = LINE) -> str:
    """A text on one line; of a very long text only the beginning is looked at."""
    return one_line(text, limit) if len(text) < 50_000 else visible(text, limit)


def _replay_text(episode: str, session: str) -> str:
    """The command that runs an episode again, with ``DIR`` for the folder of the evidence."""
    return replay_command(episode, "DIR", replay_options(session))


def _file_address(file: str) -> str:
    """A file of the bundle as a link's address."""
    return f"./{quote(file, safe='/')}"


def _bundle_reference(url: str) -> str:
    """Where an element's evidence lies: within this page, or a file of the bundle.

    Empty for any other address: nothing here leads outside.
    """
    file, mark, anchor = url.partition("#")
    if file == FILE and mark:
        return f"#{quote(anchor, safe='-._')}"
    if file == RECORD_FILE or re.fullmatch(r"episodes/[^/\\]+\.mcap", file):
        return _file_address(file)
    return ""


_FILTERS: Mapping[str, Any] = {
    "name": name,
    "line": _line_text,
    "coded": _coded,
    "breakable": _breakable,
    "prose": visible,
    "number": number_text,
    "percent": share_text,
    "seconds": seconds_text,
    "moment": moment_text,
    "size": _size_text,
    "replay": _replay_text,
    "role": role_name,
    "label": measure_label,
    "address": _file_address,
    "reference": _bundle_reference,
    "anchor": anchor,
    "case_anchor": case_anchor,
    "requirement_anchor": requirement_anchor,
    "verdict_anchor": verdict_anchor,
    "assertions": assertion_sentences,
    "fixed_n": has_fixed_n,
    "when": lambda each: violation_text(each.time, each.margin, valid=each.valid),
    "joined": lambda texts: "\n".join(map(name, texts)),
    "capital": lambda text: text[:1].upper() + text[1:],
    "kept": lambda rows, of: rows if of <= MAX_PLAIN_ROWS else min(rows, KEPT_ROWS),
    "pack": lambda text: plain_base64(packed_text(text)),
    "bounded": lambda part: keep_worst(
        part.rows, part.ranks or [0] * len(part.rows), most=MOST_ROWS
    ),
    "on_page": lambda columns: shown_in(columns, Shown.PAGE),
}
"""Filters of the templates."""

MAX_PLAIN_ROWS = 2000
"""Rows of a table that stand in the page as they are; of more, all but the first are packed."""
KEPT_ROWS = 100
"""Rows of a long table, or of an entry of it, that are not packed."""
MAX_COUNTEREXAMPLES = 5
"""Counterexamples of a verdict that are named; the list of episodes has more."""
MOST_ROWS = 500
"""Rows of a table of the document; the record has all."""
_DIRECTORY = Path(__file__).parent

Panel = Callable[[SessionRecord, ReportContents, EpisodeLinks], Mapping[str, Any]]


@dataclass(frozen=True)
class View:
    """A part of the page that is shown by itself; one without anything to show is left out.

    Args:
        name: By which parts of the document name it.
        title: In the navigation.
        panel: Returns the data of what the page alone shows there, for the template of this name,
            or nothing; ``None`` where it has only parts of the document.
        printed: Whether it is on paper, too.
    """

    name: str
    title: str
    panel: Panel | None = None
    printed: bool = False

    @property
    def anchor(self) -> str:
        """Its anchor."""
        return self.name.replace("_", "-")


VIEWS: Sequence[View] = (
    View("requirements", "Requirements", verdict_sections.requirement_section, printed=True),
    View("cases", "Cases", episode_sections.case_section),
    View("hazards", "Hazards", printed=True),
    View("episodes", "Episodes", episode_sections.episode_section),
    View("matrix", "Matrix"),
    View("argument", "Assurance case", bundle_sections.argument_section),
    View("plots", "Plots", printed=True),
    View("searches", "Searches"),
    View("monitors", "Monitors"),
    View("faults", "Faults"),
    View("failure_modes", "Failure modes"),
    View("tables", "Further tables", printed=True),
    View("provenance", "Provenance"),
    View("files", "Files", bundle_sections.files_section),
)
"""Views after the first one, in the order of the navigation and, without scripts, of the page."""


def render(record: SessionRecord) -> str:
    """The page as a text. It reads the bundle's traces, and names those that it cannot read."""
    document = document_of(record)
    worst = [(card.place.episode, card.place.component) for card in document.cards]
    contents = ReportContents.of(record, first=[key for key in worst if key[0]])
    traces = Traces(record)
    players = embed_players(record, contents.candidates, traces)
    links = EpisodeLinks.of(record, contents, players.shown)
    scripts = [_HEAD_SCRIPT, _asset("report.js")]
    styles = [_asset("report.css")]
    if players.shown:
        scripts.insert(1, players.script)
        styles.insert(0, players.style)
    panels = {
        view.name: view.panel(record, contents, links) if view.panel else {} for view in VIEWS
    }
    parts = _parts_by_view(document)
    template = _environment().get_template("report.html")
    head_script, *scripts_below = _inline(scripts)
    return template.render(
        record=record.head,
        document=document,
        cards=list(shown_cards(record, document, contents, links, traces)),
        open_cards=OPEN_CARDS,
        command=lambda entry: entry_command(record, entry.kind, entry.text),
        shard=shard_text(record),
        selected=selection_text(record),
        links=links,
        players=players,
        contents=contents,
        views=[view for view in VIEWS if panels.get(view.name) or parts.get(view.name)],
        parts=parts,
        head_script=head_script,
        scripts=scripts_below,
        styles=_inline(styles),
        policy=_content_policy(scripts, styles),
        panels=panels,
        **panels,
    )


_HEAD_SCRIPT = 'document.documentElement.classList.add("js");'
"""Before anything is drawn: one view at a time, where scripts run."""


def _parts_by_view(document: Document) -> dict[str, list[tuple[str, Part]]]:
    """Parts of the document with the titles of their sections, but for cards and empty ones."""
    parts: dict[str, list[tuple[str, Part]]] = defaultdict(list)
    for section in document.sections:
        for part in section.parts_for(Shown.PAGE, Level.PAGE):
            if isinstance(part, Card):
                continue
            shown = {Table: "rows", Text: "lines"}.get(type(part))
            if shown is None or getattr(part, shown):
                parts[part.view].append((section.title, part))
    return parts


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
    environment.globals.update(most_examples=MAX_COUNTEREXAMPLES)
    environment.tests["pair_table"] = lambda pairs: isinstance(pairs, PairTable)
    environment.tests["table"] = lambda part: isinstance(part, Table)
    environment.tests["facts"] = lambda part: isinstance(part, Facts)
    environment.tests["plot"] = lambda part: isinstance(part, Plot)
    return environment


def _finalized(value: Any) -> Any:
    """A value as a template writes it; markup that a template made stays as it is."""
    if value is None:
        return ""
    if type(value) is str:
        plain = len(value) < LINE and value.isascii() and value.isprintable()
        return value if plain else visible(value)
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
