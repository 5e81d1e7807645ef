"""Refusals: what a server says of an error, in few words that act on nothing."""

from __future__ import annotations

import json
from http import HTTPStatus
from typing import Any

from pytest_dura.llm.port import Answer

LONGEST_DETAIL = 300
_LONGEST_WORD = 100
_FILTERED = ("content_filter", "content_policy_violation", "ResponsibleAIPolicyViolation")
"""Codes with which a server says that a content filter declined."""


def refusal_of(status: int, body: bytes) -> Answer:
    """The answer where a server tells of an error, with whatever status."""
    told, code = _error(body)
    told = told.strip() or _phrase(status)
    shown = f" ({code})" if code and code not in told else ""
    detail = words(f"HTTP {status}: {told}{shown}")
    return Answer(failure="refused" if code in _FILTERED else "unavailable", detail=detail)


def words(text: str) -> str:
    """What others said, on one line that acts on no terminal; :data:`LONGEST_DETAIL` at most."""
    line = " ".join("".join(char if char.isprintable() else " " for char in text).split())
    return line if len(line) <= LONGEST_DETAIL else line[: LONGEST_DETAIL - 1] + "…"


def word(found: Any) -> str:
    """A short text of a server's on one line; empty for anything else."""
    return words(found)[:_LONGEST_WORD] if isinstance(found, str) else ""


def _phrase(status: int) -> str:
    try:
        return HTTPStatus(status).phrase
    except ValueError:
        return "an error without words"


def _error(body: bytes) -> tuple[str, str]:
    """Message and code of an error's body, in any of the forms that servers use."""
    text = body.decode(errors="replace")
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        return text, ""
    error = found.get("error") or found if isinstance(found, dict) else found
    if not isinstance(error, dict):
        return (error if isinstance(error, str) else text), ""
    told = next((error[key] for key in ("message", "detail", "title") if error.get(key)), text)
    codes = (word(error.get(key)) for key in ("code", "type"))
    return told if isinstance(told, str) else json.dumps(told), next(filter(None, codes), "")
