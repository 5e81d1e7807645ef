"""``assurance-case.svg``: the argument as a picture that stands alone."""

from __future__ import annotations

from collections import Counter

from pytest_dura.evidence.model import SessionRecord
from pytest_dura.evidence.text import name, one_line
from pytest_dura.reports.gsn.argument import REVIEW_ID, SESSION_ID, generated_argument
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
    wrap_text,
)
from pytest_dura.reports.svg import Svg, document, joined, tag
from pytest_dura.reports.wording import is_incomplete, review_text

FILE = "assurance-case.svg"

_STATED = ("cases", "episodes", "valid", "invalid", "missing")
_KINDS = ("Goal", "Strategy", "Solution", "Context", "Assumption", "CounterGoal")


def render(record: SessionRecord) -> str:
    """The file's text."""
    argument = generated_argument(record)
    session = argument[SESSION_ID]
    view = drawn_argument(argument)
    view.counts[SESSION_ID] = Counter({key: session.layers[key] for key in ("gate", *_STATED)})
    head, y = _picture_head(record, view)
    picture = layout_argument(view, next(iter(argument)), y)
    height = picture.height + MARGIN
    edges = joined([edge.svg() for edge in picture.edges], "\n")
    text = argument[next(iter(argument))].text
    return (
        document(
            round(WIDTH),
            round(height),
            tag("title", f"Assurance case, {review_text(record)}", id="gsn-title"),
            tag("desc", f"{text} {session.text}", id="gsn-text"),
            joined([tag("style", STYLE), tag("defs", MARKERS)]),
            tag("path", fill="#fff", d=f"M0 0H{WIDTH:.0f}V{height:.0f}H0z"),
            *head,
            tag("g", edges),
            *(shape.svg() for shape in picture.shapes),
            role="img",
            aria_labelledby="gsn-title gsn-text",
        )
        + "\n"
    )


def _picture_head(record: SessionRecord, view: DrawnArgument) -> tuple[list[Svg], float]:
    """Title, warning, place for the reviewer and legend; and where they end."""
    lines = [("head", f"Assurance case (GSN): {one_line(review_text(record), 120)}")]
    if is_incomplete(record):
        lines.append(("warning", "INCOMPLETE SESSION: not all was run, so no claim is made here."))
    lines += [("", sentence) for sentence in view.folded]
    if REVIEW_ID in view.argument:
        layers = view.argument[REVIEW_ID].layers
        blank = "." * 32
        review = [f"{key}: {layers[key] or blank}" for key in layers]
        lines.append(("", "   ".join(review)))
    lines.append(
        ("", f"{name(record.head.created)}. Evidence and every element: assurance-case.gsn.yaml")
    )
    y = MARGIN + 6
    texts = []
    for kind, line in lines:
        place = {"x": round(MARGIN), "y": round(y)}
        texts.append(tag("text", line, class_=f"left {kind}", **place))
        y += 20
    return [*texts, *_legend(y + 4)], y + 84


def _legend(y: float) -> list[Svg]:
    """Every kind of element and relation of the notation with its name, outside of the counts."""
    parts = []
    x = MARGIN
    for kind in _KINDS:
        round_ = kind == "Solution"
        lines = wrap_text(kind, 200, 1)
        shape = Shape(kind, kind, lines, 60.0 if round_ else 104.0, x=x, y=y)
        parts.append(shape.svg(legend=True))
        x += shape.width + 16
    undeveloped = Shape("undeveloped", "Goal", ["Undeveloped"], 104.0, undeveloped=True, x=x, y=y)
    defeated = Shape("defeated", "Goal", ["Defeated"], 90.0, defeated=True, x=x + 120, y=y)
    parts += [shape.svg(legend=True) for shape in (undeveloped, defeated)]
    x += 226
    names = {
        "supportedBy": "supported by",
        "inContextOf": "in context of",
        "challenges": "challenges",
    }
    for i, (relation, label) in enumerate(names.items()):
        height = y + 4 + i * 18
        parts.append(Edge(relation, ((x, height), (x + 50, height))).svg())
        place = {"x": round(x + 58), "y": round(height + 4)}
        parts.append(tag("text", label, class_="left", **place))
    return parts
