"""Tables of text: CSV with commas, semicolons or tabs, and a header with units in brackets."""

from __future__ import annotations

import csv
import re
from collections.abc import Collection, Iterator, Mapping
from itertools import count, islice
from pathlib import Path

import numpy as np

from pytest_dura.logs.cells import number, numbers
from pytest_dura.logs.mapping import TIME_NAMES
from pytest_dura.logs.reading import RECEIPT, ROWS, Columns, Topic, damaged

_HEADING = re.compile(r"\s*(?P<name>[^\[\](]*?)\s*(?:[\[(](?P<unit>[^\])]*)[\])])?\s*")


def fits(path: Path) -> bool:
    """Whether a file is a table of text."""
    return path.suffix.lower() in (".csv", ".tsv") and path.is_file()


def topics(path: Path) -> list[Topic]:
    """Describe the only topic by header and first line."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            header, line = stream.readline(), next(filter(str.strip, stream), "")
    except (OSError, UnicodeDecodeError) as error:
        raise damaged(path, error) from None
    return [topic_of(path, header, line)]


def topic_of(path: Path, header: str, line: str) -> Topic:
    """Describe a table by its header and its first line.

    Raises:
        ConfigurationError: If there is no line below a header, or one of other cells.
    """
    headings = _headings(header)
    try:
        reader = csv.reader(
            [line], delimiter=delimiter_of(header), skipinitialspace=True, strict=True
        )
        cells = next(reader) if line.strip() else []
    except csv.Error as error:
        raise damaged(path, error) from None
    if not headings or not cells:
        raise damaged(path, "it has no line below a header")
    names = [name for name, _ in headings]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise damaged(path, f"two columns are called {twice!r}", "give each a name of its own")
    if len(cells) != len(headings):
        raise damaged(path, f"line 2 has {len(cells)} of {len(headings)} cells")
    fields, others = {}, {}
    for (name, unit), cell in zip(headings, cells, strict=True):
        if number(cell) is None:
            others[name] = "text"
        else:
            fields[name] = unit
    return Topic("", "table", fields, others)


def blocks(path: Path, wanted: Mapping[str, Collection[str]]) -> Iterator[dict[str, Columns]]:
    """Read columns, some lines at a time; each may be that of the stamps.

    Raises:
        ConfigurationError: For a line that is cut short, and a cell of another type.
    """
    with path.open(newline="", encoding="utf-8-sig", errors="replace") as stream:
        header = stream.readline()
        for first in count(2, ROWS):
            lines = list(islice(stream, ROWS))
            if not lines:
                return
            yield from columns_of(path, header, lines, first, wanted)


def columns_of(
    path: Path, header: str, lines: list[str], first: int, wanted: Mapping[str, Collection[str]]
) -> Iterator[dict[str, Columns]]:
    """Read columns of some lines, of which the first one has a number; nothing of empty lines."""
    places = {name: place for place, (name, _) in enumerate(_headings(header))}
    names = [name for fields in wanted.values() for name in fields if name in places]
    stamps = [name for name in places if name.lower() in TIME_NAMES][:1]
    chosen = {name: places[name] for name in (*stamps, *names)}
    delimiter = delimiter_of(header)
    if not all(map(str.strip, lines)):
        lines = [line for line in lines if line.strip()]
    if lines:
        read = numbers(path, lines, first, chosen, width=len(places), delimiter=delimiter)
        time = {RECEIPT if name in stamps else name: column for name, column in read.items()}
        yield {"": Columns(time, {name: read[name].astype(np.float64) for name in names})}


def delimiter_of(header: str) -> str:
    """The delimiter that a header has most often."""
    return max(",;\t", key=header.count)


def _headings(header: str) -> list[tuple[str, str]]:
    """Names and units of a header."""
    delimiter = delimiter_of(header)
    cells = next(csv.reader([header], delimiter=delimiter, skipinitialspace=True), [])
    matches = [(cell, _HEADING.fullmatch(cell)) for cell in cells]
    return [
        (match["name"], match["unit"] or "") if match else (cell, "") for cell, match in matches
    ]
