"""Copies: an executor whose every call has a copy of this process, as it is at that moment.

A test that asks for episodes may have replaced functions before, and its classes may be its own: in
a copy all of that holds. What the call changes there is gone with it.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future

from pytest_dura.execution.children import (
    MAX_KILLED,
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
        try:
            child = self._copy(call)
        except CallFailedError as error:
            future.set_exception(error)
            return future

        def wait() -> None:
            try:
                future.set_result(self._result(child, call, seconds, future))
            except Exception as error:
                future.set_exception(error)

        threading.Thread(target=wait, name="dura-copy", daemon=True).start()
        return future

    def _copy(self, call: Callable[[], bytes]) -> Child:
        try:
            child = Child(ChildSettings((), "", memory=self._memory), None, call)
        except OSError as error:
            raise CallFailedError(f"no process can be started: {error}") from None
        with self._lock:
            self._running.add(child)
        return child

    def _result(
        self, child: Child, call: Callable[[], bytes], seconds: float | None, future: Future[bytes]
    ) -> bytes:
        """Wait for the result of a copy; one that may have been killed from outside is replaced."""
        for left in reversed(range(MAX_KILLED)):
            try:
                child.wait_until_ready()
                reply, captured, _ = child.reply(seconds)
            except ChildEndedError as ended:
                vars(future)["captured"] = child.captured()
                if self._closed:
                    raise CallFailedError("the session ended before the episode did") from None
                if not (left and ended.may_be_from_outside):
                    raise ProcessLostError(str(ended.death), ended.death) from None
            else:
                vars(future)["captured"] = captured
                return result_of(reply)
            finally:
                with self._lock:
                    self._running.discard(child)
                child.end()
            child = self._copy(call)
        raise AssertionError("the last copy was replaced")

    def close(self) -> None:
        """End the copies, whatever they are at."""
        with self._lock:
            self._closed, running = True, list(self._running)
        for child in running:
            child.kill()
