"""A wall-clock limit around a call into the component under test."""

from __future__ import annotations

import contextvars
import ctypes
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import isclose
from time import monotonic
from typing import Any, ClassVar, TypeVar

from pytest_dura.core.boundary import CallEnded
from pytest_dura.core.watchdog import Watch

T = TypeVar("T")

GRACE = 0.2
"""Seconds within which a call that is told to stop should have stopped."""


_TICK = 2e-6
"""Seconds to which timers are told."""


class TimeBudgetExceeded(CallEnded):
    """Raised inside a call that overran. Not an ``Exception``: the callee must not swallow it."""


class CallNotStopped(TimeBudgetExceeded):
    """The call overran and could not be ended: it is still running in a thread of its own."""


def call_within(seconds: float | None, function: Callable[..., T], *args: Any) -> T:
    """Call ``function`` and end it after ``seconds`` of wall-clock time.

    In the main thread an alarm interrupts whatever runs Python bytecode, sleeps or waits. Where
    there is no alarm to be had (in other threads, inside another limit, on Windows), the function
    runs in a thread of its own, which is left behind if it sleeps on. A call that stays inside C
    code is ended when it comes back. A call that catches the interruption and returns has overrun
    all the same.

    Raises:
        TimeBudgetExceeded: If it ran longer.
        CallNotStopped: If it ran longer and still does.
    """
    if seconds is None:
        return function(*args)
    if _alarm_is_free():
        if _Alarm.installed is not None:  # as it is throughout an episode
            return _call_with_alarm(_Alarm.installed, seconds, function, *args)
        with alarms():
            if _Alarm.installed is not None:
                return _call_with_alarm(_Alarm.installed, seconds, function, *args)
    return _call_in_thread(seconds, function, *args)


class _Alarm:
    """The handler of SIGALRM: ends the call that is under way, and nothing between two calls.

    Args:
        watch: Looks after the calls that have no limit of their own, between those that have one.
    """

    installed: ClassVar[_Alarm | None] = None

    def __init__(self, watch: Watch) -> None:
        self.watch = watch
        self.armed = self.expired = False
        self.due = 0.0

    def rest(self) -> None:
        """Let the timer strike for the watch alone, or not at all."""
        signal.setitimer(signal.ITIMER_REAL, self.watch.period, self.watch.period)

    def __call__(self, _signum: int, _frame: object) -> None:
        if not self.armed:
            self.watch.strike()
        elif monotonic() >= self.due:  # earlier, it is a stroke of the watch that comes late
            self.expired = True
            raise TimeBudgetExceeded


@contextmanager
def alarms(watch: Watch | None = None) -> Iterator[None]:
    """Install the alarm's handler once for many calls, which saves them most of their cost.

    Does nothing where there is no alarm to be had, and then nothing is watched either.

    Args:
        watch: Looks after all other calls meanwhile.
    """
    if _Alarm.installed is not None or not _alarm_is_free():
        yield
        return
    alarm = _Alarm(watch or Watch(None))
    previous = signal.signal(signal.SIGALRM, alarm)
    _Alarm.installed = alarm
    try:
        alarm.rest()
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        _Alarm.installed = None
        signal.signal(signal.SIGALRM, signal.SIG_DFL if previous is None else previous)


def _alarm_is_free() -> bool:
    in_main = threading.current_thread() is threading.main_thread()
    if not in_main or not hasattr(signal, "setitimer"):
        return False
    left, period = signal.getitimer(signal.ITIMER_REAL)
    alarm = _Alarm.installed
    if left == 0.0 or alarm is None or alarm.armed:
        return left == 0.0
    # The timer of the watch gives way, and nobody else's: it is told by its period.
    own = alarm.watch.period
    return own > 0.0 and isclose(period, own, abs_tol=_TICK)


def _call_with_alarm(alarm: _Alarm, seconds: float, function: Callable[..., T], *args: Any) -> T:
    alarm.due = monotonic() + seconds
    alarm.armed, alarm.expired = True, False
    try:
        # The alarm repeats, since a callee may swallow one and go on (a bare `except` in a loop).
        signal.setitimer(signal.ITIMER_REAL, seconds, max(GRACE, min(seconds, 1.0)))
        try:
            result = function(*args)
        finally:
            alarm.armed = False
    finally:
        alarm.armed = False
        alarm.rest()
    if alarm.expired:
        raise TimeBudgetExceeded
    return result


def _call_in_thread(seconds: float, function: Callable[..., T], *args: Any) -> T:
    results: list[T] = []
    errors: list[BaseException] = []
    lock, done = threading.Lock(), threading.Event()
    finished = False

    def work() -> None:
        nonlocal finished
        try:
            try:
                results.append(function(*args))
            except BaseException as error:
                errors.append(error)
            finally:
                with lock:
                    finished = True
        except TimeBudgetExceeded as late:
            errors.append(late)
        done.set()

    context = contextvars.copy_context()
    thread = threading.Thread(target=context.run, args=(work,), daemon=True)
    thread.start()
    if not done.wait(seconds):
        with lock:
            if not finished and thread.ident is not None:
                ctypes.pythonapi.PyThreadState_SetAsyncExc(
                    ctypes.c_ulong(thread.ident), ctypes.py_object(TimeBudgetExceeded)
                )
        raise TimeBudgetExceeded if done.wait(GRACE) else CallNotStopped
    if errors:
        raise errors[0]
    return results[0]
