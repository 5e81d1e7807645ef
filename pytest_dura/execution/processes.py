"""ProcessPool: an executor whose processes may end in the middle of a call."""

from __future__ import annotations

import os
import re
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass, field, replace
from functools import cached_property
from queue import Empty, SimpleQueue
from typing import Any, ParamSpec, TypeVar, cast

from pytest_dura.core.errors import DuraError
from pytest_dura.execution.child import FORKS
from pytest_dura.execution.children import (
    MAX_KILLED,
    Child,
    ChildEndedError,
    ChildSettings,
    HasThreadsError,
    Template,
    may_be_copied,
)
from pytest_dura.execution.executors import ExecutorKind, cancel_queued
from pytest_dura.execution.replies import CallFailedError, ProcessLostError, result_of

MAX_STARTS = 3
"""How often a child is started for a call before the call fails: it may be killed, or get no
memory, before it takes any call, which says nothing about the call."""
_IDLE_SECONDS = 60.0
"""Seconds without a call after which a child ends; the next call gets another."""
_SESSION_ENDED = "the session ended before the episode did"

T = TypeVar("T")
P = ParamSpec("P")


def usable_cores() -> int:
    """How many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@dataclass
class _Call:
    """A call, and the future of its reply."""

    function: str
    args: tuple[Any, ...]
    kwargs: dict[str, Any]
    future: Future[bytes] = field(default_factory=Future)


class ProcessPool(Executor):
    """Pool of children that each carry out one call at a time, each with a thread of this process.

    A child that ends in the middle takes nothing with it but its own call. How it ended, and in
    whose call, is known: :class:`ProcessLostError` says it. A call whose child was killed by a
    signal that may come from outside is given to another child, once. Calls are named and their
    arguments are plain data, and so are results and errors; nothing is pickled. Futures have the
    attribute ``captured``, what was printed, logged and warned of.

    Args:
        width: How many children at most; they are started when they are needed.
        settings: What they begin with; by default as this process is at the first call.
        memory: See :class:`ChildSettings`.
        copies: Whether children are forked from a copy of this process where one may be made.
    """

    imports_same_files = True
    """Whether an import path leads to the same file there as here."""

    def __init__(
        self,
        width: int,
        settings: ChildSettings | None = None,
        memory: int | None = None,
        *,
        copies: bool = False,
    ) -> None:
        self.width = width
        self._copies = copies
        self.preload: Sequence[str] = ()
        """Import paths of what calls will need, which the template imports."""
        self._settings, self._memory = settings, memory
        self._calls: SimpleQueue[_Call | None] = SimpleQueue()
        self._lock = threading.Lock()
        self._threads: list[threading.Thread] = []
        self._children: dict[threading.Thread, Child] = {}
        self._templates: list[Template] = []
        """The last one forks, unless it has ended."""
        self._forks = FORKS
        self._unfinished = 0
        self._closed = self._killing = False

    @property
    def is_used(self) -> bool:
        """Whether it was given a call."""
        return self._settings is not None

    @cached_property
    def is_copy(self) -> bool:
        """Whether its children are copies of this process as it is at the first call."""
        return self._copies and may_be_copied()

    @property
    def pids(self) -> list[int]:
        """The numbers of the children that there are now."""
        with self._lock:
            return [child.pid for child in self._children.values() if child.pid > 0]

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """The future of a call in one of the children.

        Args:
            fn: A function at the top of a module, which returns bytes.
            args: Plain data.
            kwargs: Plain data; ``seconds`` is also the limit that the call is held to once it has
                begun; see :func:`pytest_dura.execution.replies.begin`.
        """
        call = _Call(f"{fn.__module__}:{fn.__name__}", args, kwargs)
        with self._lock:
            if self._closed:
                raise RuntimeError("the pool is closed")
            if self._settings is None:
                self._settings = ChildSettings.here(self._memory, self.preload)
                if self.is_copy:  # here, since other threads may hold what is imported
                    self._templates.append(Template(self._settings, copied=True))
            self._unfinished += 1
            self._calls.put(call)
            if len(self._threads) < min(self.width, self._unfinished):
                thread = threading.Thread(target=self._serve, name="dura-pool", daemon=True)
                self._threads.append(thread)
                thread.start()
        return cast("Future[T]", call.future)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the children.

        Args:
            wait: Whether what was begun is carried out before that.
            cancel_futures: Whether what was not begun is given up.
        """
        with self._lock:
            self._closed = True
            self._killing = not wait
            if cancel_futures or not wait:
                cancel_queued(self._calls)
            threads = list(self._threads)
            for _ in threads:
                self._calls.put(None)
            if not wait:
                for child in self._children.values():
                    child.kill()
        for thread in threads:
            thread.join()  # what has been killed ends at once
        self._end_templates()

    def _end_templates(self) -> None:
        while self._templates:
            template = self._templates.pop()
            template.end()
            template.output.close()

    def _serve(self) -> None:
        """Hand calls to a child, one after the other, in a thread of the pool."""
        child: Child | None = None
        try:
            while True:
                try:
                    call = self._calls.get(timeout=_IDLE_SECONDS)
                except Empty:
                    self._end(child)
                    child = None
                    with self._lock:
                        if not (self._unfinished or self._children or self.is_copy):
                            self._end_templates()  # of a session that a cluster has lost, too
                    continue
                if call is None:
                    return
                if call.future.set_running_or_notify_cancel():
                    child = self._carry_out(call, child)
                with self._lock:
                    self._unfinished -= 1
        finally:
            self._end(child)

    def _carry_out(self, call: _Call, child: Child | None) -> Child | None:
        """Carry out a call, and return the child that the next one may have."""
        killed = 0
        while True:
            try:
                child = self._ready(child)
                reply, captured, stays = child.call(call.function, call.args, call.kwargs)
            except ChildEndedError as ended:
                assert child is not None
                vars(call.future)["captured"] = child.captured()
                self._end(child)
                child, killed = None, killed + 1
                if self._killing:
                    call.future.set_exception(CallFailedError(_SESSION_ENDED))
                elif ended.may_be_from_outside and killed < MAX_KILLED:
                    continue
                else:
                    lost = ProcessLostError(str(ended.death), ended.death)
                    call.future.set_exception(lost)
            except Exception as error:  # none can be started, an argument is no plain data
                call.future.set_exception(error)
            else:
                vars(call.future)["captured"] = captured
                _resolve(call.future, reply)
                if not stays:
                    self._end(child)
                    child = None
            return child

    def _ready(self, child: Child | None) -> Child:
        """A child that takes calls: the one at hand, or a fresh one.

        Raises:
            CallFailedError: If none can be started, in as many attempts as there are.
        """
        if child is not None and child.is_alive:
            return child
        self._end(child)
        left = MAX_STARTS
        while True:
            left -= 1
            fresh = None
            try:
                fresh = self._start()
                fresh.wait_until_ready()
            except HasThreadsError:
                self._end(fresh)
                self._forks, left = False, MAX_STARTS
            except CallFailedError:
                self._end(fresh)
                if self._killing or not left:
                    raise
            else:
                return fresh

    def _start(self) -> Child:
        """Start a child; it is known at once, so that the end of the pool reaches it."""
        with self._lock:
            if self._killing:
                raise CallFailedError(_SESSION_ENDED)
            assert self._settings is not None
            if self._forks and all(template.has_ended for template in self._templates[-1:]):
                if self._templates:  # what it imported may have ended it
                    self._settings = replace(self._settings, preload=())
                self._templates.append(Template(self._settings, copied=self.is_copy))
            template = self._templates[-1] if self._forks else None
        try:
            child = Child(self._settings, template)
        except OSError as error:  # there is no room for its files
            raise CallFailedError(f"no process can be started: {error}") from None
        with self._lock:
            self._children[threading.current_thread()] = child
            if self._killing:
                child.kill()
        return child

    def _end(self, child: Child | None) -> None:
        if child is not None:
            with self._lock:
                self._children.pop(threading.current_thread(), None)
            child.end()


class Processes(ExecutorKind):
    """Processes of this machine: as many as it has usable cores, or the number that is given."""

    form = "processes, or processes:N with N of 1 to 9999"
    makes_copies = FORKS

    def __init__(self, argument: str) -> None:
        if argument and not re.fullmatch("[1-9][0-9]{0,3}", argument):
            raise ValueError(argument)
        self._count = int(argument) if argument else usable_cores()
        self.local_processes = self._count
        self.where = f"in {self.local_processes} processes"

    def start(self) -> ProcessPool:
        """Make the pool."""
        return ProcessPool(self._count, memory=self.memory, copies=True)


def _resolve(future: Future[bytes], reply: bytes) -> None:
    try:
        result = result_of(reply)
    except DuraError as error:
        future.set_exception(error)
    else:
        future.set_result(result)
