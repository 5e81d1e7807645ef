"""Strict reading: each class of failure, and nothing that is mended."""

from __future__ import annotations

import json

import pytest

from pytest_dura.llm import Answer, answer_schema, read_answer
from pytest_dura.llm.answers import LONGEST, OBSERVATIONS

SCHEMA = answer_schema(("wait", "proceed"), ("slow_down", "hold", "speed_up"))
GOOD = {
    "observations": "a car from the left",
    "threat_ids": ["V1"],
    "reasoning": "it arrives before I have crossed",
    "intent": "slow_down",
    "maneuver": "wait",
    "confidence": 75,
}


def read(text, **fields):
    return read_answer(Answer(text, **fields), SCHEMA)


def of(**changes):
    return json.dumps({**GOOD, **changes})


def test_an_answer_is_read_as_it_stands():
    reading = read("\n " + json.dumps(GOOD) + "\n")
    assert reading.answered
    assert reading.content == GOOD


@pytest.mark.parametrize("failure", ["unavailable", "timeout", "empty", "refused", "truncated"])
def test_what_failed_on_the_wire_is_not_read(failure):
    reading = read(json.dumps(GOOD), failure=failure, detail="why")
    assert (reading.outcome, reading.detail, reading.content) == (failure, "why", {})


@pytest.mark.parametrize(
    "text, outcome",
    [
        ("", "empty"),
        (" \n", "empty"),
        ("I would wait.", "malformed"),
        ("```json\n" + json.dumps(GOOD) + "\n```", "malformed"),
        (json.dumps(GOOD) + " Drive safely!", "malformed"),
        (json.dumps(GOOD)[:-1], "malformed"),
        (json.dumps(GOOD)[:-1] + ', "maneuver": "proceed"}', "malformed"),
        ("[" * 5000, "malformed"),
        ("[" * (LONGEST + 1), "malformed"),
        ("9" * 5000, "malformed"),
        (json.dumps([GOOD]), "malformed"),
        ("null", "malformed"),
        (of(observations="\ud800"), "malformed"),
        (of(confidence=float("nan")), "malformed"),
        (of(confidence=float("inf")), "malformed"),
        (of(confidence=0.5), "schema_violation"),
        (of(confidence=101), "schema_violation"),
        (of(confidence=-1), "schema_violation"),
        (of(confidence="high"), "schema_violation"),
        (of(confidence=True), "schema_violation"),
        (of(observations="x" * (OBSERVATIONS + 1)), "schema_violation"),
        (of(threat_ids=["V1"] * 4), "schema_violation"),
        (of(threat_ids="V1"), "schema_violation"),
        (of(threat_ids=["V" * 17]), "schema_violation"),
        (of(extra=1), "schema_violation"),
        (of(intent="panic"), "schema_violation"),
        (of(maneuver="Wait"), "unknown_action"),
        (of(maneuver="fly"), "unknown_action"),
        (of(maneuver=3), "schema_violation"),
        (of(maneuver="fly", intent="panic"), "schema_violation"),
        (json.dumps({"maneuver": "wait"}), "schema_violation"),
        ("{}", "schema_violation"),
    ],
)
def test_each_failure_has_its_class(text, outcome):
    reading = read(text)
    assert reading.outcome == outcome
    assert reading.content == {}
    assert 0 < len(reading.detail) <= 200


def test_every_text_of_the_schema_has_a_bound():
    for name, one in SCHEMA["properties"].items():
        if one["type"] == "string":
            assert "maxLength" in one or "enum" in one, name
    ids = SCHEMA["properties"]["threat_ids"]
    assert ids["maxItems"] == 3
    assert "maxLength" in ids["items"]


def test_the_reasoning_comes_before_the_decision():
    names = list(SCHEMA["properties"])
    assert names.index("reasoning") < names.index("intent") < names.index("maneuver")
    assert SCHEMA["required"] == names


def test_a_whole_number_may_be_written_as_a_fraction():
    assert read(of(confidence=50.0)).answered


def test_a_schema_of_any_object_takes_any_object():
    assert read_answer(Answer('{"a": [1]}'), {"type": "object"}).answered
    assert not read_answer(Answer("[1]"), {"type": "object"}).answered


CLAIM = {"id": "V1", "kind": "car", "ahead_m": 4, "arrives_s": 0.5}
CLAIMING = answer_schema(
    ("wait", "proceed"), ("slow_down", "hold", "speed_up"),
    {"kind": {"type": "string", "maxLength": 16}, "ahead_m": {"type": "number"},
     "arrives_s": {"type": "number"}},
)  # fmt: skip


@pytest.mark.parametrize(
    "claims, outcome",
    [
        ([], "answered"),
        ([CLAIM] * 4, "answered"),
        ([CLAIM | {"kind": "truck"}], "answered"),
        ([CLAIM] * 5, "schema_violation"),
        (None, "schema_violation"),
        ([{"id": "V1"}], "schema_violation"),
        ([CLAIM | {"more": 1}], "schema_violation"),
        ([CLAIM | {"ahead_m": "4"}], "schema_violation"),
        ([CLAIM | {"ahead_m": True}], "schema_violation"),
        ([CLAIM | {"id": "V" * 17}], "schema_violation"),
    ],
)
def test_claims_are_data_and_may_be_missing(claims, outcome):
    assert read_answer(Answer(of(claims=claims)), CLAIMING).outcome == outcome
    assert read_answer(Answer(json.dumps(GOOD)), CLAIMING).answered
    assert read(of(claims=[])).outcome == "schema_violation", "of a schema without them"


def test_a_number_beyond_all_numbers_is_no_claim():
    text = of(claims=[CLAIM]).replace('"ahead_m": 4', '"ahead_m": 1e999')
    assert read_answer(Answer(text), CLAIMING).outcome == "schema_violation"
