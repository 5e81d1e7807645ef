"""What simulates the episodes of this process: the chosen executor, or one that fits."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.evidence.text import counted
from pytest_dura.guests import AtOnce

if TYPE_CHECKING:
    from collections.abc import Mapping, MutableMapping, Sequence

    import pytest

    from pytest_dura.core.role_spec import RoleSpec
    from pytest_dura.execution.executors import Execution, ExecutorChoice
    from pytest_dura.plugin.context import Planned, SessionContext

_SIMULATED_HERE_KEY = "dura_simulated_here"
"""Key in the output of a worker of pytest-xdist."""


class SessionExecutor:
    """Simulates the episodes of this process, itself or through an executor.

    Args:
        choice: Who simulates, if it is not this process itself; ``auto`` leaves it to
            :meth:`choose`.
        at_once: What episodes that stay in this process do at the same time, in threads.
        is_worker: Whether this is a worker of pytest-xdist.
        alone: Whether it is the only one, if it is a worker.
        collect_only: Whether nothing is run.
    """

    def __init__(
        self,
        choice: ExecutorChoice | Literal["auto"] | None,
        *,
        at_once: Sequence[AtOnce] = (),
        is_worker: bool,
        alone: bool,
        collect_only: bool,
    ) -> None:
        self._alone = alone
        self._automatic = choice == "auto"
        self._choice = None if choice == "auto" else choice
        self._chosen: str | None = None
        """Why this executor simulates, where no option names it, once it is known."""
        self._is_notable = False
        self._at_once = at_once
        self._is_worker, self._collect_only = is_worker, collect_only
        self._execution: Execution | ConfigurationError | None = None
        self._in_test = False
        self._simulated_here: Counter[tuple[str, str]] = Counter()

    def execution(self) -> Execution:
        """Return what simulates, made at the first call.

        Raises:
            ConfigurationError: If it cannot be used; the same one at every call.
        """
        if self._execution is None:
            from pytest_dura.execution.executors import Execution

            try:
                chosen = self._choice
                self._execution = Execution() if chosen is None else chosen.execution()
                if not self._alone:
                    self._execution = replace(self._execution, alone=False)
                if self._at_once:
                    from pytest_dura.execution.threads import EpisodeThreads

                    threads = EpisodeThreads(max(limit.number for limit in self._at_once))
                    self._execution = replace(self._execution, threads=threads)
                self._execution.in_test = self._in_test
            except ConfigurationError as error:
                self._execution = error
        if isinstance(self._execution, ConfigurationError):
            raise self._execution.with_traceback(None)
        return self._execution

    def connect(self) -> None:
        """Check that a cluster is reachable, before anything is collected or written.

        Raises:
            ConfigurationError: If it is not.
        """
        if self._choice is not None and not self._is_worker:
            self._choice.connect()

    def item_begins(self, *, is_test: bool) -> None:
        """Note whether the item that begins is a test, which may replace what is simulated."""
        self._in_test = is_test
        if not (self._execution is None or isinstance(self._execution, ConfigurationError)):
            self._execution.in_test = is_test

    def choose(self, context: SessionContext, items: Sequence[pytest.Item]) -> None:
        """Choose an executor, where no option names it, once all is collected.

        Args:
            context: The session's context.
            items: Those that will ask for episodes.
        """
        if not self._automatic or self._chosen is not None:
            return
        from pytest_dura.plugin.session.automatic_executor import choose_for_items

        choice = choose_for_items(context, items)
        self._chosen, self._is_notable = choice.reason, choice.is_notable
        if choice.processes is not None:
            from pytest_dura.execution.executors import ExecutorChoice

            chosen = ExecutorChoice.parse(f"processes:{choice.processes}")
            if (limit := context.options.episode_timeout) is not None:
                chosen = replace(chosen, seconds=limit)
            if chosen.kind is not None:
                chosen.kind.memory = context.options.episode_memory
            self._choice, self._execution = chosen, None

    def start(self, plan: Sequence[Planned], chosen: Mapping[str, RoleSpec | None]) -> None:
        """Start the executor once all is collected: processes find what is found by then.

        Args:
            plan: The cases that scenario items look at.
            chosen: Roles that options choose, by name.

        Raises:
            ConfigurationError: If it cannot be used.
        """
        if self._choice is None or self._is_worker or self._collect_only:
            return
        executor = self.execution().executor
        if hasattr(executor, "preload"):
            cases = [planned.case for planned in plan]
            roles = [role for case in cases for role in case.roles(chosen).values()]
            parts = [*roles, *(case.scenario.simulator_spec() for case in cases)]
            executor.preload = sorted({part.path for part in parts if part is not None})

    @property
    def is_lost(self) -> bool:
        """Whether the executor is gone, so that no further test can come to a verdict."""
        execution = self._execution
        return (
            not (execution is None or isinstance(execution, ConfigurationError))
            and execution.is_lost
        )

    def close(self) -> None:
        """Cancel what is under way, and end the processes that simulate."""
        execution, self._execution = self._execution, None
        if execution is not None and not isinstance(execution, ConfigurationError):
            self._simulated_here += execution.here
            execution.close()
            self._note_needless(execution)

    def _note_needless(self, execution: Execution) -> None:
        """Note that this process simulated all, though processes had been chosen, and why."""
        is_needless = not getattr(execution.executor, "is_used", True)
        if self._automatic and self._choice is not None and is_needless and execution.here:
            _, reason = execution.here.most_common(1)[0][0]
            self._chosen, self._choice = f"auto: {reason}", None

    def to_json(self) -> dict[str, Any]:
        """The record's key ``execution``."""
        choice = self._choice
        limits = {limit.of: limit.number for limit in self._at_once}
        many: dict[str, Any] = {"at_once": limits} if limits else {}
        if self._automatic:
            if self._chosen is None:  # nothing is collected yet
                return {"executor": "auto", "processes": None, **many}
            many["chosen"] = self._chosen
        if choice is None:
            return {"executor": "in-process", "processes": None, **many}
        return {"executor": choice.name, "processes": choice.processes, **many}

    def header(self) -> list[str]:
        """Header lines, if another process or several threads simulate."""
        choice, lines = self._choice, []
        if choice is not None and choice.kind is not None and not self._automatic:
            lines.append(f"dura: episodes are simulated {choice.kind.where}")
        lines += [f"dura: at most {limit.number} {limit.of} at once" for limit in self._at_once]
        return lines

    def chosen(self, *, verbose: bool) -> list[str]:
        """Line on what was chosen where no option names it, if it is of interest.

        Args:
            verbose: Whether it is in any case.
        """
        if not self._automatic or self._chosen is None:
            return []
        kind = None if self._choice is None else self._choice.kind
        where = "in pytest's own process" if kind is None else kind.where
        text = f"dura: episodes are simulated {where} ({self._chosen})"
        return [text] if verbose or self._is_notable else []

    def notes(self) -> list[str]:
        """Lines on episodes that were simulated here although an executor was chosen."""
        return [
            f"{counted(number, 'episode')} of {component} simulated in pytest's own process: {why}"
            for (component, why), number in sorted(self._counts().items())
        ]

    def _counts(self) -> Counter[tuple[str, str]]:
        """Count the episodes simulated here, and by workers that have ended."""
        execution = self._execution
        if execution is None or isinstance(execution, ConfigurationError):
            return self._simulated_here
        return self._simulated_here + execution.here

    def send_to_controller(self, workeroutput: MutableMapping[str, Any]) -> None:
        """Add to a worker's output what it has simulated itself."""
        workeroutput[_SIMULATED_HERE_KEY] = [
            [*key, number] for key, number in self._counts().items()
        ]

    def receive_from_worker(self, workeroutput: MutableMapping[str, Any]) -> None:
        """Add the counts of a worker that has ended."""
        for component, why, number in workeroutput.get(_SIMULATED_HERE_KEY, ()):
            self._simulated_here[component, why] += number
