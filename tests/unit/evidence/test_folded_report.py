"""A report of very many cases: those that passed are counted, all others shown."""

from __future__ import annotations

import copy
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from entries import make
from session_records import session_record
from stated_counts import stated_counts

from pytest_dura.evidence import SessionRecord
from pytest_dura.evidence.case_model import ShareEntry
from pytest_dura.evidence.model import RecordHead
from pytest_dura.reports import case_anchor, contents, verdict_anchor
from pytest_dura.reports.gsn import yaml_file
from pytest_dura.reports.html.page import render

MOST = 3
NUMBER = 10
CASE, VERDICT = "a/clear+ghost", "SAF-1"


@pytest.fixture(autouse=True)
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contents, "MAX_PLAIN_CASES", MOST)


def passing(number: int, changes: Mapping[int, Any] | None = None) -> SessionRecord:
    """The record of the support module, and so many cases that passed.

    Args:
        number: How many.
        changes: By the number of a case, what to do with its case and verdict.
    """
    found = session_record()
    head = found.head.to_json()
    case = next(one for one in head["cases"] if one["id"] == CASE)
    verdict = next(one for one in head["verdicts"] if one["case"] == CASE)
    for place in range(number):
        name = f"{CASE}{place}"
        own, judged = copy.deepcopy(case), copy.deepcopy(verdict)
        own |= {
            "id": name, "requirements": [VERDICT], "missing_runs": [], "missing_runs_total": 0,
            "faults": [{**fault, "id": f"ghost{place}"} for fault in case["faults"]],
        }  # fmt: skip
        own["metrics"] |= {"invalid": 0, "missing": 0, "measures": {}}
        judged |= {
            "case": name, "item": f"{name}::{VERDICT}", "requirement": VERDICT, "waiver": None,
            "verdict": "supported", "violations": 0, "invalid": 0, "missing": 0, "attempts": [],
            "counterexamples": [], "first_uncounted": None, "pairs": None, "margin": 1.0 + place,
        }  # fmt: skip
        if changes and place in changes:
            changes[place](own, judged)
        head["cases"].append(own)
        head["verdicts"].append(judged)
        cell = {
            "requirement": VERDICT, "scenario": "a/clear", "faults": f"ghost{place}", "case": name,
            "component": own["component"], "verdict": judged["verdict"], "applies": "scenario",
        }  # fmt: skip
        head["coverage"]["cells"].append(cell)
    return replace(found, head=RecordHead.from_data(head))


def has_rows(html: str, place: int) -> set[bool]:
    """Whether a case stands in the tables of verdicts, cases and coverage."""
    name = f"{CASE}{place}"
    anchors = (verdict_anchor(VERDICT, name), case_anchor(name))
    told = [f'<(?:tr|tbody)[^>]* id="{anchor}"' for anchor in anchors] + [rf"\+ ghost{place}<"]
    return {bool(re.search(one, html)) for one in told}


def test_cases_that_passed_are_counted_beyond_the_first_ones() -> None:
    html = render(passing(NUMBER))
    assert [has_rows(html, place) for place in range(NUMBER)] == (
        [{True}] * MOST + [{False}] * (NUMBER - MOST)
    )
    left = NUMBER - MOST
    assert f"<strong>{left} cases that passed are not shown</strong>" in html
    assert f"least margin {1 + MOST}" in html, "that of the cases which have no rows"
    assert "not shown" not in render(passing(MOST))


def test_what_is_read_back_counts_them() -> None:
    shown, folded = (
        stated_counts("report.html", render(passing(MOST))),
        stated_counts("report.html", render(passing(NUMBER))),
    )
    more = NUMBER - MOST
    assert folded["supported"] == shown["supported"] + more
    assert folded["cases"] == shown["cases"] + more
    kept = ("violated", "undecided", "waived", "episodes", "invalid", "missing", "requirements")
    assert [folded[one] for one in kept] == [shown[one] for one in kept]


def verdict_with(**keys: Any) -> Any:
    return lambda _case, verdict: verdict.update(keys)


def metrics_with(**keys: Any) -> Any:
    return lambda case, _verdict: case["metrics"].update(keys)


REMARKABLE = {
    "violated": verdict_with(verdict="violated", violations=1),
    "undecided": verdict_with(verdict="undecided"),
    "a violation within its bound": verdict_with(violations=1),
    "waived": verdict_with(waiver={"kind": "xfail", "reason": "known"}),
    "an invalid episode": metrics_with(invalid=1),
    "a missing episode": metrics_with(missing=1),
    "a collision": metrics_with(measures={"collided": make(ShareEntry, run=1).to_json()}),
    "never run": lambda case, _: case.update(missing_runs=[1], missing_runs_total=1),
    "not judged": lambda case, _: case.update(requirements=[VERDICT, "PERF-1"]),
}


@pytest.mark.parametrize("change", REMARKABLE.values(), ids=REMARKABLE)
def test_whatever_speaks_against_a_case_is_shown_however_many_there_are(change: Any) -> None:
    html = render(passing(NUMBER, dict.fromkeys(range(MOST, NUMBER), change)))
    assert all(has_rows(html, place) == {True} for place in range(NUMBER))
    assert "cases that passed are not shown" not in html


def test_more_cases_that_passed_make_no_larger_page() -> None:
    few_, many = (len(render(passing(number))) for number in (NUMBER, 20 * NUMBER))
    assert many - few_ < 100, "some digits"


def test_every_link_of_the_assurance_case_leads_somewhere(tmp_path: Path) -> None:
    (tmp_path / "evidence.json").write_text("{}")
    record = replace(passing(NUMBER), directory=tmp_path)
    links = set(re.findall(r"report\.html#([\w.-]+)", yaml_file.render(record)))
    anchors = set(re.findall(r' id="([^"]+)"', render(record)))
    assert len(links) > MOST
    assert links <= anchors
