"""Requests that are repeated by the SDK: when, how often, in whose time, and what is counted."""

from __future__ import annotations

import socket
import threading
import time
from email.utils import formatdate

import pytest
import scripted_server as script
from models import said

from pytest_dura.core import ConfigurationError
from pytest_dura.llm import Message, ModelSession, Request
from pytest_dura.llm.capabilities import probe
from pytest_dura.llm.endpoint import retries_of
from pytest_dura.llm.port import LONGEST_PAUSE, Repeats

REQUEST = Request("m1", (Message("user", "Where?"),))
BUDGET = 10.0


def session(client, *behaviours, most=3, **options):
    """A live session with a scripted server."""
    one = client(*behaviours, **options)

    class Server:
        model, base_url = "m1", one.server.base_url

        def ask(self, request, budget, repeats):
            return one.ask(request, budget, repeats=repeats)

        def probe(self):
            return "f", {}

        def scrub(self, text):
            return text

    made = ModelSession("live", environ={}, connect=lambda *_: Server(), retries=most)
    return made, one.server


def dated(exchange):
    """A server that is busy for a second or two, by a date."""
    exchange.send("{}", 503, headers={"Retry-After": formatdate(time.time() + 2, usegmt=True)})


@pytest.mark.parametrize("status", [429, 503])
def test_a_server_that_is_busy_is_asked_again_after_the_time_it_names(client, status) -> None:
    busy = script.fails(status, retry_after=0.2)
    made, server = session(client, busy, busy, script.answers("ok"))
    begun = time.monotonic()
    answer = made.ask(REQUEST, BUDGET)
    assert (answer.text, answer.failure, answer.attempts) == ("ok", "", 3)
    assert 0.4 <= answer.waited <= time.monotonic() - begun < 5.0
    assert len(server.requests) == 3
    assert made.counts == {
        ("m1", "f", "asked"): 1,
        ("m1", "f", "repeated"): 2,
        ("m1", "f", f"unavailable: HTTP {status}"): 2,
    }


def test_the_pause_may_be_a_date(client) -> None:
    made, _ = session(client, dated, script.answers("ok"))
    answer = made.ask(REQUEST, BUDGET)
    assert (answer.text, answer.attempts) == ("ok", 2)
    assert answer.waited > 0.5


def test_a_server_that_stays_busy_is_unavailable_and_each_call_is_counted(client) -> None:
    made, server = session(client, otherwise=script.fails(429, retry_after=0.01), most=2)
    answer = made.ask(REQUEST, BUDGET)
    assert (answer.failure, answer.cause, answer.attempts) == ("unavailable", "HTTP 429", 3)
    assert len(server.requests) == made.counts["m1", "f", "unavailable: HTTP 429"] == 3


def test_a_connection_that_fails_is_made_again() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    environ = {"DURA_LLM_BASE_URL": f"http://127.0.0.1:{port}/v1", "DURA_LLM_MODEL": "m1"}
    made = ModelSession("live", environ=environ, retries=5)
    made.know([{"model": "m1", "base_url": environ["DURA_LLM_BASE_URL"], "fingerprint": "f",
                "capabilities": {}, "tool": "", "created": ""}])  # fmt: skip
    started = []

    def start_after_a_failure():
        while not made.counts["m1", "f", "unavailable: connection"]:
            time.sleep(0.01)
        started.append(script.ScriptedServer(script.answers("up"), port=port))

    start = threading.Thread(target=start_after_a_failure, daemon=True)
    start.start()
    try:
        answer = made.ask(REQUEST, BUDGET)
    finally:
        start.join(10.0)
        for server in started:
            server.close()
    assert (answer.text, answer.failure) == ("up", "")
    assert made.counts["m1", "f", "unavailable: connection"] == answer.attempts - 1 >= 1


@pytest.mark.parametrize(
    "behaviour, failure",
    [
        (script.fails(500), "unavailable"),
        (script.fails(400), "unavailable"),
        (script.fails(408), "unavailable"),
        (script.tells_an_error(), "unavailable"),
        (script.refuses(), "refused"),
        (script.answers_nothing(), "empty"),
        (script.truncates("{"), "truncated"),
        (script.sends_html(), "malformed"),
        (script.resets(after_headers=True), "truncated"),
        (script.is_slow(20.0, script.answers("late")), "timeout"),
    ],
)
def test_what_the_model_or_its_server_answers_otherwise_counts(client, behaviour, failure) -> None:
    made, server = session(client, behaviour)
    answer = made.ask(REQUEST, 0.5 if failure == "timeout" else BUDGET)
    assert (answer.failure, answer.attempts) == (failure, 1)
    time.sleep(1.5 if failure == "timeout" else 0.0)  # the SDK would have asked again by now
    assert len(server.requests) == 1


def test_nothing_is_repeated_unless_it_is_wanted(client) -> None:
    made, server = session(client, script.fails(429, retry_after=1), most=0)
    answer = made.ask(REQUEST, BUDGET)
    assert (answer.failure, answer.cause, answer.retry_after) == ("unavailable", "HTTP 429", 1.0)
    assert len(server.requests) == 1
    assert ModelSession("live", environ={}).retries == 0


def test_a_server_that_wants_to_be_left_alone_for_long_is_left_alone(client) -> None:
    made, server = session(client, script.fails(429, retry_after=LONGEST_PAUSE + 1))
    assert made.ask(REQUEST, BUDGET).failure == "unavailable"
    assert len(server.requests) == 1


def test_pauses_are_not_the_component_s_time_unless_it_is_said(client) -> None:
    busy = script.fails(503, retry_after=0.3)
    made, _ = session(client, busy, script.answers("ok"))
    answer = made.ask(REQUEST, BUDGET)
    assert answer.waited >= 0.3 > answer.seconds
    made, _ = session(client, busy, script.answers("ok"))
    answer = made.ask(REQUEST, BUDGET, count_retries=True)
    assert BUDGET > answer.seconds > answer.waited >= 0.3


def test_a_pause_that_is_longer_than_the_budget_is_no_time_out_where_it_does_not_count(
    client,
) -> None:
    made, _ = session(client, script.fails(503, retry_after=1.0), script.answers("ok"))
    assert made.ask(REQUEST, 0.5).text == "ok"


def test_a_request_that_is_repeated_keeps_to_its_budget(client) -> None:
    late = script.is_slow(20.0, script.answers("late"))
    made, _ = session(client, script.fails(503, retry_after=0.01), late)
    begun = time.monotonic()
    answer = made.ask(REQUEST, 0.5)
    assert (answer.failure, answer.attempts) == ("timeout", 2)
    assert time.monotonic() - begun < 8.0


@pytest.mark.parametrize("busy", [script.fails(503, retry_after=3), dated])
def test_pauses_that_count_end_with_the_budget(client, busy) -> None:
    made, server = session(client, busy)
    answer = made.ask(REQUEST, 0.5, count_retries=True)
    assert (answer.failure, answer.cause, answer.attempts) == ("unavailable", "HTTP 503", 1)
    assert len(server.requests) == 1


def test_a_call_that_is_repeated_has_what_is_left_of_the_budget_where_pauses_count(client) -> None:
    behaviours = (script.fails(503, retry_after=1.5), script.is_slow(20.0, script.answers("late")))
    made, server = session(client, *behaviours)
    start = time.monotonic()
    answer = made.ask(REQUEST, 2.0, count_retries=True)
    assert (answer.failure, len(server.requests)) == ("timeout", 2)
    assert time.monotonic() - start < 12.0


def test_the_time_for_all_calls_holds_whatever_the_server_asks_for() -> None:
    assert Repeats(0).time_for(5.0) == Repeats(3, counted=True).time_for(5.0) == 5.0
    assert Repeats(2).time_for(5.0) >= 3 * 5.0 + 2 * LONGEST_PAUSE


def test_the_environment_says_how_often() -> None:
    assert retries_of({}) == retries_of({"DURA_LLM_RETRIES": " "}) == 0
    assert retries_of({"DURA_LLM_RETRIES": " 3 "}) == 3
    assert ModelSession("live", environ={"DURA_LLM_RETRIES": "4"}).retries == 4


@pytest.mark.parametrize("text", ["-1", "many", "21", "1.5", "\u0663", "9" * 5000])
def test_a_number_of_retries_that_is_none_is_refused(text) -> None:
    with pytest.raises(ConfigurationError, match="0 to 20") as caught:
        ModelSession("live", environ={"DURA_LLM_RETRIES": text})
    assert caught.value.key == "DURA_LLM_RETRIES"


def test_a_server_that_is_busy_during_the_probe_can_what_it_can(client) -> None:
    def behave(exchange):
        structured = "response_format" in exchange.request.json
        busy = structured and len(server.requests) % 2
        content = '{"words": [], "sentence": "The sea.", "mood": "calm"}' if structured else "sea"
        (script.fails(429, retry_after=0.01) if busy else script.answers(content))(exchange)

    one = client(otherwise=behave)
    server = one.server
    found = probe(one, one.endpoint, 5.0)
    assert found.structured == "json_schema"
    assert found.requests == len(server.requests) + 1, "the list of models is one, too"


def test_what_a_server_was_too_busy_for_is_not_taken_for_what_it_cannot_do(client) -> None:
    def behave(exchange):
        busy = "response_format" in exchange.request.json
        (script.fails(429, retry_after=0.01) if busy else script.answers("sea"))(exchange)

    one = client(otherwise=behave)
    with pytest.raises(ConfigurationError, match=r"3 tries \(unavailable\): HTTP 429"):
        probe(one, one.endpoint, 5.0)


def test_a_cassette_keeps_how_often_and_why_it_failed(client, tmp_path) -> None:
    busy = script.fails(429, retry_after=0.01)
    made, _ = session(client, busy, script.answers(said()))
    recording = ModelSession(
        "record", tmp_path / "tape.sqlite", environ={}, connect=made._connect, retries=3
    )
    answer = recording.ask(REQUEST, BUDGET)
    recording.close()
    replaying = ModelSession("replay", tmp_path / "tape.sqlite", environ={})
    assert replaying.ask(REQUEST, BUDGET) == answer
    assert answer.attempts == 2
    assert replaying.ask(REQUEST, BUDGET, count_retries=True).seconds > answer.seconds
