"""Batches: runs of a black box that are simulated together, since they come one after the other."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from logging import getLogger
from typing import Any, Generic, TypeVar

from pytest_dura.core.errors import describe_error

_LOG = getLogger(__name__)
RunT = TypeVar("RunT", bound=Hashable)
Result = Mapping[str, Any]


class Batches(Generic[RunT]):
    """Results of runs that were simulated together, for those that are asked for as a batch.

    Each result is handed out once, and to a run of a batch alone: a run that stands by itself, such
    as a replay or a run of a campaign, is simulated by itself, whatever a search left over.
    """

    def __init__(self) -> None:
        self._ready: dict[RunT, Result] = {}
        self._failed: frozenset[RunT] = frozenset()

    def forget(self) -> None:
        """Forget what was simulated together."""
        self._ready, self._failed = {}, frozenset()

    def take(
        self,
        run: RunT,
        batch: Callable[[], Sequence[RunT]],
        simulate: Callable[[Sequence[RunT]], Sequence[Result]],
        check: Callable[[Result], None],
    ) -> Result | None:
        """Return what a run came to; ``None`` if it is to be simulated by itself.

        One of the others may be at fault where a batch fails: then each is simulated by itself, and
        fails by itself.

        Args:
            run: The run.
            batch: Returns the runs that are asked for at once, this one among them.
            simulate: Simulates runs, and returns a result for each, in their order.
            check: Raises an error if the result of ``run`` in a batch is not its own.
        """
        if run in self._ready:
            return self._ready.pop(run)
        if run in self._failed:
            return None
        runs = tuple(dict.fromkeys(batch()))
        self.forget()
        if run not in runs or len(runs) == 1:
            return None
        try:
            ready = dict(zip(runs, simulate(runs), strict=True))
        except Exception as error:  # of the user's code; each run raises its own again
            self._failed = frozenset(runs)
            text = "%d runs are simulated one by one: %s"
            _LOG.warning(text, len(runs), describe_error(error))
            return None
        result = ready.pop(run)
        check(result)
        self._ready = ready
        return result
