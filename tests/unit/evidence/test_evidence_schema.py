"""The schema holds for what we write, and tells what is wrong with what we did not."""

from __future__ import annotations

import copy
import json
import math
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jsonschema import Draft202012Validator
from session_records import session_record

from pytest_dura.core.codec import encode
from pytest_dura.core.mismatches import MAX_MISMATCHES, MismatchError
from pytest_dura.evidence import Baseline, SessionRecord, check_record, record_schema
from pytest_dura.evidence.schema import record_vocabulary

DOCS = Path(__file__).parents[3] / "docs"
lawful = settings(derandomize=True, deadline=None, max_examples=40)


def whole(**changes):
    return session_record(**changes).to_json()


RECORD = whole()
RECORD["episodes"] = RECORD["episodes"][1:3]
RECORD["verdicts"] = RECORD["verdicts"][1:3]


def problems(record):
    return list(map(str, check_record(record)))


def properties(part=None, path=""):
    """Each property of the schema, with its path."""
    part = record_schema() if part is None else part
    for name, one in part.get("properties", {}).items():
        yield f"{path}.{name}", one
        yield from properties(one, f"{path}.{name}")
    for key in ("items", "additionalProperties"):
        if isinstance(part.get(key), dict):
            yield from properties(part[key], f"{path}.{key}")
    for inner in part.get("anyOf", ()):
        yield from properties(inner, path)
    for name, one in part.get("$defs", {}).items():
        yield from properties(one, f"{path}.{name}")


def steps(data, path=()):
    """The path of every value below a record that its schema has a word on."""
    items = data.items() if isinstance(data, dict) else enumerate(data)
    for key, value in items:
        if path and path[-1] in OPEN:
            return
        yield (*path, key)
        if isinstance(value, (dict, list)):
            yield from steps(value, (*path, key))


OPEN = {
    "capabilities",
    "params", "world", "parameters", "data", "packages", "activation", "duration", "choice",
    "redacted", "user", "violations", "processing_us", "processing_seconds", "robustness_min",
    "sources",
}  # fmt: skip
"""Keys whose values are the user's own, or of names that are."""
OPTIONAL = {"type", "duration", "world", "path", "digest", "file_count", "files", "opaque",
            "distribution", "params", "sources", "lines"}  # fmt: skip
STEPS = [step for step in steps(RECORD) if not set(step[:-1]) & {*OPEN, "scenario"}]


def at(data, step):
    for key in step:
        data = data[key]
    return data


def test_the_schema_is_one_of_its_draft():
    Draft202012Validator.check_schema(record_schema())
    assert record_schema()["$id"] == "urn:pytest-dura:evidence:1"


def test_every_property_is_described():
    found = dict(properties())
    assert len(found) > 350
    assert [path for path, one in found.items() if len(one.get("description", "")) < 4] == []


def test_times_and_sizes_say_their_unit():
    names = ("latency", "_at", "_time", "time_to", "seconds", "horizon", "bytes", "hours")
    units = ("in s", "econds", "hour", "bytes", "null for what")
    silent = [
        path
        for path, one in properties()
        if path.rpartition(".")[2].endswith(names)
        and not any(unit in one.get("description", "") for unit in units)
    ]
    assert silent == []


def test_a_record_of_ours_is_valid():
    assert check_record(RECORD) == []


def test_a_session_that_was_killed_is_valid_too():
    gate = {"result": "incomplete", "exit_code": 3, "warn_undecided": False, "failed": 0,
            "reasons": ["killed"]}  # fmt: skip
    nothing = dict.fromkeys(("name", "distribution", "version", "digest"))
    assert check_record(
        whole(status="running", finished=None, gate=gate, component_under_test=nothing,
              cases=[], episodes=[], verdicts=[], monitors=[])
    ) == []  # fmt: skip


def test_a_baseline_is_valid(tmp_path):
    (tmp_path / "evidence.json").write_text(json.dumps(RECORD))
    baseline = Baseline.read(".", tmp_path).compared(session_record())
    assert baseline.comparisons
    assert check_record({**RECORD, "baseline": encode(baseline)}) == []


@lawful
@given(step=st.sampled_from(STEPS))
def test_a_key_that_is_gone_is_found(step):
    if isinstance(step[-1], int) or step[-1] in OPTIONAL:
        return
    broken = copy.deepcopy(RECORD)
    del at(broken, step[:-1])[step[-1]]
    if _has_free_names(step[:-1]):
        return
    (told,) = problems(broken)
    assert told.endswith(f'missing key "{step[-1]}"')
    assert told.startswith("/" + "/".join(map(str, step[:-1])))


@lawful
@given(step=st.sampled_from(STEPS), data=st.data())
def test_a_value_of_another_type_is_found(step, data):
    broken = copy.deepcopy(RECORD)
    value = at(broken, step)
    others = [one for one in ("text", 7.5, True, {"x": 1}, [None]) if not _alike(one, value)]
    if step[-3:-2] == ("rows",):  # a cell of a table is a text, a number or null
        others = [{"x": 1}, [None]]
    wrong = data.draw(st.sampled_from(others))
    if value is None:
        wrong = object()  # what may be null may be a text or a number, and nothing else
    # A measure is a truth value, a number or null.
    if step[-1] in OPEN or step[-1] == "value" or step[-3:-1] == ("outcome", "measures"):
        return
    at(broken, step[:-1])[step[-1]] = wrong
    told = problems(broken)
    assert told
    assert all(one.startswith("/" + "/".join(map(str, step[:1]))) for one in told)


@lawful
@given(step=st.sampled_from(STEPS))
def test_a_key_that_nobody_knows_is_found(step):
    parent = at(RECORD, step[:-1])
    if not isinstance(parent, dict) or _has_free_names(step[:-1]):
        return
    broken = copy.deepcopy(RECORD)
    at(broken, step[:-1])["nobody knows"] = 1
    assert any('unknown key "nobody knows"' in one for one in problems(broken))


def _alike(one, value):
    number = (int, float)
    both_numbers = isinstance(one, number) and isinstance(value, number)
    return type(one) is type(value) or (
        both_numbers and not isinstance(one, bool) and isinstance(value, float)
    )


def _has_free_names(step):
    """Whether the keys of this mapping are names, or the user's own."""
    names = {"roles", "variation", "packages", "scenario", "performance", "wall_clock"} | OPEN
    last = next((one for one in reversed(step) if isinstance(one, str)), "")
    named = last in names or (last == "faults" and ("spec" in step or "cases" in step))
    return named or step[-2:] in (("outcome", "measures"), ("metrics", "measures"))


@pytest.mark.parametrize(
    "value, kind", [(math.nan, "NaN"), (math.inf, "Infinity"), (-math.inf, "-Infinity")]
)
def test_a_number_that_json_does_not_have_is_found(value, kind):
    timings = {**RECORD["timings"], "wall_seconds": value}
    assert problems({**RECORD, "timings": timings}) == [
        f"/timings/wall_seconds: found {kind}, expected number"
    ]


def test_what_is_wrong_is_told_in_few_words():
    broken = copy.deepcopy(RECORD)
    broken["episodes"][1]["validity"] = "fine"
    broken["episodes"][1]["digest"] = "x" * 10**6
    broken["verdicts"][0]["margins"] = 3
    broken["a/b~c\n"] = 1
    broken["cases"][0]["planned"] = -1
    assert problems(broken) == [
        '/: unknown key "a/b~c\\n"',
        "/cases/0/planned: found -1, expected at least 0",
        "/verdicts/0/margins: found integer, expected object or null",
        '/episodes/1/validity: found "fine", expected "valid" or "invalid" or "missing"',
        f'/episodes/1/digest: found "{"x" * 56}..., expected a text like "^[0-9a-f]{{64}}$"',
    ]


def test_what_is_wrong_within_a_dataclass_of_the_record_has_its_place():
    broken = copy.deepcopy(RECORD)
    broken["gate"] |= {"exit_code": -1, "reasons": ["why", 3], "more": 1}
    assert problems(broken) == [
        '/gate: unknown key "more"',
        "/gate/exit_code: found -1, expected at least 0",
        "/gate/reasons/1: found integer, expected string",
    ]
    assert problems({**RECORD, "gate": None}) == ["/gate: found null, expected object"]
    with pytest.raises(MismatchError):
        SessionRecord.of({**RECORD, "gate": broken["gate"]}, DOCS)


def test_the_problems_of_a_foreign_file_are_bounded():
    assert problems([]) == ["/: found array, expected object"]
    assert len(check_record({"episodes": [{}] * 10**4})) == MAX_MISMATCHES


def test_the_words_of_a_record():
    assert {"episodes", "undecided", "violations", "complete"} <= record_vocabulary()
    assert "nobody knows" not in record_vocabulary()
