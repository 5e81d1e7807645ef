"""Wire: the SDK's transport of our own, which ends with the deadline and sends what we know."""

from __future__ import annotations

import ssl
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cached_property

import httpcore2
import httpx2

from pytest_dura.llm.client.deadline import Deadline

LONGEST_BODY = 1_000_000
"""Bytes of a response that are read."""
LONGEST_ERROR = 16_000
"""Bytes of an error's body that are read."""
_KEPT = ("content-type", "content-length")
Network = Callable[[Deadline], httpcore2.NetworkBackend]


class Wire(httpx2.BaseTransport):
    """One request on one new connection: HTTP/1.1, no proxy, no redirect, no cookie.

    What the SDK reads from the environment (organisation, project, headers) stays here: the
    headers are our own. The read timeout that the SDK asks for is the time for the whole exchange.

    Args:
        key: The bearer token.
        network: Makes the connections of a request, which end with its deadline.
    """

    def __init__(self, key: str, network: Network) -> None:
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
            with _translated():
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
        stream = _Body(response, pool, told=response.status >= 300)
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
        told: The status tells what happened; the body is read as far as it comes.
    """

    def __init__(
        self, response: httpcore2.Response, pool: httpcore2.ConnectionPool, *, told: bool
    ) -> None:
        self._response, self._pool, self._told = response, pool, told

    def __iter__(self) -> Iterator[bytes]:
        size, limit = 0, LONGEST_ERROR if self._told else LONGEST_BODY
        try:
            with _translated():
                for chunk in self._response.iter_stream():
                    yield chunk
                    size += len(chunk)
                    if size > limit:
                        return
        except httpx2.TransportError:
            if not self._told:
                raise

    def close(self) -> None:
        self._response.close()
        self._pool.close()


@contextmanager
def _translated() -> Iterator[None]:
    """Errors of the connection as the SDK knows them."""
    try:
        yield
    except httpcore2.TimeoutException as error:
        raise httpx2.ReadTimeout(str(error)) from error
    except httpcore2.ConnectError as error:
        raise httpx2.ConnectError(str(error)) from error
    except (httpcore2.NetworkError, httpcore2.ProtocolError) as error:
        raise httpx2.RemoteProtocolError(str(error)) from error
