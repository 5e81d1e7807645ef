"""Laws of the report: harmless, whole, and of the record's counts, whatever the record holds."""

from __future__ import annotations

import re

from hostile_records import hostile_records
from hypothesis import given, settings
from hypothesis import strategies as st
from report_pages import Page
from stated_counts import stated_counts

from pytest_dura.reports import anchor
from pytest_dura.reports.html import page as report

some = settings(derandomize=True, deadline=None, max_examples=8)

FILES = ("evidence.json", "manifest.json", "assurance-case.")


@some
@given(record=hostile_records())
def test_the_report_is_harmless_whole_and_of_the_records_counts(record):
    html = report.render(record)
    assert report.render(record) == html
    assert stated_counts(report, html) == record.head.totals.to_json()
    page = Page(html)
    assert page.scripts == ["javascript"] * 2
    assert page.elements["style"] == 1
    assert (page.handlers, page.sources) == ([], [])
    # To places of the page, and to files that lie beside it.
    assert all(link.startswith(("#", "./", *FILES)) for link in page.links)
    assert max(page.ids.values()) == 1
    assert {link[1:] for link in page.links if link.startswith("#")} <= set(page.ids)
    assert not re.search(
        r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u200b\u2028\u202a-\u202e\u2066-\u2069\ud800-\udfff]", html
    )
    assert len(html.encode()) < 300_000


@some
@given(
    one=st.lists(st.text(max_size=4), min_size=1, max_size=3),
    other=st.lists(st.text(max_size=4), min_size=1, max_size=3),
)
def test_anchors_of_different_parts_differ_and_hold_no_odd_character(one, other):
    assert (anchor("x", *one) == anchor("x", *other)) == (one == other)
    assert re.fullmatch(r"[A-Za-z0-9._-]+", anchor("x", *one))
