"""Batches: runs of a black box that are simulated together, since they come one after the other."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from logging import getLogger
from typing import Any, Generic, TypeVar

from pytest_dura.core.errors import describe_error

_LOG = getLogger(__name__)
RunT = TypeVar("RunT", bound=Hashable)


class Batches(Generic[RunT]):
    """Runs that are announced, and simulated together once the first of them is asked for.

    Each result is handed out once: an equal run that comes again is simulated again, by itself, so
    that a replay shows whether a batch changes anything.
    """

    def __init__(self) -> None:
        self._announced: tuple[RunT, ...] = ()
        self._ready: dict[RunT, Mapping[str, Any]] = {}

    def announce(self, runs: Sequence[RunT]) -> None:
        """Note which runs come next, unless they are simulated already."""
        if runs and not any(run in self._ready for run in runs):
            self._announced, self._ready = tuple(dict.fromkeys(runs)), {}

    def take(
        self, run: RunT, simulate: Callable[[Sequence[RunT]], Sequence[Mapping[str, Any]]]
    ) -> Mapping[str, Any] | None:
        """Return what a run came to; ``None`` if it is to be simulated by itself.

        One of the others may be at fault where a batch fails: then each is simulated by itself, and
        fails by itself.

        Args:
            run: The run.
            simulate: Simulates runs, and returns a result for each, in their order.
        """
        if run in self._announced and len(self._announced) > 1:
            runs, self._announced = self._announced, ()
            try:
                results = simulate(runs)
                self._ready = dict(zip(runs, results, strict=True))
            except Exception as error:
                text = "%d runs are simulated one by one: %s"
                _LOG.warning(text, len(runs), describe_error(error))
        return self._ready.pop(run, None)
