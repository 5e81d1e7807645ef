"""Goals that further tables of a session bring: those of this package and of others."""

from __future__ import annotations

from collections.abc import Iterator

from pytest_dura.evidence import SessionRecord, all_tables
from pytest_dura.evidence.text import one_line
from pytest_dura.reports.gsn.element import Element, derived_id
from pytest_dura.reports.verdicts import MAX_TEXT


def table_elements(record: SessionRecord) -> Iterator[list[Element]]:
    """Yield the elements of each table that claims something, its goal first."""
    for table in all_tables():
        claims = table.claims(record.head) if table.name in record.head.conclusions else ()
        if not claims:
            continue
        top, *below = claims
        source = derived_id("Sn", table.name, what="table")
        url = f"evidence.json#/conclusions/{table.name}"
        goals = [
            Element(
                derived_id("G", table.name, claim.about, what="table"),
                one_line(claim.text, MAX_TEXT),
                supported_by=(source,) if claim.shown else (),
                undeveloped=not claim.shown,
                url=url,
                alias=f"table:{table.name}:{claim.about}",
            )
            for claim in below
        ]
        solution = Element(source, f"Table in evidence.json: {table.title}.", url=url)
        has_support = any(claim.shown for claim in below)
        yield [
            Element(
                derived_id("G", table.name, what="table"),
                one_line(top.text, MAX_TEXT),
                supported_by=tuple(goal.id for goal in goals),
                url=url,
                alias=f"table:{table.name}",
            ),
            *goals,
            *([solution] if has_support else []),
        ]
