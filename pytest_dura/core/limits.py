"""A wall-clock limit around a call into the component under test."""

from __future__ import annotations

import ctypes
import signal
import threading
from collections.abc import Callable
from typing import Any, TypeVar

T = TypeVar("T")


class TimeBudgetExceeded(BaseException):
    """Raised inside a call that overran. Not an ``Exception``: the callee must not swallow it."""


def call_within(seconds: float | None, function: Callable[..., T], *args: Any) -> T:
    """Call ``function`` and end it after ``seconds`` of wall-clock time.

    Works for anything that runs Python bytecode or sleeps. A call that stays inside C code is
    ended when it comes back.

    Raises:
        TimeBudgetExceeded: If it ran longer.
    """
    if seconds is None:
        return function(*args)
    in_main = threading.current_thread() is threading.main_thread()
    if in_main and hasattr(signal, "setitimer") and signal.getitimer(signal.ITIMER_REAL)[0] == 0.0:
        return _call_with_alarm(seconds, function, *args)
    return _call_with_watchdog(seconds, function, *args)


def _expire(signum: int, frame: object) -> None:
    raise TimeBudgetExceeded


def _call_with_alarm(seconds: float, function: Callable[..., T], *args: Any) -> T:
    previous = signal.signal(signal.SIGALRM, _expire)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        return function(*args)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, previous)


def _call_with_watchdog(seconds: float, function: Callable[..., T], *args: Any) -> T:
    caller = ctypes.c_ulong(threading.get_ident())
    lock = threading.Lock()
    running = True

    def expire() -> None:
        with lock:
            if running:
                ctypes.pythonapi.PyThreadState_SetAsyncExc(
                    caller, ctypes.py_object(TimeBudgetExceeded)
                )

    timer = threading.Timer(seconds, expire)
    timer.daemon = True
    timer.start()
    try:
        return function(*args)
    finally:
        with lock:
            running = False
        timer.cancel()
