"""The boundary between the loop and code that is not ours: roles, simulators, checks, metrics.

What such code raises counts as its own failure. Two kinds of exceptions come out of a call without
being raised by its code: those of signal handlers (the user's Ctrl-C, the time limit of another
plugin), and our own :class:`CallEnded`. While a :class:`Boundary` is open, handlers of signals are
wrapped, which tells the first kind from an exception of the same type that the code itself raises.

Called code may end its process, which is why episodes have processes of their own. Where pytest's
process simulates, an end or replacement of it never reads as a success: see :func:`lasting_guard`.

How long a call may take is the matter of :mod:`pytest_dura.core.time_limits`.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar, Token
from functools import partial
from typing import TYPE_CHECKING, Any, NoReturn

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
