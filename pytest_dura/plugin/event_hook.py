"""The hook ``pytest_dura_event``: what users implement to follow a session, and its caller."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, get_args

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable

    from pytest_dura.campaign.events import EventStream, SessionEvent
    from pytest_dura.core.errors import ConfigurationError


@pytest.hookspec
def pytest_dura_event(event: SessionEvent) -> None:
    """Take notice of an event of a session: an episode used, a verdict reached, and the like.

    It is called once for each event, in the process that runs the item, when the event happens:
    under pytest-xdist in the worker, and never in the controller. What it raises fails the item,
    and the gate.

    Args:
        event: One of the types of ``pytest_dura.campaign.SessionEvent``; it is not to be changed.
    """


class EventHook:
    """Calls the implementations of ``pytest_dura_event``.

    Args:
        config: Whose plugins and conftest files implement it.
        add_problem: Records what fails the gate, whatever the item makes of the error.
    """

    def __init__(self, config: pytest.Config, add_problem: Callable[[str], None]) -> None:
        self._config, self._add_problem = config, add_problem

    def subscribe(self, events: EventStream) -> None:
        """Call the hook with every event."""
        from pytest_dura.campaign.events import SessionEvent

        for kind in get_args(SessionEvent):
            events.subscribe(kind, self._call)

    def _call(self, event: SessionEvent) -> None:
        __tracebackhide__ = True
        try:
            self._config.hook.pytest_dura_event(event=event)
        except pytest.exit.Exception:  # it ends the session, which is not whole then
            raise
        except (Exception, pytest.fail.Exception, pytest.skip.Exception) as error:
            failure = self._failure(event, error)
            self._add_problem(f"infrastructure: {str(failure).partition(chr(10))[0]}")
            raise failure from error

    def _failure(self, event: SessionEvent, error: BaseException) -> ConfigurationError:
        """Make the error that names the implementation which raised, and its line."""
        from pytest_dura.core.errors import ConfigurationError, describe_error
        from pytest_dura.provenance import recorded_path

        entries = pytest.ExceptionInfo.from_exception(error).traceback
        own = [entry for entry in entries if entry.name == "pytest_dura_event"]
        place = own[-1] if own else entries[-1]
        return ConfigurationError(
            f"the hook pytest_dura_event raised at {type(event).__name__}: {describe_error(error)}",
            file=recorded_path(Path(place.path), self._config.rootpath),
            line=place.lineno + 1,
            expected="a hook that takes notice of the event, and raises nothing",
            remedy="correct the hook, or catch there what may fail",
        )
