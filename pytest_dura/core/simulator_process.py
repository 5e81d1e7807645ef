"""What a simulator holds of its process: a resource that outlives episodes, and the only place.

A class of simulators is opened in a process before its first episode there, and closed when the
process ends: a server is started once, and not for each episode. Of a class with ``instances`` "one
per process" at most one episode runs at a time.
"""

from __future__ import annotations

import atexit
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from pytest_dura.core.calls import current_calls
from pytest_dura.core.classes import is_subclass
from pytest_dura.core.errors import ConfigurationError, describe_error
from pytest_dura.core.simulator import Simulator

_opened: list[tuple[int, type[Simulator]]] = []
"""Classes that are open, the last one opened last, each with the process in which it was."""
_places: dict[type[Simulator], _Place] = {}
_guard = threading.RLock()


class _Place:
    """The place of a class of which a process runs one at a time."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._thread: int | None = None

    @contextmanager
    def taken(self, name: str) -> Iterator[None]:
        """Wait until no other thread has it, and take it.

        Raises:
            ConfigurationError: If this thread has it already, and would wait for itself.
        """
        if self._thread == threading.get_ident():
            raise ConfigurationError(
                f"an episode in {name} begins while another one runs: there is one per process",
                key="simulator",
                found="two episodes at a time",
                expected="a simulator with many instances, or one episode after the other",
                remedy="let a role that simulates by itself use another simulator",
            )
        with self._lock:
            self._thread = threading.get_ident()
            try:
                yield
            finally:
                self._thread = None


@contextmanager
def simulating(factory: Callable[..., Any]) -> Iterator[None]:
    """Context of one episode: the simulator's class is open, and has its place in the process.

    Args:
        factory: The class; a function that makes simulators is taken as it is.

    Raises:
        ConfigurationError: If the class cannot be opened, or is in use by this thread.
    """
    if not is_subclass(factory, Simulator):
        yield
        return
    open_class(factory)
    if factory.instances == "many":
        yield
        return
    with _guard:
        place = _places.setdefault(factory, _Place())
    with place.taken(factory.__name__):
        yield


def open_class(simulator: type[Simulator]) -> None:
    """Open a class in this process, unless it is open.

    Raises:
        ConfigurationError: If it cannot be opened; it is tried again for the next episode.
    """
    if simulator.open_process.__func__ is Simulator.open_process.__func__:  # type: ignore[attr-defined]
        return
    here = os.getpid(), simulator
    with _guard:
        if here in _opened:
            return
        try:
            with current_calls().calling("simulator"):
                simulator.open_process()
        except ConfigurationError:
            raise
        except Exception as error:
            raise ConfigurationError(
                f"{simulator.__name__} cannot be opened: {describe_error(error)}",
                key="simulator",
                found=f"{simulator.__module__}:{simulator.__qualname__}",
                remedy="correct its `open_process`, or what that starts",
            ) from error
        if not _opened:
            atexit.register(close_classes)
        _opened.append(here)


def close_classes() -> list[str]:
    """Close what was opened in this process, the last one first.

    Returns:
        What went wrong, in words; the other classes are closed all the same.
    """
    problems = []
    with _guard:
        while _opened:
            process, simulator = _opened.pop()
            if process != os.getpid():  # a fork leaves it to its parent
                continue
            try:
                simulator.close_process()
            except Exception as error:
                problems.append(f"{simulator.__name__} cannot be closed: {describe_error(error)}")
    atexit.unregister(close_classes)
    return problems
