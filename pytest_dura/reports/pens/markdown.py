"""Markdown pen, as GitHub reads it: no text of a user is a link, a mention, HTML or a cell's end.

Each table and the cards have their share of the bytes that GitHub takes, and begin with what
failed; what does not fit is left out, and a sentence says how much.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from pytest_dura.evidence.text import code, markdown
from pytest_dura.reports.columns import Shown, shown_in
from pytest_dura.reports.document import Card, Document, Entry, Facts, Level, Table

MAX_BYTES = 1024 * 1024
"""Bytes that GitHub takes."""
_KIB = 1024
_SHARES = {"Causes": 160 * _KIB, "Verdicts": 420 * _KIB, "Requirements": 100 * _KIB,
           "Cases": 150 * _KIB, "Failure modes": 30 * _KIB, "Searches": 40 * _KIB,
           "Hazards": 40 * _KIB}  # fmt: skip
"""Bytes of sections; the rest is for what has a small bound: the head, reasons, provenance."""
_SHARE = 20 * _KIB
"""Bytes of any other section."""
_MOST_LINES = 20
"""Sentences of a part."""


class MarkdownPen:
    """Writes cards and sections of a document.

    Args:
        document: What the session shows.
        command: Makes the command of an entry that is one, as it has to be typed; empty where it
            cannot be shown so.
    """

    def __init__(self, document: Document, command: Callable[[Entry], str]) -> None:
        self._document, self._command = document, command

    def cards(self) -> Iterator[str]:
        """Write the cards, as many as fit; nothing where all is supported."""
        cards = self._document.cards
        room, shown = _SHARES["Causes"], 0
        for number, card in enumerate(cards, 1):
            title = markdown(f"Cause {number}, {card.title}", 400)
            lines = ["", f"## {title}", "", f"**{markdown(card.headline, 800)}**", ""]
            lines += self._entries(card.entries, Level.TERMINAL)
            room -= sum(len(line.encode()) + 1 for line in lines)
            if room < 0:
                break
            shown += 1
            yield from lines
        if shown < len(cards):
            more = len(cards) - shown
            yield from ["", f"_{more} more causes are in the report._"]

    def _entries(self, entries: Iterable[Entry], level: Level) -> Iterator[str]:
        for entry in entries:
            if entry.weight <= level:
                label = f"{markdown(entry.label, 200)}: " if entry.label else ""
                yield f"- {label}{self._entry(entry)}"

    def _entry(self, entry: Entry) -> str:
        if entry.kind in ("replay", "rerun"):
            return self._command(entry) or "by its id in the record"
        if entry.kind in ("code", "command"):
            return code(entry.text, 1000)
        text = markdown(entry.text, 800)
        return f"{text} {code(entry.code, 400)}" if entry.code else text

    def sections(self) -> Iterator[str]:
        """Write the sections, but for the cards."""
        for section in self._document.sections:
            title = section.title
            for part in section.parts_for(Shown.SUMMARY, Level.SUMMARY):
                if isinstance(part, Table):
                    yield from _table(part.caption or section.title, part)
                elif isinstance(part, Facts):
                    yield from ["", f"## {section.title}", ""]
                    yield from self._entries(part.entries, Level.SUMMARY)
                elif not isinstance(part, Card):
                    yield from ["", f"**{title}**", ""] if title else [""]
                    title = ""
                    yield from (f"- {markdown(line, 600)}" for line in part.lines[:_MOST_LINES])
                    if len(part.lines) > _MOST_LINES:
                        yield f"- and {len(part.lines) - _MOST_LINES} more in the report"


def _table(title: str, table: Table) -> Iterator[str]:
    """A heading and a table, with as many of its rows as fit into its share."""
    columns = shown_in(table.columns, Shown.SUMMARY)
    rows = (row for _, row in table.rows if row is not None)
    lines = (f"| {' | '.join(column.cell(row).summary for column in columns)} |" for row in rows)
    yield from ["", f"## {markdown(title, 100)}", ""]
    yield from [
        f"| {' | '.join(markdown(column.name, 100) for column in columns)} |",
        f"|{' --- |' * len(columns)}",
        *_fitting(lines, _SHARES.get(title, _SHARE)),
    ]
    below = [f"{table.about}."] if table.about else []
    for text in (*below, *table.notes):
        yield from ["", markdown(text, 400)]


def _fitting(rows: Iterable[str], room: int) -> Iterator[str]:
    """As many rows as fit, and how many do not."""
    total, shown = 0, 0
    for row in rows:
        total += 1
        room -= len(row.encode()) + 1
        if room >= 0:
            shown += 1
            yield row
    if not total:
        yield from ["", "None."]
    if shown < total:
        yield ""
        yield (
            f"_{total - shown} of {total} are left out here, to stay below the limit of a summary; "
            "the report and evidence.json have all._"
        )
