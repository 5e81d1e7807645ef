"""EpisodeThreads: an executor whose threads each simulate one episode at a time, in this process.

It is for episodes that wait for a server most of the time. They share what the process has: its
recordings, its connections, its counts. Results are those of one episode
after the other, since an episode depends on nothing but its task.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future
from contextvars import Context, copy_context
from dataclasses import dataclass, field
from functools import partial
from queue import SimpleQueue
from time import monotonic
from typing import Any, ParamSpec, TypeVar, cast

from pytest_dura.core.boundary import CallEnded
from pytest_dura.core.time_limits import giving_up_by
from pytest_dura.execution.executors import IN_FLIGHT, cancel_queued
from pytest_dura.execution.replies import CallFailedError, ProcessLostError

T = TypeVar("T")
P = ParamSpec("P")

_SECONDS_TO_END = 2.0
"""How long the end of a session waits for threads, such as one that waits for a server's answer."""
_SESSION_ENDED = "the session ended before the episode did"


@dataclass(eq=False)
class _Call:
    """A call, and the future of its result, which is set once."""

    function: Callable[[], Any]
    context: Context = field(default_factory=copy_context)
    future: Future[Any] = field(default_factory=Future)
    over: bool = False


class EpisodeThreads(Executor):
    """Executor of calls in threads that end with the process.

    Args:
        width: How many episodes are worked on at the same time. There are more threads, for all
            that is begun ahead: where episodes wait for their turn at a server, no turn is lost.
    """

    def __init__(self, width: int) -> None:
        self.width, self._most = width, IN_FLIGHT * width
        self._calls: SimpleQueue[_Call | None] = SimpleQueue()
        self._lock = threading.Lock()
        self._threads: list[threading.Thread] = []
        self._running: list[_Call] = []
        self._unfinished = 0
        self._closed = self._ended = False

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """The future of a call in one of the threads, in a copy of the context at hand."""
        call = _Call(partial(fn, *args, **kwargs))
        with self._lock:
            if self._closed:
                raise RuntimeError("the executor is closed")
            self._unfinished += 1
            self._calls.put(call)
            self._start_threads()
        return cast("Future[T]", call.future)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the threads.

        Args:
            wait: Whether what was begun is carried out before that. Otherwise its futures fail at
                once, whatever its threads still come to.
            cancel_futures: Whether what was not begun is given up.
        """
        with self._lock:
            self._closed, self._ended = True, self._ended or not wait
            if cancel_futures or not wait:
                cancel_queued(self._calls)
            threads, running = list(self._threads), list(self._running)
            for _ in threads:
                self._calls.put(None)
        for call in running if self._ended else []:
            self._settle(call, error=CallFailedError(_SESSION_ENDED))
        end = monotonic() + _SECONDS_TO_END
        for thread in threads:
            thread.join(None if wait else max(0.0, end - monotonic()))

    def _start_threads(self) -> None:
        """Start a thread if there is work for it, under the lock."""
        if len(self._threads) < min(self._most, self._unfinished):
            thread = threading.Thread(target=self._serve, name="dura-episodes", daemon=True)
            self._threads.append(thread)
            thread.start()

    def _serve(self) -> None:
        """Carry out calls, one after the other, in a thread of this executor."""
        thread = threading.current_thread()
        while thread in self._threads:  # it is not, once a call of it was given up
            call = self._calls.get()
            if call is None:
                return
            with self._lock:
                begins = call.future.set_running_or_notify_cancel()
                ended = self._ended  # while the call was neither queued nor running
                if begins:
                    self._running.append(call)
                else:
                    self._unfinished -= 1
            if begins and ended:
                self._settle(call, error=CallFailedError(_SESSION_ENDED))
            elif begins:
                self._carry_out(call, thread)

    def _carry_out(self, call: _Call, thread: threading.Thread) -> None:
        def called() -> Any:
            with giving_up_by(partial(self._give_up, call, thread)):
                return call.function()

        try:
            result = call.context.run(called)
        except CallEnded as ended:  # a limit that ended nothing but the way back from its call
            self._settle(call, error=ProcessLostError(f"it overran a limit: {ended}"))
        except BaseException as error:  # it is raised where the result is taken
            self._settle(call, error=error)
        else:
            self._settle(call, result)

    def _give_up(self, call: _Call, thread: threading.Thread, cause: str) -> None:
        """Give up a call that never comes back; another thread takes the place of its own."""
        with self._lock:
            if thread in self._threads:
                self._threads.remove(thread)
        self._settle(call, error=ProcessLostError(cause))
        with self._lock:
            if not self._closed:
                self._start_threads()

    def _settle(
        self, call: _Call, result: Any = None, *, error: BaseException | None = None
    ) -> None:
        """Set the future of a call, unless it was set before."""
        with self._lock:
            if call.over:
                return
            call.over = True
            self._unfinished -= 1
            if call in self._running:
                self._running.remove(call)
        if error is None:
            call.future.set_result(result)
        else:
            call.future.set_exception(error)
