"""Servers: programs of a project that come and go; found or started, locked, watched, ended.

What exists once at its address has one session at a time. A program that is started here ends with
the process that started it, also if that is killed.
"""

from __future__ import annotations

import atexit
import os
import shlex
import signal
import socket
import subprocess
import sys
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from time import monotonic, sleep
from typing import IO, Any, Generic, Protocol, TypeVar

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.files import LockedFile, LockHeldError
from pytest_dura.core.trust import check_registered, current_places

SERVE = "serve"
"""In place of a program: this Python, which serves a component or simulator of the project."""
PORT = "{port}"
"""In an address and a command line: a free port, so that each process has a server of its own."""
_STOPPING = 5.0
"""Seconds that a server has to end by itself."""
_PAUSE = 0.05
"""Seconds between two looks at a server that starts."""
_LAST_WORDS = 300
"""Bytes of its output that an error has."""


class ServerError(Exception):
    """Error of a server that does not start, or has ended."""


class Server:
    """A server at an address, which this process has for itself until it is closed.

    Args:
        address: By which it is locked, as it is written, and named in messages.
        command: The program that starts it, with its arguments; without one it is there already.
        seconds: How long it may take until it answers.
    """

    def __init__(self, address: str, command: Sequence[str] = (), seconds: float = 60.0) -> None:
        self.address, self._command, self._seconds = address, tuple(command), seconds
        self._lock: LockedFile | None = None
        self._guard: subprocess.Popen[bytes] | None = None
        self._output: IO[bytes] | None = None
        self._end = ""

    def open(self, problem: Callable[[], str], *, find: bool = True) -> None:
        """Take the server: as it is found, or else started.

        Args:
            problem: Looks whether it answers; returns why it does not, or nothing.
            find: Whether one that answers already is taken; it is not ended afterwards.

        Raises:
            ConfigurationError: If another session has it.
            ServerError: If it does not answer in time, or ends.
        """
        self._lock = claim(self.address)
        try:
            if self._command and not (find and not problem()):
                self._start()
                self._wait(problem)
        except BaseException:  # ctrl-C too must not leave it running; it is raised again
            self.close()
            raise

    def ending(self, seconds: float = 0.0) -> str:
        """Say how the program that was started here ended; nothing while it runs.

        Args:
            seconds: How long to wait for its end, which others may see before.
        """
        if self._guard is None or self._end:
            return self._end
        with suppress(subprocess.TimeoutExpired):
            self._guard.wait(seconds)
            self._end = f"{shlex.join(self._command)} {self._ended()}{self._last_words()}"
        return self._end

    def close(self) -> None:
        """End what was started here, and let the next session have it; twice does nothing."""
        guard, self._guard = self._guard, None
        if guard is not None:
            assert guard.stdin is not None
            assert guard.stdout is not None
            guard.terminate()  # a process that was forked meanwhile may have its input open
            guard.stdin.close()
            with suppress(subprocess.TimeoutExpired):
                guard.wait(2.0 * _STOPPING)
            if guard.poll() is None:
                os.killpg(guard.pid, signal.SIGKILL)
                guard.wait()
            guard.stdout.close()
        if self._output is not None:
            self._output.close()
            self._output = None
        if self._lock is not None:
            self._lock.release()
            self._lock = None

    def _start(self) -> None:
        if sys.platform == "win32":
            raise ConfigurationError(
                "servers are not started on Windows",
                key="server",
                found=shlex.join(self._command),
                remedy="start it before the session, and leave `server` out",
            )
        self._end, self._output = "", tempfile.TemporaryFile()  # noqa: SIM115 - until close
        guard = [sys.executable, "-S", "-E", str(Path(__file__).with_name("guard.py"))]
        pipe = subprocess.PIPE
        self._guard = subprocess.Popen(
            [*guard, str(_STOPPING), *self._command],
            stdin=pipe, stdout=pipe, stderr=self._output, start_new_session=True,
        )  # fmt: skip

    def _wait(self, problem: Callable[[], str]) -> None:
        until = monotonic() + self._seconds
        while wrong := problem():
            if ending := self.ending():
                raise ServerError(f"{ending}, before it answered at {self.address}")
            if monotonic() > until:
                raise ServerError(
                    f"{shlex.join(self._command)} does not answer at {self.address} within "
                    f"{self._seconds:g} s: {wrong}{self._last_words()}"
                )
            sleep(_PAUSE)

    def _ended(self) -> str:
        assert self._guard is not None
        assert self._guard.stdout is not None
        line = self._guard.stdout.read().strip()
        return describe_code(int(line)) if line else "was killed"

    def _last_words(self) -> str:
        if self._output is None:
            return ""
        end = self._output.seek(0, 2)
        self._output.seek(max(0, end - _LAST_WORDS))
        text = " ".join(self._output.read().decode("utf-8", "replace").split())
        return f" (its output: {text})" if text else ""


class Shared(Protocol):
    """What episodes share: a connection to a server."""

    @property
    def is_broken(self) -> bool:
        """Whether it is to be made anew."""

    def open(self) -> None:
        """Open it."""

    def close(self) -> None:
        """Close it; twice does nothing."""


class ServerConnection(ABC):
    """A connection to a server that is taken or started, for one session at a time.

    Args:
        server: The server.
    """

    def __init__(self, server: Server) -> None:
        self.server = server
        self._is_lost = False

    @property
    def is_broken(self) -> bool:
        """Whether the server has ended, or did not answer."""
        return self._is_lost or bool(self.server.ending())

    def open(self) -> None:
        """Take or start the server, and connect to it.

        Raises:
            ConfigurationError: If another session has it, or client and server do not fit.
            ServerError: If it does not start. What the adapter raises where it does not answer is
                raised as well.
        """
        self.server.open(self.problem)
        try:
            self._enter()
        except BaseException:  # ctrl-C too must not leave it locked; it is raised again
            self.close()
            raise

    @abstractmethod
    def problem(self) -> str:
        """Say why the server does not answer; nothing if it does."""

    @abstractmethod
    def _enter(self) -> None:
        """Connect to the server, which answers."""

    @abstractmethod
    def close(self) -> None:
        """Let go of the server; twice does nothing."""


SharedT = TypeVar("SharedT", bound=Shared)


class Kept(Generic[SharedT]):
    """Connections that this process keeps from episode to episode, one of each kind.

    Args:
        make: Makes a connection of its arguments, which are its kind.
    """

    def __init__(self, make: Callable[..., SharedT]) -> None:
        self._make, self._open = make, dict[tuple[Any, ...], SharedT]()

    def take(self, *arguments: Any) -> SharedT:
        """Return the connection with these arguments; one that is broken is made anew."""
        key = os.getpid(), *arguments
        known = self._open.get(key)
        if known is not None and not known.is_broken:
            return known
        if known is not None:
            del self._open[key]
            known.close()
        made = self._make(*arguments)
        made.open()
        atexit.unregister(self.close)
        atexit.register(self.close)
        self._open[key] = made
        return made

    def close(self) -> None:
        """Close the connections of this process."""
        for key in [key for key in self._open if key[0] == os.getpid()]:
            self._open.pop(key).close()


def claim(address: str) -> LockedFile:
    """Lock what exists once at an address, for this session alone.

    Raises:
        ConfigurationError: If another one has it.
    """
    name = f"dura-link-{sha256(address.encode()).hexdigest()[:16]}.lock"
    try:
        return LockedFile.acquire(Path(tempfile.gettempdir()) / name)
    except LockHeldError:
        raise ConfigurationError(
            "another process uses this device or server",
            key="transport",
            found=address,
            remedy="wait for the other session, or run this one without -n",
        ) from None


def with_port(*texts: str) -> list[str]:
    """Return the texts with one free port of this machine in place of :data:`PORT`."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = str(probe.getsockname()[1])
    return [text.replace(PORT, port) for text in texts]


def project_program(command: str, key: str) -> list[str]:
    """Return a command line of a scenario in its parts.

    Its program is a file of the project, or :data:`SERVE`.

    Raises:
        ConfigurationError: For another program: files may come from strangers.
    """
    try:
        program, *arguments = shlex.split(command)
    except ValueError:
        raise ConfigurationError(
            "this is no command line",
            key=key,
            found=command,
            expected="PROGRAM ARGUMENTS",
            remedy="correct it",
        ) from None
    if program == SERVE:
        for path in arguments[:1]:
            check_registered(path)
        return [sys.executable, "-m", "pytest_dura", SERVE, *arguments]
    places, file = current_places(), Path(program)
    is_own = any(file.resolve().is_relative_to(folder) for folder in places.own)
    is_allowed = places.trusting or is_own or not places.own
    if not file.is_file() or not is_allowed or places.foreign_folder(file):
        raise ConfigurationError(
            "this program cannot be started" if file.is_file() else "there is no such program",
            key=key,
            found=command,
            expected=f"a file of the project, with its folder, or `{SERVE} package.module:Name`",
            remedy="compile or copy it into the project, or add --dura-trust-code",
        )
    return [str(file.resolve()), *arguments]


def describe_code(code: int) -> str:
    """Say how a program ended."""
    return f"ended with {'signal' if code < 0 else 'exit code'} {abs(code)}"


def end_process(process: subprocess.Popen[bytes], patience: float) -> None:
    """Wait until a process has ended by itself; kill it if it does not."""
    try:
        process.wait(patience)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
