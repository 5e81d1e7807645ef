"""Completions: the bodies of a server's responses, read into answers.

What a reasoning model thought stands in a field of its own, or before the text between ``<think>``
and ``</think>``; it is kept apart from the text.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from http.client import responses
from typing import Any

from pytest_dura.llm.answers import refuse_constant
from pytest_dura.llm.port import Answer, WireFailure

_LONGEST_DETAIL = 300
_LONGEST_CODE = 100
_FILTERED = ("content_filter", "content_policy_violation", "ResponsibleAIPolicyViolation")
"""Codes with which a server says that a content filter declined."""


def refusal_of(status: int, body: bytes) -> Answer:
    """The answer for the body of an error, with whatever status."""
    message, code = _error(body)
    message = message.strip() or responses.get(status, "an error without words")
    shown = f" ({code})" if code and code not in message else ""
    detail = short_text(f"HTTP {status}: {message}{shown}")
    if code in _FILTERED:
        return Answer(failure="refused", detail=detail)
    return Answer(failure="unavailable", detail=detail, cause=f"HTTP {status}")


def short_text(text: str) -> str:
    """A text of a server's on one line that acts on no terminal, bounded."""
    line = " ".join("".join(char if char.isprintable() else " " for char in text).split())
    return line if len(line) <= _LONGEST_DETAIL else line[: _LONGEST_DETAIL - 1] + "…"


def _short_code(value: Any) -> str:
    """A short text of a server's on one line; empty for anything else."""
    return short_text(value)[:_LONGEST_CODE] if isinstance(value, str) else ""


def _error(body: bytes) -> tuple[str, str]:
    """Message and code of an error's body, in any of the forms that servers use."""
    text = body.decode(errors="replace")
    try:
        data = json.loads(text)
    except (ValueError, RecursionError):
        return text, ""
    error = data.get("error") or data if isinstance(data, dict) else data
    if not isinstance(error, dict):
        return (error if isinstance(error, str) else text), ""
    message = next((error[key] for key in ("message", "detail", "title") if error.get(key)), text)
    codes = (_short_code(error.get(key)) for key in ("code", "type"))
    shown = message if isinstance(message, str) else json.dumps(message)
    return shown, next(filter(None, codes), "")


class BadBodyError(Exception):
    """Error for a body that is no chat completion.

    Args:
        failure: Its class.
        detail: What is wrong with it.
    """

    def __init__(self, failure: WireFailure, detail: str) -> None:
        super().__init__(detail)
        self.failure, self.detail = failure, short_text(detail)


def _object_of(body: bytes) -> dict[str, Any]:
    """Parse the JSON object in a body: UTF-8, and no numbers but JSON's.

    Raises:
        BadBodyError: ``truncated`` for the beginning of an object, ``empty`` for nothing at all,
            else ``malformed``.
    """
    if not body.strip():
        raise BadBodyError("empty", "the body of the response is empty")
    cut = BadBodyError("truncated", f"the body ends in the middle, at byte {len(body)}")
    try:
        text = body.decode()
    except UnicodeDecodeError as error:
        if error.end == len(body) and "unexpected end" in error.reason:
            raise cut from None
        raise BadBodyError("malformed", "the body is no text in UTF-8") from None
    try:
        data = json.loads(text, parse_constant=refuse_constant)
    except json.JSONDecodeError as error:
        at_end = error.pos >= len(text.rstrip()) or error.msg.startswith("Unterminated string")
        if text.lstrip().startswith("{") and (at_end or not text.rstrip().endswith("}")):
            raise cut from None
        raise BadBodyError("malformed", f"the body is no JSON: {text[:80]}") from None
    except (ValueError, RecursionError) as error:  # NaN, endless digits, endless nesting
        raise BadBodyError("malformed", f"the body is no JSON: {error}") from None
    if not isinstance(data, dict):
        raise BadBodyError("malformed", f"JSON, but no object: {type(data).__name__}")
    return data


LONGEST_TEXT = 64_000
"""Characters of an answer that are kept."""
_MOST_TOKENS = 2**53
_COUNTED = ("prompt_tokens", "completion_tokens", "total_tokens")


def read_completion(body: bytes) -> Answer:
    """Read the answer in a body; a body that holds none is a failure of its class."""
    try:
        completion = _object_of(body)
        if completion.get("error") or completion.get("object") == "error":
            return refusal_of(200, body)
        return _answer(completion)
    except BadBodyError as error:
        return Answer(failure=error.failure, detail=error.detail)


def _answer(completion: dict[str, Any]) -> Answer:
    if "choices" not in completion:
        raise BadBodyError("malformed", "no chat completion: it has no choices")
    choices = completion["choices"] or []
    if not isinstance(choices, list):
        raise BadBodyError("malformed", "no chat completion: choices is no list")
    if not choices:
        raise BadBodyError("empty", "no choices")
    choice = first_object(choices)
    message = choice.get("message")
    if not isinstance(message, dict):
        raise BadBodyError("malformed", "no chat completion: the choice has no message")
    content, refusal = message.get("content"), message.get("refusal")
    if content is not None and not isinstance(content, str):
        raise BadBodyError("malformed", "no chat completion: the content is no text")
    finish = _short_code(choice.get("finish_reason"))
    thoughts, text = split_thoughts(_encodable(content or ""))
    text = _arguments(message) or text
    fields = (message.get(name) for name in _THOUGHTS)
    own_thoughts = next((field for field in fields if isinstance(field, str) and field), "")
    usage = completion.get("usage")
    counts = usage if isinstance(usage, dict) else {}
    failure, detail = _failure(text, refusal, finish)
    return Answer(
        text[:LONGEST_TEXT],
        failure,
        short_text(_encodable(detail)),
        finish=finish,
        usage={
            name: counts[name]
            for name in _COUNTED
            if type(counts.get(name)) is int and 0 <= counts[name] < _MOST_TOKENS
        },
        fingerprint=_short_code(completion.get("system_fingerprint")),
        thoughts=(_encodable(own_thoughts).strip() or thoughts)[:LONGEST_TEXT],
    )


_THOUGHTS = ("reasoning_content", "reasoning")
"""Fields of a message in which servers put what the model thought."""
_OPENED = re.compile(r"\s*<(think|thinking)>")
_CLOSED = re.compile(r"</think(?:ing)?>")


def split_thoughts(text: str) -> tuple[str, str]:
    """What a model thought in its text, and the rest.

    Thoughts stand at the beginning, and are all of a text that does not end them. Where a template
    opens them in the prompt already, the text has their end alone; in a text that begins as a JSON
    object nothing is looked for.
    """
    opened = _OPENED.match(text)
    closed = _CLOSED.search(text)
    if opened is None and (closed is None or text.lstrip().startswith("{")):
        return "", text
    start = 0 if opened is None else opened.end()
    if closed is None:
        return text[start:].strip(), ""
    return text[start : closed.start()].strip(), text[closed.end() :].lstrip()


def first_object(items: Any) -> Mapping[str, Any]:
    """The first of a list of objects; empty where there is none."""
    first = items[0] if isinstance(items, list) and items else None
    return first if isinstance(first, dict) else {}


def _arguments(message: dict[str, Any]) -> str:
    """The arguments of the first tool that the model calls, as text; empty if it calls none."""
    function = first_object(message.get("tool_calls")).get("function")
    arguments = function.get("arguments") if isinstance(function, dict) else None
    if isinstance(arguments, dict):  # as some servers have it
        return json.dumps(arguments)
    return _encodable(arguments) if isinstance(arguments, str) else ""


def _failure(text: str, refusal: Any, finish: str) -> tuple[WireFailure, str]:
    """The class of failure of an answer, and why; both empty for a whole text."""
    if refusal:
        return "refused", f"refusal: {refusal}"
    if finish == "content_filter":
        return "refused", "finish_reason: content_filter"
    if len(text) > LONGEST_TEXT:
        return "truncated", f"of {len(text)} characters {LONGEST_TEXT} are kept"
    if finish == "length":
        return "truncated", "finish_reason: length"
    if not text.strip():
        return "empty", f"no text; finish_reason: {finish or 'none'}"
    return "", ""


def _encodable(text: str) -> str:
    """The text without half characters, which JSON's escapes can hold and no file can."""
    return text.encode("utf-16", "surrogatepass").decode("utf-16", "replace")
