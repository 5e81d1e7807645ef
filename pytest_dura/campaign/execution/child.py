"""Child: the handle of one process that simulates, which may end at any time."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import IO, Any

from pytest_dura.campaign.execution.replies import CallFailedError
from pytest_dura.campaign.execution.worker import READY, RETIRES, read_frame, write_frame

_START = (
    "import json, sys; sys.path[:] = json.loads(sys.argv.pop()); "
    "from pytest_dura.campaign.execution.worker import main; main()"
)
SECONDS_TO_START = 300.0
"""Imports from a disk that many processes read at once are slow."""
_SECONDS_TO_END = 10.0
"""How long a process is waited for that was killed, or closed its output."""
_EVERY = 1.0
"""Seconds after which it is looked whether a process still exists."""


@dataclass(frozen=True)
class Surroundings:
    """What a process needs to find what this one finds.

    Args:
        path: Where it imports from: ``sys.path``.
        folder: The folder that it works in.
    """

    path: Sequence[str]
    folder: str

    @classmethod
    def here(cls) -> Surroundings:
        """As they are in this process now."""
        folder = Path.cwd()
        return cls([str(folder / one) for one in sys.path], str(folder))


class ChildEndedError(Exception):
    """The process ended before it replied. ``seconds`` is the limit that it overran, if it did."""

    def __init__(self, how: str, seconds: float | None = None) -> None:
        self.seconds = seconds
        super().__init__(how)


class Child:
    """A process that carries out one call at a time.

    It has a session of its own, so that a key pressed in the terminal does not reach it. No wait
    for it rests on the end of its output alone, which a process that it left behind may hold open.

    Args:
        surroundings: What it finds.

    Raises:
        CallFailedError: If it cannot be started.
    """

    def __init__(self, surroundings: Surroundings) -> None:
        command = [sys.executable, *["-O"] * sys.flags.optimize, "-c", _START]
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115 - closed in `end`
        try:
            self._process = subprocess.Popen(
                [*command, json.dumps(list(surroundings.path))],
                cwd=surroundings.folder,
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
            CallFailedError: If it does not get there; then it is ended.
        """
        try:
            with self._limited(SECONDS_TO_START) as late:
                ready = self._reply(SECONDS_TO_START, late) == READY
            how = "it wrote something else"
        except ChildEndedError as ended:
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
        """Whether it has not ended, as far as it is known."""
        return not self._over and self._process.poll() is None

    def call(
        self, function: str, args: Sequence[Any], kwargs: Mapping[str, Any]
    ) -> tuple[bytes, bool]:
        """The reply to a call, and whether the process stays for another one.

        Args:
            function: ``package.module:name``.
            args: Plain data.
            kwargs: Plain data; ``seconds`` is the limit of the call.

        Raises:
            ChildEndedError: If there is no reply: the process ended, or was ended after so long.
        """
        request = {"function": function, "args": list(args), "kwargs": dict(kwargs)}
        data, seconds = json.dumps(request).encode(), kwargs.get("seconds")
        with self._limited(seconds) as late:
            try:
                write_frame(self._calls, data)  # a process that was stopped reads nothing
            except OSError:
                raise self._ended(seconds, late) from None
            found = self._reply(seconds, late)
        return found[1:], found[:1] != RETIRES

    def kill(self) -> None:
        """End it and what it started. Its call raises in the thread that waits for the reply."""
        if hasattr(os, "killpg"):
            with suppress(ProcessLookupError, PermissionError):  # all of them have ended
                os.killpg(self._process.pid, signal.SIGKILL)
        self._process.kill()

    def end(self) -> None:
        """End it, and let go of whatever it holds here. A second call does nothing."""
        if self._over:
            return
        self._over = True
        self.kill()
        with suppress(subprocess.TimeoutExpired):  # the kernel does not let go of it
            self._process.wait(_SECONDS_TO_END)
        self._reader.join(_EVERY)
        with suppress(OSError):  # of a request that it never read
            self._calls.close()
        self._errors.close()

    def _read(self, stream: IO[bytes]) -> None:
        """Take in what it writes, in a thread of its own, which alone touches the stream."""
        with stream:
            found: bytes | None = b""
            while found is not None:
                try:
                    found = read_frame(stream)
                except Exception:  # whatever is written there that is no reply
                    found = None
                self._replies.put(found)

    @contextmanager
    def _limited(self, seconds: float | None) -> Iterator[threading.Event]:
        """End the process after so long; the event tells that this happened."""
        late = threading.Event()

        def kill_late() -> None:
            late.set()
            self.kill()

        if seconds is None:
            yield late
            return
        timer = threading.Timer(seconds, kill_late)
        timer.daemon = True
        timer.start()
        try:
            yield late
        finally:
            timer.cancel()

    def _reply(self, seconds: float | None, late: threading.Event) -> bytes:
        over = False
        while (found := self._next()) == b"" and not over:
            over = late.is_set() or not self.is_alive  # what it wrote by then is on its way
        if not found:  # also if what it left behind holds its output open
            raise self._ended(seconds, late)
        return found

    def _next(self) -> bytes | None:
        """The next frame; ``None`` behind the last one, and nothing if none comes for a while."""
        try:
            return self._replies.get(timeout=_EVERY)
        except Empty:
            return b""

    def _ended(self, seconds: float | None, late: threading.Event) -> ChildEndedError:
        if late.is_set():
            return ChildEndedError(f"it took longer than {seconds:g} s", seconds)
        return ChildEndedError(self._how_it_ended())

    def _how_it_ended(self) -> str:
        """In words."""
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
