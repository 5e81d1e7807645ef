"""Laws of reading an answer: any text has an outcome, and only what keeps to the schema is one."""

from __future__ import annotations

import json

from hypothesis import given, settings
from hypothesis import strategies as st
from jsonschema import Draft202012Validator

from pytest_dura.llm import Answer, answer_schema, read_answer
from pytest_dura.llm.answers import OUTCOMES

SCHEMA = answer_schema(("wait", "proceed"), ("slow_down", "hold", "speed_up"))
JSON = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner),
    max_leaves=8,
)
NEARLY = st.fixed_dictionaries(
    {
        "observations": st.text(max_size=170) | JSON,
        "threat_ids": st.lists(st.text(max_size=4), max_size=4) | JSON,
        "reasoning": st.text(max_size=20),
        "intent": st.sampled_from(["slow_down", "hold", "speed_up", "panic"]),
        "maneuver": st.sampled_from(["wait", "proceed", "fly"]) | JSON,
        "confidence": st.floats() | st.integers(-1, 101),
    }
)
TEXTS = st.text(max_size=50) | JSON.map(json.dumps) | NEARLY.map(json.dumps)


@settings(derandomize=True, deadline=None, max_examples=200)
@given(text=TEXTS)
def test_any_text_has_one_outcome(text):
    reading = read_answer(Answer(text), SCHEMA)
    assert reading.outcome in OUTCOMES
    assert reading.answered == bool(reading.content)
    assert reading.answered or reading.detail


@settings(derandomize=True, deadline=None, max_examples=200)
@given(said=NEARLY)
def test_what_was_answered_keeps_to_the_schema(said):
    reading = read_answer(Answer(json.dumps(said)), SCHEMA)
    finite = all(abs(one) < float("inf") for one in [said["confidence"]])
    if reading.answered:
        assert Draft202012Validator(SCHEMA).is_valid(said)
        assert reading.content == said
    elif finite and Draft202012Validator(SCHEMA).is_valid(said):
        # What JSON can say and UTF-8 cannot.
        assert any(
            "\ud800" <= letter <= "\udfff" for letter in json.dumps(said, ensure_ascii=False)
        )


GOOD = {
    "observations": "clear",
    "threat_ids": ["V1"],
    "reasoning": "nothing ahead",
    "intent": "hold",
    "maneuver": "proceed",
    "confidence": 50,
}


@settings(derandomize=True, deadline=None, max_examples=60)
@given(key=st.sampled_from(sorted(GOOD)), place=st.integers(0, len(GOOD)), value=st.none() | JSON)
def test_an_answer_that_says_something_twice_says_nothing(key, place, value):
    """Whether both agree or not, and wherever the repeated key stands."""
    pairs = list(GOOD.items())
    assert read_answer(Answer(_object(pairs)), SCHEMA).answered
    repeated = GOOD[key] if value is None else value
    pairs.insert(place, (key, repeated))
    assert read_answer(Answer(_object(pairs)), SCHEMA).outcome == "malformed"


def _object(pairs):
    return "{" + ", ".join(f"{json.dumps(key)}: {json.dumps(value)}" for key, value in pairs) + "}"


CLAIM = {"kind": {"type": "string", "maxLength": 16}, "ahead_m": {"type": "number"}}
CLAIMING = answer_schema(("wait", "proceed"), ("slow_down", "hold", "speed_up"), CLAIM)
CLAIMS = st.lists(
    st.fixed_dictionaries(
        {"id": st.text(max_size=17), "kind": st.sampled_from(["car", "truck", 5])},
        optional={"ahead_m": st.integers() | st.floats(allow_nan=False), "more": JSON},
    ),
    max_size=5,
)


@settings(derandomize=True, deadline=None, max_examples=200)
@given(said=NEARLY, claims=st.none() | CLAIMS)
def test_claims_keep_to_the_schema_or_are_missing(said, claims):
    """The answer is read as it would be without them, as long as they keep to it."""
    given_claims = {} if claims is None else {"claims": claims}
    text = json.dumps({**said, **given_claims})
    reading = read_answer(Answer(text), CLAIMING)
    alone = read_answer(Answer(json.dumps(said)), SCHEMA)
    if "Infinity" in text or not alone.answered:
        assert not reading.answered
        return
    part = CLAIMING["properties"]["claims"]
    assert reading.answered == (claims is None or Draft202012Validator(part).is_valid(claims))
