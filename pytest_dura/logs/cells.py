"""Lines of a table of text as columns of numbers."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pytest_dura.logs.reading import damaged

_TRUTH = {"true": 1.0, "false": 0.0}


def number(text: str) -> float | None:
    """Return a cell as a number, NaN if it is empty; ``None`` for text."""
    try:
        return float(text) if text else math.nan
    except ValueError:
        return _TRUTH.get(text.lower())


def numbers(
    path: Path,
    lines: list[str],
    first: int,
    places: Mapping[str, int],
    *,
    width: int,
    delimiter: str,
) -> dict[str, Any]:
    """Read columns of some lines, whole numbers as such, which have no rounding.

    Args:
        path: The table, for messages.
        lines: The lines.
        first: Number of the first one in the table.
        places: Place of each column to read.
        width: Cells of each line.
        delimiter: Between two cells.

    Raises:
        ConfigurationError: For a line with more or fewer cells, and a cell with text.
    """
    try:
        # All columns, since a line that is cut short may have those that are asked for.
        whole = np.loadtxt(lines, ndmin=2, delimiter=delimiter, comments=None)
    except ValueError:
        whole = np.empty((0, 0))
    if whole.shape[1] == width:
        columns = {name: whole[:, place] for name, place in places.items()}
    else:  # a cell is empty, or holds text: cell by cell
        rows = _rows(path, lines, first, width, delimiter)
        columns = {
            name: np.array(_column(path, rows, place, name)) for name, place in places.items()
        }
    for name, column in columns.items():
        # Beyond 2**53 a float does not hold each whole number: dates in nanoseconds.
        if 2**53 <= np.nanmax(np.abs(column), initial=0.0) < 2**63:
            texts = [line.split(delimiter)[places[name]].strip() for line in lines]
            if all(text.lstrip("-").isdecimal() for text in texts):
                columns[name] = np.array([int(text) for text in texts], np.int64)
    return columns


def _rows(
    path: Path, lines: list[str], first: int, width: int, delimiter: str
) -> list[tuple[int, list[str]]]:
    """Cells of each line, with its number."""
    rows = []
    reader = csv.reader(lines, delimiter=delimiter, skipinitialspace=True, strict=True)
    try:
        for row in reader:
            line = first + reader.line_num - 1
            if row and len(row) != width:
                raise damaged(path, f"line {line} has {len(row)} of {width} cells")
            rows += [(line, row)] if row else []
    except csv.Error as error:
        raise damaged(path, error) from None
    return rows


def _column(path: Path, rows: list[tuple[int, list[str]]], place: int, name: str) -> list[float]:
    column = []
    for line, row in rows:
        value = number(row[place])
        if value is None:
            raise damaged(path, f"the column {name!r} holds {row[place][:40]!r} in line {line}")
        column.append(value)
    return column
