"""Time limits of calls of code that is not ours, so that nothing blocks for ever.

The component has its time budget (:func:`call_within`), everything else the limit of a
:class:`CallTimer`. Both share one alarm. No alarm reaches another thread than the main one: there a
second thread watches the calls. Where a call waits for others it is paused, which no limit counts.
"""

from __future__ import annotations

import contextvars
import ctypes
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from contextvars import ContextVar, Token
from time import monotonic
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

from pytest_dura.core.boundary import CallEnded

if TYPE_CHECKING:
    from typing_extensions import Self

ROLE_TIMEOUT = 60.0
"""Seconds of wall-clock time that a role or the simulator has for one call."""
_CHECKS_PER_LIMIT = 4
"""How often the timer fires within the limit."""


class CallBlocked(CallEnded):
    """Raised inside a call that has not returned in time. The callee must not swallow it."""


class CallTimer:
    """Time limit of calls. It costs a call two attributes, and no timer of its own.

    A timer fires periodically and ends a call that has been under way for longer than the limit,
    after at most one and a half times that.

    Args:
        limit: Seconds of wall-clock time for one call; ``None`` waits for ever.
    """

    def __init__(self, limit: float | None) -> None:
        self.limit = limit
        self.calls = 0
        """Number of calls that have begun."""
        self.role: str | None = None
        """Role of the current call."""
        self.overran: str | None = None
        """Role of a call that took too long, also if it returned in the end."""
        self._checked_call = -1
        self._since = 0.0

    @property
    def period(self) -> float:
        """Seconds between two checks; 0 without a limit."""
        return 0.0 if self.limit is None else self.limit / _CHECKS_PER_LIMIT

    def check(self) -> None:
        """Check the current call; the timer calls this.

        Raises:
            CallBlocked: In the middle of a call that takes too long, and again if it goes on.
        """
        if self.role is None or self.limit is None:
            self._checked_call = -1
        elif self.calls != self._checked_call:
            self._checked_call, self._since = self.calls, monotonic()
        elif monotonic() - self._since >= self.limit:
            self.overran = self.role
            raise CallBlocked(self.cause)

    @contextmanager
    def calling(self, role: str) -> Iterator[None]:
        """Context that counts as one call of a role."""
        self.calls += 1
        self.role = role
        try:
            yield
        finally:
            self.role = None

    @property
    def cause(self) -> str:
        """Description of an overrun, the same text for each."""
        return f"it did not come back within {self.limit:g} s of wall-clock time"


class Pauses:
    """Wall-clock time within calls that is not the called code's, such as a wait for others."""

    __slots__ = ("_since", "_token", "_total")

    def __init__(self) -> None:
        self._total, self._since = 0.0, 0.0
        self._token: Token[Pauses | None] | None = None

    def __enter__(self) -> Self:
        """Count the pauses from here on."""
        self._token = _PAUSES.set(self)
        return self

    def __exit__(self, *_: object) -> None:
        """Count for the surrounding call again."""
        assert self._token is not None
        _PAUSES.reset(self._token)

    @property
    def seconds(self) -> float:
        """Sum of the pauses so far, the one under way included."""
        since = self._since
        return self._total + (monotonic() - since) if since else self._total

    def begin(self) -> None:
        """Begin a pause."""
        self._since = monotonic()

    def end(self) -> None:
        """End it."""
        self._total, self._since = self.seconds, 0.0


_PAUSES: ContextVar[Pauses | None] = ContextVar("dura_pauses", default=None)


def with_pauses() -> Pauses:
    """Context of calls whose limits, and whose measured times, leave out their pauses.

    Of several calls, each leaves out the difference of ``seconds`` that it makes.
    """
    return Pauses()


@contextmanager
def paused() -> Iterator[None]:
    """Context of a pause in the call that is under way, if there is one."""
    pauses = _PAUSES.get()
    if pauses is None:
        yield
        return
    pauses.begin()
    try:
        yield
    finally:
        pauses.end()


def _paused_seconds() -> float:
    pauses = _PAUSES.get()
    return 0.0 if pauses is None else pauses.seconds


T = TypeVar("T")

GRACE = 0.2
"""Seconds that a call has to stop once it was interrupted."""

_TIMER_RESOLUTION = 2e-6
"""Seconds."""

_LEAST_WAIT = 1e-3
"""Seconds between two looks at a call that pauses."""


class TimeBudgetExceeded(CallEnded):
    """Raised inside a call that overran its budget; no ``Exception``, which callees swallow."""


class CallNotStopped(TimeBudgetExceeded):
    """Overrun of a call that could not be ended: it still runs in a thread of its own."""


def call_within(seconds: float | None, function: Callable[..., T], *args: Any) -> T:
    """Call ``function`` and end it after ``seconds`` of wall-clock time.

    In the main thread an alarm interrupts whatever runs Python bytecode, sleeps or waits. Where
    no alarm is available (in other threads, inside another limit, on Windows), the function
    runs in a thread of its own, which is left behind if it sleeps on. A call that stays inside C
    code is ended when it comes back. A call that catches the interruption and returns has overrun
    all the same.

    Raises:
        TimeBudgetExceeded: If it ran longer.
        CallNotStopped: If it ran longer and still does.
    """
    if seconds is None:
        return function(*args)
    alarm = _Alarm.installed
    if alarm is not None:  # as it is throughout an episode
        left = alarm.left()
        if left is not None:
            return _call_with_alarm(alarm, left, seconds, function, *args)
    elif _is_alarm_free():
        with alarms():
            if _Alarm.installed is not None:
                return _call_with_alarm(_Alarm.installed, 0.0, seconds, function, *args)
    return _call_in_thread(seconds, function, *args)


class _Alarm:
    """Handler of SIGALRM: ends the call that is under way, and nothing between two calls.

    It is one per process, as the signal is. The system's timer is set only where it would fire too
    late: one that fires too early is set anew then, so that most calls set none.

    Args:
        timer: For the calls that have no limit of their own, between those that have one.
    """

    installed: ClassVar[_Alarm | None] = None

    def __init__(self, timer: CallTimer) -> None:
        self.timer = timer
        self.armed = self.expired = False
        self.due = self.seconds = 0.0
        # A timer of another period is not ours.
        self.interval = timer.period or 1.0
        self._thread = threading.get_ident()

    def left(self) -> float | None:
        """Seconds until it fires, 0 where no timer is set; ``None`` where it cannot be used.

        That is in another thread, within a call that has it, and under another alarm than ours.
        """
        if self.armed or threading.get_ident() != self._thread:
            return None
        left, period = signal.getitimer(signal.ITIMER_REAL)
        # An alarm of our own timer gives way, which its period tells from any other alarm.
        is_own = left == 0.0 or abs(period - self.interval) <= _TIMER_RESOLUTION
        return left if is_own else None

    def rest(self) -> None:
        """Let the alarm fire for the timer alone, or not at all."""
        signal.setitimer(signal.ITIMER_REAL, self.timer.period, self.timer.period)

    def wait(self, seconds: float) -> None:
        """Let the alarm fire after so many seconds, and for the timer no later than without them.

        The call may end at once, and the next one, which the timer watches, may block.
        """
        if self.timer.period:
            seconds = min(seconds, self.interval)
        self.set(seconds)

    def set(self, seconds: float) -> None:
        """Let the alarm fire after so many seconds."""
        signal.setitimer(signal.ITIMER_REAL, seconds, self.interval)

    def __call__(self, _signum: int, _frame: object) -> None:
        if not self.armed:
            self.rest()
            self.timer.check()
            return
        left = self.due + _paused_seconds() - monotonic()
        if left > 0.0:  # it is of an earlier call, of the timer, or the call pauses
            self.wait(max(left, _LEAST_WAIT))
            return
        self.expired = True
        # The alarm repeats, since a callee may swallow one and go on (a bare `except` in a loop).
        self.set(max(GRACE, min(self.seconds, 1.0)))
        raise TimeBudgetExceeded


_GIVE_UP: ContextVar[Callable[[str], None] | None] = ContextVar("dura_give_up", default=None)


@contextmanager
def giving_up_by(give_up: Callable[[str], None]) -> Iterator[None]:
    """Context of an episode that a caller waits for in another thread than the main one.

    Args:
        give_up: Called, from another thread, with the role whose call stays outside of Python for
            good and with its overrun in words: nothing can end that call.
    """
    token = _GIVE_UP.set(give_up)
    try:
        yield
    finally:
        _GIVE_UP.reset(token)


class _Watch:
    """Thread that holds the calls of another one to their limit.

    It raises in the other thread, when that next runs Python bytecode. A call that does not do so
    until the next look is given up, if anybody waits for the episode, see :func:`giving_up_by`.

    Args:
        timer: Of the calls of the thread in which this is made.
    """

    def __init__(self, timer: CallTimer) -> None:
        self._timer, self._thread = timer, threading.get_ident()
        self._give_up = _GIVE_UP.get()
        self._lock, self._over = threading.Lock(), threading.Event()
        self._interrupted = -1

    def __enter__(self) -> None:
        threading.Thread(target=self._run, name="dura-watch", daemon=True).start()

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._over.set()
            if self._interrupted >= 0:  # what has not been raised by now may not be raised later
                _raise_in(self._thread, None)

    def _run(self) -> None:
        timer = self._timer
        while not self._over.wait(timer.period):
            with self._lock:
                if self._over.is_set():
                    return
                try:
                    timer.check()
                except CallBlocked as blocked:
                    is_stuck = self._interrupted == timer.calls
                    self._interrupted = timer.calls
                    _raise_in(self._thread, _with_text(blocked))
                else:
                    continue
            if is_stuck and self._give_up is not None:
                self._give_up(f"{timer.overran}: {timer.cause}")


def _with_text(blocked: CallBlocked) -> type[CallBlocked]:
    """A class of the same error with the same text: another thread makes it without arguments."""
    return type("CallBlocked", (CallBlocked,), {"__str__": lambda _: str(blocked)})


def _raise_in(thread: int, kind: type[BaseException] | None) -> None:
    """Raise an exception in a thread when it next runs bytecode; ``None`` takes that back."""
    error = ctypes.py_object() if kind is None else ctypes.py_object(kind)
    ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread), error)


@contextmanager
def alarms(timer: CallTimer | None = None) -> Iterator[None]:
    """Install the alarm's handler once for many calls, which saves them most of their cost.

    In another thread than the main one a thread of its own watches the timer instead. Where there
    is no alarm in the main thread, nothing is done, and the timer has no effect.

    Args:
        timer: For all calls that have no limit of their own.
    """
    if threading.current_thread() is not threading.main_thread():
        with nullcontext() if timer is None or timer.limit is None else _Watch(timer):
            yield
        return
    if _Alarm.installed is not None or not _is_alarm_free():
        yield
        return
    alarm = _Alarm(timer or CallTimer(None))
    previous = signal.signal(signal.SIGALRM, alarm)
    _Alarm.installed = alarm
    try:
        alarm.rest()
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        _Alarm.installed = None
        signal.signal(signal.SIGALRM, signal.SIG_DFL if previous is None else previous)


def _is_alarm_free() -> bool:
    """Whether this thread may have an alarm, and none is set."""
    is_main = threading.current_thread() is threading.main_thread()
    return (
        is_main and hasattr(signal, "setitimer") and signal.getitimer(signal.ITIMER_REAL)[0] == 0.0
    )


def _call_with_alarm(
    alarm: _Alarm, left: float, seconds: float, function: Callable[..., T], *args: Any
) -> T:
    alarm.seconds = seconds
    alarm.due = monotonic() + seconds - _paused_seconds()
    try:
        alarm.expired, alarm.armed = False, True
        if not 0.0 < left <= seconds:
            alarm.wait(seconds)
        try:
            result = function(*args)
        finally:
            alarm.armed = False
    finally:  # the alarm may fire in the first one
        alarm.armed = False
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
    before, end = _paused_seconds(), monotonic() + seconds
    thread.start()
    while not done.wait(max(end + _paused_seconds() - before - monotonic(), _LEAST_WAIT)):
        if monotonic() < end + _paused_seconds() - before:
            continue
        with lock:
            if not finished and thread.ident is not None:
                _raise_in(thread.ident, TimeBudgetExceeded)
        raise TimeBudgetExceeded if done.wait(GRACE) else CallNotStopped
    if errors:
        raise errors[0]
    return results[0]
