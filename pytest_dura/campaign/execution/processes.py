"""ProcessPool: an executor of processes, which outlives them."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future
from dataclasses import dataclass, field
from queue import Empty, SimpleQueue
from typing import Any, ParamSpec, TypeVar, cast

from pytest_dura.campaign.execution.child import Child, ChildEndedError, Surroundings
from pytest_dura.campaign.execution.replies import (
    CallFailedError,
    ProcessLostError,
    result_of,
)
from pytest_dura.core.errors import DuraError

T = TypeVar("T")
P = ParamSpec("P")

MOST_LOST = 2
"""Processes that a call may end before it is given up."""
MOST_STARTS = 3
"""How often a process is started for a call before the call fails: one may be killed, or find no
memory, before it takes any call. No call is to blame for that."""
_IDLE = 60.0
"""Seconds without a call after which a process ends; the next call starts another."""
_SESSION_ENDED = "the session ended before the episode did"


def usable_cores() -> int:
    """How many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@dataclass
class _Call:
    """A call, and who waits for it."""

    function: str
    args: tuple[Any, ...]
    kwargs: dict[str, Any]
    future: Future[bytes] = field(default_factory=Future)


class ProcessPool(Executor):
    """Processes that each carry out one call at a time, looked after by a thread of this one.

    A process that ends in the middle takes nothing with it but its own call, which another process
    is given. So it is known which call ended which process: one that ended two is given up, and so
    is one that overran its limit, after which its process is killed. Calls are named and their
    arguments are plain data, and so are results and errors; nothing is pickled.

    Args:
        width: How many processes at most; they are started when they are needed.
        surroundings: What they find; by default what this process finds at the first call.
    """

    def __init__(self, width: int, surroundings: Surroundings | None = None) -> None:
        self.width = width
        self._surroundings = surroundings
        self._calls: SimpleQueue[_Call | None] = SimpleQueue()
        self._lock = threading.Lock()
        self._threads: list[threading.Thread] = []
        self._children: dict[threading.Thread, Child] = {}
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
            kwargs: Plain data; ``seconds`` is also the limit that the call is held to.
        """
        call = _Call(f"{fn.__module__}:{fn.__name__}", args, kwargs)
        with self._lock:
            if self._closed:
                raise RuntimeError("the pool is closed")
            if self._surroundings is None:
                self._surroundings = Surroundings.here()
            self._unfinished += 1
            self._calls.put(call)
            if len(self._threads) < min(self.width, self._unfinished):
                thread = threading.Thread(target=self._look_after, name="dura-pool", daemon=True)
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
                self._drain()
            threads = list(self._threads)
            for _ in threads:
                self._calls.put(None)
            if not wait:
                for child in self._children.values():
                    child.kill()
        for thread in threads:
            thread.join()  # what has been killed ends at once

    def _drain(self) -> None:
        while True:
            try:
                call = self._calls.get_nowait()
            except Empty:
                return
            if call is not None:
                call.future.cancel()

    def _look_after(self) -> None:
        """What a thread does: hand calls to a process, one after the other."""
        child: Child | None = None
        try:
            while True:
                try:
                    call = self._calls.get(timeout=_IDLE)
                except Empty:
                    if self._leaves():
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

    def _leaves(self) -> bool:
        """Whether nothing is left to do, under the lock under which calls come."""
        with self._lock:
            if self._closed or not self._calls.empty():
                return False
            self._threads.remove(threading.current_thread())
            return True

    def _carry_out(self, call: _Call, child: Child | None) -> Child | None:
        """Carry out a call, and return the process that the next one may have."""
        lost = 0
        while True:
            try:
                child = self._started(child)
                reply, stays = child.call(call.function, call.args, call.kwargs)
            except ChildEndedError as ended:
                self._end(child)
                child, lost = None, lost + 1
                error = self._verdict(ended, lost)
                if error is None:
                    continue
                call.future.set_exception(error)
            except Exception as error:  # none can be started, an argument is no plain data
                call.future.set_exception(error)
            else:
                _settle(call.future, reply)
                if not stays:
                    self._end(child)
                    child = None
            return child

    def _verdict(self, ended: ChildEndedError, lost: int) -> Exception | None:
        """What a call comes to that lost its process; ``None`` if another process is given it."""
        if self._killing:
            return CallFailedError(_SESSION_ENDED)
        if ended.seconds is not None:
            return ProcessLostError(f"its process was ended, since {ended}")
        if lost >= MOST_LOST:
            return ProcessLostError(f"it ended {lost} processes that simulated it: {ended}")
        return None

    def _started(self, child: Child | None) -> Child:
        """A process that takes calls: the one at hand, or a fresh one.

        Raises:
            CallFailedError: If none can be started, in as many attempts as there are.
        """
        if child is not None and child.is_alive:
            return child
        self._end(child)
        for left in reversed(range(MOST_STARTS)):
            made = None
            try:
                made = self._begun()
                made.wait_until_ready()
            except CallFailedError:
                self._end(made)
                if self._killing or not left:
                    raise
            else:
                return made
        raise AssertionError("unreachable")

    def _begun(self) -> Child:
        """A process that starts; known at once, so that the end of the pool reaches it."""
        assert self._surroundings is not None
        with self._lock:
            if self._killing:
                raise CallFailedError(_SESSION_ENDED)
        made = Child(self._surroundings)
        with self._lock:
            self._children[threading.current_thread()] = made
            if self._killing:
                made.kill()
        return made

    def _end(self, child: Child | None) -> None:
        if child is not None:
            with self._lock:
                self._children.pop(threading.current_thread(), None)
            child.end()


def _settle(future: Future[bytes], reply: bytes) -> None:
    try:
        result = result_of(reply)
    except DuraError as error:
        future.set_exception(error)
    else:
        future.set_result(result)
