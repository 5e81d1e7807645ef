"""The process that simulates for another one: calls on its input, replies on its output.

A reply is plain data, errors included. Imports nothing of the package at its top but errors.
"""

from __future__ import annotations

import faulthandler
import importlib
import json
import os
import signal
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from queue import SimpleQueue
from typing import IO, Any

from pytest_dura.core.errors import ConfigurationError, DuraError, describe_error, shorten

_RESULT, _CONFIGURATION, _LOST, _FAILED = b"r", b"c", b"l", b"f"


class ProcessLostError(DuraError):
    """An episode ended every process that it was given to, or never came back from one."""


class CallFailedError(DuraError):
    """What was called in another process raised something that nobody expected there."""


class _Shown:
    """Stands for a value of another process, and looks like it."""

    def __init__(self, text: str) -> None:
        self._text = text

    def __repr__(self) -> str:
        return self._text


def reply_of(function: Callable[..., bytes], *args: Any, **kwargs: Any) -> bytes:
    """What a call comes to: its result, or what it raised."""
    try:
        return _RESULT + function(*args, **kwargs)
    except BaseException as error:  # whatever user code raises is told to who asked
        return _reply_of_error(error)


def _reply_of_error(error: BaseException) -> bytes:
    """What stands for an error."""
    if isinstance(error, ConfigurationError):
        told = {name: getattr(error, name) for name in _FIELDS}
        if error.found is not None:
            told["found"] = shorten(error.found)
        return _CONFIGURATION + json.dumps(told).encode()
    if isinstance(error, ProcessLostError):
        return _LOST + str(error).encode()
    return _FAILED + describe_error(error).encode()


def result_of(reply: bytes) -> bytes:
    """The result of a call.

    Raises:
        ConfigurationError: As it was raised there, its values apart, which look like they did.
        ProcessLostError: If no process could tell.
        CallFailedError: For anything else that was raised there.
    """
    kind, body = reply[:1], reply[1:]
    if kind == _RESULT:
        return body
    if kind == _CONFIGURATION:
        data = json.loads(body)
        if data["found"] is not None:
            data["found"] = _Shown(data["found"])
        raise ConfigurationError(**data)
    if kind == _LOST:
        raise ProcessLostError(body.decode())
    raise CallFailedError(f"a process that simulates failed: {body.decode(errors='replace')}")


_FIELDS = ("problem", "file", "line", "key", "found", "expected", "remedy")


_MAX_CALLS = 1000
"""Calls after which a process gives way to a fresh one, so that what a role leaves behind goes."""
MAX_MEMORY_GROWTH = 512 * 2**20
"""Bytes by which its memory may grow before it gives way, against a role that leaks."""
READY, STAYS, RETIRES = b"+", b"s", b"x"
"""The first byte of what it writes: that it is ready, or a reply, the last one or not."""
_LENGTH = 8
_MARGIN = 60.0
"""Seconds after its limit when a call ends the process by itself: nobody is there to do it."""


def write_frame(stream: IO[bytes], *parts: bytes) -> None:
    """Write one message.

    Raises:
        OSError: If nobody reads it any more.
    """
    stream.write(sum(map(len, parts)).to_bytes(_LENGTH, "big"))
    stream.writelines(parts)
    stream.flush()


def read_frame(stream: IO[bytes]) -> bytes | None:
    """The next message; ``None`` if there is none, or no whole one."""
    head = stream.read(_LENGTH)
    if len(head) < _LENGTH:
        return None
    size = int.from_bytes(head, "big")
    data = stream.read(size)
    return data if len(data) == size else None


def main() -> None:
    """Carry out calls until the input ends."""
    calls, replies = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    # A key that interrupts the session reaches this process as well; the session will end it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    requests: SimpleQueue[bytes] = SimpleQueue()
    threading.Thread(target=_read, args=(calls, requests), daemon=True).start()
    write_frame(replies, READY)
    # From now on nothing that is printed here gets into the terminal or between the replies.
    null = os.open(os.devnull, os.O_RDWR)
    for number in range(3):
        os.dup2(null, number)
    first: int | None = None
    for count in range(1, _MAX_CALLS + 1):
        reply = _carried_out(json.loads(requests.get()))
        memory = _memory()
        first = memory if first is None else first
        stays = count < _MAX_CALLS and memory - first <= MAX_MEMORY_GROWTH
        try:
            write_frame(replies, STAYS if stays else RETIRES, reply)
        except OSError:  # nobody is interested any more
            os._exit(1)
        if not stays:
            os._exit(0)  # also with threads that roles left behind


def _read(calls: IO[bytes], requests: SimpleQueue[bytes]) -> None:
    while (request := read_frame(calls)) is not None:
        requests.put(request)
    # Whatever the main thread is doing, and whatever it has started: nobody waits for it.
    if hasattr(os, "killpg") and os.getpgrp() == os.getpid():
        os.killpg(0, signal.SIGKILL)
    os._exit(0)


def _carried_out(request: dict[str, Any]) -> bytes:
    seconds = request["kwargs"].get("seconds")
    if seconds is not None:
        # Also out of code that never lets another thread run.
        faulthandler.dump_traceback_later(seconds + _MARGIN, exit=True, file=2)
    try:
        module, _, name = request["function"].partition(":")
        function = getattr(importlib.import_module(module), name)
        return reply_of(function, *request["args"], **request["kwargs"])
    finally:
        if seconds is not None:
            faulthandler.cancel_dump_traceback_later()


def _memory() -> int:
    """Bytes of memory that this process has; 0 where that is not told."""
    try:
        # The peak that getrusage tells is on Linux that of whoever started this process, if higher.
        split = Path("/proc/self/statm").read_bytes().split()
        return int(split[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        pass
    if sys.platform == "win32":
        return 0
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024
