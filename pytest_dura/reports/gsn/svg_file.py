"""``assurance-case.svg``: the argument as a picture that stands alone, page below page."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from pytest_dura.evidence.model import SessionRecord
from pytest_dura.evidence.text import name, one_line
from pytest_dura.reports.gsn.argument import REVIEW_ID, SESSION_ID, generated_argument
from pytest_dura.reports.gsn.drawing import (
    MARKERS,
    STYLE,
    DrawnArgument,
    Edge,
    Shape,
    drawn_argument,
)
from pytest_dura.reports.gsn.pages import (
    BETWEEN,
    HEIGHT,
    MARGIN,
    WIDTH,
    Pages,
    layout_argument,
    page_top,
)
from pytest_dura.reports.svg import Svg, document, joined, tag
from pytest_dura.reports.wording import is_incomplete, review_text

FILE = "assurance-case.svg"

_STATED = ("cases", "episodes", "valid", "invalid", "missing")
_KINDS = (
    "Goal", "Strategy", "Solution", "Context", "Assumption", "Justification", "CounterGoal",
)  # fmt: skip


def render(record: SessionRecord) -> str:
    """The file's text."""
    argument = generated_argument(record)
    session = argument[SESSION_ID]
    view = drawn_argument(argument)
    view.counts[SESSION_ID] = Counter({key: session.layers[key] for key in ("gate", *_STATED)})
    root = next(iter(argument))
    head, y = _picture_head(record, view)
    pages = layout_argument(view, root, y)
    height = page_top(len(pages.titles)) - BETWEEN
    return (
        document(
            round(WIDTH),
            round(height),
            tag("title", f"Assurance case, {review_text(record)}", id="gsn-title"),
            tag("desc", f"{argument[root].text} {session.text}", id="gsn-text"),
            joined([tag("style", STYLE), tag("defs", MARKERS)]),
            *_sheets(record, pages),
            *head,
            tag("g", joined([edge.svg() for edge in pages.edges], "\n")),
            *(shape.svg() for shape in pages.shapes),
            role="img",
            aria_labelledby="gsn-title gsn-text",
        )
        + "\n"
    )


def _sheets(record: SessionRecord, pages: Pages) -> Iterator[Svg]:
    """Each page by its outline and title, and a view: ``assurance-case.svg#page-2`` shows it."""
    for number, roots in enumerate(pages.titles, 1):
        top = page_top(number - 1)
        yield tag("view", id=f"page-{number}", viewBox=f"0 {top:.0f} {WIDTH:.0f} {HEIGHT:.0f}")
        yield tag("rect", class_="page", x=0.5, y=top + 0.5, width=WIDTH - 1, height=HEIGHT - 1)
        head = ", ".join(roots)
        if number == 1:
            head = f"Assurance case (GSN): {one_line(review_text(record), 120)}"
        yield tag("text", head, class_="left head", x=round(MARGIN), y=round(top + MARGIN + 6))
        of = f"page {number} of {len(pages.titles)}"
        yield tag("text", of, class_="right", x=round(WIDTH - MARGIN), y=round(top + MARGIN + 4))


def _picture_head(record: SessionRecord, view: DrawnArgument) -> tuple[list[Svg], float]:
    """Warning, review and legend of the first page; and where they end."""
    lines = []
    if is_incomplete(record):
        lines.append(("warning", "INCOMPLETE SESSION: not all was run, so no claim is made here."))
    lines += [("", sentence) for sentence in view.folded]
    layers = view.argument[REVIEW_ID].layers
    review = "   ".join(f"{key}: {layers[key]}" for key in layers if layers[key])
    how = "A review is signed by python -m pytest_dura sign DIR --key=KEY.pem --review=review.yaml."
    files = (
        "Verdicts, episodes and tables are in evidence.json; each element by itself and all "
        "counterexamples are in assurance-case.gsn.yaml."
    )
    lines += [("", f"{name(record.head.created)}. {review or how}"), ("", files)]
    y = MARGIN + 28
    texts = []
    for kind, line in lines:
        place = {"x": round(MARGIN), "y": round(y)}
        texts.append(tag("text", line, class_=f"left {kind}", **place))
        y += 19
    return [*texts, *_legend(y - 4)], y + 66


def _legend(y: float) -> list[Svg]:
    """Every kind of element and relation of the notation with its name, outside of the counts."""
    parts = []
    x = MARGIN
    for text in (*_KINDS, "Undeveloped", "Defeated"):
        kind = text if text in _KINDS else "Goal"
        shape = Shape(
            text,
            kind,
            [text.replace("Counter", "Counter ")],
            60.0 if kind == "Solution" else 108.0,
            undeveloped=text == "Undeveloped",
            defeated=text == "Defeated",
            x=x,
            y=y,
        )
        parts.append(shape.svg(legend=True))
        x += shape.width + 16
    relations = {
        "supportedBy": "supported by",
        "inContextOf": "in context of",
        "challenges": "challenges",
        "defeats": "challenges, and defeats",
    }
    for i, (relation, label) in enumerate(relations.items()):
        left, height = x + 150 * (i // 2), y + 12 + i % 2 * 20
        parts.append(Edge(relation, ((left, height), (left + 42, height))).svg())
        place = {"x": round(left + 50), "y": round(height + 4)}
        parts.append(tag("text", label, class_="left", **place))
    return parts
