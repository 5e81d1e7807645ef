"""Calls under way, in bytes that another process can read: whose code ran when this one ended.

The loop writes the tick, and before each call into a role, the simulator or the component the
name of whoever is called. A process that ends leaves these bytes to its parent.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

_TICK = struct.Struct("<i")
_NAME = slice(_TICK.size, 64)
SIZE = _NAME.stop
"""Bytes that are shared."""
COMPONENT = "generator"
"""Name of the role that wraps the component under test."""
_IDLE = bytes(SIZE - _TICK.size)


class Calls:
    """The call under way in a process.

    Args:
        shared: Bytes that the parent reads, or any others.
        check: Called after each call, which may have harmed the process.
    """

    def __init__(self, shared: Any = None, check: Callable[[], None] | None = None) -> None:
        self._shared = bytearray(SIZE) if shared is None else shared
        self._check = check
        self._names: dict[str, bytes] = {}

    def at(self, tick: int) -> None:
        """Write the tick that begins."""
        _TICK.pack_into(self._shared, 0, tick)

    def begin(self, name: str) -> None:
        """Write whose call begins."""
        written = self._names.get(name)
        if written is None:
            encoded = name.encode()[: len(_IDLE)]
            written = self._names[name] = encoded.ljust(len(_IDLE), b"\0")
        self._shared[_NAME] = written

    def end(self) -> None:
        """Write that the call is over."""
        if self._check is not None:
            self._check()
        self._shared[_NAME] = _IDLE

    @contextmanager
    def calling(self, name: str) -> Iterator[None]:
        """Context of one call."""
        self.begin(name)
        try:
            yield
        finally:
            self.end()


_calls = Calls()
"""Of the whole process: a parent asks what its child was at."""


def current_calls() -> Calls:
    """Return the calls of this process."""
    return _calls


def use_calls(calls: Calls) -> Calls:
    """Set the calls of this process; returns those that held before."""
    global _calls
    before, _calls = _calls, calls
    return before


def read_call(shared: bytes) -> tuple[str, int]:
    """Read whose call was under way, empty for none, and the tick."""
    name = shared[_NAME].rstrip(b"\0").decode(errors="replace")
    return name, _TICK.unpack_from(shared)[0]
