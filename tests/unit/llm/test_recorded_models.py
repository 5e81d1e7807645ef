"""What the record has of language models: facts of processes, and tables of them."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from session_records import session_record

from pytest_dura.core.codec import decode, encode
from pytest_dura.core.mismatches import MismatchError
from pytest_dura.evidence.conclude import conclude, contradictions
from pytest_dura.evidence.conclusions.tables import Tables
from pytest_dura.evidence.model import Fact
from pytest_dura.llm.record import CASSETTE, NAME, Cassette, Tokens, UsedModel, models_of
from pytest_dura.llm.stated import LIVE

COUNTS = st.integers(0, 10**9)
TOKENS = st.builds(Tokens, COUNTS, COUNTS, COUNTS)
USED = st.builds(
    UsedModel,
    component=st.sampled_from(["C", None]), model=st.sampled_from(["m", "n; m"]),
    about=st.just(""), base_url=st.sampled_from(["http://h/v1", None]),
    mode=st.sampled_from(["live", "replay"]), fingerprint=st.just("f" * 64),
    capabilities=st.just({"structured": "json_schema", "enforced": True}),
    prompts=st.none(), asked=COUNTS, repeated=COUNTS,
    unavailable=st.dictionaries(st.sampled_from(["HTTP 429", "connection"]), COUNTS),
    asked_tokens=TOKENS, reused=COUNTS, reused_tokens=TOKENS, injected=COUNTS, missed=COUNTS,
)  # fmt: skip
TAPE = Fact(NAME, CASSETTE, 0, encode(Cassette("dura-cassette.sqlite", "b" * 64, 42)))


def record(*facts, **changes):
    return session_record(facts=[*map(encode, facts)], conclusions={}, **changes)


@settings(derandomize=True, deadline=None, max_examples=25)
@given(st.lists(USED, max_size=4))
def test_counts_of_processes_are_summed_by_model_and_read_back_as_written(used):
    facts = [each.fact(f"gw{place}") for place, each in enumerate(used)]
    assert [decode(UsedModel, dict(fact.data)) for fact in facts] == used
    found = models_of(record(TAPE, *facts).head)
    assert {each.key for each in found} == {each.key for each in used}
    for key in ("asked", "reused", "missed"):
        assert sum(getattr(each, key) for each in found) == sum(getattr(e, key) for e in used)
    tokens = [sum(each.asked_tokens.prompt for each in models) for models in (found, used)]
    assert tokens[0] == tokens[1]
    calls = [sum(sum(each.unavailable.values()) for each in models) for models in (found, used)]
    assert calls[0] == calls[1]


def used(**changes):
    none = Tokens()
    known = UsedModel("C", "llama", "8B", "http://h/v1", "replay", "f" * 64, None, None,
                      30, 0, {}, none, 12, none, 2, 0)  # fmt: skip
    return replace(known, **changes)


def test_the_table_names_what_was_asked_and_the_lines_why_a_server_was_not_available():
    busy = used(repeated=1, unavailable={"HTTP 429": 3}, asked_tokens=Tokens(100, 20, 1))
    table = conclude(record(busy.fact("main"), TAPE), [Tables]).head.conclusions[NAME]
    assert table.rows == (
        ("C", "llama (8B)", "http://h/v1", "replay", None, 30, 1, 12, 2, 0, "3 x HTTP 429",
         "f" * 12),
    )  # fmt: skip
    assert table.lines == (
        (
            "language model llama: 31 requests to the server: 100 + 20 tokens (prompts + answers); "
            "the server counted none for 1 answer"
        ),
        "language model llama: unavailable in 3 calls (3 x HTTP 429); 1 request was repeated",
    )
    assert table.about.startswith("cassette dura-cassette.sqlite, 42 exchanges, SHA-256 bbb")


@pytest.mark.parametrize("changes", [{"asked": -1}, {"mode": "dead"}, {"more": 1}])
def test_a_fact_that_is_none_is_no_model(changes):
    fact = used().fact("main")
    with pytest.raises(MismatchError):
        models_of(record(replace(fact, data={**fact.data, **changes})).head)


def test_a_cassette_that_is_no_input_and_an_answer_of_no_live_model_are_contradictions():
    other = replace(TAPE, data={**TAPE.data, "sha256": "c" * 64})
    problems = [*contradictions(record(used().fact("main"), other))]
    assert "inputs: the cassette dura-cassette.sqlite is not among them as it was replayed" in (
        problems
    )
    cases = session_record().to_json()["cases"]
    cases[0]["repeat"] = {
        "episode": "a/clear#0", "digest": "d" * 64, "repeated_digest": None, "result": "skipped",
        "detail": "", "declared": LIVE,
    }  # fmt: skip
    said = "not repeated for the sake of a live model, and none was asked"
    for mode, contradicts in (("replay", True), ("live", False)):
        found = contradictions(record(used(mode=mode).fact("main"), TAPE, cases=cases))
        assert any(said in each for each in found) == contradicts
