"""Answers in parts, and what a model thinks: read as if all had come at once."""

from __future__ import annotations

import json

import pytest
import scripted_server as script
from llm_servers import KEY
from server_dialects import streams

from pytest_dura.llm import Answer, Message, Request
from pytest_dura.llm.completions import split_thoughts

REQUEST = Request("m1", (Message("user", "Where?"),), stream=True)
PLAIN = Request("m1", (Message("user", "Where?"),))
BUDGET = 10.0


def events(*lines, kind="text/event-stream"):
    return script.sends("".join(f"{line}\n\n" for line in lines), kind=kind)


def part(finish=None, **delta):
    return "data: " + json.dumps({"choices": [{"delta": delta, "finish_reason": finish}]})


def test_parts_make_the_answer_that_comes_at_once(client) -> None:
    text = '{"a": "snow ☃ and more of it"}'
    one = client(
        lambda exchange: streams(exchange, text, thoughts="Hm. Well.", size=3),
        script.answers(text),
    )
    parts, whole = one.ask(REQUEST, BUDGET), one.ask(PLAIN, BUDGET)
    assert (parts.text, parts.finish, parts.usage) == (text, whole.finish, whole.usage)
    assert (parts.thoughts, parts.fingerprint, parts.failure) == ("Hm. Well.", "fp_scripted", "")
    assert one.server.requests[0].json["stream_options"] == {"include_usage": True}
    assert "stream" not in one.server.requests[1].json
    assert whole.first_token is None


def test_the_time_to_the_first_token_is_not_that_to_the_last_nor_to_the_headers(client) -> None:
    def slow(exchange):
        streams(exchange, "ab", pause=0.2, size=1)

    answer = client(slow).ask(REQUEST, BUDGET)
    assert 0.2 <= answer.first_token <= answer.seconds

    def slow_end(exchange):
        exchange.start(kind="text/event-stream")
        exchange.write(f"{part(content='a')}\n\n".encode())
        exchange.sleep(1.0)  # the client may take its time to read what came before
        exchange.write(f"{part('stop', content='b')}\n\n".encode())

    answer = client(slow_end).ask(REQUEST, BUDGET)
    assert answer.text == "ab"
    assert answer.seconds - answer.first_token >= 0.3
    assert Answer.from_json(json.loads(json.dumps(answer.to_json()))) == answer


def test_a_connection_that_stays_open_after_the_end_costs_no_time(client) -> None:
    def hang(exchange):
        streams(exchange, "whole")
        exchange.sleep(20.0)

    answer = client(hang).ask(REQUEST, BUDGET)
    assert (answer.text, answer.failure) == ("whole", "")
    assert answer.seconds < 5.0


def test_a_server_that_does_not_stream_answers_at_once(client) -> None:
    answer = client(script.answers("ok")).ask(REQUEST, BUDGET)
    assert (answer.text, answer.first_token, answer.failure) == ("ok", None, "")


@pytest.mark.parametrize(
    "lines, failure, detail",
    [
        ([part(content="a"), part(content="b")], "truncated", "the stream ends in the middle"),
        ([], "truncated", "the stream ends in the middle"),
        ([part(content="a"), 'data: {"error": {"message": "out of memory"}}'], "unavailable",
         "HTTP 200: out of memory"),
        ([part(content="a"), part("length")], "truncated", "finish_reason: length"),
        ([part(content="a"), part("content_filter")], "refused", "content_filter"),
        ([part(refusal="I "), part("stop", refusal="cannot.")], "refused", "I cannot."),
        ([part("stop")], "empty", "no text"),
        (["data: <html>"], "malformed", "an event is no JSON"),
        (["data: [1]"], "malformed", "an event is no object"),
        ([part(content=5)], "malformed", "no text"),
        (["data: " + "[" * 100_000], "malformed", "an event is no JSON"),
        (["data: [DONE]"], "truncated", "the stream ends in the middle"),
    ],
)  # fmt: skip
def test_a_stream_that_fails_has_its_class(client, lines, failure, detail) -> None:
    answer = client(events(*lines)).ask(REQUEST, BUDGET)
    assert answer.failure == failure
    assert detail in answer.detail


def test_a_stream_that_is_cut_or_late_has_its_class(client) -> None:
    def cut(exchange):
        exchange.start(kind="text/event-stream", length=9999)
        exchange.write(f"{part(content='a')}\n\n".encode())

    assert client(cut).ask(REQUEST, BUDGET).failure == "truncated"

    def dribble(exchange):
        exchange.start(kind="text/event-stream")
        while exchange.sleep(0.02):
            exchange.write(f"{part(content='a')}\n\n".encode())

    answer = client(dribble).ask(REQUEST, 0.3)
    assert (answer.failure, answer.seconds < 5.0) == ("timeout", True)


def test_a_stream_without_end_is_left(client, monkeypatch) -> None:
    monkeypatch.setattr("pytest_dura.llm.wire.LONGEST_STREAM", 50_000)

    def endless(exchange):
        exchange.start(kind="text/event-stream")
        while exchange.request.sent < 8_000_000:
            exchange.write(f"{part(content='a' * 500)}\n\n".encode())

    answer = client(endless).ask(REQUEST, BUDGET)
    assert (answer.failure, answer.detail) == ("malformed", "a stream of more than 50000 bytes")


@pytest.mark.parametrize("size", [1, 2, 3, 1000])
def test_lines_are_read_wherever_they_are_cut_and_others_than_data_are_left(client, size) -> None:
    data = ": ping\r\nevent: x\r\n" + part(content="snow ☃\u2028") + "\r\n\r\n" + part("stop")

    def cut(exchange):
        exchange.start(kind="text/event-stream")
        raw = f"{data}\n\n".encode()
        for start in range(0, len(raw), size):
            exchange.write(raw[start : start + size])

    assert client(cut).ask(REQUEST, BUDGET).text == "snow ☃\u2028"


def test_a_tool_s_arguments_come_in_parts(client) -> None:
    def call(text):
        return part(tool_calls=[{"index": 0, "function": {"arguments": text}}])

    answer = client(events(call('{"a": '), call('"b"}'), part("tool_calls"))).ask(REQUEST, BUDGET)
    assert (answer.text, answer.finish, answer.failure) == ('{"a": "b"}', "tool_calls", "")


@pytest.mark.parametrize("cut", [3, 9])
def test_a_key_in_parts_is_taken_out_of_text_and_thoughts(client, cut) -> None:
    behave = events(
        part(content=f"it is {KEY[:cut]}", reasoning=f"hm {KEY[:cut]}"),
        part("stop", content=KEY[cut:], reasoning=KEY[cut:]),
    )
    answer = client(behave).ask(REQUEST, BUDGET)
    assert (answer.text, answer.thoughts) == ("it is [key]", "hm [key]")


# What a model thinks


@pytest.mark.parametrize(
    "text, thoughts, rest",
    [
        ('{"a": 1}', "", '{"a": 1}'),
        ("<think>Hm. {}</think>\n\n{}", "Hm. {}", "{}"),
        ("\n<thinking>Hm.</thinking>{}", "Hm.", "{}"),
        ("Hm. So.\n</think>\n{}", "Hm. So.", "{}"),
        ("<think>Hm", "Hm", ""),
        ("<think></think>{}", "", "{}"),
        ('{"a": "</think>"}', "", '{"a": "</think>"}'),
        ('{"a": "<think>b</think>"}', "", '{"a": "<think>b</think>"}'),
        ("I <think> so", "", "I <think> so"),
        ("<think>a</think>{} <think>b</think>", "a", "{} <think>b</think>"),
        ("", "", ""),
    ],
)
def test_thoughts_are_parted_from_the_text(text, thoughts, rest) -> None:
    assert split_thoughts(text) == (thoughts, rest)


@pytest.mark.parametrize("field", ["reasoning_content", "reasoning"])
def test_thoughts_in_a_field_are_kept_apart(client, field) -> None:
    whole = script.completion("{}")
    whole["choices"][0]["message"][field] = " First this. "
    answer = client(script.sends(whole)).ask(PLAIN, BUDGET)
    assert (answer.text, answer.thoughts) == ("{}", "First this.")
    assert answer.to_json()["thoughts"] == "First this."


@pytest.mark.parametrize(
    "text, finish, failure",
    [("<think>Hm", "length", "truncated"), ("<think>Hm</think>", "stop", "empty"),
     ("<think>Hm", "stop", "empty")],
)  # fmt: skip
def test_thoughts_alone_are_no_answer(client, text, finish, failure) -> None:
    answer = client(script.answers(text, finish_reason=finish)).ask(PLAIN, BUDGET)
    assert (answer.failure, answer.text, answer.thoughts) == (failure, "", "Hm")


@pytest.mark.parametrize("value", [5, {"a": 1}, None, ["x"]])
def test_thoughts_that_are_no_text_are_left(client, value) -> None:
    whole = script.completion("{}")
    whole["choices"][0]["message"]["reasoning"] = value
    answer = client(script.sends(whole)).ask(PLAIN, BUDGET)
    assert (answer.text, answer.thoughts, answer.failure) == ("{}", "", "")


@pytest.mark.parametrize(
    "calls, text",
    [
        ([{"function": {"name": "answer", "arguments": '{"a": 1}'}}], '{"a": 1}'),
        ([{"function": {"name": "answer", "arguments": {"a": 1}}}], '{"a": 1}'),
        ([], "prose"), ("none", "prose"), ([5], "prose"), ([{"function": {}}], "prose"),
    ],
)  # fmt: skip
def test_the_arguments_of_a_tool_are_the_answer(client, calls, text) -> None:
    whole = script.completion("prose")
    whole["choices"][0]["message"]["tool_calls"] = calls
    assert client(script.sends(whole)).ask(PLAIN, BUDGET).text == text
