"""Child: the process that carries out calls for another one, and the template that forks it."""

from __future__ import annotations

import contextlib
import ctypes
import faulthandler
import gc
import importlib
import io
import json
import logging
import mmap
import os
import signal
import socket
import struct
import sys
import threading
import warnings
from collections.abc import Callable, Mapping, Sequence
from multiprocessing import connection as connections
from pathlib import Path
from queue import SimpleQueue
from typing import IO, Any, NoReturn, cast

from pytest_dura.core.boundary import SessionWanted, end_process
from pytest_dura.core.calls import SIZE, Calls, use_calls
from pytest_dura.execution.replies import gives_way, reply_of, take_attached, tell_begun

FORKS = sys.platform != "darwin" and hasattr(os, "fork")
"""Whether children are forked. System libraries of macOS do not bear it."""
READY, BEGUN, STAYS, RETIRES = b"+", b"b", b"s", b"x"
"""The first byte of what a child writes: that it is ready, that the limit of a call begins, or a
reply, the last one or not."""
THREADS = -1
"""What stands for the number of a child where the template has threads, and forks none."""
STATUS = struct.Struct("<q")
"""Form of what a template writes of a child: its number once it is forked, then how it ended."""
_MAX_CALLS = 1000
"""Calls after which a child gives way to a fresh one, so that what a role leaves behind goes."""
MAX_MEMORY_GROWTH = 512 * 2**20
"""Bytes by which its memory may grow before it gives way: roles may leak."""
HARMED = 70
"""Exit code of a child whose connection was closed by what it called, and of a copy of it."""
_DIE_WITH_PARENT = 1
"""Of Linux: ``PR_SET_PDEATHSIG``."""


def main(
    places: Mapping[str, Any],
    memory: int | None,
    preload: Sequence[str],
    *,
    forks: bool,
) -> NoReturn:
    """Be a template, or a child of its own, until the parent is gone.

    Args:
        places: See :class:`pytest_dura.execution.children.ChildSettings`, as the next ones.
        memory: See there.
        preload: See there.
        forks: Whether to be a template.
    """
    # A key that interrupts the session reaches this process as well; the session will end it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    given = os.dup(0)
    _replace(0, os.open(os.devnull, os.O_RDWR))
    trust = importlib.import_module("pytest_dura.core.trust")
    trust.use_places(trust.Places.from_json(places))
    if forks:
        importlib.import_module("pytest_dura.execution.address").preload(preload)
        given = _fork_children(socket.socket(fileno=given))
        _serve(_connection(given), memory)
    calls: SimpleQueue[bytes] = SimpleQueue()
    connection = _connection(given)
    threading.Thread(target=_read, args=(connection, calls), daemon=True).start()
    _serve(connection, memory, calls.get)


def be_template(control: socket.socket, output: IO[bytes], memory: int | None) -> NoReturn:
    """Be a template, in a copy of the process of a session that has just been made."""
    _leave_session([os.dup(output.fileno()) for _ in range(2)])
    given = _fork_children(control, is_clean=False)
    _serve(_connection(given), memory)


def carry_out(
    call: Callable[[], bytes], connection: Any, outputs: Sequence[IO[bytes]], memory: int | None
) -> NoReturn:
    """Carry out one call, in a copy of the process of a session that has just been made."""
    _leave_session([os.dup(each.fileno()) for each in outputs])
    gc.freeze()
    _serve(connection, memory, lambda: call, most=1)


def _leave_session(outputs: Sequence[int]) -> None:
    """Let go of what pytest and its plugins did to this process for its terminal and reports."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    faulthandler.disable()  # it writes where pytest's process does
    for name in ("SIGTERM", "SIGALRM", "SIGHUP", "SIGSEGV", "SIGBUS", "SIGFPE", "SIGILL"):
        signal.signal(getattr(signal, name), signal.SIG_DFL)
    _begin_life(os.getppid(), outputs)
    _replace(0, os.open(os.devnull, os.O_RDWR))
    sys.stdin = os.fdopen(0, closefd=False)
    sys.stdout, sys.stderr = (
        io.TextIOWrapper(os.fdopen(number, "wb", 0, closefd=False)) for number in (1, 2)
    )
    faulthandler.cancel_dump_traceback_later()
    faulthandler.enable(file=sys.stderr)
    sys.unraisablehook = sys.__unraisablehook__
    threading.excepthook = threading.__excepthook__
    loggers = [logging.root, *map(logging.getLogger, tuple(logging.root.manager.loggerDict))]
    for logger in loggers:  # records go to the session, which hands them to its own handlers
        logger.handlers.clear()
    coverage = sys.modules.get("coverage")
    measured = None if coverage is None else coverage.Coverage.current()
    if measured is not None:
        measured.stop()


def _connection(descriptor: int) -> Any:
    if sys.platform == "win32":
        import msvcrt

        return connections.PipeConnection(msvcrt.get_osfhandle(descriptor))
    return connections.Connection(descriptor)


def _replace(number: int, descriptor: int) -> None:
    os.dup2(descriptor, number)
    os.close(descriptor)


def _fork_children(control: socket.socket, *, is_clean: bool = True) -> int:
    """Fork a child for each request; returns in the child, with its connection."""
    woken, wakes = os.pipe()
    os.set_blocking(wakes, False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.set_wakeup_fd(wakes, warn_on_full_buffer=False)
    if is_clean:
        gc.collect()  # of a session it would take long
    gc.freeze()  # a child that searches what was there before for garbage copies all of it
    has_threads = is_clean and native_threads() > 1  # a copy has the thread that made it
    statuses, template = dict[int, int](), os.getpid()
    while True:
        ready = connections.wait([control, woken])  # any number of open files, unlike select
        if woken in ready:
            os.read(woken, 4096)
            _reap(statuses)
        if control not in ready:
            continue
        _, given, _, _ = socket.recv_fds(control, 1, 4)
        if not given:  # whatever children are at: the parent is gone
            for pid in statuses:
                with contextlib.suppress(OSError):
                    os.killpg(pid, signal.SIGKILL)
            os._exit(0)
        connection, status, *outputs = given
        pid = THREADS if has_threads else fork()
        if pid == 0:
            for own in (control.detach(), woken, wakes, status, *statuses.values()):
                os.close(own)
            _begin_life(template, outputs)
            os.set_inheritable(connection, False)
            return connection
        os.write(status, STATUS.pack(pid))
        if pid > 0:
            statuses[pid] = status
        for number in (connection, *outputs, *(() if pid > 0 else (status,))):
            os.close(number)


def fork() -> int:
    """Fork this process, whose threads were looked at before."""
    with warnings.catch_warnings():
        # Of threads that libraries which compute end at a fork; others are looked for before.
        warnings.simplefilter("ignore", DeprecationWarning)
        return os.fork()


def native_threads() -> int:
    """How many threads this process has at a fork, those of libraries that compute left out."""
    pid = fork()  # at which they end them
    if pid == 0:
        os._exit(0)
    os.waitpid(pid, 0)
    return number_of_threads()


def number_of_threads() -> int:
    """How many threads this process has, those of libraries included where the system says so."""
    try:
        return sum(1 for _ in Path("/proc/self/task").iterdir())
    except OSError:
        return threading.active_count()


def _begin_life(template: int, outputs: Sequence[int]) -> None:
    signal.set_wakeup_fd(-1)
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    os.setsid()
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_DIE_WITH_PARENT, signal.SIGKILL)
        if os.getppid() != template:
            os._exit(1)
    for number, descriptor in enumerate(outputs, 1):
        _replace(number, descriptor)


def _reap(statuses: dict[int, int]) -> None:
    """Write to the parent how children ended."""
    with contextlib.suppress(ChildProcessError):
        while (ended := os.waitpid(-1, os.WNOHANG))[0]:
            status = statuses.pop(ended[0])
            with contextlib.suppress(OSError):
                os.write(status, STATUS.pack(ended[1]))
            os.close(status)


def _read(connection: Any, calls: SimpleQueue[bytes]) -> None:
    """Queue calls, and end this process with its parent, whatever the main thread is at."""
    with contextlib.suppress(EOFError, OSError):
        while True:
            calls.put(connection.recv_bytes())
    if hasattr(os, "killpg") and os.getpgrp() == os.getpid():
        os.killpg(0, signal.SIGKILL)
    os._exit(0)


def _serve(
    connection: Any,
    memory: int | None,
    receive: Callable[[], bytes | Callable[[], bytes]] | None = None,
    most: int = _MAX_CALLS,
) -> NoReturn:
    """Carry out calls, so many at most, until the connection ends."""
    for stream in cast("tuple[Any, Any]", (sys.stdout, sys.stderr)):
        stream.reconfigure(encoding="utf-8", errors="backslashreplace", write_through=True)
    sys.breakpointhook = _want_terminal
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_parent=_note_fork)
    own, pid = _identity(connection), os.getpid()

    def check(number: int) -> None:
        if os.getpid() != pid:  # a copy, also one that was made in C
            end_process(HARMED)
        if _forks_of_calls:
            calls.note_copy(number)
            os.kill(pid, signal.SIGKILL)
        if _identity(connection) != own:
            end_process(HARMED)

    calls = Calls(mmap.mmap(1, SIZE), check)
    use_calls(calls)
    tell_begun(lambda: connection.send_bytes(BEGUN))
    _limit_memory(memory)
    first: int | None = None
    connection.send_bytes(READY)
    try:
        for count in range(1, most + 1):
            head, reply = _reply_to((receive or connection.recv_bytes)())
            used = _memory()
            first = used if first is None else first
            has_room = count < most and used - first <= MAX_MEMORY_GROWTH
            stays = has_room and not gives_way()
            if not stays:
                _close_simulators()
            connection.send_bytes(b"".join((STAYS if stays else RETIRES, head, b"\n", reply)))
            if not stays:
                break
    except (EOFError, OSError):  # the parent is gone
        _close_simulators()
        os._exit(1)
    os._exit(0)  # also with threads that roles left behind


_STARTS_PROGRAMS = ("multiprocessing", "subprocess", "concurrent")
"""Packages that fork for a program of its own: such a copy never returns to the loop."""
_forks_of_calls: list[int] = []
"""Forks of this process that what it called has made, other than by these packages."""


def _note_fork() -> None:
    caller = str(sys._getframe(1).f_globals.get("__name__"))  # noqa: SLF001 - calls os.fork
    if caller.partition(".")[0] not in _STARTS_PROGRAMS:
        _forks_of_calls.append(os.getpid())


def _want_terminal(*_: Any, **__: Any) -> None:
    if os.environ.get("PYTHONBREAKPOINT") != "0":  # by which users switch breakpoints off
        raise SessionWanted("it opens a debugger")


def _identity(connection: Any) -> tuple[int, int] | None:
    if sys.platform == "win32":
        return None
    try:
        status = os.fstat(connection.fileno())
    except OSError:
        return None
    return status.st_dev, status.st_ino


def _reply_to(request: bytes | Callable[[], bytes]) -> tuple[bytes, bytes]:
    if callable(request):
        reply = reply_of(request)
    else:
        named = json.loads(request)
        module, _, name = named["function"].partition(":")

        def call(*args: Any, **kwargs: Any) -> bytes:
            return cast("bytes", getattr(importlib.import_module(module), name)(*args, **kwargs))

        reply = reply_of(call, *named["args"], **named["kwargs"])
    return json.dumps(take_attached()).encode(), reply


def _close_simulators() -> None:
    """Close what simulators started in this process, if any was loaded."""
    module = sys.modules.get("pytest_dura.core.simulator_process")
    if module is not None:
        module.close_classes()


def _limit_memory(memory: int | None) -> None:
    if memory is None or sys.platform == "win32":
        return
    import resource

    has = int(Path("/proc/self/statm").read_bytes().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (has + memory, resource.RLIM_INFINITY))


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
