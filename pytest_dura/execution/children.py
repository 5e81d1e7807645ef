"""Children: processes that carry out calls, forked from a clean template process.

The template imports once what children need, and has a single thread. Where the system does not
fork, or what the template imported has threads, each child is started anew. A child that ends in
the middle leaves to its parent how it ended, and in shared bytes whose call was under way.
"""

from __future__ import annotations

import json
import mmap
import os
import re
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field, replace
from multiprocessing import Pipe
from multiprocessing.connection import wait
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import IO, Any, ParamSpec, TypeVar, cast

from pytest_dura.core.calls import SIZE, read_call
from pytest_dura.core.errors import DuraError
from pytest_dura.core.trust import Places, current_places
from pytest_dura.execution.child import BEGUN, FORKS, READY, RETIRES, THREADS
from pytest_dura.execution.executors import ExecutorKind, cancel_queued
from pytest_dura.execution.replies import CallFailedError, Death, ProcessLostError, result_of
from pytest_dura.execution.surroundings import Captured

_START = (
    "import json, sys; given = json.loads(sys.argv.pop()); sys.path[:] = given.pop('path'); "
    "from pytest_dura.execution.child import main; main(**given)"
)
SECONDS_TO_START = 300.0
"""What a process has for its start, and a call for its imports: a disk that many processes read at
once is slow."""
_SECONDS_TO_END = 10.0
"""How long the pool waits for a process that was killed, or closed its connection."""
_POLL_SECONDS = 1.0
"""Seconds from one check to the next whether a process still exists."""
MAX_STARTS = 3
"""How often a child is started for a call before the call fails: it may be killed, or get no
memory, before it takes any call, which says nothing about the call."""
_MAX_KILLED = 2
"""Children that a call may lose to a signal from outside before it is given up."""
_IDLE_SECONDS = 60.0
"""Seconds without a call after which a child ends; the next call starts another."""
_MOST_OUTPUT = 100_000
"""Bytes of what a call prints that are kept, the last ones."""
_SESSION_ENDED = "the session ended before the episode did"
_FROM_OUTSIDE = {getattr(signal, name, None) for name in ("SIGKILL", "SIGTERM", "SIGHUP")}
_WITH_TEMPLATE = "ended with its template, which "
_STATUS = struct.Struct("<q")


def _how_it_ended(code: int) -> str:
    if code >= 0 or os.name == "nt":
        return f"ended with exit code {code}"
    names = {each.value: each.name for each in signal.Signals}
    return f"was ended by {names.get(-code, f'signal {-code}')}"


@dataclass(frozen=True)
class ChildSettings:
    """What a child begins with.

    Args:
        path: Where it imports from: ``sys.path``.
        folder: The folder that it works in.
        places: Where code that files name may come from, see :meth:`Places.to_json`.
        memory: Bytes that it may take beside those that it begins with; ``None`` for any number.
        preload: Import paths of what the template imports.
    """

    path: Sequence[str]
    folder: str
    places: Mapping[str, Any] = field(default_factory=Places().to_json)
    memory: int | None = None
    preload: Sequence[str] = ()

    @classmethod
    def here(cls, memory: int | None = None, preload: Sequence[str] = ()) -> ChildSettings:
        """Those of this process, as they are now."""
        folder = Path.cwd()
        path = [str(folder / entry) for entry in sys.path]
        return cls(path, str(folder), current_places().to_json(), memory, preload)


def _start(settings: ChildSettings, pipe: int, stdout: Any, stderr: Any, **how: bool) -> Any:
    """Start a process of its own session, so that a key pressed in the terminal does not reach it.

    Raises:
        CallFailedError: If it cannot be started.
    """
    command = [sys.executable, *["-O"] * sys.flags.optimize, "-c", _START]
    given = asdict(settings) | how
    folder = given.pop("folder")
    try:
        return subprocess.Popen(
            [*command, json.dumps(given)], cwd=folder, stdin=pipe, stdout=stdout, stderr=stderr,
            start_new_session=True,
        )  # fmt: skip
    except OSError as error:
        raise CallFailedError(f"no process can be started: {error}") from None


def _open_file() -> IO[bytes]:
    """Open a file without a name, to which each process appends."""
    descriptor, path = tempfile.mkstemp(prefix="pytest-dura-")
    os.close(descriptor)
    flags = os.O_RDWR | os.O_APPEND | getattr(os, "O_BINARY", 0) | getattr(os, "O_TEMPORARY", 0)
    file = os.fdopen(os.open(path, flags), "r+b", buffering=0)
    with suppress(OSError):  # where an open file keeps its name, it goes with it
        Path(path).unlink()
    return file


def _take(file: IO[bytes], begin: int = 0) -> str:
    """Take what was written behind this place, the end of it."""
    size = file.seek(0, os.SEEK_END)
    if size <= begin:
        return ""
    file.seek(max(begin, size - _MOST_OUTPUT))
    text = file.read().decode(errors="replace")
    with suppress(OSError):  # of a mapped file, on some systems
        file.truncate(begin)
    return text


def _inherited(connection: Any) -> int:
    """The descriptor of a connection, as a process is started with it."""
    if sys.platform != "win32":
        return cast("int", connection.fileno())
    import msvcrt

    return msvcrt.open_osfhandle(connection.fileno(), 0)


class Template:
    """The process from which children are forked.

    Args:
        settings: Of its children.
    """

    def __init__(self, settings: ChildSettings) -> None:
        self.output = _open_file()
        self._control, theirs = socket.socketpair()
        with theirs:
            self.process = _start(
                settings, theirs.fileno(), subprocess.DEVNULL, self.output, forks=True
            )

    def fork(self, descriptors: Sequence[int]) -> None:
        """Ask for a child, which gets these files."""
        with suppress(OSError):  # it has ended, which the files show
            socket.send_fds(self._control, [b"f"], descriptors)

    @property
    def has_ended(self) -> bool:
        """Whether it forks no more children."""
        return self.process.poll() is not None

    def how_it_ended(self) -> str:
        """How it ended, in words."""
        with suppress(subprocess.TimeoutExpired):
            return _how_it_ended(self.process.wait(_SECONDS_TO_END))
        return "does not answer"

    def end(self) -> None:
        """End it, and with it its children."""
        self._control.close()
        self.process.kill()
        with suppress(subprocess.TimeoutExpired):  # the kernel does not let go of it
            self.process.wait(_SECONDS_TO_END)


class ChildEndedError(Exception):
    """Error for a child that ended before its reply.

    Args:
        death: How, and in whose call.
        signal: The signal that ended it, if one did.
        overran: Whether the parent ended it after its limit.
    """

    def __init__(self, death: Death, signal: int | None = None, *, overran: bool = False) -> None:
        self.death, self.signal, self.overran = death, signal, overran
        super().__init__(death.how)


class HasThreadsError(Exception):
    """Error for a template whose modules have threads, from which no child is forked."""


@dataclass(frozen=True)
class _Limit:
    """Limit of a wait for a child; ``overrun`` is set when it is ended for that."""

    seconds: float | None
    what: str
    overrun: threading.Event = field(default_factory=threading.Event)


class Child:
    """A process that carries out one call at a time.

    Args:
        settings: What it begins with.
        template: From which it is forked; ``None`` to start it anew.

    Raises:
        CallFailedError: If it cannot be started.
    """

    def __init__(self, settings: ChildSettings, template: Template | None) -> None:
        self.pid, self._over, self._ended_by = 0, False, ""
        self._signal: int | None = None
        self._template = template
        self._process: Any = None
        self._status: int | None = None
        self._files = _open_file(), _open_file()
        self._files[0].write(bytes(SIZE))
        self._shared = mmap.mmap(self._files[0].fileno(), SIZE)
        self._connection, theirs = Pipe()
        with theirs:
            if template is None:
                self._process = _start(settings, _inherited(theirs), *self._files, forks=False)
                self.pid = self._process.pid
                return
            self._status, status = os.pipe()
            template.fork([theirs.fileno(), status, *(file.fileno() for file in self._files)])
            os.close(status)

    def wait_until_ready(self) -> None:
        """Wait until it takes calls.

        Raises:
            CallFailedError: If it never does; then it is ended.
            HasThreadsError: If the template does not fork.
        """
        try:
            with self._limited(SECONDS_TO_START, "its start") as limit:
                if self._status is not None and wait([self._status]):
                    self.pid = self._read_status() or 0
                if self.pid == THREADS:
                    self.end()
                    raise HasThreadsError
                ready = self._receive(limit) == READY
            how = "it wrote something else"
        except ChildEndedError as ended:
            ready, how = False, f"it {ended.death.how.removeprefix(_WITH_TEMPLATE)}"
        if ready:
            return
        printed = "" if self._template is None else _take(self._template.output)
        printed = (_take(self._files[1]) + printed).strip()
        self.end()
        raise CallFailedError(f"a process that simulates did not start: {printed or how}")

    @property
    def is_alive(self) -> bool:
        """Whether it has not ended, as far as is known."""
        return not (self._over or self._ended_by or self._has_ended(0.0))

    def call(
        self, function: str, args: Sequence[Any], kwargs: Mapping[str, Any]
    ) -> tuple[bytes, Captured, bool]:
        """The reply to a call, what was captured of it, and whether the child stays for another.

        Args:
            function: ``package.module:name``.
            args: Plain data.
            kwargs: Plain data; ``seconds`` is the limit of the call once it has begun.

        Raises:
            ChildEndedError: If there is no reply: the child ended, or was ended after so long.
        """
        request = {"function": function, "args": list(args), "kwargs": dict(kwargs)}
        data, seconds = json.dumps(request).encode(), kwargs.get("seconds")
        with self._limited(None if seconds is None else SECONDS_TO_START, "its imports") as limit:
            try:
                self._connection.send_bytes(data)  # a child that was stopped reads nothing
            except OSError:
                raise self._ended(limit) from None
            reply = self._receive(limit)
        if reply == BEGUN:
            with self._limited(seconds, "it") as limit:
                reply = self._receive(limit)
        head, _, body = reply[1:].partition(b"\n")
        return body, self.captured(json.loads(head)), reply[:1] != RETIRES

    def captured(self, seen: Mapping[str, Any] | None = None) -> Captured:
        """What the last call printed, which is taken, with what else was seen of it."""
        out, errors = self._files
        return Captured(_take(out, SIZE), _take(errors), seen or {})

    def kill(self) -> None:
        """End it and what it started. Its call raises in the thread that waits for the reply."""
        if self.pid > 0 and hasattr(os, "killpg"):
            with suppress(ProcessLookupError, PermissionError):  # all of them have ended
                os.killpg(self.pid, signal.SIGKILL)
        if self._process is not None:
            self._process.kill()
        elif self.pid <= 0 and self._template is not None:  # which has not answered yet
            self._template.process.kill()

    def end(self) -> None:
        """End it, and close its pipes and files here. A second call does nothing."""
        if self._over:
            return
        self._over = True
        self.kill()
        self._has_ended(_SECONDS_TO_END)
        self._connection.close()
        if self._status is not None:
            os.close(self._status)
        self._shared.close()
        for file in self._files:
            file.close()

    @contextmanager
    def _limited(self, seconds: float | None, what: str) -> Iterator[_Limit]:
        """Context that ends the child after so many seconds."""
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

    def _receive(self, limit: _Limit) -> bytes:
        """The next message. A copy of the child that it left behind may hold the connection."""
        sources: list[Any] = [self._connection]
        if self._status is not None:
            sources.append(self._status)
        while True:
            ready = wait(sources, _POLL_SECONDS)
            if self._connection in ready or self._connection.poll():
                try:
                    return self._connection.recv_bytes()
                except (EOFError, OSError):
                    raise self._ended(limit) from None
            if ready or self._has_ended(0.0):
                raise self._ended(limit)

    def _has_ended(self, seconds: float) -> bool:
        """Whether it ends within so many seconds; then how is known, as far as it ever is."""
        if self._ended_by:
            return True
        if self._process is not None:
            with suppress(subprocess.TimeoutExpired):
                self._note_end(self._process.wait(seconds))
        elif self._status is not None and wait([self._status], seconds):
            status = self._read_status()
            self._note_end(None if status is None else os.waitstatus_to_exitcode(status))
        return bool(self._ended_by)

    def _note_end(self, code: int | None) -> None:
        if code is None:
            assert self._template is not None
            self._ended_by = _WITH_TEMPLATE + self._template.how_it_ended()
            self._signal = signal.SIGKILL
        else:
            self._ended_by = _how_it_ended(code)
            self._signal = -code if code < 0 else None

    def _read_status(self) -> int | None:
        assert self._status is not None
        data = os.read(self._status, _STATUS.size)
        return _STATUS.unpack(data)[0] if len(data) == _STATUS.size else None

    def _ended(self, limit: _Limit) -> ChildEndedError:
        if not self._has_ended(_SECONDS_TO_END):
            self._ended_by = "closed its connection to the session"
        how = self._ended_by
        if limit.overrun.is_set():
            how = f"was ended, since {limit.what} took longer than {limit.seconds:g} s"
        # A template takes all its children along, of which at most one has ended it.
        whose = ("", 0) if how.startswith(_WITH_TEMPLATE) else read_call(self._shared[:])
        death = Death(how, *whose)
        return ChildEndedError(death, self._signal, overran=limit.overrun.is_set())


T = TypeVar("T")
P = ParamSpec("P")


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
    """Pool of children that each carry out one call at a time, each with a thread of this process.

    A child that ends in the middle takes nothing with it but its own call. How it ended, and in
    whose call, is known: :class:`ProcessLostError` says it. A call whose child was killed by a
    signal that may come from outside is given to another child, once. Calls are named and their
    arguments are plain data, and so are results and errors; nothing is pickled. Futures have the
    attribute ``captured``, what was printed, logged and warned of.

    Args:
        width: How many children at most; they are started when they are needed.
        settings: What they begin with; by default as this process is at the first call.
        memory: See :class:`ChildSettings`.
    """

    imports_same_files = True
    """Whether an import path leads to the same file there as here."""

    def __init__(
        self, width: int, settings: ChildSettings | None = None, memory: int | None = None
    ) -> None:
        self.width = width
        self.preload: Sequence[str] = ()
        """Import paths of what calls will need, which the template imports."""
        self._settings, self._memory = settings, memory
        self._calls: SimpleQueue[_Call | None] = SimpleQueue()
        self._lock = threading.Lock()
        self._threads: list[threading.Thread] = []
        self._children: dict[threading.Thread, Child] = {}
        self._templates: list[Template] = []
        """The last one forks, unless it has ended."""
        self._forks = FORKS
        self._unfinished = 0
        self._closed = self._killing = False

    @property
    def is_used(self) -> bool:
        """Whether it was given a call."""
        return self._settings is not None

    @property
    def pids(self) -> list[int]:
        """The numbers of the children that there are now."""
        with self._lock:
            return [child.pid for child in self._children.values() if child.pid > 0]

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """The future of a call in one of the children.

        Args:
            fn: A function at the top of a module, which returns bytes.
            args: Plain data.
            kwargs: Plain data; ``seconds`` is also the limit that the call is held to once it has
                begun; see :func:`pytest_dura.execution.replies.begin`.
        """
        call = _Call(f"{fn.__module__}:{fn.__name__}", args, kwargs)
        with self._lock:
            if self._closed:
                raise RuntimeError("the pool is closed")
            if self._settings is None:
                self._settings = ChildSettings.here(self._memory, self.preload)
            self._unfinished += 1
            self._calls.put(call)
            if len(self._threads) < min(self.width, self._unfinished):
                thread = threading.Thread(target=self._serve, name="dura-pool", daemon=True)
                self._threads.append(thread)
                thread.start()
        return cast("Future[T]", call.future)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the children.

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
        for template in self._templates:
            template.end()
            template.output.close()

    def _serve(self) -> None:
        """Hand calls to a child, one after the other, in a thread of the pool."""
        child: Child | None = None
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

    def _carry_out(self, call: _Call, child: Child | None) -> Child | None:
        """Carry out a call, and return the child that the next one may have."""
        killed = 0
        while True:
            try:
                child = self._ready(child)
                reply, captured, stays = child.call(call.function, call.args, call.kwargs)
            except ChildEndedError as ended:
                assert child is not None
                vars(call.future)["captured"] = child.captured()
                self._end(child)
                child, killed = None, killed + 1
                from_outside = ended.signal in _FROM_OUTSIDE and not ended.overran
                if self._killing:
                    call.future.set_exception(CallFailedError(_SESSION_ENDED))
                elif from_outside and killed < _MAX_KILLED:
                    continue
                else:
                    lost = ProcessLostError(str(ended.death), ended.death)
                    call.future.set_exception(lost)
            except Exception as error:  # none can be started, an argument is no plain data
                call.future.set_exception(error)
            else:
                vars(call.future)["captured"] = captured
                _resolve(call.future, reply)
                if not stays:
                    self._end(child)
                    child = None
            return child

    def _ready(self, child: Child | None) -> Child:
        """A child that takes calls: the one at hand, or a fresh one.

        Raises:
            CallFailedError: If none can be started, in as many attempts as there are.
        """
        if child is not None and child.is_alive:
            return child
        self._end(child)
        left = MAX_STARTS
        while True:
            left -= 1
            fresh = None
            try:
                fresh = self._start()
                fresh.wait_until_ready()
            except HasThreadsError:
                self._end(fresh)
                self._forks, left = False, MAX_STARTS
            except CallFailedError:
                self._end(fresh)
                if self._killing or not left:
                    raise
            else:
                return fresh

    def _start(self) -> Child:
        """Start a child; it is known at once, so that the end of the pool reaches it."""
        with self._lock:
            if self._killing:
                raise CallFailedError(_SESSION_ENDED)
            assert self._settings is not None
            if self._forks and all(template.has_ended for template in self._templates[-1:]):
                if self._templates:  # what it imported may have ended it
                    self._settings = replace(self._settings, preload=())
                self._templates.append(Template(self._settings))
            template = self._templates[-1] if self._forks else None
        try:
            child = Child(self._settings, template)
        except OSError as error:  # there is no room for its files
            raise CallFailedError(f"no process can be started: {error}") from None
        with self._lock:
            self._children[threading.current_thread()] = child
            if self._killing:
                child.kill()
        return child

    def _end(self, child: Child | None) -> None:
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
        return ProcessPool(self._count, memory=self.memory)


def _resolve(future: Future[bytes], reply: bytes) -> None:
    try:
        result = result_of(reply)
    except DuraError as error:
        future.set_exception(error)
    else:
        future.set_result(result)
