"""The report's page: its sections put into the templates, and what the browser may run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pytest_dura.evidence.formats.report import (
    coverage,
    episodes,
    failure_modes,
    faults,
    gate,
    monitors,
    provenance,
    requirements,
    scenarios,
    searches,
    traceability,
)
from pytest_dura.evidence.formats.report.figures import FILTERS
from pytest_dura.evidence.formats.report.gathering import Gathered
from pytest_dura.evidence.formats.report.links import Links
from pytest_dura.evidence.player.page import content_hash
from pytest_dura.evidence.record.session_record import SessionRecord
from pytest_dura.evidence.text import visible

if TYPE_CHECKING:
    from jinja2 import Environment

FILE = "report.html"
HERE = Path(__file__).parent

Section = Callable[[SessionRecord, Gathered, Links], Mapping[str, Any]]
SECTIONS: Mapping[str, Section] = {
    "gate": gate.section,
    "requirements": requirements.section,
    "searches": searches.section,
    "scenarios": scenarios.section,
    "failure_modes": failure_modes.section,
    "faults": faults.section,
    "coverage": coverage.section,
    "traceability": traceability.section,
    "monitors": monitors.section,
    "episodes": episodes.section,
    "provenance": provenance.section,
}
"""By the name of their template, in the order of the page."""


def render(record: SessionRecord) -> str:
    """The page as a text. It reads the bundle's traces, and tells of those it cannot read."""
    from pytest_dura.evidence.formats.report.players import embedded

    gathered = Gathered.of(record)
    players = embedded(record, gathered.candidates)
    links = Links.of(gathered, players.shown)
    scripts = [_asset("report.js")]
    styles = [_asset("report.css")]
    if players.shown:
        scripts.insert(0, players.script)
        styles.insert(0, players.style)
    told = {name: section(record, gathered, links) for name, section in SECTIONS.items()}
    template = _environment().get_template("report.html")
    return template.render(
        record=record.head,
        links=links,
        players=players,
        gathered=gathered,
        scripts=_inline(scripts),
        styles=_inline(styles),
        policy=_policy(scripts, styles),
        **told,
    )


@cache
def _environment() -> Environment:
    """Templates in which every value is made visible, bounded and escaped."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(HERE / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_shown,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(FILTERS)
    return environment


def _shown(value: Any) -> Any:
    """What a template writes of a value; markup that a template made stays as it is."""
    if value is None:
        return ""
    if type(value) is str:
        return visible(value)
    return value


def _asset(file: str) -> str:
    return (HERE / file).read_text(encoding="utf-8")


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


def _policy(scripts: list[str], styles: list[str]) -> str:
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
