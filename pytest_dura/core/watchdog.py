"""A wall-clock limit on every call into anything but the component: nothing blocks for ever.

The component has a budget of its own, see :mod:`pytest_dura.core.limits`, whose alarm this shares.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from time import monotonic

from pytest_dura.core.boundary import CallEnded

ROLE_TIMEOUT = 60.0
"""Seconds of wall-clock time that a role or the simulator has for one call."""
_STROKES = 4
"""How often the timer strikes within the limit."""


class CallBlocked(CallEnded):
    """Raised inside a call that has not come back in time. The callee must not swallow it."""


class Watch:
    """Ends a call that takes too long. It costs a call two attributes, and no timer of its own.

    A timer strikes again and again; a call that is seen to be under way for longer than the limit
    is ended, after at most one and a half times that.

    Args:
        limit: Seconds of wall-clock time for one call; ``None`` waits for ever.
    """

    def __init__(self, limit: float | None) -> None:
        self.limit = limit
        self.calls = 0
        """Calls that have begun."""
        self.role: str | None = None
        """Who is called at this moment, if anybody is."""
        self.overran: str | None = None
        """Who took too long, also if it went on and came back in the end."""
        self._seen = -1
        self._since = 0.0

    @property
    def period(self) -> float:
        """Seconds from stroke to stroke; 0 without a limit."""
        return 0.0 if self.limit is None else self.limit / _STROKES

    def strike(self) -> None:
        """What the timer does.

        Raises:
            CallBlocked: In the middle of a call that takes too long, and again if it goes on.
        """
        if self.role is None or self.limit is None:
            self._seen = -1
        elif self.calls != self._seen:
            self._seen, self._since = self.calls, monotonic()
        elif monotonic() - self._since >= self.limit:
            self.overran = self.role
            raise CallBlocked(self.cause)

    @contextmanager
    def calling(self, role: str) -> Iterator[None]:
        """Watch what is done meanwhile as one call."""
        self.calls += 1
        self.role = role
        try:
            yield
        finally:
            self.role = None

    @property
    def cause(self) -> str:
        """What happened, in words that are the same whenever it happens."""
        return f"it did not come back within {self.limit:g} s of wall-clock time"
