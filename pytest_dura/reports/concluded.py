"""Further tables of a session as columns and rows, which terminal, summary and page write."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import NamedTuple

from pytest_dura.evidence.model import CellValue, ConcludedColumn, ConcludedTable, SessionRecord
from pytest_dura.reports.columns import Cell, Column, Shown, Value, number_text, prose_cell

Row = Sequence[CellValue]


class TableShown(NamedTuple):
    """A table with its columns.

    Args:
        name: Its key in the record.
        title: Its heading.
        about: What it shows.
        columns: The first one names the row; the terminal has it beside the others.
        rows: Its rows.
    """

    name: str
    title: str
    about: str
    columns: list[Column[Row]]
    rows: Sequence[Row]


def concluded_tables(record: SessionRecord) -> Iterator[TableShown]:
    """Yield the further tables of a record, by name."""
    for name, table in record.head.conclusions.items():
        columns = [_column(number, column, table) for number, column in enumerate(table.columns)]
        yield TableShown(name, table.title, table.about, columns, table.rows)


def _column(number: int, column: ConcludedColumn, table: ConcludedTable) -> Column[Row]:
    texts = any(isinstance(row[number], str) for row in table.rows)
    unit = f" {column.unit}" if column.unit else ""
    return Column(
        column.name + unit,
        partial(_cell, number),
        heading=column.name,
        small=column.unit,
        meaning=column.meaning,
        shown=Shown.ALL if number else Shown.FILES,
        kind="" if texts else "n",
    )


def _cell(number: int, row: Row) -> Value:
    value = row[number]
    if isinstance(value, bool):
        return Cell(*3 * ("yes" if value else "no",))
    if isinstance(value, str):
        return prose_cell(value)
    return None if value is None else Cell(*3 * (number_text(value),))
