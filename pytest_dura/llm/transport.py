"""Transport of the SDK: pooled connections, proxies, and a deadline for each whole exchange.

With it simulated networks on which every server fails in one way.

Needs httpcore2 and httpx2, which the extra ``llm`` installs; :mod:`pytest_dura.llm.client`
imports it at first use.
"""

from __future__ import annotations

import contextlib
import ipaddress
import os
import queue
import socket
import ssl
import sys
import threading
import time
import weakref
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property
from importlib.util import find_spec
from typing import Any
from urllib.parse import unquote, urlsplit
from urllib.request import getproxies, proxy_bypass

import httpcore2
import httpx2

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.llm.port import ServerFault
from pytest_dura.llm.streams import is_stream

_LEAST = 0.001
_LONGEST = 86_400.0
_CHUNK = 16_384
_IDLE = 2.0
"""Seconds after which an idle connection is closed, before servers do so: they wait 5 s or longer.
A request on a connection that the server closes at that moment would fail without its fault."""

_CALL = threading.local()
"""The moment of the monotonic clock at which the exchange of a thread has to end."""


def _left(late: type[Exception]) -> float:
    """Seconds that are left of this thread's exchange; raises the error if there are none."""
    left: float = _CALL.end - time.monotonic()
    if left <= 0.0:
        raise late("the deadline has passed")
    return max(left, _LEAST)


class Network(httpcore2.SyncBackend):
    """The machine's network, each of whose steps gets what is left of its thread's exchange."""

    def connect_tcp(
        self,
        host: str,
        port: int,
        timeout: float | None = None,  # noqa: ARG002 - the deadline holds
        local_address: str | None = None,
        socket_options: Iterable[Any] | None = None,
    ) -> httpcore2.NetworkStream:
        """A connection to the first address of the host that takes one."""
        addresses = _addresses(host, port)
        for others, address in zip(range(len(addresses), 0, -1), addresses, strict=True):
            seconds = _left(httpcore2.ConnectTimeout) / others
            try:
                stream = super().connect_tcp(address, port, seconds, local_address, socket_options)
            except (httpcore2.ConnectError, httpcore2.ConnectTimeout):
                if others == 1:
                    raise
            else:
                return _Stream(stream)
        raise httpcore2.ConnectError(f"{host} has no address")


class _Stream(httpcore2.NetworkStream):
    """A connection, each of whose steps gets what is left of its thread's exchange."""

    def __init__(self, stream: httpcore2.NetworkStream) -> None:
        self._stream = stream

    def read(self, max_bytes: int, timeout: float | None = None) -> bytes:  # noqa: ARG002 - see above
        if sys.platform == "linux":
            # Servers that send a response in two parts wait with the second one until the first
            # is acknowledged, which Linux does after 40 ms on a connection that is used again.
            sock = self._stream.get_extra_info("socket")
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)
        return self._stream.read(max_bytes, _left(httpcore2.ReadTimeout))

    def write(self, buffer: bytes, timeout: float | None = None) -> None:  # noqa: ARG002 - see above
        for start in range(0, len(buffer), _CHUNK):
            chunk = buffer[start : start + _CHUNK]
            self._stream.write(chunk, _left(httpcore2.WriteTimeout))

    def start_tls(
        self,
        ssl_context: ssl.SSLContext,
        server_hostname: str | None = None,
        timeout: float | None = None,  # noqa: ARG002 - see above
    ) -> httpcore2.NetworkStream:
        try:
            seconds = _left(httpcore2.ConnectTimeout)
            return _Stream(self._stream.start_tls(ssl_context, server_hostname, seconds))
        except BaseException:  # a time limit, too, must leave no socket open; it is raised again
            self.close()
            raise

    def get_extra_info(self, info: str) -> Any:
        return self._stream.get_extra_info(info)

    def close(self) -> None:
        self._stream.close()


def _addresses(host: str, port: int) -> list[str]:
    """Addresses of a host. A name is looked up apart: the system's look-up knows no timeout."""
    if _ip_address(host) is not None:
        return [host]
    answers: queue.SimpleQueue[list[str] | Exception] = queue.SimpleQueue()

    def look_up() -> None:
        try:
            entries = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
            answers.put([str(place[0]) for *_, place in entries])
        except (OSError, UnicodeError) as error:
            answers.put(httpcore2.ConnectError(f"{host} has no address: {error}"))

    threading.Thread(target=look_up, name="dura-look-up", daemon=True).start()
    try:
        answer = answers.get(timeout=_left(httpcore2.ConnectTimeout))
    except queue.Empty:
        raise httpcore2.ConnectTimeout("the deadline has passed in the look-up") from None
    if isinstance(answer, Exception):
        raise answer
    return answer


def _ip_address(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    with contextlib.suppress(ValueError):
        return ipaddress.ip_address(host)
    return None


def environment_proxy(url: str) -> httpcore2.Proxy | None:
    """The proxy to a server that the environment names, as other programs read it.

    ``HTTPS_PROXY``, ``HTTP_PROXY`` and ``ALL_PROXY`` name it, also in lower case, ``NO_PROXY`` the
    hosts, domains and networks that are reached without; so is this machine, always.

    Raises:
        ConfigurationError: If it cannot be used; no password is shown.
    """
    server, proxies = urlsplit(url), getproxies()
    scheme = server.scheme if proxies.get(server.scheme) else "all"
    address = proxies.get(scheme, "")
    if not address or _is_direct(server.hostname or "", server.port, proxies.get("no", "")):
        return None

    def refused(problem: str, remedy: str, shown: str | None = None) -> ConfigurationError:
        return ConfigurationError(
            f"the proxy {problem}",
            key=f"{scheme.upper()}_PROXY",
            found=shown,
            expected="a URL such as http://proxy.example.org:3128",
            remedy=f"{remedy}, or name the server in NO_PROXY",
        )

    try:
        parts = urlsplit(address if "://" in address else f"http://{address}")
        place = parts.netloc.rpartition("@")[2]
        usable = (
            bool(parts.hostname) and parts.port != 0 and place.isascii() and place.isprintable()
        )
    except ValueError:
        usable = False
    if not usable:
        raise refused("cannot be read", "check its host and its port")
    shown = f"{parts.scheme}://{place}"
    if parts.scheme not in ("http", "https", "socks5", "socks5h"):
        raise refused("has no scheme that can be used", "begin it with http://", shown)
    if parts.scheme.startswith("socks") and find_spec("socksio") is None:
        raise refused("needs the package 'socksio'", "pip install socksio", shown)
    user = parts.username
    auth = None if user is None else (unquote(user), unquote(parts.password or ""))
    return httpcore2.Proxy(shown, auth=auth)


def _is_direct(host: str, port: int | None, no_proxy: str) -> bool:
    """Whether a host is reached without a proxy."""
    address = _ip_address(host)
    if address is None:
        return host == "localhost" or bool(proxy_bypass(host if port is None else f"{host}:{port}"))
    if address.is_loopback or "*" in no_proxy.split(","):
        return True
    for entry in no_proxy.split(","):
        with contextlib.suppress(ValueError):  # a name of a host, or of a domain
            if address in ipaddress.ip_network(entry.strip().strip("[]"), strict=False):
                return True
    return False


LONGEST_BODY = 1_000_000
"""Bytes of a response that are read."""
LONGEST_STREAM = 16_000_000
"""Bytes of a response that comes in parts: each token has about 300."""
_LONGEST_ERROR = 16_000
"""Bytes of an error's body that are read."""
_KEPT = ("content-type", "content-length")


class Wire(httpx2.BaseTransport):
    """Transport over a pool of connections: HTTP/1.1, no redirect, no cookie, nothing sent twice.

    What the SDK reads from the environment (organisation, project, headers) stays here: the
    headers are our own. The read timeout that the SDK asks for is the time for the whole exchange.
    Threads share the pool; a process that is forked makes one of its own.

    Args:
        headers: That are sent to the server, beside those that the transport itself needs.
        network: Makes the connections.
        proxy: The proxy to the server, if there is one.
    """

    def __init__(
        self,
        headers: Mapping[str, str],
        network: httpcore2.NetworkBackend,
        proxy: httpcore2.Proxy | None = None,
    ) -> None:
        self._own_headers, self._network, self._proxy = dict(headers), network, proxy
        self._pools: dict[int, httpcore2.ConnectionPool] = {}
        weakref.finalize(self, _close_connections, self._pools)

    @cached_property
    def _trusted(self) -> ssl.SSLContext:
        """Of ``SSL_CERT_FILE`` and ``SSL_CERT_DIR``, or the system's."""
        return httpx2.create_ssl_context()

    def _pool(self, scheme: str) -> httpcore2.ConnectionPool:
        process = os.getpid()
        if process not in self._pools:
            _close_connections(self._pools, process)  # the copies of a fork
            pool = httpcore2.ConnectionPool(
                ssl_context=self._trusted if scheme == "https" else None,
                proxy=self._proxy,
                max_connections=None,
                keepalive_expiry=_IDLE,
                network_backend=self._network,
            )
            return self._pools.setdefault(process, pool)  # another thread may have been quicker
        return self._pools[process]

    def handle_request(self, request: httpx2.Request) -> httpx2.Response:
        """The response, whose body is read from the connection while it is asked for."""
        _CALL.end = time.monotonic() + min(request.extensions["timeout"]["read"], _LONGEST)
        with _sdk_errors():
            response = self._pool(request.url.scheme).handle_request(
                httpcore2.Request(
                    request.method,
                    str(request.url),
                    headers=self._headers(request),
                    content=request.read(),
                )
            )
        # An encoding was not asked for, and is not undone: a small body could become a huge one.
        headers = [(name.lower(), value) for name, value in response.headers]
        headers = [pair for pair in headers if pair[0] != b"content-encoding"]
        kinds = (value.decode("latin-1") for name, value in headers if name == b"content-type")
        longest = LONGEST_STREAM if any(map(is_stream, kinds)) else LONGEST_BODY
        stream = _Body(response, longest, is_error=response.status >= 300)
        return httpx2.Response(response.status, headers=headers, stream=stream)

    def _headers(self, request: httpx2.Request) -> list[tuple[str, str]]:
        needed = [
            ("Host", request.url.netloc.decode("ascii")),
            ("Accept", "application/json"),
            ("Accept-Encoding", "identity"),
            ("User-Agent", "pytest-dura"),
            *((name, request.headers[name]) for name in _KEPT if name in request.headers),
        ]
        own = {name.casefold() for name in self._own_headers}
        kept = [pair for pair in needed if pair[0].casefold() not in own]
        return [*kept, *self._own_headers.items()]


class _Body(httpx2.SyncByteStream):
    """The bytes of a response.

    Args:
        longest: Bytes that are read of it.
        is_error: Whether the status is that of an error, whose body is read as far as it comes.
    """

    def __init__(self, response: httpcore2.Response, longest: int, *, is_error: bool) -> None:
        self._response, self._longest, self._is_error = response, longest, is_error

    def __iter__(self) -> Iterator[bytes]:
        size, limit = 0, _LONGEST_ERROR if self._is_error else self._longest
        try:
            with _sdk_errors():
                for chunk in self._response.iter_stream():
                    yield chunk
                    size += len(chunk)
                    if size > limit:
                        return
        except httpx2.TransportError:
            if not self._is_error:
                raise

    def close(self) -> None:
        self._response.close()


def _close_connections(pools: dict[int, httpcore2.ConnectionPool], but: int | None = None) -> None:
    """Close the connections of all pools but that of a process.

    Not by :meth:`close` of a pool: a thread that a fork did not copy may hold the pool's lock.
    """
    for process in [process for process in pools if process != but]:
        pool = pools.pop(process, None)
        for connection in [] if pool is None else pool.connections:
            connection.close()


@contextmanager
def _sdk_errors() -> Iterator[None]:
    """Context that turns errors of the connection into those of the SDK."""
    try:
        yield
    except httpcore2.TimeoutException as error:
        raise httpx2.ReadTimeout(str(error)) from error
    except httpcore2.ConnectError as error:
        raise httpx2.ConnectError(str(error)) from error
    except httpcore2.ProxyError as error:
        raise httpx2.ProxyError(str(error)) from error
    except (httpcore2.NetworkError, httpcore2.ProtocolError) as error:
        raise httpx2.RemoteProtocolError(str(error)) from error


def response(status: str, body: bytes, *, size: int | None = None) -> bytes:
    """Make an HTTP response.

    Args:
        status: Code and phrase, such as ``500 Internal Server Error``.
        body: The part of the body that is sent.
        size: The length that is announced, where it is another.
    """
    length = len(body) if size is None else size
    head = (
        f"HTTP/1.1 {status}\r\nContent-Type: application/json\r\nContent-Length: {length}\r\n\r\n"
    )
    return head.encode() + body


_CUT = b'{"object": "chat.completion", "choices": [{"index": 0, "message": {"role": "assist'
RESPONSES: Mapping[ServerFault, bytes] = {
    "http_429": response(
        "429 Too Many Requests",
        b'{"error": {"message": "Rate limit reached", "type": "rate_limit_exceeded"}}',
    ),
    "http_500": response(
        "500 Internal Server Error",
        b'{"error": {"message": "The server had an error", "type": "server_error"}}',
    ),
    "cut": response("200 OK", _CUT, size=4 * len(_CUT)),
    "garbage": response("200 OK", b"<html><body>It works!</body></html>"),
    "error_text": response(
        "200 OK", b'{"error": {"message": "The model is overloaded", "type": "server_error"}}'
    ),
}
"""Responses of the servers; one that refuses the connection has none."""


class _Refusing(httpcore2.MockBackend):
    def connect_tcp(self, *_given: Any, **_named: Any) -> httpcore2.NetworkStream:
        raise httpcore2.ConnectError("[Errno 111] Connection refused")


def failing(fault: ServerFault) -> httpcore2.NetworkBackend:
    """A network whose servers all have a fault.

    Raises:
        KeyError: For a fault that there is not.
    """
    return _Refusing([]) if fault == "refused" else httpcore2.MockBackend([RESPONSES[fault]])
