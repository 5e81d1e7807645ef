"""Copies: an executor whose every call has a copy of this process, as it is at that moment.

A test that asks for episodes may have replaced functions before, and its classes may be its own: in
a copy all of that holds. What the call changes there is gone with it.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future

from pytest_dura.execution.children import (
    Child,
    ChildEndedError,
    ChildSettings,
    may_be_copied,
)
from pytest_dura.execution.replies import CallFailedError, ProcessLostError, result_of


class Copies:
    """Calls in copies of this process, see :func:`may_be_copied`.

    Futures have the attribute ``captured``, as those of a
    :class:`~pytest_dura.execution.processes.ProcessPool`, whose errors they raise, too.

    Args:
        width: How many copies work at the same time where calls are begun ahead.
        pool: Makes an executor whose children are forked from one copy.
        memory: Bytes that a copy may take beside those that it begins with.
    """

    in_flight = 1
    """Calls per copy that are under way, since each begins at once."""

    def __init__(self, width: int, pool: Callable[[], Executor], memory: int | None = None) -> None:
        self.width, self.pool, self._memory = width, pool, memory
        self._lock = threading.Lock()
        self._running: set[Child] = set()
        self._closed = False

    @property
    def is_possible(self) -> bool:
        """Whether this process may be copied as it is now."""
        return may_be_copied()

    def submit(self, call: Callable[[], bytes], seconds: float | None = None) -> Future[bytes]:
        """The future of a call in a copy, which is made at once.

        Args:
            call: What the copy carries out.
            seconds: Limit of the call once it has begun.
        """
        future: Future[bytes] = Future()
        future.set_running_or_notify_cancel()
        settings = ChildSettings((), "", memory=self._memory)
        try:
            child = Child(settings, None, call)
        except OSError as error:
            future.set_exception(CallFailedError(f"no process can be started: {error}"))
            return future
        with self._lock:
            self._running.add(child)
        wait = threading.Thread(
            target=self._wait, args=(child, seconds, future), name="dura-copy", daemon=True
        )
        wait.start()
        return future

    def _wait(self, child: Child, seconds: float | None, future: Future[bytes]) -> None:
        """Wait for the reply of a copy, in a thread of its own."""
        error: Exception | None = None
        reply = b""
        try:
            child.wait_until_ready()
            reply, captured, _ = child.reply(seconds)
        except ChildEndedError as ended:
            captured = child.captured()
            error = ProcessLostError(str(ended.death), ended.death)
            if self._closed:
                error = CallFailedError("the session ended before the episode did")
        except Exception as failed:
            captured, error = None, failed
        with self._lock:
            self._running.discard(child)
        child.end()
        vars(future)["captured"] = captured
        try:
            result = result_of(reply) if error is None else b""
        except Exception as raised:
            error = raised
        if error is None:
            future.set_result(result)
        else:
            future.set_exception(error)

    def close(self) -> None:
        """End the copies, whatever they are at."""
        with self._lock:
            self._closed, running = True, list(self._running)
        for child in running:
            child.kill()
