"""Room for the frames of calls that are made deep in the stack."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

_SLOTS = 17_000
_SOURCE = f"""
def with_room(call, *, never=False):
    if never:
        return ({"call, " * _SLOTS})
    return call()
"""


def _made() -> Callable[..., Any]:
    made: dict[str, Any] = {}
    exec(_SOURCE, made)
    return made["with_room"]


with_room = _made()
"""Calls a function below a frame of its own that is large, and so is what Python allocates for it.

Python allocates the frames of calls by 16 KB, and frees them when the calls return. A loop whose
calls lie at the end of such a piece has one allocated and freed for each: in a session that runs
within a test, hundreds of calls deep, thousands of times a second.
"""
