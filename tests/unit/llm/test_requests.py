"""The key of a request: what was recorded is found again, and what determines an answer counts."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pytest_dura.llm import Answer, Cassette, Message, Request
from pytest_dura.llm.cassette import Exchange
from pytest_dura.llm.misses import explain_miss

REQUEST = Request(
    "m", (Message("system", "drive"), Message("user", "speed 8")), {"type": "object"},
    "json_schema", 0.0, 600, 7, 1,
)  # fmt: skip
CHANGES = {
    "temperature": {"temperature": None},
    "tokens": {"tokens": "max_completion_tokens"},
    "extra": {"extra": {"top_k": 5}},
    "stream": {"stream": True},
    "structured": {"structured": "tool"},
}


def test_requests_that_use_nothing_new_keep_the_keys_under_which_they_were_recorded() -> None:
    # Computed before requests had these parts; a cassette is worth nothing once they change.
    key = "2bae251eda3a690023a8e6134a194ad0fe4770a12e0556f06dce47b9c887bd8a"
    assert REQUEST.key("f00d") == key
    assert replace(REQUEST, tokens="max_tokens", extra={}, stream=False).key("f00d") == key
    plain = Request("m", (Message("user", "x"),))
    assert plain.key("") == "d1ad2f035d67a0bba4afda6e0d74b158819195f937f3c38d46a198979abc326e"


@pytest.mark.parametrize("name", CHANGES)
def test_what_determines_the_answer_is_in_the_key_the_cassette_and_the_miss(tmp_path, name) -> None:
    other = replace(REQUEST, **CHANGES[name])
    assert other.key("f") != REQUEST.key("f")
    cassette = Cassette(tmp_path / "tape.sqlite", writable=True)
    exchange = Exchange(other.key("f"), "f", other.to_json(), Answer("x"), "2026-01-02T03:04:05")
    cassette.add(exchange)
    assert list(cassette.exchanges()) == [exchange]
    assert f" {name} (recorded " in explain_miss(cassette, REQUEST.to_json(), "f")
    cassette.close()
