"""Places: how many requests are under way at the same time, and calls that are made at once."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar, copy_context
from threading import BoundedSemaphore, Thread
from typing import TypeVar

from pytest_dura.core.time_limits import paused

T = TypeVar("T")

_has_place: ContextVar[bool] = ContextVar("dura_llm_has_place", default=False)
"""Whether the thread has a place for its request already."""


class Places:
    """Places of the requests that are under way at the same time, for the threads of a process.

    Args:
        count: How many there are.
    """

    def __init__(self, count: int) -> None:
        self._free = BoundedSemaphore(count)

    @contextmanager
    def taken(self) -> Iterator[None]:
        """Context of a request; the wait for a place is no time of the component's."""
        if _has_place.get():
            yield
            return
        if not self._free.acquire(blocking=False):
            with paused():
                self._free.acquire()
        try:
            yield
        finally:
            self._free.release()

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
                self._free.release()

        threads: list[Thread] = []
        numbers = deque(range(len(calls)))
        while numbers and not errors:
            own = numbers.popleft()
            while numbers and self._take_spare():
                beside = call_beside, numbers.popleft()
                threads.append(Thread(target=copy_context().run, args=beside, daemon=True))
                threads[-1].start()
            call(own)
        for thread in threads:
            thread.join()
        if errors:
            raise errors[min(errors)]
        return [results[number] for number in range(len(calls))]

    def _take_spare(self) -> bool:
        """Take a place if another one is free beside it, for a call that others wait for."""
        if not self._free.acquire(blocking=False):
            return False
        is_spare = self._free.acquire(blocking=False)
        self._free.release()
        return is_spare
