"""Children: processes that carry out calls, forked from a template process with a single thread.

The template is a copy of this process, in which all holds that was changed here, such as by a
``conftest.py``. Where this process has threads that a copy would lack, the template is started anew
and imports what children need; where what it imports has threads, or the system does not fork, each
child is started anew. A child that ends in the middle leaves to its parent how it ended, and in
shared bytes whose call was under way.
"""

from __future__ import annotations

import json
import mmap
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from functools import lru_cache, partial
from multiprocessing import Pipe
from multiprocessing.connection import wait
from pathlib import Path
from typing import IO, Any, cast

from pytest_dura.core.calls import SIZE, CallUnderWay, read_call
from pytest_dura.core.trust import Places, current_places
from pytest_dura.execution.child import (
    BEGUN,
    FORKS,
    READY,
    RETIRES,
    STATUS,
    THREADS,
    be_template,
    carry_out,
    fork,
    native_threads,
    number_of_threads,
)
from pytest_dura.execution.replies import CallFailedError, Death
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
MAX_KILLED = 2
"""Children that a call may lose to a signal from outside before it is given up."""
_FROM_OUTSIDE = {getattr(signal, name, None) for name in ("SIGKILL", "SIGTERM", "SIGHUP")}
_WAIT_SECONDS = 0.002
"""Seconds from one look at a copy that is to end to the next."""
_MOST_OUTPUT = 100_000
"""Bytes of what a call prints that are kept, the last ones."""
_WITH_TEMPLATE = "ended with its template, which "


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


def _open_shared_file() -> tuple[IO[bytes], mmap.mmap]:
    """Open one whose first bytes are shared with each process that has it.

    Raises:
        CallFailedError: If they cannot be written.
    """
    file, why = _open_file(), "the disk of temporary files is full"
    try:
        if file.write(bytes(SIZE)) == SIZE:
            return file, mmap.mmap(file.fileno(), SIZE)
    except OSError as error:
        why = str(error)
    file.close()
    raise CallFailedError(f"no process can be started: {why}")


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


_WAITING = frozenset({
    "asyncio.unix_events", "concurrent.futures.thread", "execnet.gateway_base",
    "multiprocessing.connection", "queue", "selectors", "socket", "socketserver", "ssl",
    "subprocess", "threading", __name__, "pytest_dura.execution.processes",
})  # fmt: skip
"""Modules of the innermost frame of a thread that waits for something to do."""


def may_be_copied() -> bool:
    """Whether a copy of this process lacks no thread that it might wait for.

    Threads of Python that wait for something to do hold nothing, and libraries that compute end
    theirs at a fork; with any other one this process is not copied.
    """
    if not FORKS or threading.current_thread() is not threading.main_thread():
        return False
    frames = sys._current_frames()  # noqa: SLF001 - of all threads, those of other packages too
    own = threading.get_ident()
    names = {frames[ident].f_globals.get("__name__") for ident in frames if ident != own}
    return names <= _WAITING and _unknown_threads(number_of_threads(), len(frames)) <= 0


@lru_cache(maxsize=64)
def _unknown_threads(_: int, known: int) -> int:
    """How many threads are not Python's; counted once for as many threads."""
    return native_threads() - known


class _Copy:
    """Copy of this process, as far as it is used like a ``subprocess.Popen``.

    Args:
        live: What the copy does; it ends the copy.
        errors: Where it writes what it raised before that.
    """

    def __init__(self, live: Callable[[], None], errors: IO[bytes]) -> None:
        self._lock = threading.Lock()
        self._code: int | None = None
        self.pid = fork()
        if self.pid == 0:
            try:
                live()
            except BaseException:  # the session goes on in the process that was copied
                errors.write(traceback.format_exc().encode(errors="replace"))
            finally:
                os._exit(1)

    def poll(self) -> int | None:
        """The exit code, or the negative number of the signal; ``None`` as long as it runs."""
        with self._lock:
            if self._code is None:
                try:
                    pid, status = os.waitpid(self.pid, os.WNOHANG)
                except ChildProcessError:  # code of the user's has waited for all processes
                    self._code = 255
                else:
                    self._code = os.waitstatus_to_exitcode(status) if pid else None
            return self._code

    def wait(self, seconds: float) -> int:
        """The same, after at most so many seconds.

        Raises:
            subprocess.TimeoutExpired: If it still runs.
        """
        end = time.monotonic() + seconds
        while (code := self.poll()) is None:
            if time.monotonic() >= end:
                raise subprocess.TimeoutExpired("copy", seconds)
            time.sleep(_WAIT_SECONDS)
        return code

    def kill(self) -> None:
        """End it."""
        if self.poll() is None:
            with suppress(ProcessLookupError):
                os.kill(self.pid, signal.SIGKILL)


class Template:
    """The process from which children are forked.

    Args:
        settings: Of its children.
        copied: Whether it is a copy of this process, see :func:`may_be_copied`.
    """

    def __init__(self, settings: ChildSettings, *, copied: bool = False) -> None:
        self.output = _open_file()
        self._control, theirs = socket.socketpair()
        with theirs:
            self.process: Any
            if copied:
                self.process = _Copy(lambda: self._live(theirs, settings.memory), self.output)
                return
            self.process = _start(
                settings, theirs.fileno(), subprocess.DEVNULL, self.output, forks=True
            )

    def _live(self, control: socket.socket, memory: int | None) -> None:
        self._control.close()
        be_template(control, self.output, memory)

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
        self.death = death
        self.may_be_from_outside = signal in _FROM_OUTSIDE and not overran
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
        call: What it carries out as a copy of this process, and nothing else.

    Raises:
        CallFailedError: If it cannot be started.
    """

    def __init__(
        self,
        settings: ChildSettings,
        template: Template | None,
        call: Callable[[], bytes] | None = None,
    ) -> None:
        self.pid, self._over, self._ended_by = 0, False, ""
        self._signal: int | None = None
        self._template = template
        self._process: Any = None
        self._status: int | None = None
        shared, self._shared = _open_shared_file()
        self._files = shared, _open_file()
        self._connection, theirs = Pipe()
        with theirs:
            if call is not None:
                live = partial(self._live, call, theirs, settings.memory)
                self._process = _Copy(live, self._files[1])
            elif template is None:
                self._process = _start(settings, _inherited(theirs), *self._files, forks=False)
            if self._process is not None:
                self.pid = self._process.pid
                return
            assert template is not None
            self._status, status = os.pipe()
            template.fork([theirs.fileno(), status, *(file.fileno() for file in self._files)])
            os.close(status)

    def _live(self, call: Callable[[], bytes], connection: Any, memory: int | None) -> None:
        self._connection.close()
        carry_out(call, connection, self._files, memory)

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
        return self.reply(kwargs.get("seconds"), json.dumps(request).encode())

    def reply(
        self, seconds: float | None, request: bytes | None = None
    ) -> tuple[bytes, Captured, bool]:
        """The reply to a request, or that of a copy, see :meth:`call`."""
        with self._limited(None if seconds is None else SECONDS_TO_START, "its imports") as limit:
            try:
                if request is not None:
                    self._connection.send_bytes(request)  # a child that was stopped reads nothing
            except OSError:
                raise self._ended(limit) from None
            reply = self._receive(limit)
        if reply == BEGUN:
            with self._limited(seconds, "it") as limit:
                reply = self._receive(limit)
        head, _, body = reply[1:].partition(b"\n")
        try:
            seen = json.loads(head)
        except ValueError:  # what it called wrote into the connection
            self.kill()
            raise self._ended(limit) from None
        return body, self.captured(seen), reply[:1] != RETIRES

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
        data = os.read(self._status, STATUS.size)
        return STATUS.unpack(data)[0] if len(data) == STATUS.size else None

    def _ended(self, limit: _Limit) -> ChildEndedError:
        if not self._has_ended(_SECONDS_TO_END):
            self._ended_by = "closed its connection to the session"
        how = self._ended_by
        if limit.overrun.is_set():
            how = f"was ended, since {limit.what} took longer than {limit.seconds:g} s"
        # A template takes all its children along, of which at most one has ended it.
        call = read_call(self._shared[:])
        if call.copied:
            how, self._signal = "was ended, since it made a copy of itself", None
        elif how.startswith(_WITH_TEMPLATE):
            call = CallUnderWay("", 0)
        death = Death(how, call.name, call.tick)
        return ChildEndedError(death, self._signal, overran=limit.overrun.is_set())
