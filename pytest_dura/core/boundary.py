"""The boundary between the loop and code that is not ours: roles, simulators, checks, metrics.

What such code raises counts as its own failure. Two kinds of exceptions come out of a call without
being raised by its code: those of signal handlers (the user's Ctrl-C, the time limit of another
plugin), and our own :class:`CallEnded`. While a :class:`Boundary` is open, handlers of signals are
wrapped, which tells the first kind from an exception of the same type that the code itself raises.

Called code may end its process, which is why episodes have processes of their own. Where pytest's
process simulates, an end or replacement of it never reads as a success: see :func:`lasting_guard`.

Every call has a wall-clock limit, so that nothing blocks for ever: the component its time budget
(:func:`call_within`), everything else the limit of a :class:`CallTimer`. Both share one alarm. No
alarm reaches another thread than the main one: there a second thread watches the calls.
"""

from __future__ import annotations

import contextvars
import ctypes
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from contextvars import ContextVar, Token
from functools import partial
from time import monotonic
from typing import TYPE_CHECKING, Any, ClassVar, NoReturn, TypeVar

if TYPE_CHECKING:
    from typing_extensions import Self


EXIT_CODE = 70
"""Exit code (``EX_SOFTWARE``) of a process that would have ended itself with 0, and of copies."""

_INTERRUPTING = {
    getattr(signal, name): name != "SIGALRM"
    for name in ("SIGINT", "SIGTERM", "SIGBREAK", "SIGALRM")
    if hasattr(signal, name)
}
"""Signals whose handlers raise exceptions, of pytest, a plugin or a user, and whether they end the
session: then no call goes on after one of them."""
_DEBUGGERS = ("bdb", "_pytest.debugging")
"""Modules that raise what ends a session when a user quits a debugger."""

traceback_of: Any = vars(BaseException)["__traceback__"].__get__
"""Returns the traceback of an error, past what its class overrides."""
_end: Callable[[int], NoReturn] = os._exit


class CallEnded(BaseException):
    """Raised by the loop in a call that takes too long; only the loop handles it."""


class SessionWanted(BaseException):
    """Raised in a call that needs what only the session's process has, such as its terminal."""


class Boundary:
    """Context in which code that is not ours is called.

    ``signalled`` is an exception of a signal handler, which a call does not hide by catching it.
    """

    __slots__ = ("_handlers", "_interruptible", "_passing", "_pid", "_token", "signalled")

    def __init__(self) -> None:
        self._pid = os.getpid()
        self.signalled: BaseException | None = None
        self._passing: BaseException | None = None
        self._interruptible = False
        self._handlers: dict[int, tuple[Any, Any]] = {}
        self._token: Token[Boundary | None] | None = None

    def __enter__(self) -> Self:
        """Wrap the handlers of signals."""
        self._token = _CURRENT.set(self)
        if threading.current_thread() is threading.main_thread():
            for number, lasting in _INTERRUPTING.items():
                self._wrap(number, lasting=lasting)
            self._interruptible = signal.getsignal(signal.SIGINT) is not None
        return self

    def __exit__(self, *_: object) -> None:
        """Restore the handlers, but for those that were replaced meanwhile."""
        if os.getpid() != self._pid:  # a copy that the called code has made of this process
            end_process(EXIT_CODE)
        for number, (own, before) in self._handlers.items():
            if signal.getsignal(number) is own:
                signal.signal(number, before)
        assert self._token is not None
        _CURRENT.reset(self._token)

    def let_pass(self, error: BaseException) -> None:
        """Raise an exception again unless the called code raised it.

        A ``KeyboardInterrupt`` that might be the user's, as in another thread than the main one,
        is taken for the user's.

        Args:
            error: The exception that came out of a call.
        """
        self.raise_signalled()
        if error is self._passing:
            raise error
        if isinstance(error, KeyboardInterrupt) and not self._interruptible:
            raise error
        if isinstance(error, SessionWanted) or _is_of_debugger(error):
            raise error

    def raise_signalled(self) -> None:
        """Raise the exception of a signal handler that a call has caught."""
        if self.signalled is not None:
            raise self.signalled

    def _wrap(self, number: int, *, lasting: bool) -> None:
        before = signal.getsignal(number)
        if callable(before):
            own = partial(self._handle, before, lasting)
            signal.signal(number, own)
            self._handlers[number] = own, before

    def _handle(
        self, handler: Callable[[int, Any], Any], lasting: bool, number: int, frame: Any
    ) -> None:
        __tracebackhide__ = True
        try:
            handler(number, frame)
        except BaseException as error:
            if lasting:
                self.signalled = error
            else:
                self._passing = error
            raise


def _is_of_debugger(error: BaseException) -> bool:
    """Whether a user left a debugger, in the called code, by quitting."""
    trace = traceback_of(error)
    while trace is not None:
        if trace.tb_frame.f_globals.get("__name__") in _DEBUGGERS:
            return True
        trace = trace.tb_next
    return False


_CURRENT: ContextVar[Boundary | None] = ContextVar("dura_boundary", default=None)


def let_pass(error: BaseException) -> None:
    """Raise an exception again unless the called code raised it, see :meth:`Boundary.let_pass`.

    Where no boundary is open, only a ``KeyboardInterrupt`` is raised.
    """
    boundary = _CURRENT.get()
    if boundary is not None:
        boundary.let_pass(error)
    elif isinstance(error, KeyboardInterrupt):
        raise error


def end_process(code: int) -> NoReturn:
    """End this process at once, past the guard."""
    _end(code)


@contextmanager
def lasting_guard(say: Callable[[str], object]) -> Iterator[None]:
    """Context in which ``os._exit(0)`` ends the process with :data:`EXIT_CODE`, at any time.

    So does ``os.exec*``, after which the exit code would be that of another program. A thread or a
    finalizer that a component leaves behind may call them between episodes.

    Args:
        say: Prints a line before the process ends.
    """
    modules = [os, *filter(None, [sys.modules.get(os.name)])]
    pid = os.getpid()

    def guarded(name: str, real: Callable[..., NoReturn], *args: Any) -> NoReturn:
        is_success = name != "_exit" or args[:1] == (0,)
        if is_success and os.getpid() == pid:
            say(f"dura: os.{name} was called while a session ran: exit code {EXIT_CODE}")
            end_process(EXIT_CODE)
        real(*args)

    places = [
        (module, name, getattr(module, name), partial(guarded, name, getattr(os, name)))
        for module in modules
        for name in ("_exit", "execv", "execve")
        if hasattr(module, name)
    ]
    for module, name, _, stand_in in places:
        setattr(module, name, stand_in)
    try:
        yield
    finally:
        for module, name, real, stand_in in places:
            if getattr(module, name) is stand_in:
                setattr(module, name, real)


class HeldInterruptions:
    """Context in which Ctrl-C waits, so that what is written in it is written whole.

    What came meanwhile is delivered at its end, once, unless an exception leaves it already. In
    another thread than the main one, which no signal reaches, nothing waits.

    Args:
        passing: How many are delivered at once, before the next ones wait.
    """

    def __init__(self, passing: int = 0) -> None:
        self._passing = passing
        self._waiting: tuple[int, Any] | None = None
        self._before: Any = None

    def __enter__(self) -> Self:
        """Wrap the handler of Ctrl-C, where there is one."""
        before = signal.getsignal(signal.SIGINT)
        if threading.current_thread() is threading.main_thread() and callable(before):
            self._before = before
            signal.signal(signal.SIGINT, self._handle)
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Restore the handler, unless it was replaced meanwhile, and deliver what waits."""
        if signal.getsignal(signal.SIGINT) == self._handle:
            signal.signal(signal.SIGINT, self._before)
        if self._waiting is not None and kind is None:
            self._before(*self._waiting)

    def _handle(self, number: int, frame: Any) -> None:
        __tracebackhide__ = True
        if self._passing:
            self._passing -= 1
            self._before(number, frame)
        else:
            self._waiting = number, frame


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
