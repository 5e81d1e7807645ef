"""Terminal pen: lines of text, each with a status that colours it. It knows nothing of pytest."""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

from pytest_dura.evidence.text import counted, indent_if_reserved, name
from pytest_dura.reports.columns import Column, Shown, legend_entries, shown_in
from pytest_dura.reports.document import Card, Document, Entry, Facts, Level, Table, keep_worst

WIDTH = 100
LONGEST = 500
"""Characters of a row's name."""
MOST_ROWS = 100
"""Rows of a table that are shown at most, unless all are asked for."""
WHERE_ALL_ARE = "-v shows all of them, as do the report and evidence.json"
_MOST_CARDS = 5
_MOST_CARDS_VERBOSE = 100
_LABEL = 12
"""Characters of the label of a card's entry, with what stands before it."""


class Line(NamedTuple):
    """A line, and the status that colours it; empty for none."""

    text: str
    status: str = ""


class TerminalPen:
    """Writes a document for a terminal.

    Args:
        document: What the session shows.
        command: Makes the command of an entry that is one.
        verbose: Whether all is shown that the terminal has.
    """

    def __init__(
        self, document: Document, command: Callable[[Entry], str], *, verbose: bool = False
    ) -> None:
        self._document, self._command, self._verbose = document, command, verbose
        self._level = Level.SUMMARY if verbose else Level.TERMINAL
        self._explained: set[str] = set()
        """Legends that have been given: each once."""

    def lines(self) -> Iterator[Line]:
        """Write the sections, with an empty line before each but the first."""
        began = False
        for section in self._document.sections:
            every = section.parts_for(Shown.TERMINAL, self._level)
            parts = [part for part in every if not isinstance(part, Table) or part.rows]
            cards = [part for part in parts if isinstance(part, Card)]
            if parts and began:
                yield Line("")
            began = began or bool(parts)
            yield from self._cards(cards)
            previous: object = None
            for part in parts:
                if isinstance(part, (Card, Facts)):
                    continue
                if previous is not None and Table in (type(part), type(previous)):
                    yield Line("")
                previous = part
                if isinstance(part, Table):
                    yield from self.table(part)
                else:
                    for text in part.lines:
                        yield from (Line(line, part.status) for line in wrapped(text))

    def _cards(self, cards: Sequence[Card]) -> Iterator[Line]:
        shown = cards[: _MOST_CARDS_VERBOSE if self._verbose else _MOST_CARDS]
        for number, card in enumerate(shown, 1):
            if number > 1:
                yield Line("")
            heading = f"{card.title} ({number} of {counted(len(cards), 'cause')})"
            for line in textwrap.wrap(heading, WIDTH, subsequent_indent="  "):
                yield Line(line, card.status)
            yield from map(Line, self._card_lines(card))
        if len(shown) < len(cards):
            left = Counter(card.status for card in cards[len(shown) :])
            counts = ", ".join(f"{count} {status}" for status, count in left.items())
            where = "the report has all of them" if self._verbose else (
                "-v shows them, as does the report"
            )  # fmt: skip
            more = counted(left.total(), "more cause", "more causes")
            yield from (Line(""), Line(f"and {more}: {counts}; {where}"))

    def _card_lines(self, card: Card) -> Iterator[str]:
        """Lines of a card below its heading; a command stays on one line, however long it is."""
        yield from textwrap.wrap(
            card.headline, WIDTH, initial_indent="  ", subsequent_indent="  ",
            break_on_hyphens=False,
        )  # fmt: skip
        for entry in card.entries:
            if entry.weight > self._level:
                continue
            label = f"{entry.label}:" if entry.label else ""
            head = f"  {label:<{_LABEL - 2}}"
            if len(head) > _LABEL:  # the name of a requirement may be long
                yield head
                head = " " * _LABEL
            if entry.kind in ("replay", "rerun"):
                yield f"{head}{self._command(entry)}"
                continue
            text = f"{entry.text} [{entry.code}]" if entry.code else entry.text
            yield from textwrap.wrap(
                text, WIDTH, initial_indent=head, subsequent_indent=" " * _LABEL,
                break_on_hyphens=False,
            )  # fmt: skip

    def table(self, table: Table) -> Iterator[Line]:
        """Write a table with its legend; of many rows the worst."""
        if not table.rows:
            return
        ranks = table.ranks or [0] * len(table.rows)
        sums = sum(rank < 0 for rank in ranks)
        most = None if self._verbose else MOST_ROWS + sums
        statuses = table.statuses or [""] * len(table.rows)
        every = list(zip(table.rows, statuses, strict=True))
        rows = keep_worst(every, ranks, most=most)
        columns = shown_in(table.columns, Shown.TERMINAL, table.group)
        cells = [
            ["" if row is None else column.cell(row).terminal for column in columns]
            for (_, row), _ in rows
        ]
        names = [own for (own, _), _ in rows]
        lines = aligned(table.name, columns, names, cells)
        for (text, row), status in zip(lines, ["", *(status for _, status in rows)], strict=True):
            yield from (Line(line.rstrip(), status) for line in (*text, row))
        if len(rows) < len(every):
            noun = table.name if table.name.isalpha() else "row"
            left = counted(len(every) - len(rows), noun)
            worst = "those with the worst verdicts are shown; " if table.ranks else ""
            yield Line(f"and {left} more: {worst}{WHERE_ALL_ARE}")
        yield from map(Line, self._legend(columns, table.about))
        for note in table.notes:
            if note not in self._explained:
                self._explained.add(note)
                yield from map(Line, wrapped(note))

    def _legend(self, columns: Sequence[Column[Any]], about: str) -> list[str]:
        """Write what the columns mean, each once, indented where it goes on."""
        every = filter(None, [about, *legend_entries(columns)])
        entries = [text for text in every if text not in self._explained]
        self._explained.update(entries)
        text = "; ".join(entries)
        lines = textwrap.wrap(text, WIDTH - 2, break_on_hyphens=False)
        return [f"{'  ' if number else ''}{name(line, WIDTH)}" for number, line in enumerate(lines)]


def wrapped(text: str) -> list[str]:
    """Lines of a text, indented where it goes on: no text of others begins a line."""
    return textwrap.wrap(
        indent_if_reserved(text), WIDTH, subsequent_indent="  ", break_on_hyphens=False
    )


def aligned(
    title: str, columns: Sequence[Column[Any]], names: Sequence[str], rows: Sequence[Sequence[str]]
) -> list[tuple[list[str], str]]:
    """Align the rows of a table, texts at the left, each with the lines that stand before it.

    A name that is too long stands on a line of its own, before its row.
    """
    # The names of cases, faults and metrics may have any length.
    names = [indent_if_reserved(name(text, LONGEST)) for text in names]
    table = [[name(column.label) for column in columns], *rows]
    sides = [">" if column.kind else "<" for column in columns]
    widths = [max(len(row[i]) for row in table) for i in range(len(columns))]
    room = max(24, WIDTH - sum(widths) - 2 * len(widths))
    label_width = min(max(map(len, [title, *names])), room)
    lines: list[tuple[list[str], str]] = []
    for label, row in zip([title, *names], table, strict=True):
        cells = "".join(
            f"  {cell:{side}{width}}" for cell, side, width in zip(row, sides, widths, strict=True)
        )
        if len(label) <= label_width:
            lines.append(([], f"{label:<{label_width}}{cells}"))
        elif cells.strip():
            lines.append(([label], " " * label_width + cells))
        else:
            lines.append(([], label))
    return lines
