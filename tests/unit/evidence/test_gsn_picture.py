"""The picture: nothing overlaps, nothing is fetched, and it counts what it shows."""

import re
from itertools import combinations
from xml.etree import ElementTree as ET

import pytest
from session_records import REQUIREMENTS, session_record, verdict
from stated_counts import stated_counts

from pytest_dura.core.codec import encode
from pytest_dura.reports import svg
from pytest_dura.reports.gsn import svg_file
from pytest_dura.reports.gsn.drawing import COLOURS, text_width, wrap_text

SUPPORTED = verdict("SAF-1", "a/clear", ("satisfied",))
VIOLATED = verdict("SAF-1", "a/clear", ("violated",))
NAMESPACE = "{http://www.w3.org/2000/svg}"


def shapes(text):
    return [
        one.attrib for one in ET.fromstring(text).iter(f"{NAMESPACE}g") if "data-id" in one.attrib
    ]


def boxes(text):
    return [tuple(map(float, one["data-box"].split())) for one in shapes(text)]


def pages(text):
    """Left, top, width and height of each page, by its view."""
    views = ET.fromstring(text).iter(f"{NAMESPACE}view")
    return [tuple(map(float, view.get("viewBox").split())) for view in views]


def overlapping(found):
    return [
        (a, b)
        for a, b in combinations(sorted(found, key=lambda one: one[1]), 2)
        if a[0] < b[0] + b[2] and b[0] < a[0] + a[2] and a[1] < b[1] + b[3] and b[1] < a[1] + a[3]
    ]


def large(requirements, cases):
    """A record of many requirements and cases; every tenth verdict is violated."""
    given, verdicts = [], []
    for i in range(requirements):
        given.append({**encode(REQUIREMENTS["SAF-1"]), "id": f"R-{i}"})
        for j in range(cases):
            one = VIOLATED if (i * cases + j) % 10 == 0 else SUPPORTED
            verdicts.append({**one, "case": f"a/{j}", "requirement": f"R-{i}"})
    return session_record(
        requirements=given,
        verdicts=verdicts,
        coverage={"cells": [], "left_out": 0, "parameters": []},
    )


@pytest.mark.parametrize("size", [(0, 0), (3, 40), (20, 20), (90, 3)], ids=str)
def test_no_shape_overlaps_another_and_all_are_inside(size):
    record = large(*size) if size[0] else session_record()
    text = svg_file.render(record)
    found = boxes(text)
    assert overlapping(found) == []
    sheets = pages(text)
    for x, y, w, h in found:  # each on one page
        assert any(left <= x and x + w <= left + width and top <= y and y + h <= top + height
                   for left, top, width, height in sheets)  # fmt: skip
    assert stated_counts(svg_file, text) == record.head.totals.to_json()


def test_a_large_argument_is_folded_and_says_so():
    text = svg_file.render(large(90, 20))
    assert "1800 verdicts are folded by requirement." in text
    assert len(shapes(text)) < 1300
    single = [one for one in shapes(text) if one.get("data-violated") == "1"]
    assert any(one["data-id"] == "G-R-0@a/0" for one in single)  # still to be seen


def test_the_picture_stands_alone():
    text = svg_file.render(session_record())
    assert "<script" not in text
    assert re.findall(r"(?:href|src|url)\s*=|@import|url\((?!#)", text) == []
    assert set(re.findall(r"https?://[^\"]*", text)) == {svg.NAMESPACE}
    root = ET.fromstring(text)
    assert root.find(f"{NAMESPACE}title").text == "Assurance case, generated, unreviewed"
    assert "gate failed" in root.find(f"{NAMESPACE}desc").text
    assert root.get("role") == "img"


def test_each_kind_of_element_has_its_shape_and_each_relation_its_arrow():
    text = svg_file.render(session_record())
    root = ET.fromstring(text)
    outlines = {
        "Goal": "rect", "Strategy": "polygon", "Solution": "circle", "Context": "rect",
        "Assumption": "ellipse", "Justification": "ellipse", "CounterGoal": "rect",
        "CounterSolution": "circle", "Reference": "rect",
    }  # fmt: skip
    seen = set()
    for group in root.iter(f"{NAMESPACE}g"):
        if "data-id" in group.attrib:
            kind = group.get("data-kind")
            seen.add(kind)
            outline = group.find(f"{NAMESPACE}g")
            assert outline[0].tag == NAMESPACE + outlines[kind]
            marks = {one.get("class") for one in outline}
            assert ("diamond" in marks) == ("data-undeveloped" in group.attrib)
            assert ("cross" in marks) == ("data-defeated" in group.attrib)
    assert seen >= set(outlines) - {"Reference"}
    relations = {one.get("class") for one in root.iter(f"{NAMESPACE}polyline")}
    assert relations == {"supportedBy", "inContextOf", "challenges", "defeats"}


def test_pages_are_sheets_in_landscape_on_which_letters_can_be_read():
    for record in (session_record(), large(3, 40)):
        text = svg_file.render(record)
        for _, _, width, height in pages(text):
            assert width / height == pytest.approx(2**0.5, abs=0.01)
            # 9 points on a sheet of A3, 420 mm wide.
            assert 12 / width * 420 / 25.4 * 72 > 8.9
        assert "text{font:12px " in text
        assert f"page 1 of {len(pages(text))}" in text


def test_no_words_of_a_usual_session_are_cut():
    reason = "Because of what is known about it. " * 20
    requirements = [{**encode(one), "reason": reason} for one in REQUIREMENTS.values()]
    text = svg_file.render(session_record(requirements=requirements))
    words = " ".join(ET.fromstring(text).itertext()).split()
    drawn = " ".join(each.text or "" for each in ET.fromstring(text).iter(f"{NAMESPACE}text"))
    assert "…" not in words
    assert drawn.count("what is known about it.") == 20 * len(requirements)


def test_what_is_undecided_is_never_drawn_as_violated():
    undecided = verdict("SEC-1", "a/clear+ghost", ("violated", "satisfied"), planned=9)
    assert undecided["verdict"] == "undecided"
    assert undecided["counterexamples"]
    allowed = verdict("SEC-1", "a/clear", ("violated", *["satisfied"] * 19))
    for judged, is_red in ((undecided, False), (allowed, False), (VIOLATED, True)):
        root = ET.fromstring(svg_file.render(session_record(verdicts=[judged], monitors=[])))
        outlines = [
            group.find(f"{NAMESPACE}g")
            for group in root.iter(f"{NAMESPACE}g")
            if "data-id" in group.attrib
        ]
        assert any(each.get("stroke") == COLOURS["violated"] for each in outlines) == is_red
        assert any("defeats" in each.get("class") for each in outlines) == is_red
        relations = {
            each.get("class") for each in root.findall(f"{NAMESPACE}g/{NAMESPACE}polyline")
        }
        assert relations >= {"defeats" if is_red else "challenges"}
        assert ("defeats" in relations) == is_red


def test_lines_keep_their_width_and_what_is_left_out_is_told():
    for text in ("a few words of prose " * 9, "W" * 300, "path/to/" * 40, "語" * 90):
        lines = wrap_text(text, 180, 6)
        assert len(lines) <= 6
        assert all(text_width(line) <= 180 for line in lines)
        assert lines[-1].endswith("…")
    assert wrap_text("short", 180, 6) == ["short"]
