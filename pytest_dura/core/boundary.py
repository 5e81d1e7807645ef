"""The boundary between the loop and code that is not ours: roles, simulators, checks, metrics.

Whatever such code raises says something about it, and about nobody else. Two kinds of exceptions
come out of a call without being raised by its code: those of signal handlers (the user's Ctrl-C,
the time limit of another plugin), and our own :class:`CallEnded`. While a :class:`Boundary` is
open, handlers of signals are wrapped, so that the first kind can be told from an exception of the
same type that the code has raised itself.

Called code does not end the process either: ``os._exit`` and ``os.exec*`` are refused where it
runs, and a copy of the process that it makes by ``os.fork`` ends where the call would return.
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
"""Signals whose handlers raise exceptions, of pytest, a plugin or a user; and whether they are
meant for the session, so that no call goes on after one of them."""
_STARTS_PROGRAMS = ("multiprocessing", "subprocess", "concurrent")
"""Packages whose copies of a process never return from the call that made them."""

_end: Callable[[int], NoReturn] = os._exit


class CallEnded(BaseException):
    """Raised by the loop in a call that takes too long. Nobody else handles it."""


class ExitRefusedError(BaseException):
    """Raised in place of ending or replacing the process in the middle of an episode."""


class Boundary:
    """Context in which code that is not ours is called.

    ``noted`` is ``True`` once there is something that a call cannot hide by catching exceptions:
    an exception of a signal handler, or what it did to the process (``misdeed``).
    """

    __slots__ = (
        "_handlers", "_hears_keys", "_passing", "_signalled", "_token", "misdeed", "noted", "pid",
    )  # fmt: skip

    def __init__(self) -> None:
        self.pid = os.getpid()
        self.noted = False
        self.misdeed: str | None = None
        self._signalled: BaseException | None = None
        self._passing: BaseException | None = None
        self._hears_keys = False
        self._handlers: dict[int, tuple[Any, Any]] = {}
        self._token: Token[Boundary | None] | None = None

    def __enter__(self) -> Self:
        """Wrap the handlers of signals, and refuse to end the process."""
        _install()
        self._token = _CURRENT.set(self)
        if threading.current_thread() is threading.main_thread():
            for number, lasting in _INTERRUPTING.items():
                self._wrap(number, lasting=lasting)
            self._hears_keys = signal.getsignal(signal.SIGINT) is not None
        return self

    def __exit__(self, *_: object) -> None:
        """Put back what was there, as far as nobody has put something else there meanwhile."""
        self.end_copy()
        for number, (own, before) in self._handlers.items():
            if signal.getsignal(number) is own:
                signal.signal(number, before)
        assert self._token is not None
        _CURRENT.reset(self._token)
        _uninstall()

    def let_pass(self, error: BaseException) -> None:
        """Raise what was not raised by the code that was called.

        A ``KeyboardInterrupt`` that cannot be told from the user's, as in another thread than the
        main one, is taken for the user's.

        Args:
            error: What came out of a call.
        """
        if self._signalled is not None:
            raise self._signalled
        if error is self._passing:
            raise error
        if isinstance(error, KeyboardInterrupt) and not self._hears_keys:
            raise error

    def raise_signalled(self) -> None:
        """Raise what a signal handler raised in a call that went on all the same."""
        if self._signalled is not None:
            raise self._signalled

    def take_misdeed(self) -> str | None:
        """What the call that is over did to the process, in words, if anything.

        Raises:
            BaseException: What a signal handler raised meanwhile, if it did.
        """
        self.raise_signalled()
        self.noted = False
        misdeed, self.misdeed = self.misdeed, None
        return misdeed

    def note(self, misdeed: str) -> None:
        """Note what the call under way does to the process; the first such thing is kept."""
        self.misdeed = self.misdeed or misdeed
        self.noted = True

    def end_copy(self) -> None:
        """End the process at once if it is a copy of the one that began the episode."""
        if os.getpid() != self.pid:
            end_process(EXIT_CODE)

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
                self._signalled, self.noted = error, True
            else:
                self._passing = error
            raise


_CURRENT: ContextVar[Boundary | None] = ContextVar("dura_boundary", default=None)


def let_pass(error: BaseException) -> None:
    """Raise what the code that was called has not raised itself, see :meth:`Boundary.let_pass`.

    Where no boundary is open, that is any ``KeyboardInterrupt``.
    """
    boundary = _CURRENT.get()
    if boundary is not None:
        boundary.let_pass(error)
    elif isinstance(error, KeyboardInterrupt):
        raise error


def end_process(code: int) -> NoReturn:
    """End this process at once; nothing refuses that."""
    _end(code)


@contextmanager
def lasting_guard() -> Iterator[None]:
    """Context in which the process does not end itself with a success between episodes either.

    What a component leaves behind, such as a thread or a finalizer, may call ``os._exit`` at any
    time: then the exit code is :data:`EXIT_CODE` in place of 0.
    """
    _install()
    try:
        yield
    finally:
        _uninstall()


def _exit(status: int) -> NoReturn:
    """Stand in for ``os._exit``."""
    boundary = _CURRENT.get()
    if boundary is not None and boundary.pid == os.getpid():
        _refuse(boundary, f"os._exit({status})" if type(status) is int else "os._exit")
    lasts = boundary is None and _GUARD.wanted > 0 and os.getpid() == _GUARD.pid
    if lasts and status == 0:
        text = f"dura: os._exit(0) was called while a session ran: exit code {EXIT_CODE}\n"
        os.write(2, text.encode())
        end_process(EXIT_CODE)
    end_process(status)


def _execute(name: str, real: Callable[..., NoReturn], *args: Any) -> NoReturn:
    """Stand in for ``os.execv`` and ``os.execve``."""
    boundary = _CURRENT.get()
    if boundary is not None and boundary.pid == os.getpid():
        _refuse(boundary, f"os.{name}")
    real(*args)


def _refuse(boundary: Boundary, what: str) -> NoReturn:
    tried = f"tried to end the process by {what}"
    boundary.note(tried)
    raise ExitRefusedError(tried)


class _Guard:
    """What stands in for functions of ``os``, as long as anybody wants it."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.wanted = self.pid = 0
        modules = [os, *filter(None, [sys.modules.get(os.name)])]
        stand_ins: dict[str, Callable[..., Any]] = {"_exit": _exit}
        for name in ("execv", "execve"):
            stand_ins[name] = partial(_execute, name, getattr(os, name))
        self.places = [
            (module, name, getattr(module, name), stand_in)
            for module in modules
            for name, stand_in in stand_ins.items()
            if hasattr(module, name)
        ]


_GUARD = _Guard()


def _install() -> None:
    with _GUARD.lock:
        _GUARD.wanted += 1
        if _GUARD.wanted == 1:
            _GUARD.pid = os.getpid()
            for module, name, _, stand_in in _GUARD.places:
                setattr(module, name, stand_in)


def _uninstall() -> None:
    with _GUARD.lock:
        _GUARD.wanted -= 1
        if _GUARD.wanted == 0:
            for module, name, real, stand_in in _GUARD.places:
                if getattr(module, name) is stand_in:
                    setattr(module, name, real)


def _after_fork() -> None:
    boundary = _CURRENT.get()
    if boundary is None or boundary.pid != os.getpid():
        return
    caller = sys._getframe(1).f_globals.get("__name__")  # noqa: SLF001 - who has called os.fork
    if str(caller).partition(".")[0] not in _STARTS_PROGRAMS:
        boundary.note("forked the process")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_parent=_after_fork)
