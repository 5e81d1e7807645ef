"""What a pen writes of a part of a document."""

from __future__ import annotations

from pytest_dura.reports.document import Document, Table
from pytest_dura.reports.pens.terminal import TerminalPen


def table_lines(*tables: Table | None) -> list[str]:
    """The lines of tables in a terminal, with the legends of each."""
    pen = TerminalPen(Document("", ()), str, verbose=True)
    return [line.text for table in tables if table is not None for line in pen.table(table)]
