"""Columns of the tables of reports, and their cells as terminal, summary and page write them."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import Flag, auto
from typing import Generic, NamedTuple, TypeVar

from pytest_dura.core.measures import MeasureInfo
from pytest_dura.core.roles import STANDARD_ROLES
from pytest_dura.evidence.case_model import ShareEntry
from pytest_dura.evidence.text import code, markdown, name, one_line
from pytest_dura.reports.failure_modes import percent_text

Row = TypeVar("Row")
_Part = TypeVar("_Part")
NO_VALUE = "\N{EN DASH}"
"""What the page shows where there is no value; the other formats have a hyphen."""


class Shown(Flag):
    """Formats in which a column stands."""

    TERMINAL = auto()
    SUMMARY = auto()
    PAGE = auto()
    FILES = SUMMARY | PAGE
    ALL = TERMINAL | SUMMARY | PAGE


class Mark(NamedTuple):
    """A status with its symbol.

    Args:
        word: The status.
        note: What stands behind it, smaller.
        anchor: Where it leads.
    """

    word: str
    note: str = ""
    anchor: str | None = None


@dataclass(frozen=True)
class Cell:
    """A cell as each format writes it.

    Args:
        terminal: Without blanks at its ends.
        summary: Escaped for Markdown.
        page: Not escaped.
        notes: Texts that stand behind it in the page, smaller.
        below: Whether each of them begins a line.
        folded: What the page folds them under; empty where they are seen at once.
        hint: What the page tells of the notes when they are pointed at.
        anchor: Where the page's text leads.
        links: Texts and anchors that the page lists in its place.
        total: Numbers that add up over rows, for the row of those that are not shown.
        style: CSS class in the page.
        marks: What stands before the page's text.
    """

    terminal: str
    summary: str
    page: str
    notes: tuple[str, ...] = ()
    below: bool = False
    folded: str = ""
    hint: str = ""
    anchor: str | None = None
    links: tuple[tuple[str, str], ...] = ()
    total: tuple[int, ...] = ()
    style: str = ""
    marks: tuple[Mark, ...] = ()


BEYOND = "in runs that are invalid or missing, which are in no rate"
EMPTY = Cell("-", "-", NO_VALUE)
Value = Cell | str | int | None
"""A cell, or what stands in every format as it is; ``None`` where there is no value."""


@dataclass(frozen=True)
class Column(Generic[Row]):
    """A column of a table.

    Args:
        name: Its heading in the summary.
        value: Gives the cell of a row.
        heading: In the page; by default the name.
        small: What stands behind the page's heading, smaller.
        short: Heading in the terminal; by default the name.
        meaning: Explains it in the terminal's legend, and in the page where it is pointed at.
        shown: Formats that have it.
        kind: CSS class in the page: ``n`` for what stands at the right; empty for text.
        group: The terminal's table that has it, where one list makes several.
        anchor: Where its heading leads in the page.
    """

    name: str
    value: Callable[[Row], Value]
    heading: str = ""
    small: str = ""
    short: str = ""
    meaning: str = ""
    shown: Shown = Shown.ALL
    kind: str = "n"
    group: str = ""
    anchor: str | None = None

    def cell(self, row: Row) -> Cell:
        """The cell of a row."""
        value = self.value(row)
        if value is None:
            return EMPTY
        if isinstance(value, Cell):
            return value
        text = str(value)
        return Cell(text, text, text, total=(value,) if isinstance(value, int) else ())

    @property
    def title(self) -> str:
        """Heading in the page."""
        return self.heading or self.name.capitalize()

    @property
    def label(self) -> str:
        """Heading in the terminal."""
        return self.short or self.name

    def summed(self, rows: Iterable[Row]) -> str:
        """The sums of its cells over rows that the page does not show, or that there are none."""
        totals = [total for row in rows if (total := self.cell(row).total)]
        return " / ".join(str(sum(part)) for part in zip(*totals, strict=True)) or NO_VALUE


def shown_in(columns: Sequence[Column[Row]], place: Shown, group: str = "") -> list[Column[Row]]:
    """The columns of a format.

    Args:
        columns: All of a table.
        place: The format.
        group: The terminal's table.
    """
    return [
        column
        for column in columns
        if place in column.shown and (place != Shown.TERMINAL or column.group == group)
    ]


def legend_entries(columns: Sequence[Column[Row]]) -> list[str]:
    """What the terminal's columns mean: ``TP: true positives``, ``FP: false positives``."""
    return [
        f"{column.label.removesuffix(' %').removesuffix(' s')}: {column.meaning}"
        for column in columns
        if column.meaning
    ]


# Figures in words.


def number_text(value: float | None, digits: int = 3) -> str:
    """A number with so many significant digits; an integer as it is."""
    if value is None:
        return NO_VALUE
    if isinstance(value, int) or float(value).is_integer():
        return f"{value:.0f}" if abs(value) < 1e15 else f"{value:.{digits}g}"
    shown = f"{value:.{digits}g}"
    return f"{value:.0f}" if "e+" in shown and abs(value) < 1e9 else shown


def share_text(value: float | None) -> str:
    """A share as a percentage with three significant digits: ``18.1 %``."""
    return NO_VALUE if value is None else f"{100 * value:.3g}\N{NO-BREAK SPACE}%"


def seconds_text(value: float | None, digits: int = 2) -> str:
    """``6.50 s``."""
    return NO_VALUE if value is None else f"{value:.{digits}f}\N{NO-BREAK SPACE}s"


def moment_text(text: str) -> str:
    """A point in time as it is read: ``2026-01-02 03:04:05 UTC``."""
    if not re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\+00:00", text):
        return one_line(text)
    return text.replace("T", " ").replace("+00:00", " UTC")


def role_name(role: str) -> str:
    """A standard role's name as in the paper, such as ``SafetyMonitor``; any other one as it is."""
    return STANDARD_ROLES[role].__name__ if role in STANDARD_ROLES else name(role)


def measure_label(measure: MeasureInfo) -> str:
    """Name of a measure in words."""
    return measure.name.replace("_", " ")


def name_cell(
    text: str | None, *notes: str, below: bool = False, anchor: str | None = None
) -> Cell:
    """A name that a user gave."""
    shown = name(text or "")
    return Cell(shown or "-", code(shown) or "-", shown, notes, below=below, anchor=anchor)


def prose_cell(text: str, limit: int = 200) -> Cell:
    """A text that a user or a component wrote."""
    line = one_line(text)
    return Cell(line or "-", markdown(text, limit) or "-", line)


def runs_cell(share: ShareEntry | None, valid: int, *, starred: bool = False) -> Cell | None:
    """How often something happened in valid runs, and with a star in others.

    Args:
        share: How often.
        valid: Valid runs.
        starred: Whether the terminal, which shows per cent, has the others as well.
    """
    if share is None:
        return None
    beyond = share.run - share.valid
    rate = share.share_of_valid
    percent = "-" if rate is None else f"{100 * rate:.0f}"
    return Cell(
        f"{percent} +{beyond}*" if starred and beyond else percent,
        f"{share.valid} of {valid}" + (f", {beyond}*" if beyond else ""),
        f"{share.valid}/{valid}",
        (f"+{beyond}*",) if beyond else (),
        hint=BEYOND,
        total=(share.valid,),
    )


def part_cell(count: int, of: int) -> Cell:
    """So many of so many."""
    return Cell(f"{count}/{of}", f"{count} of {of}", f"{count}/{of}")


def percent_cell(part: float | None) -> Cell | None:
    """A share in a column whose heading has the unit, but for the page's."""
    text = percent_text(part)
    return None if part is None else Cell(text, text, f"{text} %")


def given(part: _Part | None, value: Callable[[_Part], Value]) -> Value:
    """The cell of a part that not every row has."""
    return None if part is None else value(part)


def rounded(value: float | None, spec: str) -> str:
    """A number in this format."""
    return "-" if value is None else f"{value:{spec}}"
