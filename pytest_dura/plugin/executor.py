"""SessionExecutor: which executor simulates the episodes of this process."""

from __future__ import annotations

from collections import Counter
from collections.abc import MutableMapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

from pytest_dura.core.errors import ConfigurationError

if TYPE_CHECKING:
    from pytest_dura.execution.executors import Execution, ExecutorChoice
    from pytest_dura.plugin.session import DuraSession


EXECUTOR_OPTION = "--dura-executor"
TIMEOUT_OPTION = "--dura-episode-timeout"
_SIMULATED_HERE_KEY = "dura_simulated_here"
"""Key of what a worker of pytest-xdist tells the controller at its end."""


def executor_choice(config: pytest.Config, seconds: float | None) -> ExecutorChoice | None:
    """The executor that the options name; ``None`` for this process.

    Args:
        config: The session's configuration.
        seconds: What an episode may take in another process, if that was given.

    Raises:
        ConfigurationError: If there is none, or another option does not go with it.
    """
    text = config.getoption("dura_executor")
    if text in (None, "in-process"):
        if seconds is not None:
            raise ConfigurationError(
                f"{TIMEOUT_OPTION} is held by ending the process that simulates, and that is"
                " pytest's own",
                key=TIMEOUT_OPTION,
                found=f"{seconds:g} without another executor",
                expected=f"{EXECUTOR_OPTION}=processes, or a Dask cluster",
                remedy=f"add {EXECUTOR_OPTION}=processes, or leave out {TIMEOUT_OPTION}; each call"
                " into a role has"
                " --dura-role-timeout",
            )
        return None
    from pytest_dura.execution.executors import ExecutorChoice

    choice = ExecutorChoice.parse(text)
    if seconds is not None:
        choice = replace(choice, seconds=seconds)
    if choice.kind == "processes" and config.getoption("numprocesses", None):
        raise ConfigurationError(
            "the workers of pytest-xdist would each start processes of their own",
            key=EXECUTOR_OPTION,
            found=f"{text} beside -n {config.getoption('numprocesses')}",
            expected="one of them",
            remedy=f"leave out -n, and give {EXECUTOR_OPTION}=processes:N the cores; or leave out"
            f" {EXECUTOR_OPTION}",
        )
    mode = config.getoption("dura_llm")
    if mode in ("record", "replay"):
        raise ConfigurationError(
            "a cassette is of this process, and the episodes would be simulated in others",
            key=EXECUTOR_OPTION,
            found=f"{text} beside --dura-llm={mode}",
            expected="one of them",
            remedy=f"leave out {EXECUTOR_OPTION}, or use -n, whose workers share the cassette",
        )
    return choice


class SessionExecutor:
    """Who simulates the episodes of this process.

    Args:
        session: The session of this process.
    """

    def __init__(self, session: DuraSession) -> None:
        self.session = session
        self._execution: Execution | ConfigurationError | None = None
        self._noted: Counter[tuple[str, str]] = Counter()

    def execution(self) -> Execution:
        """What simulates, made at the first call.

        Raises:
            ConfigurationError: If it cannot be used; the same one at every call.
        """
        if self._execution is None:
            from pytest_dura.execution.executors import Execution

            choice = self.session.options.executor
            try:
                self._execution = Execution() if choice is None else choice.execution()
            except ConfigurationError as error:
                self._execution = error
        if isinstance(self._execution, ConfigurationError):
            raise self._execution.with_traceback(None)
        return self._execution

    def knock(self) -> None:
        """Find out before anything is collected or written whether a cluster is there.

        Raises:
            ConfigurationError: If it is not.
        """
        choice = self.session.options.executor
        if choice is not None and not self.session.is_worker:
            choice.connect()

    def begin(self) -> None:
        """Have what simulates, once all is collected: processes find what is imported by then.

        Raises:
            ConfigurationError: If it cannot be used.
        """
        idle = self.session.is_worker or self.session.config.option.collectonly
        if self.session.options.executor is not None and not idle:
            self.execution()

    @property
    def is_lost(self) -> bool:
        """Whether whoever simulates is gone, so that no further test can tell anything."""
        found = self._execution
        return not (found is None or isinstance(found, ConfigurationError)) and found.is_lost

    def close(self) -> None:
        """Give up what is under way, and end the processes that simulate."""
        found, self._execution = self._execution, None
        if found is not None and not isinstance(found, ConfigurationError):
            self._noted += found.here
            found.close()

    def to_json(self) -> dict[str, Any]:
        """What the record says of it."""
        choice = self.session.options.executor
        if choice is None:
            return {"executor": "in-process", "processes": None}
        return {"executor": choice.kind, "processes": choice.processes}

    def header(self) -> list[str]:
        """A line, if another process simulates."""
        choice = self.session.options.executor
        if choice is None:
            return []
        if choice.processes is not None:
            return [f"dura: episodes are simulated in {choice.processes} processes"]
        return [f"dura: episodes are simulated by Dask, scheduler at {choice.address}"]

    def notes(self) -> list[str]:
        """Lines on episodes that were simulated here, though others were to simulate."""
        from pytest_dura.plugin.terminal_tables import counted

        return [
            f"{counted(number, 'episode')} of {component} simulated in pytest's own process: {why}"
            for (component, why), number in sorted(self._counts().items())
        ]

    def _counts(self) -> Counter[tuple[str, str]]:
        """Of this process, and of the workers that are done."""
        found = self._execution
        if found is None or isinstance(found, ConfigurationError):
            return self._noted
        return self._noted + found.here

    def tell_controller(self, workeroutput: MutableMapping[str, Any]) -> None:
        """Tell the controller what this worker has simulated itself."""
        workeroutput[_SIMULATED_HERE_KEY] = [
            [*key, number] for key, number in self._counts().items()
        ]

    def hear_worker(self, workeroutput: MutableMapping[str, Any]) -> None:
        """Take in what a worker tells at its end."""
        for component, why, number in workeroutput.get(_SIMULATED_HERE_KEY, ()):
            self._noted[component, why] += number
