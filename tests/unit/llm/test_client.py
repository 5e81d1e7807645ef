"""The client against a scripted server on loopback: what is sent, and what comes of the answers."""

from __future__ import annotations

import json
import socket
from dataclasses import replace

import numpy as np
import pytest
import scripted_server as script
from llm_servers import KEY

from pytest_dura.llm import Answer, Endpoint, Image, Message, OpenAiClient, Request
from pytest_dura.llm.client import body_of, data_url

SCHEMA = {"type": "object", "properties": {"a": {"type": "string", "maxLength": 9}}}
REQUEST = Request("m1", (Message("system", "Be brief."), Message("user", "Where?")))
BUDGET = 10.0


def sent(client, **changes):
    """The body that goes out for a request with these parts."""
    one = client(script.answers("ok"))
    given = {"model": "m1", "messages": REQUEST.messages, **changes}
    assert one.ask(Request(**given), BUDGET).failure == ""
    (request,) = one.server.requests
    assert request.path == "/v1/chat/completions"
    return request.json


# What is sent


def test_texts_are_sent_as_plain_texts_and_nothing_is_sent_that_was_not_asked_for(client) -> None:
    assert sent(client, max_tokens=55) == {
        "model": "m1",
        "messages": [
            {"role": "system", "content": "Be brief."},
            {"role": "user", "content": "Where?"},
        ],
        "temperature": 0.0,
        "max_tokens": 55,
    }
    found = sent(client, seed=0, temperature=0.7)
    assert (found["seed"], found["temperature"]) == (0, 0.7)


@pytest.mark.parametrize(
    "level, expected",
    [
        (
            "json_schema",
            {
                "type": "json_schema",
                "json_schema": {"name": "answer", "strict": True, "schema": SCHEMA},
            },
        ),
        ("json_object_schema", {"type": "json_object", "schema": SCHEMA}),
        ("json_object", {"type": "json_object"}),
        ("none", None),
    ],
)
def test_each_level_of_structure_is_asked_for_in_its_own_way(client, level, expected) -> None:
    found = sent(client, schema=SCHEMA, structured=level)
    assert found.get("response_format") == expected
    assert ("response_format" in found) == (expected is not None)


def test_pictures_come_before_the_text_as_they_are(client) -> None:
    pixels = np.random.default_rng(1).integers(0, 256, (7, 5, 3), dtype=np.uint8)
    images = (Image("camera_front", pixels), Image("camera_rear", 255 - pixels))
    found = sent(client, messages=(Message("user", "What is it?", images),))
    (message,) = found["messages"]
    *shown, text = message["content"]
    assert text == {"type": "text", "text": "What is it?"}
    # That every pixel arrives in such an URL is a law of ``test_llm_client``.
    assert [part["image_url"]["url"] for part in shown] == [data_url(image) for image in images]
    assert {part["type"] for part in shown} == {"image_url"}


def test_fields_are_left_out_and_added_as_the_request_says() -> None:
    usual = {"model": "m1", "messages": body_of(REQUEST)["messages"]}
    assert body_of(replace(REQUEST, temperature=None, tokens="none")) == usual
    body = body_of(replace(REQUEST, tokens="max_completion_tokens", extra={"top_k": 5}))
    assert body == {**usual, "temperature": 0.0, "max_completion_tokens": 700, "top_k": 5}


def test_a_tool_is_offered_that_has_to_be_called(client) -> None:
    body = sent(client, schema=SCHEMA, structured="tool")
    (tool,) = body["tools"]
    assert tool["function"]["parameters"] == SCHEMA
    assert body["tool_choice"]["function"] == {"name": tool["function"]["name"]}
    assert "response_format" not in body


def test_the_environment_changes_nothing(client, monkeypatch, tmp_path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as proxy:
        address = f"http://127.0.0.1:{proxy.getsockname()[1]}"
        for name in ("HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY", "http_proxy", "all_proxy"):
            monkeypatch.setenv(name, address)
        for name in ("NO_PROXY", "no_proxy"):
            monkeypatch.delenv(name, raising=False)
        (tmp_path / "netrc").write_text("machine 127.0.0.1 login me password from-netrc\n")
        monkeypatch.setenv("NETRC", str(tmp_path / "netrc"))
        monkeypatch.setenv("OPENAI_API_KEY", "sk-from-environment")
        monkeypatch.setenv("OPENAI_ADMIN_KEY", "sk-admin")
        monkeypatch.setenv("OPENAI_ORG_ID", "org-surprise")
        monkeypatch.setenv("OPENAI_PROJECT_ID", "project-surprise")
        monkeypatch.setenv("OPENAI_BASE_URL", address)
        monkeypatch.setenv("OPENAI_CUSTOM_HEADERS", "Authorization: Bearer x\nX-Surprise: 1")
        one = client(script.answers("ok"))
        assert one.ask(REQUEST, BUDGET).text == "ok"
        (request,) = one.server.requests
    assert request.headers.pop("content-length") == str(len(request.body))
    assert request.headers.pop("user-agent") == "pytest-dura"
    assert request.headers == {
        "host": one.server.base_url.removeprefix("http://").removesuffix("/v1"),
        "accept": "application/json",
        "accept-encoding": "identity",
        "authorization": f"Bearer {KEY}",
        "content-type": "application/json",
    }


def test_nothing_is_kept_from_one_request_to_the_next(client) -> None:
    cookie = {"Set-Cookie": "session=1; Path=/"}
    one = client(script.sends(script.completion("a"), headers=cookie), script.answers("b"))
    assert [one.ask(REQUEST, BUDGET).text for _ in range(2)] == ["a", "b"]
    assert "cookie" not in one.server.requests[1].headers


# What comes of it


def test_an_answer_is_told_with_its_usage_and_the_server_s_word(client) -> None:
    usage = {"prompt_tokens": 3, "completion_tokens": 4, "total_tokens": 7, "cost": 0.2}
    answer = client(script.answers("Here. ☃", usage=usage)).ask(REQUEST, BUDGET)
    assert 0.0 < answer.seconds < BUDGET
    assert Answer.from_json(json.loads(json.dumps(answer.to_json()))) == answer
    assert answer == Answer(
        "Here. ☃",
        seconds=answer.seconds,
        finish="stop",
        usage={"prompt_tokens": 3, "completion_tokens": 4, "total_tokens": 7},
        fingerprint="fp_scripted",
    )


def test_usage_is_counted_in_whole_tokens(client) -> None:
    usage = {"prompt_tokens": 3.5, "completion_tokens": True, "total_tokens": 7}
    assert client(script.answers("x", usage=usage)).ask(REQUEST, BUDGET).usage == {
        "total_tokens": 7
    }


def choice(**message):
    return {"choices": [{"message": message, "finish_reason": "stop"}]}


CLASSES = {
    "status 400": (script.fails(400), "unavailable", "HTTP 400: scripted failure"),
    "status 429": (script.fails(429, retry_after=1), "unavailable", "HTTP 429: scripted failure"),
    "status 500": (script.fails(500), "unavailable", "HTTP 500: scripted failure"),
    "status 503 in plain text": (script.sends("Loading model\n", 503), "unavailable",
                                 "HTTP 503: Loading model"),
    "status 502 without a word": (script.sends("", 502), "unavailable", "HTTP 502: Bad Gateway"),
    "status 599": (script.sends("", 599), "unavailable", "HTTP 599: an error without words"),
    "status 422 as FastAPI": (script.sends({"detail": [{"loc": ["seed"]}]}, 422), "unavailable",
                              'HTTP 422: [{"loc": ["seed"]}]'),
    "status 400 by a filter": (
        script.sends({"error": {"message": "Filtered", "code": "content_filter"}}, 400),
        "refused", "HTTP 400: Filtered (content_filter)"),
    "an error with status 200": (script.tells_an_error(), "unavailable",
                                 "HTTP 200: the model is overloaded (server_error)"),
    "an error as text": (script.sends({"error": "no such model"}), "unavailable",
                         "HTTP 200: no such model"),
    "an error as vLLM": (script.sends({"object": "error", "message": "too long", "code": 400}),
                         "unavailable", "HTTP 200: too long"),
    "reset before the headers": (script.resets(), "unavailable", "ReadError: "),
    "reset in the body": (script.resets(after_headers=True), "truncated", "ends in the middle"),
    "cut": (script.cuts("a long answer", after=40), "truncated", "ends in the middle"),
    "cut without a length": (
        lambda exchange: (exchange.start(), exchange.write(b'{"choices": [{"mess')),
        "truncated", "ends in the middle, at byte 19"),
    "cut after a brace": (script.sends('{"choices": [{"message": {"content": "{}'), "truncated",
                          "ends in the middle"),
    "at the limit": (script.truncates("so far"), "truncated", "finish_reason: length"),
    "at the limit without text": (script.truncates(""), "truncated", "finish_reason: length"),
    "no text": (script.answers_nothing(), "empty", "finish_reason: stop"),
    "null": (script.answers_nothing(None), "empty", "finish_reason: stop"),
    "blanks": (script.answers_nothing(" \n"), "empty", "finish_reason: stop"),
    "no choices": (script.has_no_choices(), "empty", "no choices"),
    "null choices": (script.sends({"choices": None}), "empty", "no choices"),
    "no body": (script.sends(""), "empty", "body of the response is empty"),
    "a refusal": (script.refuses("I will not."), "refused", "refusal: I will not."),
    "a filter": (script.answers("I", finish_reason="content_filter"), "refused", "content_filter"),
    "no message": (script.sends({"choices": [{}]}), "malformed", "no message"),
    "a choice that is none": (script.sends({"choices": [None]}), "malformed", "no message"),
    "content that is no text": (script.sends(choice(content=[1])), "malformed", "is no text"),
    "wrong types": (script.has_wrong_types(), "malformed", "choices is no list"),
    "another object": (script.sends({"status": "ok"}), "malformed", "it has no choices"),
    "a list": (script.sends([1]), "malformed", "no object: list"),
    "HTML": (script.sends_html(), "malformed", "<!doctype html>"),
    "garbage": (script.sends_garbage(), "malformed", "no text in UTF-8"),
    "not a number": (script.sends('{"choices": NaN}'), "malformed", "NaN is no number"),
    "endless digits": (script.sends('{"choices": ' + "9" * 5000 + "}"), "malformed", "no JSON"),
    "endless nesting": (script.sends('{"a":' * 100_000), "malformed", "no JSON"),
    "a stream": (script.sends('data: {"choices": []}\n\n'), "malformed", "no JSON: data:"),
}  # fmt: skip


@pytest.mark.parametrize("name", CLASSES)
def test_every_failure_has_its_class_and_is_asked_for_once(client, name) -> None:
    behaviour, failure, detail = CLASSES[name]
    one = client(behaviour)
    answer = one.ask(REQUEST, BUDGET)
    assert (answer.failure, len(one.server.requests)) == (failure, 1)
    assert detail in answer.detail
    assert answer.detail.isprintable()
    assert len(answer.detail) <= 300


def test_text_before_a_limit_is_kept_and_bounded(client) -> None:
    one = client(script.truncates("so far"), script.answers("x" * 70_000))
    assert one.ask(REQUEST, BUDGET).text == "so far"
    long = one.ask(REQUEST, BUDGET)
    assert (len(long.text), long.failure) == (64_000, "truncated")


def test_half_characters_are_replaced_so_that_every_answer_can_be_written(client) -> None:
    body = b'{"choices": [{"message": {"content": "a\\ud800b \\ud83d\\ude00"}}]}'
    answer = client(script.sends(body)).ask(REQUEST, BUDGET)
    assert answer.text == "a�b \N{GRINNING FACE}"
    answer.text.encode()


def test_what_a_server_says_of_an_error_acts_on_no_terminal(client) -> None:
    answer = client(script.fails(500, "a\x1b[31m\r\nb\u202e" + "x" * 999)).ask(REQUEST, BUDGET)
    assert answer.detail.startswith("HTTP 500: a [31m b x")
    assert len(answer.detail) == 300


def test_no_connection_is_unavailable() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    for host in ("127.0.0.1", "localhost"):
        answer = OpenAiClient(Endpoint(f"http://{host}:{port}/v1", "m")).ask(REQUEST, BUDGET)
        assert (answer.failure, "refused" in answer.detail) == ("unavailable", True)


def test_a_server_without_tls_is_unavailable_over_https(client) -> None:
    one = client(otherwise=script.answers("ok"))
    secure = one.server.base_url.replace("http:", "https:")
    answer = OpenAiClient(Endpoint(secure, "m", KEY)).ask(REQUEST, BUDGET)
    assert (answer.failure, "SSL" in answer.detail) == ("unavailable", True)


def test_a_redirect_is_not_followed_and_takes_the_key_nowhere(client) -> None:
    elsewhere = client(otherwise=script.answers("caught"))
    headers = {"Location": f"{elsewhere.server.base_url}/chat/completions"}
    for status in (301, 302, 307, 308):
        answer = client(script.sends("", status, headers=headers)).ask(REQUEST, BUDGET)
        assert answer.failure == "unavailable"
        assert answer.detail.startswith(f"HTTP {status}: ")
    assert elsewhere.server.requests == []


def test_the_key_is_taken_out_of_all_that_comes_back(client) -> None:
    leaky = {
        **script.completion(f"key {KEY}", finish_reason=f"stop {KEY}"),
        "system_fingerprint": KEY,
    }
    one = client(script.echoes_the_key(), script.sends(leaky),
                 script.fails(500, "y" * 282 + KEY), script.sends(f"<p>{KEY}"),
                 script.refuses("y" * 282 + KEY), script.answers("x" * 63_990 + KEY))  # fmt: skip
    answers = [one.ask(REQUEST, BUDGET) for _ in range(6)]
    assert "HTTP 401: Incorrect API key provided: Bearer [key]" in answers[0].detail
    assert answers[1].text == "key [key]"
    assert "yyy[key]" in answers[2].detail
    for answer in answers:
        assert KEY[:6] not in json.dumps(answer.to_json()), "cut keys are keys, too"
