"""Mismatches: where data does not agree with its type, in words that a terminal can show."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

MAX_MISMATCHES = 20
"""Mismatches that are reported; data of another form would have thousands."""
_SHOWN_CHARACTERS = 60


class Mismatch(NamedTuple):
    """Place at which data does not agree with its type.

    Args:
        pointer: JSON pointer of the place.
        found: What is there, or what is wrong with it.
        expected: What would have been accepted; empty if ``found`` says it.
    """

    pointer: str
    found: str
    expected: str = ""

    def __str__(self) -> str:
        """Describe it on one line."""
        what = f"found {self.found}, expected {self.expected}" if self.expected else self.found
        return f"{self.pointer}: {what}"


class MismatchError(ValueError):
    """Data that does not agree with its type.

    Args:
        mismatches: The first of them, at least one.
    """

    def __init__(self, mismatches: Sequence[Mismatch]) -> None:
        super().__init__("\n".join(map(str, mismatches)))
        self.mismatches = tuple(mismatches)


# The place of a value: the place of what holds it, and its key there.
Place = tuple[Any, "str | int"] | None


class EnoughError(Exception):
    """As many mismatches as are reported."""


class Mismatches(list[Mismatch]):
    """Collects mismatches.

    Args:
        most: How many are reported.
    """

    def __init__(self, most: int) -> None:
        super().__init__()
        self.most = most

    def add(self, place: Place, found: str, expected: str = "") -> Any:
        """Note a mismatch; returns ``None``.

        Raises:
            EnoughError: If as many are noted as are reported.
        """
        self.append(Mismatch(pointer_of(place), found, expected))
        if len(self) >= self.most:
            raise EnoughError


KINDS: dict[type, str] = {
    type(None): "null", bool: "boolean", int: "integer", float: "number", str: "string",
    dict: "object", list: "array",
}  # fmt: skip
"""Names of JSON types."""


def kind_of(value: Any) -> str:
    """Name the JSON type of a value; truth values, null and what is not finite by themselves."""
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, float) and not math.isfinite(value):
        return json.dumps(value)
    return KINDS.get(type(value), type(value).__name__)


def shown(value: Any) -> str:
    """Show a value in a message, in ASCII: whatever stands there, a terminal can show it."""
    try:
        text = json.dumps(value)
    except (TypeError, ValueError, RecursionError):
        text = ascii(value)
    return text if len(text) <= _SHOWN_CHARACTERS else f"{text[: _SHOWN_CHARACTERS - 3]}..."


def key_list(keys: Sequence[str]) -> str:
    """List the first keys in a message."""
    more = f" and {len(keys) - 5} more" if len(keys) > 5 else ""
    return ", ".join(map(shown, keys[:5])) + more


def pointer(path: Iterable[str | int]) -> str:
    """Write a path as a JSON pointer; what cannot be printed is escaped."""
    parts = (str(part).replace("~", "~0").replace("/", "~1") for part in path)
    return "".join(f"/{part if part.isprintable() else ascii(part)[1:-1]}" for part in parts) or "/"


def pointer_of(place: Place) -> str:
    """Write a place as a JSON pointer."""
    path: list[str | int] = []
    while place is not None:
        place, key = place
        path.append(key)
    return pointer(reversed(path))
