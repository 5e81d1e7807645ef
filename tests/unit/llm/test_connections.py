"""The client's connections: kept for the next call, through proxies, one pool for each process."""

from __future__ import annotations

import os
import socket
import ssl
import threading

import pytest
import scripted_server as script
from llm_servers import KEY
from tls_servers import certificate, tunnel

from pytest_dura.core import ConfigurationError
from pytest_dura.llm import Endpoint, Message, OpenAiClient, Request

__all__ = ["certificate", "tunnel"]

REQUEST = Request("m1", (Message("system", "Be brief."), Message("user", "Where?")))
BUDGET = 10.0
PROXIES = [
    name for word in ("HTTP", "HTTPS", "ALL", "NO") for name in (f"{word}_PROXY", f"{word}_proxy")
]


@pytest.fixture(autouse=True)
def _no_proxies(monkeypatch):
    for name in PROXIES:
        monkeypatch.delenv(name, raising=False)
        monkeypatch.delenv(name.lower(), raising=False)


@pytest.fixture
def kept(client):
    """As ``client``, of a server that keeps connections open."""
    return lambda *behaviours, **options: client(*behaviours, keep_alive=True, **options)


# The pool


def test_calls_share_a_connection(kept) -> None:
    one = kept(otherwise=script.answers("ok"))
    assert [one.ask(REQUEST, BUDGET).text for _ in range(5)] == ["ok"] * 5
    assert one.listing(BUDGET).failure == ""
    assert (len(one.server.requests), one.server.accepted) == (5, 1)


def test_threads_share_a_pool_and_do_not_meet(kept) -> None:
    barrier, found = threading.Barrier(4), {}

    def echo(request):
        barrier.wait(30.0)  # all four are under way at once
        return request.prompt

    one = kept(otherwise=script.answers_by(echo))

    def ask(number):
        for turn in range(3):
            prompt = f"n{number} {turn}"
            found[prompt] = one.ask(Request("m", (Message("user", prompt),)), BUDGET).text

    threads = [threading.Thread(target=ask, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == {
        f"n{number} {turn}": f"n{number} {turn}" for number in range(4) for turn in range(3)
    }
    assert one.server.accepted == 4


def test_a_connection_that_the_server_closed_is_not_used_again(kept) -> None:
    one = kept(otherwise=script.answers("ok"))
    assert one.ask(REQUEST, BUDGET).text == "ok"
    one.server.close_connections()
    assert [one.ask(REQUEST, BUDGET).text for _ in range(2)] == ["ok"] * 2
    assert (len(one.server.requests), one.server.accepted) == (3, 2)


@pytest.mark.parametrize(
    "behaviour, failure",
    [
        (script.is_slow(20.0, script.answers("late")), "timeout"),
        (script.dribbles("x" * 500, pause=0.02), "timeout"),
        (script.sends("x" * 2_000_000), "malformed"),
        (script.resets(after_headers=True), "truncated"),
    ],
)
def test_a_connection_on_which_a_call_failed_is_closed_within_the_budget(
    kept, behaviour, failure
) -> None:
    one = kept(script.answers("ok"), behaviour, script.answers("again"))
    assert one.ask(REQUEST, BUDGET).text == "ok"
    budget = 0.3 if failure == "timeout" else BUDGET
    answer = one.ask(REQUEST, budget)
    assert answer.failure == failure
    assert answer.seconds < budget + 0.5
    assert one.ask(REQUEST, BUDGET).text == "again", "the next call has a budget of its own"
    assert one.server.accepted == 2


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the system does not fork")
def test_a_copy_of_the_process_makes_connections_of_its_own(kept) -> None:
    one = kept(otherwise=script.answers_by(lambda request: request.prompt))

    def ask(text):
        return one.ask(Request("m", (Message("user", text),)), BUDGET).text

    assert ask("before") == "before"
    copy = os.fork()
    if copy == 0:
        os._exit(0 if [ask(f"copy {turn}") for turn in range(2)] == ["copy 0", "copy 1"] else 1)
    assert [ask(f"own {turn}") for turn in range(5)] == [f"own {turn}" for turn in range(5)]
    assert os.waitstatus_to_exitcode(os.waitpid(copy, 0)[1]) == 0
    assert ask("after") == "after"
    assert one.server.accepted == 2


# Proxies


def through(server):
    """The address of a server, as that of a proxy with a password."""
    return server.base_url.removesuffix("/v1").replace("://", "://me:pass%20word@")


@pytest.mark.parametrize("name", ["HTTP_PROXY", "http_proxy", "ALL_PROXY"])
def test_requests_go_through_the_proxy_of_the_environment(client, monkeypatch, name) -> None:
    proxy = client(otherwise=script.answers("from the proxy"), keep_alive=True).server
    monkeypatch.setenv(name, through(proxy))
    one = OpenAiClient(Endpoint("http://model.invalid/v1", "m", KEY))
    assert [one.ask(REQUEST, BUDGET).text for _ in range(2)] == ["from the proxy"] * 2
    request = proxy.requests[0]
    assert request.path == "http://model.invalid/v1/chat/completions"
    assert request.headers["host"] == "model.invalid"
    assert request.headers["authorization"] == f"Bearer {KEY}"
    assert request.headers["proxy-authorization"] == "Basic bWU6cGFzcyB3b3Jk"  # me:pass word
    assert proxy.accepted == 1


@pytest.mark.parametrize("no_proxy", ["model.test", ".test", "other, model.test", "*"])
def test_no_proxy_is_respected(client, monkeypatch, no_proxy) -> None:
    one = client(otherwise=script.answers("directly"))
    proxy = client(otherwise=script.answers("from the proxy")).server
    really = socket.getaddrinfo
    monkeypatch.setattr(
        socket, "getaddrinfo", lambda host, *args, **options: really("127.0.0.1", *args, **options)
    )
    monkeypatch.setenv("HTTP_PROXY", through(proxy))
    url = one.server.base_url.replace("127.0.0.1", "model.test")
    assert OpenAiClient(Endpoint(url, "m")).ask(REQUEST, BUDGET).text == "from the proxy"
    monkeypatch.setenv("NO_PROXY", no_proxy)
    assert OpenAiClient(Endpoint(url, "m")).ask(REQUEST, BUDGET).text == "directly"
    assert len(proxy.requests) == len(one.server.requests) == 1


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost"])
def test_this_machine_is_reached_without_a_proxy(client, monkeypatch, host) -> None:
    one = client(otherwise=script.answers("directly"))
    proxy = client(otherwise=script.answers("from the proxy")).server
    monkeypatch.setenv("HTTP_PROXY", through(proxy))
    monkeypatch.setenv("ALL_PROXY", through(proxy))
    url = one.server.base_url.replace("127.0.0.1", host)
    assert OpenAiClient(Endpoint(url, "m")).ask(REQUEST, BUDGET).text == "directly"


@pytest.mark.parametrize(
    "address",
    [
        "http://me:secret@host:port",
        "http://me:secret@[::1",
        "ftp://me:secret@host",
        "socks5://me:secret@host:1080",
    ],
)
def test_a_proxy_that_cannot_be_used_is_refused_and_its_password_not_shown(
    monkeypatch, address
) -> None:
    monkeypatch.setenv("HTTPS_PROXY", address)
    with pytest.raises(ConfigurationError, match="a proxy ") as caught:
        OpenAiClient(Endpoint("https://model.invalid/v1", "m", KEY))
    assert "HTTPS_PROXY" in caught.value.key
    assert "secret" not in str(caught.value)


def test_https_goes_through_a_tunnel_and_trusts_what_the_environment_does(
    client, tunnel, certificate, monkeypatch
) -> None:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate)
    server = client(otherwise=script.answers("ok"), keep_alive=True, tls=context).server
    proxy = tunnel(("127.0.0.1", server.port))
    monkeypatch.setenv("HTTPS_PROXY", proxy.address)
    monkeypatch.delenv("SSL_CERT_DIR", raising=False)
    monkeypatch.setenv("SSL_CERT_FILE", str(certificate))
    one = OpenAiClient(Endpoint("https://model.test/v1", "m", KEY))
    assert [one.ask(REQUEST, BUDGET).text for _ in range(3)] == ["ok"] * 3
    assert (len(proxy.asked), server.accepted) == (1, 1)
    assert proxy.asked[0][0] == "connect model.test:443 http/1.1"
    assert "proxy-authorization: basic bwu6cgfzcw==" in proxy.asked[0]
    assert KEY not in str(proxy.asked), "the proxy does not see the key"

    monkeypatch.delenv("SSL_CERT_FILE")
    answer = OpenAiClient(Endpoint("https://model.test/v1", "m", KEY)).ask(REQUEST, BUDGET)
    assert answer.failure == "unavailable"
    assert "certificate verify failed" in answer.detail


def test_a_proxy_that_declines_is_named_and_gets_no_key(tunnel, monkeypatch) -> None:
    proxy = tunnel(None, "407 Proxy Authentication Required")
    monkeypatch.setenv("HTTPS_PROXY", proxy.address)
    answer = OpenAiClient(Endpoint("https://model.invalid/v1", "m", KEY)).ask(REQUEST, BUDGET)
    assert answer.failure == "unavailable"
    assert answer.detail == "ProxyError: 407 Proxy Authentication Required"
    assert KEY not in str(proxy.asked)


def test_a_handshake_that_hangs_ends_with_the_budget() -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        url = f"https://127.0.0.1:{silent.getsockname()[1]}/v1"
        answer = OpenAiClient(Endpoint(url, "m", KEY)).ask(REQUEST, 0.3)
    assert answer.failure == "timeout"
    assert answer.seconds < 0.8


def test_a_proxy_that_does_not_answer_ends_with_the_budget(monkeypatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as proxy:
        monkeypatch.setenv("HTTPS_PROXY", f"http://127.0.0.1:{proxy.getsockname()[1]}")
        answer = OpenAiClient(Endpoint("https://model.invalid/v1", "m", KEY)).ask(REQUEST, 0.3)
    assert answer.failure == "timeout"
    assert answer.seconds < 0.8
