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
    """Read columns; the one of the stamps is named by ``wanted`` as well.

    Raises:
        ConfigurationError: For a line that is cut short, and a cell of another type.
    """
    headings, rows = _table(path)
    places = {name: place for place, (name, _) in enumerate(headings)}
    names = [name for fields in wanted.values() for name in fields if name in places]
    values = {name: np.array(_column(path, rows, places[name], name)) for name in names}
    stamps = [name for name, _ in headings if name.lower() in TIME_NAMES]
    time: dict[str, Any] = {}
    if stamps:
        time[RECEIPT] = _stamps(path, rows, places[stamps[0]], stamps[0])
    for name in names:
        time[name] = _stamps(path, rows, places[name], name, optional=True)
    return {"": Columns({key: each for key, each in time.items() if each is not None}, values)}


def _table(path: Path, most: int | None = None) -> tuple[list[tuple[str, str]], list[list[str]]]:
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            first = stream.readline()
            delimiter = max(",;\t", key=first.count)
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


def _stamps(
    path: Path, rows: list[list[str]], place: int, name: str, *, optional: bool = False
) -> Any:
    """Read stamps as whole numbers where they are, which have no rounding."""
    texts = [row[place].strip() for row in rows]
    if all(text.lstrip("-").isdecimal() for text in texts):
        return np.array([int(text) for text in texts], np.int64)
    if optional:
        return None
    return np.array(_column(path, rows, place, name))
