"""The JSON object in a response's body, read strictly."""

from __future__ import annotations

import json
from typing import Any

from pytest_dura.llm.client.refusals import words
from pytest_dura.llm.port import WireFailure


class BadBodyError(Exception):
    """A body that is no chat completion.

    Args:
        failure: Its class.
        detail: What is wrong with it.
    """

    def __init__(self, failure: WireFailure, detail: str) -> None:
        super().__init__(detail)
        self.failure, self.detail = failure, words(detail)


def object_of(body: bytes) -> dict[str, Any]:
    """The JSON object that a body is: UTF-8, and numbers that JSON knows.

    Raises:
        BadBodyError: ``truncated`` for the beginning of an object, ``empty`` for nothing at all,
            else ``malformed``.
    """
    if not body.strip():
        raise BadBodyError("empty", "the body of the response is empty")
    text = _decoded(body)
    try:
        found = json.loads(text, parse_constant=_no_number)
    except json.JSONDecodeError as error:
        if _ends_early(text, error):
            raise _cut(body) from None
        raise BadBodyError("malformed", f"the body is no JSON: {text[:80]}") from None
    except (ValueError, RecursionError) as error:  # NaN, endless digits, endless nesting
        raise BadBodyError("malformed", f"the body is no JSON: {error}") from None
    if not isinstance(found, dict):
        raise BadBodyError("malformed", f"JSON, but no object: {type(found).__name__}")
    return found


def _decoded(body: bytes) -> str:
    try:
        return body.decode()
    except UnicodeDecodeError as error:
        if error.end == len(body) and "unexpected end" in error.reason:
            raise _cut(body) from None
        raise BadBodyError("malformed", "the body is no text in UTF-8") from None


def _cut(body: bytes) -> BadBodyError:
    return BadBodyError("truncated", f"the body ends in the middle, at byte {len(body)}")


def _ends_early(text: str, error: json.JSONDecodeError) -> bool:
    """Whether a text is the beginning of a JSON object, for all that can be seen."""
    whole = text.strip()
    if not whole.startswith("{"):
        return False
    at_end = error.pos >= len(text.rstrip())
    return at_end or error.msg.startswith("Unterminated string") or not whole.endswith("}")


def _no_number(name: str) -> float:
    raise ValueError(f"{name} is no number of JSON")
