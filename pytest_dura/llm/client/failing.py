"""Failing servers: networks on which every server fails in one way, without any network.

The bytes of the responses go through the same HTTP parsing and reading as a real server's.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import httpcore2

from pytest_dura.llm.client.deadline import Deadline
from pytest_dura.llm.port import ServerFault


def response(status: str, body: bytes, *, size: int | None = None) -> bytes:
    """A whole HTTP response.

    Args:
        status: Code and phrase, such as ``500 Internal Server Error``.
        body: What is sent of the body.
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
"""What the servers answer; one that refuses the connection answers nothing."""


class _Refusing(httpcore2.MockBackend):
    def connect_tcp(self, *_given: Any, **_named: Any) -> httpcore2.NetworkStream:
        raise httpcore2.ConnectError("[Errno 111] Connection refused")


def failing(fault: ServerFault, _deadline: Deadline) -> httpcore2.NetworkBackend:
    """A network whose servers fail like that.

    Raises:
        KeyError: For a way to fail that there is not.
    """
    return _Refusing([]) if fault == "refused" else httpcore2.MockBackend([RESPONSES[fault]])
