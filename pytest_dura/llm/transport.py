"""Transport of the SDK that ends with the deadline of a whole exchange.

With it simulated networks on which every server fails in one way.

Needs httpcore2 and httpx2, which the extra ``llm`` installs; :mod:`pytest_dura.llm.client`
imports it at first use.
"""

from __future__ import annotations

import ipaddress
import queue
import socket
import ssl
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import httpcore2
import httpx2

from pytest_dura.llm.port import ServerFault

_LEAST = 0.001
_LONGEST = 86_400.0
_CHUNK = 65_536


@dataclass(frozen=True)
class Deadline:
    """A moment of the monotonic clock."""

    at: float

    @classmethod
    def within(cls, seconds: float) -> Deadline:
        """The moment that many seconds from now; a day at most."""
        return cls(time.monotonic() + min(seconds, _LONGEST))

    def left(self) -> float:
        """Seconds that are left.

        Raises:
            TimeoutError: If there are none.
        """
        left = self.at - time.monotonic()
        if left <= 0.0:
            raise TimeoutError("the deadline has passed")
        return max(left, _LEAST)


class Network(httpcore2.NetworkBackend):
    """The machine's network, whose connections end with a deadline."""

    def __init__(self, deadline: Deadline) -> None:
        self._deadline = deadline

    def connect_tcp(
        self,
        host: str,
        port: int,
        timeout: float | None = None,  # noqa: ARG002 - the deadline holds
        local_address: str | None = None,  # noqa: ARG002 - none is asked for
        socket_options: Iterable[Any] | None = None,  # noqa: ARG002 - none are asked for
    ) -> httpcore2.NetworkStream:
        """A connection to the first address of the host that takes one."""
        with _socket_errors(httpcore2.ConnectTimeout, httpcore2.ConnectError):
            addresses = _addresses(host, port, self._deadline)
            for number, address in enumerate(addresses):
                others = len(addresses) - number
                try:
                    return _Stream(_connected(address, self._deadline.left() / others),
                                   self._deadline)  # fmt: skip
                except OSError:
                    if others == 1:
                        raise
            raise OSError(f"{host} has no address")


class _Stream(httpcore2.NetworkStream):
    """A connection, each of whose steps gets what is left."""

    def __init__(self, sock: socket.socket, deadline: Deadline) -> None:
        self._sock, self._deadline = sock, deadline

    def read(self, max_bytes: int, timeout: float | None = None) -> bytes:  # noqa: ARG002 - see above
        with _socket_errors(httpcore2.ReadTimeout, httpcore2.ReadError):
            self._sock.settimeout(self._deadline.left())
            return self._sock.recv(max_bytes)

    def write(self, buffer: bytes, timeout: float | None = None) -> None:  # noqa: ARG002 - see above
        view = memoryview(buffer)
        with _socket_errors(httpcore2.WriteTimeout, httpcore2.WriteError):
            while view:
                self._sock.settimeout(self._deadline.left())
                view = view[self._sock.send(view[:_CHUNK]) :]

    def start_tls(
        self,
        ssl_context: ssl.SSLContext,
        server_hostname: str | None = None,
        timeout: float | None = None,  # noqa: ARG002 - see above
    ) -> httpcore2.NetworkStream:
        try:
            with _socket_errors(httpcore2.ConnectTimeout, httpcore2.ConnectError):
                self._sock.settimeout(self._deadline.left())
                wrapped = ssl_context.wrap_socket(self._sock, server_hostname=server_hostname)
        except BaseException:  # a time limit, too, must leave no socket open; it is raised again
            self.close()
            raise
        return _Stream(wrapped, self._deadline)

    def get_extra_info(self, info: str) -> Any:  # noqa: ARG002 - nothing is told: HTTP/1.1 needs nothing
        return None

    def close(self) -> None:
        self._sock.close()


def _connected(address: tuple[Any, ...], seconds: float) -> socket.socket:
    family, kind, protocol, _, place = address
    sock = socket.socket(family, kind, protocol)
    try:
        sock.settimeout(seconds)
        sock.connect(place)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    except BaseException:  # see above
        sock.close()
        raise
    return sock


def _addresses(host: str, port: int, deadline: Deadline) -> list[tuple[Any, ...]]:
    """Addresses of a host. A name is looked up apart: the system's look-up knows no timeout."""
    try:
        ipaddress.ip_address(host)
    except ValueError:
        pass
    else:
        return list(socket.getaddrinfo(host, port, type=socket.SOCK_STREAM))
    answers: queue.SimpleQueue[list[tuple[Any, ...]] | OSError] = queue.SimpleQueue()

    def look_up() -> None:
        try:
            answers.put(list(socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)))
        except (OSError, UnicodeError) as error:
            answers.put(OSError(f"{host} has no address: {error}"))

    threading.Thread(target=look_up, name="dura-look-up", daemon=True).start()
    try:
        answer = answers.get(timeout=deadline.left())
    except queue.Empty:
        raise TimeoutError("the deadline has passed while the host was looked up") from None
    if isinstance(answer, OSError):
        raise answer
    return answer


@contextmanager
def _socket_errors(late: type[Exception], failed: type[Exception]) -> Iterator[None]:
    """Context that turns errors of sockets into those of the HTTP library."""
    try:
        yield
    except TimeoutError as error:
        raise late(str(error)) from error
    except OSError as error:
        raise failed(str(error)) from error


LONGEST_BODY = 1_000_000
"""Bytes of a response that are read."""
_LONGEST_ERROR = 16_000
"""Bytes of an error's body that are read."""
_KEPT = ("content-type", "content-length")
NetworkFactory = Callable[[Deadline], httpcore2.NetworkBackend]


class Wire(httpx2.BaseTransport):
    """Transport of one request on a new connection: HTTP/1.1, no proxy, no redirect, no cookie.

    What the SDK reads from the environment (organisation, project, headers) stays here: the
    headers are our own. The read timeout that the SDK asks for is the time for the whole exchange.

    Args:
        key: The bearer token.
        network: Makes the connections of a request, which end with its deadline.
    """

    def __init__(self, key: str, network: NetworkFactory) -> None:
        self._key, self._network = key, network

    @cached_property
    def _trusted(self) -> ssl.SSLContext:
        return httpx2.create_ssl_context()

    def handle_request(self, request: httpx2.Request) -> httpx2.Response:
        """The response, whose body is read from the connection while it is asked for."""
        deadline = Deadline.within(request.extensions["timeout"]["read"])
        https = request.url.scheme == "https"
        pool = httpcore2.ConnectionPool(
            ssl_context=self._trusted if https else None,
            max_connections=1,
            max_keepalive_connections=0,
            network_backend=self._network(deadline),
        )
        try:
            with _sdk_errors():
                response = pool.handle_request(
                    httpcore2.Request(
                        request.method,
                        str(request.url),
                        headers=self._headers(request),
                        content=request.read(),
                    )
                )
        except BaseException:  # a time limit, too, must leave no connection; it is raised again
            pool.close()
            raise
        # An encoding was not asked for, and is not undone: a small body could become a huge one.
        headers = [pair for pair in response.headers if pair[0].lower() != b"content-encoding"]
        stream = _Body(response, pool, is_error=response.status >= 300)
        return httpx2.Response(response.status, headers=headers, stream=stream)

    def _headers(self, request: httpx2.Request) -> list[tuple[str, str]]:
        return [
            ("Host", request.url.netloc.decode("ascii")),
            ("Accept", "application/json"),
            ("Accept-Encoding", "identity"),
            ("Authorization", f"Bearer {self._key}"),
            ("Connection", "close"),
            ("User-Agent", "pytest-dura"),
            *((name, request.headers[name]) for name in _KEPT if name in request.headers),
        ]


class _Body(httpx2.SyncByteStream):
    """The bytes of a response.

    Args:
        is_error: Whether the status is that of an error, whose body is read as far as it comes.
    """

    def __init__(
        self, response: httpcore2.Response, pool: httpcore2.ConnectionPool, *, is_error: bool
    ) -> None:
        self._response, self._pool, self._is_error = response, pool, is_error

    def __iter__(self) -> Iterator[bytes]:
        size, limit = 0, _LONGEST_ERROR if self._is_error else LONGEST_BODY
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
        self._pool.close()


@contextmanager
def _sdk_errors() -> Iterator[None]:
    """Context that turns errors of the connection into those of the SDK."""
    try:
        yield
    except httpcore2.TimeoutException as error:
        raise httpx2.ReadTimeout(str(error)) from error
    except httpcore2.ConnectError as error:
        raise httpx2.ConnectError(str(error)) from error
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


def failing(fault: ServerFault, _deadline: Deadline) -> httpcore2.NetworkBackend:
    """A network whose servers all have a fault.

    Raises:
        KeyError: For a fault that there is not.
    """
    return _Refusing([]) if fault == "refused" else httpcore2.MockBackend([RESPONSES[fault]])
