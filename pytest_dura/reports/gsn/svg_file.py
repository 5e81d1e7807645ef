"""``assurance-case.svg``: the argument as a picture that stands alone."""

from __future__ import annotations

from collections import Counter

from pytest_dura.evidence.model import SessionRecord
from pytest_dura.evidence.text import name
from pytest_dura.reports.gsn.argument import REVIEW_ID, SESSION_ID
from pytest_dura.reports.gsn.drawing import (
    MARGIN,
    MARKERS,
    STYLE,
    WIDTH,
    DrawnArgument,
    Edge,
    Shape,
    drawn_argument,
    layout_argument,
    text_of,
    wrap_text,
)
from pytest_dura.reports.gsn.user_argument import session_argument
from pytest_dura.reports.wording import is_incomplete

FILE = "assurance-case.svg"
NAMESPACE = "http://www.w3.org/2000/svg"

_STATED = ("cases", "episodes", "valid", "invalid", "missing")
_KINDS = ("Goal", "Strategy", "Solution", "Context", "Assumption", "CounterGoal")


def render(record: SessionRecord) -> str:
    """The file's text.

    Raises:
        ConfigurationError: If the user's argument does not fit.
    """
    argument = session_argument(record)
    session = argument[SESSION_ID]
    view = drawn_argument(argument)
    view.counts[SESSION_ID] = Counter({key: session.layers[key] for key in ("gate", *_STATED)})
    head, y = _picture_head(record, view)
    picture = layout_argument(view, next(iter(argument)), y)
    height = picture.height + MARGIN
    edges = "\n".join(edge.svg() for edge in picture.edges)
    shapes = "\n".join(shape.svg() for shape in picture.shapes)
    text = argument[next(iter(argument))].text
    return (
        f'<svg xmlns="{NAMESPACE}" viewBox="0 0 {WIDTH:.0f} {height:.0f}" width="{WIDTH:.0f}" '
        f'height="{height:.0f}" role="img" aria-labelledby="gsn-title gsn-text">\n'
        '<title id="gsn-title">Assurance case, generated, unreviewed</title>\n'
        f'<desc id="gsn-text">{text_of(f"{text} {session.text}")}</desc>\n'
        f"<style>{STYLE}</style><defs>{MARKERS}</defs>\n"
        f'<path fill="#fff" d="M0 0H{WIDTH:.0f}V{height:.0f}H0z"/>\n'
        f"{head}\n<g>{edges}</g>\n{shapes}\n</svg>\n"
    )


def _picture_head(record: SessionRecord, view: DrawnArgument) -> tuple[str, float]:
    """Title, warning, place for the reviewer and legend; and where they end."""
    lines = [("head", "Assurance case (GSN): generated, unreviewed")]
    if is_incomplete(record):
        lines.append(("warning", "INCOMPLETE SESSION: not all was run, so no claim is made here."))
    lines += [("", sentence) for sentence in view.folded]
    if REVIEW_ID in view.argument:
        layers = view.argument[REVIEW_ID].layers
        blank = "." * 32
        review = [f"{key}: {layers[key] or blank}" for key in layers]
        lines.append(("", "   ".join(review)))
    lines.append(
        ("", f"{name(record['created'])}. Evidence and every element: assurance-case.gsn.yaml")
    )
    y = MARGIN + 6
    texts = []
    for kind, line in lines:
        texts.append(
            f'<text class="left {kind}" x="{MARGIN:.0f}" y="{y:.0f}">{text_of(line)}</text>'
        )
        y += 20
    legend = _legend(y + 4)
    return "\n".join([*texts, *legend]), y + 84


def _legend(y: float) -> list[str]:
    """Every kind of element and relation of the notation with its name, outside of the counts."""
    parts = []
    x = MARGIN
    for kind in _KINDS:
        round_ = kind == "Solution"
        lines = wrap_text(kind, 200, 1)
        shape = Shape(kind, kind, lines, 60 if round_ else 104, x=x, y=y)
        parts.append(shape.svg().replace("data-id", "data-legend").replace("data-box", "data-size"))
        x += shape.width + 16
    undeveloped = Shape("undeveloped", "Goal", ["Undeveloped"], 104, undeveloped=True, x=x, y=y)
    defeated = Shape("defeated", "Goal", ["Defeated"], 90, defeated=True, x=x + 120, y=y)
    parts += [
        shape.svg().replace("data-id", "data-legend").replace("data-box", "data-size")
        for shape in (undeveloped, defeated)
    ]
    x += 226
    names = {
        "supportedBy": "supported by",
        "inContextOf": "in context of",
        "challenges": "challenges",
    }
    for i, (relation, label) in enumerate(names.items()):
        height = y + 4 + i * 18
        parts.append(Edge(relation, ((x, height), (x + 50, height))).svg())
        parts.append(f'<text class="left" x="{x + 58:.0f}" y="{height + 4:.0f}">{label}</text>')
    return parts
