"""Calls under way, in bytes that another process can read: whose code ran when this one ended.

The loop writes the tick, and before each call into a role, the simulator or the component the
name of the role that is called. A process that ends leaves these bytes to its parent.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

_TICK = struct.Struct("<i")
AT = _TICK.size
"""Place of the byte that says who is being called: a number of :class:`Calls`, 0 for no role."""
_TABLE = AT + 1
SIZE = 2048
"""Bytes that are shared: the tick, who is being called, a table of names, one a line, and in which
call at which tick the process made a copy of itself."""
_COPY = SIZE - _TICK.size - 1
COMPONENT = "generator"
"""Name of the role that wraps the component under test."""
_MANY = 255
"""Number of all names for which there is no other one, and which the parent does not learn."""


class _Numbers(dict[str, int]):
    """Numbers of names; a new name gets the next one, and is written into the table."""

    def __init__(self, shared: Any) -> None:
        super().__init__()
        self._shared = shared

    def __missing__(self, name: str) -> int:
        number = len(self) + 1
        lines = "\n".join([" ".join(each.split()) for each in (*self, name)])
        table = lines.encode(errors="replace")
        if number >= _MANY or len(table) > _COPY - _TABLE:
            return _MANY
        self[name] = number
        self._shared[_TABLE : _TABLE + len(table)] = table
        return number


class Calls:
    """The call under way in a process.

    The loop, of whose time two method calls for each call would be a twentieth, writes
    ``shared[AT] = numbers[name]`` before a call, and afterwards calls ``check`` with that number,
    if there is one, and writes ``shared[AT] = 0``.

    Args:
        shared: Bytes that the parent reads, or any others.
        check: Called after each call, which may have harmed the process.
    """

    def __init__(self, shared: Any = None, check: Callable[[int], None] | None = None) -> None:
        self.shared = bytearray(SIZE) if shared is None else shared
        self.tick = 0
        self.check = check
        self.numbers = _Numbers(self.shared)
        _ = self.numbers[COMPONENT]  # which is to be known, whatever else is called

    def at(self, tick: int) -> None:
        """Write the tick that begins."""
        self.tick = tick
        _TICK.pack_into(self.shared, 0, tick)

    def note_copy(self, number: int) -> None:
        """Write that the process is a copy, which this call has made of the one that is known."""
        _TICK.pack_into(self.shared, _COPY + 1, self.tick)
        self.shared[_COPY] = number

    @contextmanager
    def calling(self, name: str) -> Iterator[None]:
        """Context of one call."""
        number = self.shared[AT] = self.numbers[name]
        try:
            yield
        finally:
            if self.check is not None:
                self.check(number)
            self.shared[AT] = 0


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


@dataclass(frozen=True)
class CallUnderWay:
    """Call in which a process ended.

    Args:
        name: Of the role; empty for none.
        tick: At which tick.
        copied: Whether it made a copy of its process, which is why that was ended.
    """

    name: str
    tick: int
    copied: bool = False


def read_call(shared: bytes) -> CallUnderWay:
    """Read which call was under way."""
    names = shared[_TABLE:_COPY].rstrip(b"\0").decode(errors="replace").split("\n")
    copied = shared[_COPY] > 0
    number, place = (shared[_COPY], _COPY + 1) if copied else (shared[AT], 0)
    name = names[number - 1] if 0 < number <= len(names) else ""
    return CallUnderWay(name, _TICK.unpack_from(shared, place)[0], copied)
