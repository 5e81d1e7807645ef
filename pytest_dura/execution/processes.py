"""ProcessPool: an executor whose processes may end in the middle of a call."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import IO, Any, ParamSpec, TypeVar, cast

from pytest_dura.core.errors import DuraError
from pytest_dura.core.trust import Places, current_places
from pytest_dura.execution.executors import ExecutorKind, cancel_queued
from pytest_dura.execution.worker import (
    BEGUN,
    READY,
    RETIRES,
    SECONDS_TO_START,
    CallFailedError,
    ProcessLostError,
    read_frame,
    result_of,
    write_frame,
)

_START = (
    "import json, sys; given = json.loads(sys.argv.pop()); sys.path[:] = given['path']; "
    "from pytest_dura.execution.worker import main; main(given['places'])"
)
_SECONDS_TO_END = 10.0
"""How long the pool waits for a process that was killed, or closed its output."""
_POLL_SECONDS = 1.0
"""Seconds from one check to the next whether a process still exists."""


@dataclass(frozen=True)
class ProcessEnvironment:
    """Import path and folder of a process, and which of its folders are strangers'.

    Args:
        path: Where it imports from: ``sys.path``.
        folder: The folder that it works in.
        places: Where code that files name may come from, see :meth:`Places.to_json`.
    """

    path: Sequence[str]
    folder: str
    places: Mapping[str, Any] = field(default_factory=Places().to_json)

    @classmethod
    def here(cls) -> ProcessEnvironment:
        """Those of this process, as they are now."""
        folder = Path.cwd()
        path = [str(folder / entry) for entry in sys.path]
        return cls(path, str(folder), current_places().to_json())


class WorkerEndedError(Exception):
    """Error for a process that ended before its reply; ``seconds`` is the limit it overran."""

    def __init__(self, how: str, seconds: float | None = None) -> None:
        self.seconds = seconds
        super().__init__(how)


@dataclass(frozen=True)
class _Limit:
    """Limit of a wait for a process; ``overrun`` is set when it is ended for that."""

    seconds: float | None
    what: str
    """What takes the time, as the error says it."""
    overrun: threading.Event = field(default_factory=threading.Event)


class WorkerProcess:
    """A process that carries out one call at a time.

    It has a session of its own, so that a key pressed in the terminal does not reach it. No wait
    for it rests on the end of its output alone, which a process that it left behind may hold open.

    Args:
        environment: Where it imports from and works.

    Raises:
        CallFailedError: If it cannot be started.
    """

    def __init__(self, environment: ProcessEnvironment) -> None:
        command = [sys.executable, *["-O"] * sys.flags.optimize, "-c", _START]
        places = dict(environment.places)
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115 - closed in `end`
        try:
            self._process = subprocess.Popen(
                [*command, json.dumps({"path": list(environment.path), "places": places})],
                cwd=environment.folder,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._errors,
                start_new_session=True,
            )
        except OSError as error:
            self._errors.close()
            raise CallFailedError(f"no process can be started: {error}") from None
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._calls = self._process.stdin
        self._replies: SimpleQueue[bytes | None] = SimpleQueue()
        """Frames as they come; ``None`` at the end."""
        self._reader = threading.Thread(
            target=self._read, args=(self._process.stdout,), name="dura-replies", daemon=True
        )
        self._reader.start()
        self._over = False

    def wait_until_ready(self) -> None:
        """Wait until it takes calls.

        Raises:
            CallFailedError: If it never does; then it is ended.
        """
        try:
            with self._limited(SECONDS_TO_START, "its start") as limit:
                ready = self._reply(limit) == READY
            how = "it wrote something else"
        except WorkerEndedError as ended:
            ready, how = False, str(ended)
        if ready:
            return
        self._errors.seek(0)
        printed = self._errors.read().decode(errors="replace").strip()
        self.end()
        raise CallFailedError(f"a process that simulates did not start: {printed or how}")

    @property
    def pid(self) -> int:
        """The number of the process."""
        return self._process.pid

    @property
    def is_alive(self) -> bool:
        """Whether it has not ended, as far as is known."""
        return not self._over and self._process.poll() is None

    def call(
        self, function: str, args: Sequence[Any], kwargs: Mapping[str, Any]
    ) -> tuple[bytes, bool]:
        """The reply to a call, and whether the process stays for another one.

        Args:
            function: ``package.module:name``.
            args: Plain data.
            kwargs: Plain data; ``seconds`` is the limit of the call once it has begun.

        Raises:
            WorkerEndedError: If there is no reply: the process ended, or was ended after so long.
        """
        request = {"function": function, "args": list(args), "kwargs": dict(kwargs)}
        data, seconds = json.dumps(request).encode(), kwargs.get("seconds")
        with self._limited(None if seconds is None else SECONDS_TO_START, "its imports") as limit:
            try:
                write_frame(self._calls, data)  # a process that was stopped reads nothing
            except OSError:
                raise self._ended(limit) from None
            reply = self._reply(limit)
        if reply == BEGUN:
            with self._limited(seconds, "it") as limit:
                reply = self._reply(limit)
        return reply[1:], reply[:1] != RETIRES

    def kill(self) -> None:
        """End it and what it started. Its call raises in the thread that waits for the reply."""
        if hasattr(os, "killpg"):
            with suppress(ProcessLookupError, PermissionError):  # all of them have ended
                os.killpg(self._process.pid, signal.SIGKILL)
        self._process.kill()

    def end(self) -> None:
        """End it, and close its pipes and files here. A second call does nothing."""
        if self._over:
            return
        self._over = True
        self.kill()
        with suppress(subprocess.TimeoutExpired):  # the kernel does not let go of it
            self._process.wait(_SECONDS_TO_END)
        self._reader.join(_POLL_SECONDS)
        with suppress(OSError):  # of a request that it never read
            self._calls.close()
        self._errors.close()

    def _read(self, stream: IO[bytes]) -> None:
        """Queue what it writes, in a thread of its own, which alone touches the stream."""
        with stream:
            frame: bytes | None = b""
            while frame is not None:
                try:
                    frame = read_frame(stream)
                except Exception:  # whatever is written there that is no reply
                    frame = None
                self._replies.put(frame)

    @contextmanager
    def _limited(self, seconds: float | None, what: str) -> Iterator[_Limit]:
        """Context that ends the process after so many seconds."""
        limit = _Limit(seconds, what)

        def end_late() -> None:
            limit.overrun.set()
            self.kill()

        if seconds is None:
            yield limit
            return
        timer = threading.Timer(seconds, end_late)
        timer.daemon = True
        timer.start()
        try:
            yield limit
        finally:
            timer.cancel()

    def _reply(self, limit: _Limit) -> bytes:
        over = False
        while (frame := self._next()) == b"" and not over:
            over = limit.overrun.is_set() or not self.is_alive  # what it wrote is on its way
        if not frame:  # also if a process that it left behind holds its output open
            raise self._ended(limit)
        return frame

    def _next(self) -> bytes | None:
        """The next frame; ``None`` behind the last one, and ``b""`` if none comes for a while."""
        try:
            return self._replies.get(timeout=_POLL_SECONDS)
        except Empty:
            return b""

    def _ended(self, limit: _Limit) -> WorkerEndedError:
        if limit.overrun.is_set():
            return WorkerEndedError(
                f"{limit.what} took longer than {limit.seconds:g} s", limit.seconds
            )
        return WorkerEndedError(self._how_it_ended())

    def _how_it_ended(self) -> str:
        try:
            code = self._process.wait(_SECONDS_TO_END)
        except subprocess.TimeoutExpired:  # it closed its output, and goes on
            return "it closed the pipe to the session"
        if code >= 0 or os.name == "nt":
            return f"it ended with exit code {code}"
        try:
            return f"it was ended by {signal.Signals(-code).name}"
        except ValueError:
            return f"it was ended by signal {-code}"


T = TypeVar("T")
P = ParamSpec("P")

_MAX_LOST = 2
"""Processes that a call may end before it is given up."""
MAX_STARTS = 3
"""How often a process is started for a call before the call fails: it may be killed, or get no
memory, before it takes any call, which says nothing about the call."""
_IDLE_SECONDS = 60.0
"""Seconds without a call after which a process ends; the next call starts another."""
_SESSION_ENDED = "the session ended before the episode did"


def usable_cores() -> int:
    """How many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@dataclass
class _Call:
    """A call, and the future of its reply."""

    function: str
    args: tuple[Any, ...]
    kwargs: dict[str, Any]
    future: Future[bytes] = field(default_factory=Future)


class ProcessPool(Executor):
    """Pool of processes that each carry out one call at a time, each with a thread of this one.

    A process that ends in the middle takes nothing with it but its own call, which another process
    is given. So it is known which call ended which process: one that ended two is given up, and so
    is one that overran its limit, after which its process is killed. Calls are named and their
    arguments are plain data, and so are results and errors; nothing is pickled.

    Args:
        width: How many processes at most; they are started when they are needed.
        environment: Where they import from and work; by default as this process at the first call.
    """

    imports_same_files = True
    """Whether an import path leads to the same file there as here."""

    def __init__(self, width: int, environment: ProcessEnvironment | None = None) -> None:
        self.width = width
        self._environment = environment
        self._calls: SimpleQueue[_Call | None] = SimpleQueue()
        self._lock = threading.Lock()
        self._threads: list[threading.Thread] = []
        self._children: dict[threading.Thread, WorkerProcess] = {}
        self._unfinished = 0
        self._closed = self._killing = False

    @property
    def pids(self) -> list[int]:
        """The numbers of the processes that there are now."""
        with self._lock:
            return [child.pid for child in self._children.values()]

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """The future of a call in one of the processes.

        Args:
            fn: A function at the top of a module, which returns bytes.
            args: Plain data.
            kwargs: Plain data; ``seconds`` is also the limit that the call is held to once it has
                begun; see :func:`pytest_dura.execution.worker.begin`.
        """
        call = _Call(f"{fn.__module__}:{fn.__name__}", args, kwargs)
        with self._lock:
            if self._closed:
                raise RuntimeError("the pool is closed")
            if self._environment is None:
                self._environment = ProcessEnvironment.here()
            self._unfinished += 1
            self._calls.put(call)
            if len(self._threads) < min(self.width, self._unfinished):
                thread = threading.Thread(target=self._serve, name="dura-pool", daemon=True)
                self._threads.append(thread)
                thread.start()
        return cast("Future[T]", call.future)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes.

        Args:
            wait: Whether what was begun is carried out before that.
            cancel_futures: Whether what was not begun is given up.
        """
        with self._lock:
            self._closed = True
            self._killing = not wait
            if cancel_futures or not wait:
                cancel_queued(self._calls)
            threads = list(self._threads)
            for _ in threads:
                self._calls.put(None)
            if not wait:
                for child in self._children.values():
                    child.kill()
        for thread in threads:
            thread.join()  # what has been killed ends at once

    def _serve(self) -> None:
        """Hand calls to a process, one after the other, in a thread of the pool."""
        child: WorkerProcess | None = None
        try:
            while True:
                try:
                    call = self._calls.get(timeout=_IDLE_SECONDS)
                except Empty:
                    if self._retire():
                        return
                    continue
                if call is None:
                    return
                if call.future.set_running_or_notify_cancel():
                    child = self._carry_out(call, child)
                with self._lock:
                    self._unfinished -= 1
        finally:
            self._end(child)

    def _retire(self) -> bool:
        """Take this thread out of the pool if no call is left, under the lock of `submit`."""
        with self._lock:
            if self._closed or not self._calls.empty():
                return False
            self._threads.remove(threading.current_thread())
            return True

    def _carry_out(self, call: _Call, child: WorkerProcess | None) -> WorkerProcess | None:
        """Carry out a call, and return the process that the next one may have."""
        lost = 0
        while True:
            try:
                child = self._ready(child)
                reply, stays = child.call(call.function, call.args, call.kwargs)
            except WorkerEndedError as ended:
                self._end(child)
                child, lost = None, lost + 1
                error = self._error_of(ended, lost)
                if error is None:
                    continue
                call.future.set_exception(error)
            except Exception as error:  # none can be started, an argument is no plain data
                call.future.set_exception(error)
            else:
                _resolve(call.future, reply)
                if not stays:
                    self._end(child)
                    child = None
            return child

    def _error_of(self, ended: WorkerEndedError, lost: int) -> Exception | None:
        """The error of a call that lost its process; ``None`` if another process gets the call."""
        if self._killing:
            return CallFailedError(_SESSION_ENDED)
        if ended.seconds is not None:
            return ProcessLostError(f"its process was ended, since {ended}")
        if lost >= _MAX_LOST:
            return ProcessLostError(f"it ended {lost} processes that simulated it: {ended}")
        return None

    def _ready(self, child: WorkerProcess | None) -> WorkerProcess:
        """A process that takes calls: the one at hand, or a fresh one.

        Raises:
            CallFailedError: If none can be started, in as many attempts as there are.
        """
        if child is not None and child.is_alive:
            return child
        self._end(child)
        for left in reversed(range(MAX_STARTS)):
            fresh = None
            try:
                fresh = self._start()
                fresh.wait_until_ready()
            except CallFailedError:
                self._end(fresh)
                if self._killing or not left:
                    raise
            else:
                return fresh
        raise AssertionError("unreachable")

    def _start(self) -> WorkerProcess:
        """Start a process; it is known at once, so that the end of the pool reaches it."""
        assert self._environment is not None
        with self._lock:
            if self._killing:
                raise CallFailedError(_SESSION_ENDED)
        child = WorkerProcess(self._environment)
        with self._lock:
            self._children[threading.current_thread()] = child
            if self._killing:
                child.kill()
        return child

    def _end(self, child: WorkerProcess | None) -> None:
        if child is not None:
            with self._lock:
                self._children.pop(threading.current_thread(), None)
            child.end()


class Processes(ExecutorKind):
    """Processes of this machine: as many as it has usable cores, or the number that is given."""

    form = "processes, or processes:N with N of 1 to 9999"

    def __init__(self, argument: str) -> None:
        if argument and not re.fullmatch("[1-9][0-9]{0,3}", argument):
            raise ValueError(argument)
        self._count = int(argument) if argument else usable_cores()
        self.local_processes = self._count
        self.where = f"in {self.local_processes} processes"

    def start(self) -> ProcessPool:
        """Make the pool."""
        return ProcessPool(self._count)


def _resolve(future: Future[bytes], reply: bytes) -> None:
    try:
        result = result_of(reply)
    except DuraError as error:
        future.set_exception(error)
    else:
        future.set_result(result)
