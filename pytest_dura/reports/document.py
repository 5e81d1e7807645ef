"""Document: what a session shows, in order of importance, for every pen.

A part names the level of detail from which on it is shown, so that a pen stops early. Texts are
bounded and on one line each; a pen escapes them for its format.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Literal, TypeVar

from pytest_dura.reports.columns import Column, Shown
from pytest_dura.reports.svg import Svg

_Row = TypeVar("_Row")


class Level(IntEnum):
    """Level of detail."""

    FIRST = 0
    """The first screen."""
    TERMINAL = 1
    """The terminal."""
    SUMMARY = 2
    """The summary, and the terminal with ``-v``."""
    PAGE = 3
    """The page."""


Kind = Literal["text", "code", "command", "replay", "rerun"]


@dataclass(frozen=True)
class Entry:
    """A labelled entry of a card.

    Args:
        label: What it is on; a requirement's id, or a word of ours; empty where it goes on.
        text: The text; of kind ``command`` one to type; of kind ``replay`` the id of an episode, of
            kind ``rerun`` that of an item, of which a pen makes the command.
        kind: How a pen sets it.
        code: A check that stands behind the text; empty for none.
        weight: From which level on it is shown.
        links: Names that the page lists behind the text, each with the anchor where it leads.
    """

    label: str
    text: str
    kind: Kind = "text"
    code: str = ""
    weight: Level = Level.FIRST
    links: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class Place:
    """Where to see what a card is on.

    Args:
        case: Id of the case; empty for the whole session.
        component: Name of the component under test.
        episode: Id of an episode that shows it; empty for none.
        time: When, in s.
    """

    case: str = ""
    component: str = ""
    episode: str = ""
    time: float | None = None


@dataclass(frozen=True)
class Card:
    """One thing that went wrong, or one verdict.

    Args:
        status: Of what it is on, such as ``violated``.
        title: Heading, without its number.
        headline: What happened, in a sentence.
        entries: The rest.
        place: Where to see it.
    """

    status: str
    title: str
    headline: str
    entries: tuple[Entry, ...] = ()
    weight: Level = Level.FIRST
    shown: Shown = Shown.ALL
    place: Place = Place()


@dataclass(frozen=True)
class Text:
    """Sentences, each on lines of its own.

    Args:
        lines: The sentences.
        weight: From which level on they are shown.
        shown: Formats that have them.
        status: What colours them, such as ``undecided``; empty for nothing.
        view: The page's view that has them; empty for its first one.
    """

    lines: tuple[str, ...]
    weight: Level = Level.TERMINAL
    shown: Shown = Shown.ALL
    status: str = ""
    view: str = ""


@dataclass(frozen=True)
class Facts:
    """Labelled entries below each other.

    Args:
        entries: Each from its own level of detail on.
        weight: From which level on they are shown.
        shown: Formats that have them.
        view: The page's view that has them; empty for its first one.
    """

    entries: tuple[Entry, ...]
    weight: Level = Level.SUMMARY
    shown: Shown = Shown.FILES
    view: str = ""


@dataclass(frozen=True)
class Table:
    """A table.

    Args:
        name: Heading of the names of its rows, and in files its title.
        columns: As they are declared.
        rows: Each with its name, which the terminal shows beside the cells; ``None`` for a heading
            among them.
        about: What the legend begins with.
        group: The terminal's table, where a list of columns makes several.
        notes: Lines below it.
        weight: From which level on it is shown.
        shown: Formats that have it.
        statuses: What colours each row; empty for nothing.
        ranks: How bad each row is, 0 the worst, where a pen keeps the worst of many, and less than
            0 for sums, which it keeps beside them; empty where it keeps the first.
        caption: Its title in the page; that of its section where it is empty.
        view: The page's view that has it; empty for its first one.
        legend: Styles of the cells of a matrix, each with what it means; empty for other tables.
    """

    name: str
    columns: Sequence[Column[Any]]
    rows: Sequence[tuple[str, Any]]
    about: str = ""
    group: str = ""
    notes: tuple[str, ...] = ()
    weight: Level = Level.SUMMARY
    shown: Shown = Shown.ALL
    statuses: Sequence[str] = ()
    ranks: Sequence[int] = ()
    caption: str = ""
    view: str = ""
    legend: tuple[tuple[str, str], ...] = ()


def keep_worst(rows: Sequence[_Row], ranks: Sequence[int], *, most: int | None) -> list[_Row]:
    """Return the worst rows, as many as are shown, in their own order.

    Args:
        rows: All there is.
        ranks: How bad each is, 0 the worst; among equals the first ones stay.
        most: How many; ``None`` for all.
    """
    if most is None or len(rows) <= most:
        return list(rows)
    places = sorted(range(len(rows)), key=ranks.__getitem__)[:most]
    return [rows[index] for index in sorted(places)]


@dataclass(frozen=True)
class Picture:
    """A picture of a plot.

    Args:
        title: What it shows.
        svg: The picture.
        about: Goes on from its title, in sentences.
        numbers: What it shows as a table; ``None`` without one.
        left_out: What is not drawn, of :func:`not_drawn`.
        mark: Stands behind its title, smaller.
        opened: Whether the page unfolds it, where it is one of several below a heading; ``None``
            where it is never folded.
    """

    title: str
    svg: Svg
    about: str = ""
    numbers: Table | None = None
    left_out: str = ""
    mark: str = ""
    opened: bool | None = None


@dataclass(frozen=True)
class Plot:
    """Pictures of one kind; in formats without pictures what they show, in words.

    Args:
        title: Its heading; empty for none.
        pictures: In order of importance.
        about: Sentences below the heading.
        lines: The words, each on lines of its own.
        left_out: Pictures that are not drawn, of :func:`not_drawn`.
        small: Whether they stand side by side.
        weight: From which level on it is shown.
        shown: Formats that have it; those without pictures where there are words.
        view: The page's view that has it.
    """

    title: str = ""
    pictures: tuple[Picture, ...] = ()
    about: str = ""
    lines: tuple[str, ...] = ()
    left_out: str = ""
    small: bool = False
    weight: Level = Level.SUMMARY
    shown: Shown = Shown.ALL
    status: str = ""
    view: str = "plots"


def not_drawn(number: int, what: str) -> str:
    """Say how much is not drawn, such as ``3 more cases are``; empty for nothing."""
    return f"{number} more {what} not drawn." if number else ""


Part = Text | Facts | Card | Table | Plot


@dataclass(frozen=True)
class Section:
    """A section of a document.

    Args:
        title: Its heading in files; empty for none.
        parts: In order of importance.
        weight: From which level on it is shown.
    """

    title: str
    parts: tuple[Part, ...]
    weight: Level = Level.FIRST

    def parts_for(self, place: Shown, level: Level) -> Iterator[Part]:
        """Yield the parts of a format at a level of detail; none below the section's own."""
        if self.weight <= level:
            for part in self.parts:
                if part.weight <= level and place in part.shown:
                    yield part


@dataclass(frozen=True)
class Document:
    """What a session shows.

    Args:
        verdict: Result of the gate and what it rests on, in a line.
        sections: In order of importance.
        sentence: What the result of the gate rests on, in a sentence.
    """

    verdict: str
    sections: tuple[Section, ...]
    sentence: str = ""

    @property
    def cards(self) -> list[Card]:
        """All cards, the worst first."""
        return [
            part for section in self.sections for part in section.parts if isinstance(part, Card)
        ]
