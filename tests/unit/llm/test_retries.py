"""Requests that are repeated: when, after which pause, and in whose time."""

from __future__ import annotations

import socket
import time

import pytest
import scripted_server as script
from models import said

from pytest_dura.core import ConfigurationError
from pytest_dura.llm import Answer, Message, ModelSession, Request
from pytest_dura.llm.capabilities import probe
from pytest_dura.llm.retries import LONGEST_PAUSE, Retries, retries_of, retry_after

REQUEST = Request("m1", (Message("user", "Where?"),))
BUDGET = 10.0
MONDAY = "Mon, 05 Jan 2026 10:00:00 GMT"


class Pauses(list):
    """Stands for the wait between two calls, and takes no time."""

    def __call__(self, seconds):
        self.append(seconds)


def session(client, *behaviours, most=3, pauses=None, **options):
    """A live session with a scripted server, and the pauses that it made."""
    pauses = Pauses() if pauses is None else pauses
    one = client(*behaviours, **options)

    class Server:
        model, base_url = "m1", one.server.base_url

        def ask(self, request, budget):
            return one.ask(request, budget)

        def probe(self):
            return "f", {}

        def scrub(self, text):
            return text

    made = ModelSession("live", environ={}, connect=lambda *_: Server(),
                        retries=Retries(most, pauses))  # fmt: skip
    return made, one.server, pauses


@pytest.mark.parametrize("status", [429, 503])
def test_a_server_that_is_busy_is_asked_again_after_the_time_it_names(client, status) -> None:
    busy = script.fails(status, retry_after=7)
    made, server, pauses = session(client, busy, busy, script.answers("ok"))
    answer = made.ask(REQUEST, BUDGET)
    assert (answer.text, answer.failure, answer.attempts) == ("ok", "", 3)
    assert pauses == [7.0, 7.0]
    assert len(server.requests) == 3
    assert made.counts == {
        ("m1", "f", "asked"): 1,
        ("m1", "f", "repeated"): 2,
        ("m1", "f", f"unavailable: HTTP {status}"): 2,
    }


def test_the_pause_is_that_of_a_date_by_the_server_s_own_clock(client) -> None:
    until = {"Retry-After": "Mon, 05 Jan 2026 10:00:09 GMT", "X-Date": MONDAY}

    def busy(exchange):
        handler = exchange._handler
        handler.date_time_string = lambda timestamp=None: MONDAY
        exchange.send("{}", 503, headers=until)

    made, _, pauses = session(client, busy, script.answers("ok"))
    assert made.ask(REQUEST, BUDGET).text == "ok"
    assert pauses == [9.0]


def test_without_a_time_the_pauses_grow(client) -> None:
    made, _, pauses = session(client, otherwise=script.fails(429), most=6)
    answer = made.ask(REQUEST, BUDGET)
    assert (answer.failure, answer.cause, answer.attempts) == ("unavailable", "HTTP 429", 7)
    assert pauses == [0.5, 1.0, 2.0, 4.0, 8.0, 8.0]


def test_a_connection_that_fails_is_made_again() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    started = []

    def start(seconds):
        started.append(script.ScriptedServer(script.answers("up"), port=port))

    environ = {"DURA_LLM_BASE_URL": f"http://127.0.0.1:{port}/v1", "DURA_LLM_MODEL": "m1"}
    made = ModelSession("live", environ=environ, retries=Retries(1, start))
    made.know([{"model": "m1", "base_url": environ["DURA_LLM_BASE_URL"], "fingerprint": "f",
                "capabilities": {}, "tool": "", "created": ""}])  # fmt: skip
    try:
        answer = made.ask(REQUEST, BUDGET)
    finally:
        for server in started:
            server.close()
    assert (answer.text, answer.attempts) == ("up", 2)
    assert made.counts["m1", "f", "unavailable: connection"] == 1


@pytest.mark.parametrize(
    "behaviour, failure",
    [
        (script.fails(500), "unavailable"),
        (script.fails(400), "unavailable"),
        (script.tells_an_error(), "unavailable"),
        (script.refuses(), "refused"),
        (script.answers_nothing(), "empty"),
        (script.truncates("{"), "truncated"),
        (script.sends_html(), "malformed"),
    ],
)
def test_what_the_model_or_its_server_answers_otherwise_counts(client, behaviour, failure) -> None:
    made, server, pauses = session(client, behaviour)
    answer = made.ask(REQUEST, BUDGET)
    assert (answer.failure, answer.attempts) == (failure, 1)
    assert (len(server.requests), pauses) == (1, [])


def test_nothing_is_repeated_unless_it_is_wanted(client) -> None:
    made, server, _ = session(client, script.fails(429, retry_after=1), most=0)
    answer = made.ask(REQUEST, BUDGET)
    assert (answer.failure, answer.cause, answer.retry_after) == ("unavailable", "HTTP 429", 1.0)
    assert len(server.requests) == 1
    assert ModelSession("live", environ={}).retries.most == 0


def test_a_server_that_wants_to_be_left_alone_for_long_is_left_alone(client) -> None:
    made, server, pauses = session(client, script.fails(429, retry_after=LONGEST_PAUSE + 1))
    assert made.ask(REQUEST, BUDGET).failure == "unavailable"
    assert (len(server.requests), pauses) == (1, [])


def test_pauses_are_not_the_component_s_time_unless_it_is_said(client) -> None:
    busy = script.fails(503, retry_after=0.3)
    made, _, _ = session(client, busy, script.answers("ok"), pauses=time.sleep)
    answer = made.ask(REQUEST, BUDGET)
    assert answer.waited >= 0.3 > answer.seconds
    made, _, _ = session(client, busy, script.answers("ok"), pauses=time.sleep)
    answer = made.ask(REQUEST, BUDGET, count_retries=True)
    assert BUDGET > answer.seconds > answer.waited >= 0.3


def test_pauses_that_count_end_with_the_budget(client) -> None:
    made, server, pauses = session(client, script.fails(503, retry_after=3))
    answer = made.ask(REQUEST, 2.0, count_retries=True)
    assert (answer.failure, answer.attempts) == ("unavailable", 1)
    assert (len(server.requests), pauses) == (1, [])


def test_a_call_that_is_repeated_has_what_is_left_of_the_budget_where_pauses_count(client) -> None:
    behaviours = (script.fails(503, retry_after=1.5), script.is_slow(20.0, script.answers("late")))
    made, server, _ = session(client, *behaviours, pauses=time.sleep)
    start = time.monotonic()
    answer = made.ask(REQUEST, 2.0, count_retries=True)
    assert (answer.failure, len(server.requests)) == ("timeout", 2)
    assert time.monotonic() - start < 12.0


def test_the_time_for_all_calls_holds_whatever_the_server_asks_for() -> None:
    retries = Retries(2)
    assert Retries(0).time_for(5.0) == 5.0
    assert retries.time_for(5.0) >= 3 * 5.0 + 2 * LONGEST_PAUSE
    busy = Answer(failure="unavailable", cause="HTTP 429", retry_after=LONGEST_PAUSE)
    assert [retries.pause(busy, attempts) for attempts in (1, 2, 3)] == [60.0, 60.0, None]


@pytest.mark.parametrize(
    "text, seconds",
    [
        ("0", 0.0), (" 12 ", 12.0), ("1.5", 1.5), ("-3", None), ("", None), ("soon", None),
        ("1e9", None), ("nan", None), ("9" * 20, None),
        ("Mon, 05 Jan 2026 10:01:00 GMT", 60.0), ("Mon, 05 Jan 2026 09:00:00 GMT", 0.0),
        ("Mon, 05 Jan 2026 10:01:00 +0100", 0.0), ("Mon, 99 Jan 2026 10:01:00 GMT", None),
    ],
)  # fmt: skip
def test_retry_after_is_a_number_or_a_date_or_nothing(text, seconds) -> None:
    assert retry_after({"retry-after": text, "date": MONDAY}) == seconds


def test_without_a_date_of_the_server_s_this_machine_s_clock_holds() -> None:
    assert retry_after({"retry-after": MONDAY.replace("2026", "2020")}) == 0.0
    assert retry_after({"retry-after": MONDAY.replace("2026", "2999")}) > 1e9


def test_the_environment_says_how_often() -> None:
    assert retries_of({}) == retries_of({"DURA_LLM_RETRIES": " "}) == 0
    assert retries_of({"DURA_LLM_RETRIES": " 3 "}) == 3
    assert ModelSession("live", environ={"DURA_LLM_RETRIES": "4"}).retries.most == 4


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
        (script.fails(429, retry_after=0) if busy else script.answers(content))(exchange)

    one = client(otherwise=behave)
    server = one.server
    assert probe(one, one.endpoint, 5.0).structured == "json_schema"


def test_what_a_server_was_too_busy_for_is_not_taken_for_what_it_cannot_do(client) -> None:
    def behave(exchange):
        busy = "response_format" in exchange.request.json
        (script.fails(429, retry_after=0) if busy else script.answers("sea"))(exchange)

    one = client(otherwise=behave)
    with pytest.raises(ConfigurationError, match=r"3 tries \(unavailable\): HTTP 429"):
        probe(one, one.endpoint, 5.0)


def test_a_cassette_keeps_how_often_and_why_it_failed(client, tmp_path) -> None:
    made, _, _ = session(client, script.fails(429, retry_after=0), script.answers(said()))
    recording = ModelSession(
        "record", tmp_path / "tape.sqlite", environ={}, connect=made._connect, retries=made.retries
    )
    answer = recording.ask(REQUEST, BUDGET)
    recording.close()
    replaying = ModelSession("replay", tmp_path / "tape.sqlite", environ={})
    assert replaying.ask(REQUEST, BUDGET) == answer
    assert answer.attempts == 2
    assert replaying.ask(REQUEST, BUDGET, count_retries=True).seconds > answer.seconds
