"""Part of a section: which failure modes the component's own accounts show."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pytest_dura.evidence.formats.report.gathering import Gathered
from pytest_dura.evidence.formats.report.links import Links
from pytest_dura.evidence.record.session_record import SessionRecord
from pytest_dura.evidence.views.failure_modes import (
    HEADINGS,
    NULL,
    ages,
    answers,
    by_kind,
    in_words,
    percent,
    summed,
    told,
)

Data = Mapping[str, Any]

MOST_ROWS = 500
"""Of single cases; the record has all."""


def section(record: SessionRecord, _gathered: Gathered, _links: Links) -> Data:
    """A table over all cases for each component that gave accounts, and one of single cases."""
    cases = record["cases"]
    rows = [
        {"case": case, **_row(one)}
        for case in told(cases)
        for one in by_kind(case["metrics"]["failure_modes"])
    ]
    return {
        "components": [
            {"component": component, "groups": _groups([_row(one) for one in modes])}
            for component, modes in summed(cases).items()
        ],
        "answers": list(answers(cases)),
        "ages": list(ages(cases)),
        "null": NULL,
        "rows": rows[:MOST_ROWS],
        "left_out": len(rows[MOST_ROWS:]),
    }


def _row(one: Data) -> dict[str, Any]:
    return {
        **one,
        "words": in_words(one["name"]),
        "percent": percent(one["share"]),
        "null_percent": percent(one["null_share"]),
        "at_most": percent(one.get("upper")),
    }


def _groups(rows: list[dict[str, Any]]) -> list[Data]:
    return [
        {"heading": heading, "rows": found}
        for kind, heading in HEADINGS.items()
        if (found := [row for row in rows if row["kind"] == kind])
    ]
