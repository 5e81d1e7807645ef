"""Places: how many requests are under way at the same time, and calls that are made at once."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar, copy_context
from threading import Condition, Thread
from typing import TypeVar

T = TypeVar("T")

_has_place: ContextVar[bool] = ContextVar("dura_llm_has_place", default=False)
"""Whether the thread has a place for its request already."""


class Places:
    """Places of the requests that are under way at the same time, for the threads of a process.

    Who needs a place waits for at most one request of another thread: further places are only
    taken where nobody waits.

    Args:
        count: How many there are.
    """

    def __init__(self, count: int) -> None:
        self._free, self._waiting = count, 0
        self._change = Condition()

    @contextmanager
    def taken(self) -> Iterator[None]:
        """Context of a request, which waits until a place is free, unless the thread has one."""
        if _has_place.get():
            yield
            return
        with self._change:
            self._waiting += 1
            try:
                while not self._free:
                    self._change.wait()
            finally:
                self._waiting -= 1
            self._free -= 1
        try:
            yield
        finally:
            self._give()

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
        """Take a place beside the next one, if nobody waits for it."""
        with self._change:
            spare = self._free > self._waiting + 1
            self._free -= spare
        return spare

    def _give(self) -> None:
        with self._change:
            self._free += 1
            self._change.notify()
