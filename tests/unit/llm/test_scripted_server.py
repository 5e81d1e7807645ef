from __future__ import annotations

import http.client
import json
import threading
import time

import openai
import pytest
import scripted_server as scripted
from scripted_server import ScriptedServer

MESSAGES = [{"role": "user", "content": "V1 gap 3 m"}]


def client_of(server, *, timeout=5.0, key="sk-secret"):
    return openai.OpenAI(base_url=server.base_url, api_key=key, max_retries=0, timeout=timeout)


def ask(server, **options):
    with client_of(server, **options) as client:
        return client.chat.completions.create(model="m", messages=MESSAGES, temperature=0)


def raw(server, limit=None):
    """Status, headers and body without the SDK; errors of the connection come through."""
    host, port = server.base_url.split("/")[2].split(":")
    connection = http.client.HTTPConnection(host, int(port), timeout=5)
    try:
        connection.request("POST", "/v1/chat/completions", json.dumps({"messages": MESSAGES}))
        response = connection.getresponse()
        return response.status, response.headers, response.read(limit)
    finally:
        connection.close()


def raw_json(server):
    return json.loads(raw(server)[2])


def test_answers_come_in_order_and_requests_are_recorded(scripted_server):
    server = scripted_server(scripted.answers("one"), scripted.answers({"intent": "hold"}))
    server.then(scripted.answers_by(lambda request: request.prompt.upper()))
    texts = [ask(server).choices[0].message.content for _ in range(3)]
    assert texts == ["one", '{"intent": "hold"}', "V1 GAP 3 M"]
    assert len(server.requests) == 3
    request = server.requests[0]
    assert (request.method, request.path) == ("POST", "/v1/chat/completions")
    assert request.headers["authorization"] == "Bearer sk-secret"
    assert request.json["messages"] == MESSAGES
    assert request.json["temperature"] == 0
    assert request.sent > 100
    assert not request.abandoned


def test_what_is_not_scripted_goes_to_otherwise_or_is_told_at_the_end():
    with ScriptedServer(scripted.answers("a"), otherwise=scripted.answers("b")) as server:
        assert [ask(server).choices[0].message.content for _ in range(3)] == ["a", "b", "b"]

    def forgetful():
        with ScriptedServer() as server, pytest.raises(openai.InternalServerError):
            ask(server)

    with pytest.raises(AssertionError, match=r"nothing was scripted for .*POST /v1/chat"):
        forgetful()


def test_the_models_are_listed_without_a_script(scripted_server):
    with client_of(scripted_server()) as client:
        assert [model.id for model in client.models.list()] == [scripted.MODEL]


def test_empty_refused_and_truncated_answers(scripted_server):
    server = scripted_server(
        scripted.answers_nothing(),
        scripted.answers_nothing(None),
        scripted.refuses("no"),
        scripted.truncates('{"a'),
    )
    empty, null, refused, truncated = (ask(server).choices[0] for _ in range(4))
    assert empty.message.content == ""
    assert null.message.content is None
    assert (refused.message.content, refused.message.refusal) == (None, "no")
    assert (truncated.message.content, truncated.finish_reason) == ('{"a', "length")


@pytest.mark.parametrize(
    "status, error",
    [
        (401, openai.AuthenticationError),
        (404, openai.NotFoundError),
        (429, openai.RateLimitError),
        (500, openai.InternalServerError),
    ],
)
def test_errors_have_their_status_and_message(scripted_server, status, error):
    server = scripted_server(scripted.fails(status, "because", retry_after=7))
    with pytest.raises(error, match="because") as caught:
        ask(server)
    assert caught.value.status_code == status
    assert caught.value.response.headers["retry-after"] == "7"
    assert len(server.requests) == 1


def test_an_error_can_repeat_the_key(scripted_server):
    with pytest.raises(openai.AuthenticationError, match="Bearer sk-secret"):
        ask(scripted_server(scripted.echoes_the_key()))


def test_success_without_an_answer(scripted_server):
    server = scripted_server(
        scripted.tells_an_error("overloaded"), scripted.has_no_choices(), scripted.has_wrong_types()
    )
    error, none, wrong = (raw_json(server) for _ in range(3))
    assert error["error"]["message"] == "overloaded"
    assert "choices" not in error
    assert none["choices"] == []
    assert isinstance(wrong["choices"], str)


def test_bodies_that_are_no_json(scripted_server):
    server = scripted_server(scripted.sends_html(), scripted.sends_garbage())
    status, headers, body = raw(server)
    assert (status, headers["content-type"]) == (200, "text/html")
    assert body.startswith(b"<!doctype html>")
    status, headers, body = raw(server)
    assert (status, headers["content-type"]) == (200, "application/json")
    with pytest.raises(UnicodeDecodeError):
        body.decode()


def test_a_slow_answer_comes_late_or_after_the_timeout(scripted_server):
    slow = scripted.is_slow(0.3, then=scripted.answers("late"))
    server = scripted_server(slow, slow)
    begun = time.monotonic()
    assert ask(server).choices[0].message.content == "late"
    assert time.monotonic() - begun >= 0.3
    with pytest.raises(openai.APITimeoutError):
        ask(server, timeout=0.1)


def test_a_dribbled_body_outlasts_a_timeout_between_bytes(scripted_server):
    server = scripted_server(scripted.dribbles("slowly", pause=0.01))
    begun = time.monotonic()
    assert ask(server, timeout=1.0).choices[0].message.content == "slowly"
    assert time.monotonic() - begun > 1.0


def test_connections_that_break(scripted_server):
    server = scripted_server(
        scripted.cuts("text"), scripted.resets(), scripted.resets(after_headers=True)
    )
    with pytest.raises(http.client.IncompleteRead) as cut:
        raw(server)
    assert len(cut.value.partial) == 40
    for _ in range(2):
        with pytest.raises(ConnectionResetError):
            raw(server)
    server.then(scripted.cuts("text"), scripted.resets())
    for _ in range(2):
        with pytest.raises(openai.APIConnectionError):
            ask(server)


def test_an_endless_body_ends_at_the_servers_bound_or_with_the_client(scripted_server):
    server = scripted_server(
        scripted.never_ends(megabytes=1), scripted.never_ends(megabytes=64, pause=0.001)
    )
    assert 2**20 <= len(raw(server)[2]) < 2**20 + 2**17
    assert len(raw(server, limit=1000)[2]) == 1000
    deadline = time.monotonic() + 30
    while not server.requests[1].abandoned and time.monotonic() < deadline:
        time.sleep(0.01)
    assert [request.abandoned for request in server.requests] == [False, True]
    assert server.requests[1].sent < 2**25


def test_closing_interrupts_what_is_under_way_and_leaves_no_thread():
    before = set(threading.enumerate())
    server = ScriptedServer(scripted.is_slow(30, then=scripted.answers("never")))
    failures = []

    def waits():
        try:
            ask(server, timeout=30)
        except openai.APIConnectionError as error:
            failures.append(error)

    waiting = threading.Thread(target=waits)
    waiting.start()
    deadline = time.monotonic() + 30
    while not server.requests and time.monotonic() < deadline:
        time.sleep(0.01)
    begun = time.monotonic()
    server.close()
    waiting.join(timeout=20)
    assert time.monotonic() - begun < 15
    assert len(failures) == 1
    assert set(threading.enumerate()) <= before
    server.close()  # a second time does nothing


def test_it_closes_by_itself():
    server = ScriptedServer(at_most=0.1)
    server._loop.join(timeout=20)
    assert not server._loop.is_alive()
    with pytest.raises(openai.APIConnectionError):
        ask(server)
    server.close()
    assert not server._watchdog.is_alive()
