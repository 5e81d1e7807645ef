"""Places: how many requests are under way at the same time, and calls that are made at once."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar, copy_context
from threading import Event, Lock, Thread
from typing import TypeVar

from pytest_dura.core.boundary import paused

T = TypeVar("T")

_has_place: ContextVar[bool] = ContextVar("dura_llm_has_place", default=False)
"""Whether the thread has a place for its request already."""


class Places:
    """Places of the requests that are under way at the same time, for the threads of a process.

    Who needs a place gets it in turn, and the wait is no time of the component's. Further places
    are only taken where nobody waits.

    Args:
        count: How many there are.
    """

    def __init__(self, count: int) -> None:
        self._free = count
        self._queue: deque[Event] = deque()
        """Events of those who wait, the first one first; there is none while a place is free."""
        self._lock = Lock()

    @contextmanager
    def taken(self) -> Iterator[None]:
        """Context of a request, which waits for its turn, unless the thread has a place."""
        if _has_place.get():
            yield
            return
        turn = Event()
        with self._lock:
            if self._free:
                self._free -= 1
                turn.set()
            else:
                self._queue.append(turn)
        if not turn.is_set():
            self._wait_for(turn)
        try:
            yield
        finally:
            self._give()

    def _wait_for(self, turn: Event) -> None:
        try:
            with paused():
                turn.wait()
        except BaseException:  # a time limit; it is raised again
            with self._lock:
                is_waiting = turn in self._queue
                if is_waiting:
                    self._queue.remove(turn)
            if not is_waiting:
                self._give()
            raise

    def call_all(self, calls: Sequence[Callable[[], T]]) -> list[T]:
        """The results of calls that make a request each, in their order.

        This thread makes them one after the other; another one makes the next call as long as there
        is a place for it beside this one's.

        Raises:
            BaseException: What the first of the calls raised that raised anything.
        """
        results: dict[int, T] = {}
        errors: dict[int, BaseException] = {}

        def call(number: int) -> None:
            try:
                results[number] = calls[number]()
            except BaseException as error:  # it is raised again in the thread of the component
                errors[number] = error

        def call_beside(number: int) -> None:
            _has_place.set(True)
            try:
                call(number)
            finally:
                self._give()

        threads: list[Thread] = []
        numbers = deque(range(len(calls)))
        while numbers:
            own = numbers.popleft()
            while numbers and self._try_take():
                beside = call_beside, numbers.popleft()
                threads.append(Thread(target=copy_context().run, args=beside, daemon=True))
                threads[-1].start()
            call(own)
            if own in errors:
                break
        for thread in threads:
            thread.join()
        if errors:
            raise errors[min(errors)]
        return [results[number] for number in range(len(calls))]

    def _try_take(self) -> bool:
        """Take a place beside the next one, if both are free."""
        with self._lock:
            spare = self._free > 1
            self._free -= spare
        return spare

    def _give(self) -> None:
        """Hand a place to the first who waits, or leave it free."""
        with self._lock:
            if self._queue:
                self._queue.popleft().set()
            else:
                self._free += 1
