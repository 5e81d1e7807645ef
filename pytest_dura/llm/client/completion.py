"""Completion: the body of a response with status 200, read into an answer."""

from __future__ import annotations

from typing import Any

from pytest_dura.llm.client.json_body import BadBodyError, object_of
from pytest_dura.llm.client.refusals import refusal_of, word, words
from pytest_dura.llm.port import Answer, WireFailure

LONGEST_TEXT = 64_000
"""Characters of an answer that are kept."""
_MOST_TOKENS = 2**53
_COUNTED = ("prompt_tokens", "completion_tokens", "total_tokens")


def read_completion(body: bytes) -> Answer:
    """The answer in a body; a body that holds none is a failure of its class."""
    try:
        found = object_of(body)
        if found.get("error") or found.get("object") == "error":
            return refusal_of(200, body)
        return _answer(found)
    except BadBodyError as error:
        return Answer(failure=error.failure, detail=error.detail)


def _answer(found: dict[str, Any]) -> Answer:
    choice, message = _first_choice(found)
    content, refusal = message.get("content"), message.get("refusal")
    if content is not None and not isinstance(content, str):
        raise BadBodyError("malformed", "no chat completion: the content is no text")
    finish = word(choice.get("finish_reason"))
    text = _encodable(content or "")
    failure, detail = _failure(text, refusal, finish)
    return Answer(
        text[:LONGEST_TEXT],
        failure,
        words(_encodable(detail)),
        finish=finish,
        usage=_usage(found.get("usage")),
        fingerprint=word(found.get("system_fingerprint")),
    )


def _failure(text: str, refusal: Any, finish: str) -> tuple[WireFailure, str]:
    """The class of an answer that is none, and why."""
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


def _first_choice(found: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """The first choice, and its message."""
    if "choices" not in found:
        raise BadBodyError("malformed", "no chat completion: it has no choices")
    choices = found["choices"] or []
    if not isinstance(choices, list):
        raise BadBodyError("malformed", "no chat completion: choices is no list")
    if not choices:
        raise BadBodyError("empty", "no choices")
    choice = choices[0]
    message = choice.get("message") if isinstance(choice, dict) else None
    if not isinstance(message, dict):
        raise BadBodyError("malformed", "no chat completion: the choice has no message")
    return choice, message


def _usage(found: Any) -> dict[str, int]:
    given = found if isinstance(found, dict) else {}
    counts = {name: given.get(name) for name in _COUNTED}
    return {
        name: count
        for name, count in counts.items()
        if type(count) is int and 0 <= count < _MOST_TOKENS
    }


def _encodable(text: str) -> str:
    """The text without half characters, which JSON's escapes can hold and no file can."""
    return text.encode("utf-16", "surrogatepass").decode("utf-16", "replace")
