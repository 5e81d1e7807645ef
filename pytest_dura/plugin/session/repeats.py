"""Repetition of one episode of each case, by which differences show."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pytest_dura.core.errors import describe_error
from pytest_dura.guests import reason_to_differ
from pytest_dura.plugin.context import draws_reason
from pytest_dura.plugin.items.outcomes import target_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    import numpy as np
    import pytest
    from numpy.typing import NDArray

    from pytest_dura.campaign.events import EpisodeUsed
    from pytest_dura.evidence.lines import RepeatedCase
    from pytest_dura.execution.task import EpisodeTask
    from pytest_dura.plugin.context import SessionContext
    from pytest_dura.plugin.session.executor import SessionExecutor


@dataclass(frozen=True)
class _DueRepetition:
    """An episode that is to be repeated."""

    task: EpisodeTask
    digest: str
    declared: str
    """What declares that it may differ; empty if nothing does."""
    skipped: bool
    """Whether a guest declares it, so that repeating it would say nothing."""
    signals: Mapping[str, NDArray[np.float64]]
    """To be compared within :attr:`tolerances`; empty where the digest is."""
    tolerances: Mapping[str, float] | None
    """Those of a simulator that is not deterministic; ``None`` for another one."""


class Repeats:
    """Repeats the first episode of each case once this process has run the last item on it.

    By then the process has run other episodes, so that what they left in classes or modules shows.

    Args:
        context: The session's context.
        executor: Who simulates.
    """

    def __init__(
        self,
        context: SessionContext,
        executor: SessionExecutor,
    ) -> None:
        self._context, self._executor = context, executor
        self._due: dict[tuple[str, str], _DueRepetition] = {}
        self._done: set[tuple[str, str]] = set()

    def episode_used(self, event: EpisodeUsed) -> None:
        """Note the first planned episode of a case, which is to be repeated."""
        case, episode = event.case, event.episode
        key = case.id, episode.spec.component
        known = key in self._due or key in self._done
        if not event.planned or known or episode.failure is not None:
            return
        from pytest_dura.library.scenario import tolerances_of

        task = self._context.runner.task(case, episode.spec.run)
        declared = draws_reason(self._context, case)
        skipped = bool(declared) and declared == reason_to_differ(task.spec.roles.values())
        tolerances = tolerances_of(task.spec)
        signals = {} if tolerances is None else episode.signals
        self._due[key] = _DueRepetition(
            task, episode.digest, declared, skipped, signals, tolerances
        )

    def item_ends(self, item: pytest.Item, nextitem: pytest.Item | None) -> Iterator[RepeatedCase]:
        """Repeat what is due, unless the next item is on the same case.

        Yields:
            What came of each repetition.
        """
        stopped = bool(item.session.shouldstop or item.session.shouldfail)
        if stopped or self._executor.is_lost:
            self._due.clear()
        if not self._due or (
            nextitem is not None and _case_id_of(nextitem) == _case_id_of(item) != ""
        ):
            return
        from pytest_dura.evidence.lines import RepeatedCase

        # The last case first: a component that behaves by turns, one way in a run and another way
        # in its twin, would otherwise meet the turn of the first time.
        in_turn = list(reversed(self._due.items()))
        due_tasks = [due.task for _, due in in_turn if not due.skipped]
        self._context.runner.store.begin_repeats(due_tasks)
        for (case, component), due in in_turn:
            self._done.add((case, component))
            about = {"case": case, "component": component, "episode": due.task.spec.id}
            about |= {"digest": due.digest, "declared": due.declared}
            yield RepeatedCase.from_data({**about, **self._repeated(due)})
        self._due.clear()

    def _repeated(self, due: _DueRepetition) -> Mapping[str, Any]:
        """Repeat an episode."""
        if due.skipped:
            return {"result": "skipped", "repeated_digest": None, "detail": due.declared}
        try:
            with self._context.guests.uncounted():
                repetition = self._context.runner.store.repeat(due.task)
        except Exception as error:  # whatever user code raises, which it did not the first time
            return {
                "result": "failed",
                "repeated_digest": None,
                "detail": f"infrastructure: {describe_error(error)}",
            }
        result = "equal" if repetition.digest == due.digest else "different"
        detail = repetition.failure or ""
        if repetition.failure is not None:
            result = "failed"
        elif result == "different" and due.tolerances is not None:
            from pytest_dura.core.simulator import beyond_tolerance, describe_tolerances

            beyond = beyond_tolerance(due.tolerances, due.signals, repetition.signals)
            result = "within tolerances" if beyond is None else result
            detail = beyond or describe_tolerances(due.tolerances)
        return {"result": result, "repeated_digest": repetition.digest, "detail": detail}


def _case_id_of(item: pytest.Item) -> str:
    """Id of the case that an item looks at; empty where it chooses its episodes itself."""
    target = target_of(item)
    return "" if target is None else str(target.case.id)
