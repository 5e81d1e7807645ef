"""Worker: the process that simulates for another one; calls on its input, replies on its output.

A reply is plain data, errors included. The module imports nothing of the package but errors, so
that a worker starts quickly.
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
_FIELDS = ("problem", "file", "line", "key", "found", "expected", "remedy")
"""Attributes of a ConfigurationError."""


class ProcessLostError(DuraError):
    """Error for an episode that ended every process that it was given to, or overran its limit."""


class CallFailedError(DuraError):
    """Error for a call in another process that raised anything unexpected there."""


class _Shown:
    """Stand-in for a value of another process, with the same ``repr``."""

    def __init__(self, text: str) -> None:
        self._text = text

    def __repr__(self) -> str:
        return self._text


def reply_of(function: Callable[..., bytes], *args: Any, **kwargs: Any) -> bytes:
    """Call a function, and return its result, or what it raised, as a reply."""
    try:
        return _RESULT + function(*args, **kwargs)
    except BaseException as error:  # whatever user code raises is raised where the call came from
        return _reply_of_error(error)


def _reply_of_error(error: BaseException) -> bytes:
    if isinstance(error, ConfigurationError):
        fields = {name: getattr(error, name) for name in _FIELDS}
        if error.found is not None:
            fields["found"] = shorten(error.found)
        return _CONFIGURATION + json.dumps(fields).encode()
    if isinstance(error, ProcessLostError):
        return _LOST + str(error).encode()
    return _FAILED + describe_error(error).encode()


def result_of(reply: bytes) -> bytes:
    """Take the result of a call out of its reply.

    Raises:
        ConfigurationError: As it was raised there; its ``found`` only looks like the value there.
        ProcessLostError: If the episode ended the processes that it was given to.
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


_MAX_CALLS = 1000
"""Calls after which a process gives way to a fresh one, so that what a role leaves behind goes."""
MAX_MEMORY_GROWTH = 512 * 2**20
"""Bytes by which its memory may grow before it gives way: roles may leak."""
READY, BEGUN, STAYS, RETIRES = b"+", b"b", b"s", b"x"
"""The first byte of what it writes: that it is ready, that the limit of a call begins, or a reply,
the last one or not."""
SECONDS_TO_START = 300.0
"""What a process has for its start, and a call for its imports: a disk that many processes read at
once is slow."""
_LENGTH = 8
_MARGIN = SECONDS_TO_START + 60.0
"""Seconds after its limit at which a call ends the process by itself: its parent is gone."""
_REPLIES: list[IO[bytes]] = []
"""Where this process writes to the one that it simulates for, if there is one."""


def begin() -> None:
    """Let the limit of the call that this process carries out begin: its imports are over.

    Called by each function with a limit, which has :data:`SECONDS_TO_START` until then.
    """
    for replies in _REPLIES:
        write_frame(replies, BEGUN)


def write_frame(stream: IO[bytes], *parts: bytes) -> None:
    """Write one message.

    Raises:
        OSError: If the pipe is closed.
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


def main(places: dict[str, Any]) -> None:
    """Carry out calls until the input ends.

    Args:
        places: Where code that files name may come from, see ``core.trust.Places.to_json``.
    """
    calls, replies = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    _REPLIES.append(replies)
    # A key that interrupts the session reaches this process as well; the session will end it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    requests: SimpleQueue[bytes] = SimpleQueue()
    threading.Thread(target=_read, args=(calls, requests), daemon=True).start()
    write_frame(replies, READY)
    trust = importlib.import_module("pytest_dura.core.trust")
    trust.use_places(trust.Places.from_json(places))
    # From now on nothing that is printed here gets into the terminal or between the replies.
    null = os.open(os.devnull, os.O_RDWR)
    for number in range(3):
        os.dup2(null, number)
    first: int | None = None
    for count in range(1, _MAX_CALLS + 1):
        reply = _reply_to(json.loads(requests.get()))
        memory = _memory()
        first = memory if first is None else first
        stays = count < _MAX_CALLS and memory - first <= MAX_MEMORY_GROWTH
        if not stays:
            _close_simulators()
        try:
            write_frame(replies, STAYS if stays else RETIRES, reply)
        except OSError:  # the parent is gone
            _close_simulators()
            os._exit(1)
        if not stays:
            os._exit(0)  # also with threads that roles left behind


def _close_simulators() -> None:
    """Close what simulators started in this process, if any was loaded."""
    module = sys.modules.get("pytest_dura.core.simulator_process")
    if module is not None:
        module.close_classes()


def _read(calls: IO[bytes], requests: SimpleQueue[bytes]) -> None:
    while (request := read_frame(calls)) is not None:
        requests.put(request)
    # Whatever the main thread is doing, and whatever it has started: the parent is gone.
    if hasattr(os, "killpg") and os.getpgrp() == os.getpid():
        os.killpg(0, signal.SIGKILL)
    os._exit(0)


def _reply_to(request: dict[str, Any]) -> bytes:
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
    """Bytes of memory that this process has; 0 where the system does not tell."""
    try:
        # The peak that getrusage tells is on Linux that of its parent, if higher.
        pages = Path("/proc/self/statm").read_bytes().split()[1]
        return int(pages) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        pass
    if sys.platform == "win32":
        return 0
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024
