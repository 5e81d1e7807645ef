"""Plain data: mappings, lists, tuples, texts and numbers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def plain_copy(value: Any) -> Any:
    """A copy of plain data, down to the last container."""
    if isinstance(value, Mapping):
        return {key: plain_copy(item) for key, item in value.items()}
    if isinstance(value, list):
        return [plain_copy(item) for item in value]
    return tuple(plain_copy(item) for item in value) if isinstance(value, tuple) else value
