"""Streams: answers that come in parts, as server-sent events, put together to one completion."""

from __future__ import annotations

import json
from typing import Any

from pytest_dura.llm.answers import refuse_constant
from pytest_dura.llm.completions import BadBodyError

_DATA = b"data:"
_END = b"[DONE]"
_TEXTS = ("content", "refusal", "reasoning_content", "reasoning")


def is_stream(content_type: str) -> bool:
    """Whether a response of this type comes in parts."""
    return content_type.partition(";")[0].strip().lower() == "text/event-stream"


class EventStream:
    """Parts of one answer, as they come."""

    def __init__(self) -> None:
        self.first_token: float | None = None
        """Seconds at which the first part of a text came, as they were given to :meth:`feed`."""
        self.ended = False
        """Whether the last part has come."""
        self._rest = b""
        self._error: Any = None
        self._whole: dict[str, Any] = {}
        self._texts: dict[str, list[str]] = {}
        self._arguments: list[str] = []
        self._finish: Any = None

    def feed(self, data: bytes, seconds: float) -> None:
        """Add bytes.

        Args:
            data: The next ones, cut anywhere.
            seconds: When they came.

        Raises:
            BadBodyError: For an event that is none of a chat completion.
        """
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            self._read(line.strip(), seconds)

    def body(self) -> bytes:
        """The whole as the body of a completion that comes at once.

        Raises:
            BadBodyError: If it ends in the middle.
        """
        self._read(self._rest.strip(), 0.0)
        if self._error is not None:
            return json.dumps({"error": self._error}).encode()
        if not self.ended and self._finish is None:
            raise BadBodyError("truncated", "the stream ends in the middle")
        message: dict[str, Any] = {name: "".join(parts) for name, parts in self._texts.items()}
        if self._arguments:
            function = {"arguments": "".join(self._arguments)}
            message["tool_calls"] = [{"function": function}]
        choice = {"message": message, "finish_reason": self._finish}
        return json.dumps({**self._whole, "choices": [choice]}).encode()

    def _read(self, line: bytes, seconds: float) -> None:
        """Read one line; others than data are comments, names and pauses."""
        if not line.startswith(_DATA) or self.ended:
            return
        data = line[len(_DATA) :].strip()
        if data == _END:
            self.ended = True
            return
        try:
            event = json.loads(data, parse_constant=refuse_constant)
        except (ValueError, RecursionError):
            raise BadBodyError("malformed", f"an event is no JSON: {data[:80]!r}") from None
        if not isinstance(event, dict):
            raise BadBodyError("malformed", "an event is no object")
        if event.get("error"):
            self._error, self.ended = event["error"], True
            return
        for name in ("system_fingerprint", "usage"):
            if event.get(name) is not None:
                self._whole[name] = event[name]
        choices = event.get("choices")
        choice = choices[0] if isinstance(choices, list) and choices else None
        if isinstance(choice, dict):
            self._add(choice, seconds)

    def _add(self, choice: dict[str, Any], seconds: float) -> None:
        delta = choice.get("delta")
        delta = delta if isinstance(delta, dict) else {}
        texts = {name: delta.get(name) for name in _TEXTS}
        calls = delta.get("tool_calls")
        call = calls[0] if isinstance(calls, list) and calls else None
        function = call.get("function") if isinstance(call, dict) else None
        arguments = function.get("arguments") if isinstance(function, dict) else None
        parts = [part for part in (*texts.values(), arguments) if part is not None]
        if not all(isinstance(part, str) for part in parts):
            raise BadBodyError("malformed", "a part of the answer is no text")
        for name, part in texts.items():
            if part:
                self._texts.setdefault(name, []).append(part)
        if arguments:
            self._arguments.append(arguments)
        if any(parts) and self.first_token is None:
            self.first_token = seconds
        if choice.get("finish_reason") is not None:
            self._finish = choice["finish_reason"]
