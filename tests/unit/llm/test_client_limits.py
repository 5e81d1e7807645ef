"""The client in bad company: deadlines, bounds, injected failures, errors of its own."""

from __future__ import annotations

import gzip
import json
import socket
import struct
import sys
import threading
import time

import numpy as np
import pytest
import scripted_server as script
from llm_servers import KEY

import pytest_dura.llm.client as chat_module
from pytest_dura.core import ConfigurationError
from pytest_dura.llm import Endpoint, Image, Message, OpenAiClient, Request
from pytest_dura.llm.wire import RESPONSES

REQUEST = Request("m1", (Message("system", "Be brief."), Message("user", "Where?")))
BUDGET = 10.0


# The deadline


BUSY = 6.0
"""Seconds that a busy machine may add; without a budget these servers take 10 s and more."""


def late(answer, budget):
    assert answer.failure == "timeout"
    assert budget <= answer.seconds < budget + BUSY
    assert answer.text == ""


def dribbles_headers(exchange):
    for byte in b"HTTP/1.1 200 OK\r\nX-Long: " + b"x" * 500:
        exchange.write(bytes([byte]))
        if not exchange.sleep(0.02):
            return


@pytest.mark.parametrize(
    "behaviour",
    [script.is_slow(20.0, script.answers("late")), script.dribbles("x" * 500, pause=0.02),
     dribbles_headers],
    ids=["slow", "body", "headers"],
)  # fmt: skip
def test_what_comes_late_or_byte_by_byte_ends_with_the_budget(client, behaviour) -> None:
    late(client(behaviour).ask(REQUEST, 0.3), 0.3)


def test_an_error_whose_body_dribbles_is_told_by_its_status_in_time(client) -> None:
    def dribble(exchange):
        exchange.start(500, length=500)
        while exchange.sleep(0.02):
            exchange.write(b"x")

    answer = client(dribble).ask(REQUEST, 0.3)
    assert answer.failure == "unavailable"
    assert answer.detail.startswith("HTTP 500: ")
    assert answer.seconds < 0.3 + BUSY


def test_a_server_that_does_not_read_ends_with_the_budget() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        endpoint = Endpoint(f"http://127.0.0.1:{server.getsockname()[1]}/v1", "m")
        long = Request("m", (Message("user", "x" * 20_000_000),))
        late(OpenAiClient(endpoint).ask(long, 0.5), 0.5)


def test_a_look_up_that_hangs_ends_with_the_budget(monkeypatch) -> None:
    hangs = threading.Event()
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: hangs.wait(20) and [])
    try:
        late(OpenAiClient(Endpoint("http://some.host/v1", "m")).ask(REQUEST, 0.2), 0.2)
    finally:
        hangs.set()


def test_every_address_of_a_host_is_tried(client, monkeypatch) -> None:
    one = client(script.answers("ok"))
    really = socket.getaddrinfo

    def look_up(host, port, *args, **options):
        names = ["127.0.0.2", "127.0.0.1"] if host == "some.host" else [host]  # the first is closed
        return [entry for name in names for entry in really(name, port, *args, **options)]

    monkeypatch.setattr(socket, "getaddrinfo", look_up)
    two = OpenAiClient(Endpoint(one.server.base_url.replace("127.0.0.1", "some.host"), "m"))
    assert two.ask(REQUEST, BUDGET).text == "ok"


@pytest.mark.parametrize("budget", [0.0, -1.0, float("nan")])
def test_without_time_nothing_is_sent(client, budget) -> None:
    one = client()
    answer = one.ask(REQUEST, budget)
    assert (answer.failure, answer.seconds) == ("timeout", 0.0)
    assert one.server.requests == []


def test_time_without_end_is_a_day(client) -> None:
    assert client(script.answers("ok")).ask(REQUEST, float("inf")).text == "ok"


def test_a_body_without_end_is_left(client) -> None:
    one = client(script.never_ends(megabytes=32))
    start = time.perf_counter()
    answer = one.ask(REQUEST, BUDGET)
    assert (answer.failure, time.perf_counter() - start < 5.0) == ("malformed", True)
    assert "more than 1000000 bytes" in answer.detail
    (request,) = one.server.requests
    # The server notices as it goes on to write, and would not if it were stopped before.
    deadline = time.monotonic() + 10.0
    while not request.abandoned and time.monotonic() < deadline:
        time.sleep(0.01)
    assert request.abandoned, "the connection was closed"
    assert request.sent < 16 * 2**20, "but for what the system's buffers took"


def test_a_compressed_body_is_not_blown_up(client) -> None:
    body = gzip.compress(json.dumps(script.completion("x" * 10_000_000)).encode())
    assert len(body) < 100_000
    answer = client(script.sends(body, headers={"Content-Encoding": "gzip"})).ask(REQUEST, BUDGET)
    assert (answer.failure, answer.detail) == ("malformed", "the body is no text in UTF-8")


# Injected failures


@pytest.mark.parametrize("fault", RESPONSES)
def test_an_injected_failure_is_read_as_that_of_a_server_which_fails_so(client, fault) -> None:
    status, body = RESPONSES[fault]

    def fail(exchange):
        exchange.start(status, length=len(body) * (4 if fault == "cut" else 1))
        exchange.write(body)

    one = client(fail)
    real = one.ask(REQUEST, BUDGET)
    injected = one.ask(REQUEST, BUDGET, fault)
    assert real.failure
    assert real.seconds > injected.seconds == 0.0
    assert (injected.failure, injected.detail) == (real.failure, real.detail)
    assert len(one.server.requests) == 1, "the real server is not asked"


def test_an_injected_refusal_is_that_of_a_closed_port() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    closed = OpenAiClient(Endpoint(f"http://127.0.0.1:{port}/v1", "m")).ask(REQUEST, BUDGET)
    injected = OpenAiClient(Endpoint("https://host.invalid/v1", "m")).ask(
        REQUEST, BUDGET, "refused"
    )
    assert injected.failure == closed.failure == "unavailable"
    assert "Connection refused" in injected.detail


def test_an_injected_failure_needs_no_network(monkeypatch) -> None:
    def connect(*_args, **_named):
        raise AssertionError("no socket is opened")

    monkeypatch.setattr(socket, "socket", connect)
    monkeypatch.setattr(socket, "getaddrinfo", connect)
    one = OpenAiClient(Endpoint("https://host.invalid/v1", "m", KEY))
    found = [one.ask(REQUEST, BUDGET, fault) for fault in RESPONSES]
    assert found[0].detail.startswith("HTTP 429: ")
    assert found[1].detail.startswith("HTTP 500: ")
    assert [answer.failure for answer in found] == [
        "unavailable", "unavailable", "truncated", "malformed", "unavailable"
    ]  # fmt: skip


# The call itself


def test_a_request_that_cannot_be_made_is_an_answer_too(client) -> None:
    one = client()
    flat = Request("m", (Message("user", "x", (Image("c", np.zeros((4, 4, 4, 4), np.uint8)),)),))
    answer = one.ask(flat, BUDGET)
    assert answer.failure == "unavailable"
    assert answer.detail.startswith("the request could not be made: ")
    assert one.server.requests == []


def test_an_interrupt_is_none(client, monkeypatch) -> None:
    def interrupted(_body):
        raise KeyboardInterrupt

    monkeypatch.setattr(chat_module, "read_completion", interrupted)
    with pytest.raises(KeyboardInterrupt):
        client(script.answers("ok")).ask(REQUEST, BUDGET)


def test_calls_of_many_threads_do_not_meet(client) -> None:
    def echo(request):
        time.sleep(0.02)
        return request.prompt

    one = client(otherwise=script.answers_by(echo))
    found = {}

    def ask(number):
        found[number] = one.ask(Request("m", (Message("user", f"n{number}"),)), BUDGET).text

    threads = [threading.Thread(target=ask, args=(number,)) for number in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == {number: f"n{number}" for number in range(8)}


@pytest.mark.parametrize("package", ["openai", "PIL"])
def test_without_the_extra_there_is_one_clear_error(monkeypatch, package) -> None:
    for name in [one for one in sys.modules if one.partition(".")[0] == package]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ConfigurationError, match=f"'{package}'") as caught:
        OpenAiClient(Endpoint("http://127.0.0.1/v1", "m"))
    assert caught.value.remedy == "pip install 'pytest-dura[llm]'"


def test_the_list_of_models_is_read_as_it_is(client) -> None:
    one = client()
    assert json.loads(one.listing(BUDGET).text)["data"][0]["id"] == script.MODEL
    one.server.close()
    assert one.listing(BUDGET).failure == "unavailable"


def test_a_reset_of_a_connection_that_was_taken_is_unavailable() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:

        def reset():
            connection, _ = server.accept()
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            connection.close()

        thread = threading.Thread(target=reset)
        thread.start()
        endpoint = Endpoint(f"http://127.0.0.1:{server.getsockname()[1]}/v1", "m")
        answer = OpenAiClient(endpoint).ask(REQUEST, BUDGET)
        thread.join()
    assert answer.failure == "unavailable"
