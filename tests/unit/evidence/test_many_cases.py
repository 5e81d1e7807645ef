"""Work on a record of many cases grows with their number: steps are counted, no clock is read."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from conclusions import concluded
from entries import make
from item_lines import expected
from session_records import HEADER, session_record

from pytest_dura.core.codec import encode
from pytest_dura.evidence import (
    RECORD_FILE,
    UNKNOWN_COMPONENT,
    Coverage,
    RecordBuilder,
    all_formats,
    conclude,
)
from pytest_dura.evidence.case_model import CasePlan
from pytest_dura.evidence.conclusions.cases import missing_runs, verdicts_on_cases
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.requirements.model import Requirement

SIZES = (20, 40, 80)


def steps(work: Callable[[], object]) -> int:
    """Lines of Python that run; those of a comprehension once for each of its rounds."""
    count = 0

    def trace(_frame: Any, event: str, _argument: Any) -> Any:
        nonlocal count
        count += event == "line"
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        work()
    finally:
        sys.settrace(before)
    return count


def assert_linear(build: Callable[[int], Any], work: Callable[[Any], object]) -> None:
    """Twice as many more cases take no more than twice as many more steps, and a little."""
    work(build(SIZES[0]))  # what is done once
    made = [build(size) for size in SIZES]
    few, some, many = (steps(partial(work, one)) for one in made)
    assert many - some <= 2.2 * max(0, some - few) + 0.05 * few


def requirement() -> dict[str, Any]:
    return encode(Requirement("R", "t"))


def case(number: int, component: str) -> dict[str, Any]:
    return make(
        CasePlan, id=f"a/b+f{number}", scenario="a/b", component=component,
        faults=[{"id": f"f{number}"}], requirements=["R"], planned=2,
    ).to_json()  # fmt: skip


def gathered(number: int) -> RecordBuilder:
    """A session that stopped early: half of its items were excused, and the others never ran."""
    made = RecordBuilder(HEADER)
    for one in range(number):
        name = f"t.py::test_{one}" if one % 4 == 0 else f"a/b+f{one}::R"
        made.add(expected(name, requirement(), case(one, UNKNOWN_COMPONENT)))
        if one % 2:
            made.waive(f"{name}[x]", "xfail", "known")
    return made


def test_the_record_of_a_session_that_ran_little() -> None:
    assert_linear(gathered, lambda made: made.record("interrupted"))


def many_cases(number: int) -> Any:
    """The record of the support module, with copies of its cases and verdicts under other ids."""
    found = session_record()
    head = found.head.to_json()
    (one, *_), (verdict, *_) = (
        [one for one in head["cases"] if one["id"] == "a/clear+ghost"],
        [one for one in head["verdicts"] if one["case"] == "a/clear+ghost"],
    )
    for place in range(number):
        name = f"a/clear+ghost{place}"
        faults = [{**fault, "id": f"ghost{place}"} for fault in one["faults"]]
        head["cases"].append({**one, "id": name, "faults": faults})
        item = f"{name}::{verdict['requirement']}"
        head["verdicts"].append({**verdict, "case": name, "item": item})
    whole = found.changed(**head)
    return conclude(whole, [Coverage])


@pytest.mark.parametrize("form", list(all_formats()), ids=lambda form: form.FILE)
def test_each_format_of_the_bundle(form: Any, tmp_path: Path) -> None:
    (tmp_path / RECORD_FILE).write_text("{}")  # one of them states the digest of this file
    assert_linear(lambda number: replace(many_cases(number), directory=tmp_path), form.render)


def placed(number: int) -> list[CasePlan]:
    """Cases in as many scenarios."""
    return [make(CasePlan, **case(one, "C") | {"scenario": f"a/{one}"}) for one in range(number)]


def test_coverage_of_scenarios_with_faults_of_their_own() -> None:
    """Each scenario crosses with the faults of all others: too many cells to go through."""

    def work(number: int) -> Callable[[], object]:
        cases = placed(number)
        return lambda: concluded(Coverage, cases=cases)

    most = 300  # squared, this is more than can be listed
    found = concluded(Coverage, cases=placed(most))["coverage"]
    assert len(found.cells) == most, "one for each scenario and requirement"
    assert found.left_out == most * (most + 1) - most
    assert steps(work(2 * most)) <= 2.2 * steps(work(most))


def test_missing_runs_of_a_comparison_are_those_of_both_its_cases() -> None:
    told = make(
        ItemVerdict, case="a", component="C", planned=3, pairs={"case": "a~x", "without": "x"}
    )
    found = verdicts_on_cases([told])
    for name in ("a", "a~x"):
        assert found[name, "C"] == [told]
        missing = missing_runs(make(CasePlan, id=name, planned=1), found[name, "C"], {0})
        assert missing == {"missing_runs": [1, 2], "missing_runs_total": 2}
