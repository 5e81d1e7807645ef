"""The columns of tables: one list, which terminal, summary and page render in its order."""

from __future__ import annotations

import re

import pytest
from entries import make
from pens import table_lines
from searches import entry
from session_records import session_record

from pytest_dura.evidence.case_model import CaseEntry
from pytest_dura.evidence.model import SessionRecord
from pytest_dura.reports import (
    Cell,
    Column,
    Shown,
    case_columns,
    session_tables,
    shown_in,
    summary,
    tables,
)
from pytest_dura.reports.columns import NO_VALUE
from pytest_dura.reports.html import verdict_sections
from pytest_dura.reports.html.page import render
from pytest_dura.reports.session_tables import case_table, fault_table


def headings_of_summary(text: str, section: str) -> list[str]:
    body = text.partition(f"\n## {section}\n\n")[2]
    return body.partition("\n")[0].strip("| ").split(" | ")


def headings_of_page(html: str, table: str) -> list[str]:
    head = (
        html.partition(f'<table id="{table}"')[2].partition("</thead>")[0].partition("<thead>")[2]
    )
    cells = re.findall(r"<th[^>]*>(.*?)</th>", head, re.DOTALL)
    return [re.sub(r"<small>.*?</small>|<[^>]+>", "", cell).strip() for cell in cells]


def test_each_format_has_the_columns_of_cases_in_their_order() -> None:
    record = session_record()
    cases, measures = record.head.cases, record.head.measures
    columns = case_columns(cases, measures)
    assert headings_of_summary(summary.render(record), "Cases") == [
        column.name for column in shown_in(columns, Shown.SUMMARY)
    ]
    assert headings_of_page(render(record), "outcomes") == [
        column.title for column in shown_in(columns, Shown.PAGE)
    ]
    header = table_lines(case_table(cases, measures=measures))[0]
    labels = " ".join(column.label for column in shown_in(columns, Shown.TERMINAL))
    assert header.split() == ["case", *labels.split()]


@pytest.fixture
def with_a_column(monkeypatch: pytest.MonkeyPatch) -> SessionRecord:
    """A record with searches, and one more column of verdicts."""
    added: Column[object] = Column(
        "added",
        lambda _: Cell("-", "sum-up", "page-up", ("small",), hint="<hint>"),
        meaning="<new>",
    )
    for module in (session_tables, verdict_sections):
        monkeypatch.setattr(module, "VERDICT_COLUMNS", [*tables.VERDICT_COLUMNS, added])
    return session_record(searches=[entry("falsified")])


def test_an_added_column_stands_in_summary_and_page(with_a_column: SessionRecord) -> None:
    text, html = summary.render(with_a_column), render(with_a_column)
    assert headings_of_summary(text, "Verdicts")[-1] == "added"
    rows = len(with_a_column.head.verdicts)
    assert text.count("| sum-up |\n") == rows
    assert headings_of_page(html, "verdicts")[-2:] == ["Added", "Why, and what speaks against it"]
    assert html.count('page-up <small><abbr title="&lt;hint&gt;">small</abbr></small>') == rows
    assert '<abbr title="&lt;new&gt;">Added</abbr>' in html
    # Rows that span the table span the added column as well.
    columns = len(headings_of_page(html, "verdicts"))
    assert f'<th scope="rowgroup" colspan="{columns}">' in html


def test_the_legend_has_what_every_column_means() -> None:
    faults = [{"id": "ghost", "run": 4, "activated": 3}]
    _, row, *lines = table_lines(
        fault_table([make(CaseEntry, id="a/clear", metrics={"faults": faults})])
    )
    assert row.split()[:5] == ["ghost", "on", "a/clear", "4", "3"]
    legend = " ".join(lines)
    assert all(len(line) <= 100 for line in lines)
    for meaning in ("act: it began", "manif: changed what a role read", "viol: "):
        assert meaning in legend


def test_sums_of_rows_that_are_not_shown_leave_out_what_does_not_add_up() -> None:
    record = session_record()
    cases, measures = record.head.cases, record.head.measures
    sums = {
        column.name: column.summed(cases)
        for column in shown_in(case_columns(cases, measures), Shown.PAGE)
    }
    valid, planned = (
        sum(getattr(case.metrics, key) for case in cases) for key in ("valid", "planned")
    )
    assert sums["n"] == f"{valid} / {planned}"
    assert sums["flagged"] == str(sum(case.metrics.flagged.valid for case in cases))
    assert sums["clearance time"] == sums["case"] == NO_VALUE
