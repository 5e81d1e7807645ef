"""Repeats: one episode of each case is run twice in a session, and compared with itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pytest_dura.core.errors import describe_error
from pytest_dura.plugin.messages import shown_lines

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pytest

    from pytest_dura.campaign.cases import Case
    from pytest_dura.campaign.episodes.task import EpisodeTask
    from pytest_dura.evidence.record.session_record import SessionRecord
    from pytest_dura.plugin.session import DuraSession
    from pytest_dura.requirements.verdicts import JudgedEpisode


@dataclass(frozen=True)
class _Due:
    """An episode that is to be repeated."""

    task: EpisodeTask
    digest: str
    why_not: str | None
    """Why it cannot be, if so."""


class Repeats:
    """Repeats the first episode of each case once this process has run the last item on it.

    By then the process has run other episodes, so that what they left in classes or modules shows.
    Of the processes of a session one simulates the repetition.

    Args:
        session: The session of this process.
    """

    def __init__(self, session: DuraSession) -> None:
        self.session = session
        self._due: dict[tuple[str, str], _Due] = {}
        self._done: set[tuple[str, str]] = set()

    def episode_used(self, case: Case, episode: JudgedEpisode) -> None:
        """An item looked at a planned episode of a case."""
        key = case.id, episode.spec.component
        if key in self._due or key in self._done or episode.failure is not None:
            return
        from pytest_dura.campaign.episodes.address import model_answers

        task = self.session.bench.task(case, episode.spec.run)
        answers = model_answers(task)
        live = answers is not None and not answers.startswith("replay ")
        why_not = "a live language model answers" if live else None
        self._due[key] = _Due(task, episode.digest, why_not)

    def item_ends(self, item: pytest.Item, nextitem: pytest.Item | None) -> None:
        """Repeat what is due, unless the next item is on the same case."""
        stopped = bool(item.session.shouldstop or item.session.shouldfail)
        if stopped or self.session.simulating.is_lost:
            self._due.clear()
        if not self._due or (nextitem is not None and _case_of(nextitem) == _case_of(item) != ""):
            return
        for (case, component), due in list(self._due.items()):
            found = self._repeated(due)
            self._done.add((case, component))
            if found is not None:
                told = {"case": case, "component": component, "episode": due.task.spec.id}
                self.session.reporter.case_repeated({**told, "digest": due.digest, **found})
        self._due.clear()

    def _repeated(self, due: _Due) -> Mapping[str, Any] | None:
        """What came of it; ``None`` if another process finds that out."""
        if due.why_not is not None:
            return {"result": "skipped", "repeated_digest": None, "detail": due.why_not}
        if not self.session.shared.first_to_repeat(due.task.spec.case, due.task.spec.component):
            return None
        try:
            with self.session.models.uncounted():
                again = self.session.bench.store.repeat(due.task)
        except Exception as error:  # whatever user code raises: the first time it did not
            return {
                "result": "failed",
                "repeated_digest": None,
                "detail": f"infrastructure: {describe_error(error)}",
            }
        result = "equal" if again.digest == due.digest else "different"
        if again.failure is not None:
            result = "failed"
        return {"result": result, "repeated_digest": again.digest, "detail": again.failure or ""}


def _case_of(item: pytest.Item) -> str:
    """Id of the case that an item looks at; empty for one that chooses its episodes itself."""
    planned = getattr(item, "planned", None)
    for value in getattr(getattr(item, "callspec", None), "params", {}).values():
        if hasattr(value, "planned") and hasattr(value, "case"):
            planned = value
    return "" if planned is None else str(planned.case.id)


def show_repeats(session: DuraSession, terminal: Any, record: SessionRecord) -> None:
    """The cases that are not repeatable, unless the gate says so anyway."""
    from pytest_dura.evidence.record.repeats import not_repeatable

    for line in not_repeatable(record["cases"]):
        if line not in session.evidence.objections:
            for part in shown_lines(line):
                terminal.line(part, yellow=True)
