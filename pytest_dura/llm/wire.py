"""Wire of the SDK: an HTTP client that holds each call to its deadline and counts its requests.

Proxies, certificates, connections and the pauses between retries are those of the SDK and its
client. Needs httpx2 and openai, which the extra ``llm`` installs; :mod:`pytest_dura.llm.client`
imports it at first use.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextvars import ContextVar, copy_context
from threading import Condition, Thread
from typing import Any, TypeVar

import httpx2
import openai

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.llm.completions import BadBodyError
from pytest_dura.llm.port import LONGEST_PAUSE, Repeats, ServerFault

T = TypeVar("T")

LONGEST_BODY = 1_000_000
"""Bytes of a response that are read."""
LONGEST_STREAM = 16_000_000
"""Bytes of a response that comes in parts: each token has about 300."""
_LONGEST_ERROR = 16_000
"""Bytes of an error's body that are read."""
_LONGEST = 86_400.0
_BUSY = (429, 503)
_SENT = ("host", "content-type", "content-length")
_LOCAL: dict[str, httpx2.BaseTransport | None] = {
    f"all://{host}": None for host in ("127.0.0.1", "localhost", "[::1]")
}
"""Hosts that are reached without a proxy, whatever the environment says of others."""


class LateError(openai.OpenAIError):
    """Error for a call that has no time left; the SDK repeats none of its own errors."""


class Call:
    """One call: its deadline, and the requests that were made for it.

    Args:
        budget: Seconds for each request; for all of them and the pauses where they count.
        repeats: Whether and how often a request is made again.
    """

    def __init__(self, budget: float, repeats: Repeats) -> None:
        self.budget, self.repeats = min(budget, _LONGEST), repeats
        self.begun = self.started = time.monotonic()
        self.attempts = 0
        self.status = 0
        """Of the response with which the server refused the latest request, if it did."""
        self.failure: Exception | None = None
        """Error of the connection of the latest request, if there was one."""
        self._until = self.begun + self.budget
        self._changed, self._has_ended = Condition(), False

    def run(self, make: Callable[[], T]) -> T:
        """Run the call in a thread of its own, since a look-up of a name knows no time limit.

        Raises:
            LateError: If it has not ended at its deadline. Its connection is closed when the
                server next sends anything, or at the time limit of the SDK.
        """
        results: list[T] = []
        errors: list[BaseException] = []

        def made() -> None:
            _CALL.set(self)
            try:
                results.append(make())
            except BaseException as error:  # it is raised again in the caller's thread
                errors.append(error)
            with self._changed:
                self._has_ended = True
                self._changed.notify_all()

        Thread(target=copy_context().run, args=(made,), name="dura-request", daemon=True).start()
        with self._changed:
            try:
                while not self._has_ended and (left := self._until - time.monotonic()) > 0.0:
                    self._changed.wait(left)
            finally:
                self._until = -math.inf  # nothing goes on for a caller that has left
        if errors:
            raise errors[0]
        if not results:
            raise LateError("no whole answer within the budget")
        return results[0]

    def begin(self) -> None:
        """Begin a request.

        Raises:
            LateError: If it may not be made any more.
        """
        with self._changed:
            if self.attempts:
                cause = f"HTTP {self.status}" if self.status else "connection"
                if self.left <= 0.0 or not self.repeats.allowed(cause):
                    raise LateError("the request is not made again")
                self.started = time.monotonic()
                if not self.repeats.counted:
                    self._until = self.started + self.budget
            self.attempts, self.status, self.failure = self.attempts + 1, 0, None
            self._changed.notify_all()

    def refuse(self, status: int, failure: Exception | None = None, *, repeated: bool) -> None:
        """Note that a request was refused, or could not be sent."""
        with self._changed:
            self.status, self.failure = status, failure
            if repeated and not self.repeats.counted and self.attempts <= self.repeats.most:
                self._until = max(self._until, time.monotonic() + 2 * LONGEST_PAUSE)
            self._changed.notify_all()

    @property
    def left(self) -> float:
        """Seconds until the deadline."""
        return self._until - time.monotonic()


_CALL: ContextVar[Call] = ContextVar("dura_llm_call")


class Wire(httpx2.Client):
    """Client of the SDK: no redirect, no cookie, and no header but the endpoint's own.

    Args:
        headers: That are sent to the server, beside those that a request needs.
        transport: In place of the machine's network.

    Raises:
        ConfigurationError: If a proxy or a certificate of the environment cannot be used.
    """

    def __init__(
        self, headers: Mapping[str, str], transport: httpx2.BaseTransport | None = None
    ) -> None:
        self._own_headers = dict(headers)
        # Servers close idle connections after 5 s and longer: on one that is closed at the moment
        # of a request that would fail without the server's fault.
        limits = httpx2.Limits(max_connections=None, keepalive_expiry=2.0)
        try:
            super().__init__(
                transport=transport,
                trust_env=transport is None,
                mounts=_LOCAL if transport is None else None,
                limits=limits,
                follow_redirects=False,
            )
        except (ValueError, ImportError, OSError, httpx2.InvalidURL) as error:
            raise ConfigurationError(
                "a proxy or a certificate that the environment names cannot be used"
                f" ({type(error).__name__})",
                key="HTTP_PROXY, HTTPS_PROXY, ALL_PROXY, SSL_CERT_FILE",
                expected="URLs such as http://proxy.example.org:3128, and a readable file",
                remedy="correct them, or name the server in NO_PROXY",
            ) from None

    def send(self, request: httpx2.Request, **named: Any) -> httpx2.Response:
        """Send a request of the call in this context; see the base class."""
        call = _CALL.get()
        call.begin()
        needed = {name: request.headers[name] for name in _SENT if name in request.headers}
        needed |= {"Accept": "application/json", "Accept-Encoding": "identity"}
        headers = httpx2.Headers({**needed, "User-Agent": "pytest-dura"})
        headers.update(self._own_headers)
        sent = httpx2.Request(
            request.method,
            request.url,
            headers=headers,
            content=request.read(),
            extensions=request.extensions,
        )
        try:
            response = super().send(sent, **named)
        except httpx2.TimeoutException as error:
            raise LateError(str(error)) from error  # the SDK would repeat it
        except httpx2.RequestError as error:
            call.refuse(0, error, repeated=True)
            raise
        response.request = request  # whose headers, which are not sent, tell the SDK what to return
        is_stream = is_event_stream(response)
        is_error = response.status_code >= 300
        limit = _LONGEST_ERROR if is_error else LONGEST_STREAM if is_stream else LONGEST_BODY
        # An encoding was not asked for, and is not undone: a small body could become a huge one.
        response.headers.pop("content-encoding", None)
        response.stream = _Body(response.stream, call, limit, is_error=is_error)
        pause = retry_after(response.headers)
        longest = call.left if call.repeats.counted else LONGEST_PAUSE
        repeated = response.status_code in _BUSY and (pause is None or pause <= longest)
        response.headers["x-should-retry"] = "true" if repeated else "false"  # which the SDK obeys
        if is_error:
            call.refuse(response.status_code, repeated=repeated)
        return response


class _Body(httpx2.SyncByteStream):
    """Bytes of a response, as far as they come within the deadline and the bound.

    Args:
        body: Of the client.
        call: Whose deadline holds.
        limit: Bytes that are read.
        is_error: Whether the status is that of an error, whose body is read as far as it comes.
    """

    def __init__(self, body: Any, call: Call, limit: int, *, is_error: bool) -> None:
        self._body, self._call, self._limit, self._is_error = body, call, limit, is_error

    def __iter__(self) -> Iterator[bytes]:
        size = 0
        try:
            for chunk in self._body:
                yield chunk
                size += len(chunk)
                if size > self._limit:
                    if self._is_error:
                        return
                    what = "a body" if self._limit == LONGEST_BODY else "a stream"
                    detail = f"{what} of more than {self._limit} bytes"
                    raise BadBodyError("malformed", detail)
                if self._call.left <= 0.0:
                    raise LateError("no whole answer within the budget")
        except httpx2.TransportError:
            if not self._is_error:
                raise

    def close(self) -> None:
        self._body.close()


def is_event_stream(response: httpx2.Response) -> bool:
    """Whether a response comes in parts."""
    kind = response.headers.get("content-type", "")
    return kind.partition(";")[0].strip().lower() == "text/event-stream"


def retry_after(headers: Mapping[str, str]) -> float | None:
    """Seconds of a response's ``Retry-After``; ``None`` for a date, which the SDK reads."""
    with contextlib.suppress(ValueError):
        seconds = float(headers.get("retry-after", ""))
        return seconds if 0.0 <= seconds < 1e9 else None
    return None


_CUT = b'{"object": "chat.completion", "choices": [{"index": 0, "message": {"role": "assist'
RESPONSES: Mapping[ServerFault, tuple[int, bytes]] = {
    "http_429": (
        429,
        b'{"error": {"message": "Rate limit reached", "type": "rate_limit_exceeded"}}',
    ),
    "http_500": (500, b'{"error": {"message": "The server had an error", "type": "server_error"}}'),
    "cut": (200, _CUT),
    "garbage": (200, b"<html><body>It works!</body></html>"),
    "error_text": (
        200,
        b'{"error": {"message": "The model is overloaded", "type": "server_error"}}',
    ),
}
"""Status and body of the servers' responses; one that refuses the connection has none."""


class _CutBody(httpx2.SyncByteStream):
    def __iter__(self) -> Iterator[bytes]:
        yield _CUT
        raise httpx2.RemoteProtocolError(
            "peer closed connection without sending complete message body "
            f"(received {len(_CUT)} bytes, expected {4 * len(_CUT)})"
        )


def failing(fault: ServerFault) -> httpx2.MockTransport:
    """A network whose servers all have a fault.

    Raises:
        KeyError: For a fault that there is not.
    """
    status, body = (0, b"") if fault == "refused" else RESPONSES[fault]

    def respond(request: httpx2.Request) -> httpx2.Response:
        if fault == "refused":
            raise httpx2.ConnectError("[Errno 111] Connection refused", request=request)
        if fault == "cut":
            return httpx2.Response(status, stream=_CutBody())
        return httpx2.Response(status, stream=httpx2.ByteStream(body))

    return httpx2.MockTransport(respond)
