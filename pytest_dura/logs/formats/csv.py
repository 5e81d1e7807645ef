"""Tables of text: CSV with commas, semicolons or tabs, and a header with units in brackets."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pytest_dura.logs.mapping import TIME_NAMES
from pytest_dura.logs.reading import RECEIPT, Columns, Topic, damaged

_HEADING = re.compile(r"\s*(?P<name>[^\[\](]*?)\s*(?:[\[(](?P<unit>[^\])]*)[\])])?\s*")
_TRUTH = {"true": 1.0, "false": 0.0}


def fits(path: Path) -> bool:
    """Whether a file is a table of text."""
    return path.suffix.lower() in (".csv", ".tsv") and path.is_file()


def topics(path: Path) -> list[Topic]:
    """Describe the only topic by header and first line."""
    headings, rows = _table(path, most=1)
    fields, others = {}, {}
    for place, (name, unit) in enumerate(headings):
        number = _number(rows[0][place]) if rows else None
        if number is None:
            others[name] = "text"
        else:
            fields[name] = unit
    return [Topic("", "table", fields, others)]


def read(path: Path, wanted: Mapping[str, Collection[str]]) -> dict[str, Columns]:
    """Read columns; each may be the one of the stamps, beside that of such a name.

    Raises:
        ConfigurationError: For a line that is cut short, and a cell of another type.
    """
    headings, _ = _table(path, most=1)
    places = {name: place for place, (name, _) in enumerate(headings)}
    names = [name for fields in wanted.values() for name in fields if name in places]
    stamps = [name for name in places if name.lower() in TIME_NAMES][:1]
    numbers = _numbers(path, [*stamps, *names], places)
    time = {RECEIPT if name in stamps else name: numbers[name] for name in numbers}
    values = {name: numbers[name].astype(np.float64) for name in names}
    return {"": Columns(time, values)}


def _numbers(path: Path, names: list[str], places: Mapping[str, int]) -> dict[str, Any]:
    """Read columns, whole numbers as such, which have no rounding."""
    with path.open(encoding="utf-8-sig", errors="replace") as stream:
        delimiter = _delimiter(stream.readline())
    how: dict[str, Any] = {"delimiter": delimiter, "encoding": "utf-8-sig", "comments": None}
    try:
        # All columns, since a line that is cut short may have those that are asked for.
        whole = np.loadtxt(path, skiprows=1, ndmin=2, **how)
        columns = {name: whole[:, places[name]] for name in names}
    except ValueError:  # a cell is empty, or holds text: cell by cell
        rows = _table(path)[1]
        columns = {name: np.array(_column(path, rows, places[name], name)) for name in names}
    for name, column in columns.items():
        # Beyond 2**53 a float does not hold each whole number: dates in nanoseconds.
        if len(column) and np.nanmax(np.abs(column)) >= 2**53:
            texts = [row[places[name]].strip() for row in _table(path)[1]]
            if all(text.lstrip("-").isdecimal() for text in texts):
                columns[name] = np.array([int(text) for text in texts], np.int64)
    return columns


def _delimiter(header: str) -> str:
    return max(",;\t", key=header.count)


def _table(path: Path, most: int | None = None) -> tuple[list[tuple[str, str]], list[list[str]]]:
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            delimiter = _delimiter(stream.readline())
            stream.seek(0)
            reader = csv.reader(stream, delimiter=delimiter, skipinitialspace=True, strict=True)
            header = next(reader, [])
            rows = []
            for row in reader:
                if row and len(row) != len(header):
                    problem = f"line {reader.line_num} has {len(row)} of {len(header)} cells"
                    raise damaged(path, problem)
                if row:
                    rows.append(row)
                if most is not None and len(rows) >= most:
                    break
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise damaged(path, error) from None
    if not header or not rows:
        raise damaged(path, "it has no line below a header")
    matches = [_HEADING.fullmatch(heading) for heading in header]
    names = [
        (match["name"], match["unit"] or "") if match else (heading, "")
        for match, heading in zip(matches, header, strict=True)
    ]
    return names, rows


def _number(text: str) -> float | None:
    try:
        return float(text) if text else math.nan
    except ValueError:
        return _TRUTH.get(text.lower())


def _column(path: Path, rows: list[list[str]], place: int, name: str) -> list[float]:
    column = []
    for line, row in enumerate(rows, 2):
        number = _number(row[place])
        if number is None:
            raise damaged(path, f"the column {name!r} holds {row[place][:40]!r} in line {line}")
        column.append(number)
    return column
