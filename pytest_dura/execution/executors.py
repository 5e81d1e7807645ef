"""Executors: which one the user chose, and how episodes are handed to it."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from queue import Empty, SimpleQueue
from typing import Any, ClassVar, ParamSpec, TypeVar, cast

from pytest_dura.core.classes import is_subclass
from pytest_dura.core.episode import EpisodeSpec
from pytest_dura.core.errors import ConfigurationError, did_you_mean
from pytest_dura.core.registry import Registry
from pytest_dura.execution.address import conditions_of, simulate, simulate_copied
from pytest_dura.execution.copies import Copies
from pytest_dura.execution.replies import SessionWantedHereError
from pytest_dura.execution.sources import LoadedModules
from pytest_dura.execution.surroundings import surroundings
from pytest_dura.execution.task import EpisodeTask, is_same_elsewhere, reason_not_portable
from pytest_dura.requirements.checks import is_function_path
from pytest_dura.requirements.episode_verdicts import JudgedEpisode

KEY = "--dura-executor"
IN_FLIGHT = 2
"""Episodes per worker that are under way, so that no worker waits for its next one."""
MAX_SECONDS = 3600.0
"""Limit of an episode in another process, beside the time that its component is given."""


_NO_COPY = "a test asks for them, and a copy of this process would lack its threads"


def cancel_queued(calls: SimpleQueue[Any]) -> None:
    """Cancel the futures of all calls that are queued; ``None`` stands for the end of a thread."""
    with suppress(Empty):
        while True:
            call = calls.get_nowait()
            if call is not None:
                call.future.cancel()


class ExecutorKind(ABC):
    """Kind of executor that ``--dura-executor`` names, as ``name`` or ``name:argument``.

    Args:
        argument: What follows the name and the colon; empty without.

    Raises:
        ValueError: If it takes no such argument.
    """

    form: ClassVar[str]
    """How it is written, for messages."""
    local_processes: int | None = None
    """How many processes of this machine simulate, if any do."""
    makes_copies: ClassVar[bool] = False
    """Whether episodes of tests are simulated in copies of the session's process."""
    memory: int | None = None
    """Bytes that a process may take beside what it begins with; ``None`` for any number."""
    where = "elsewhere"
    """Where episodes are simulated, for the header: after "episodes are simulated"."""

    def __init__(self, argument: str) -> None:
        if argument:
            raise ValueError(argument)

    def connect(self) -> None:  # noqa: B027 - most have nothing to check
        """Check that it can be started, without starting it.

        Raises:
            ConfigurationError: If it cannot be.
        """

    @abstractmethod
    def start(self) -> Executor:
        """Make the executor.

        Its ``submit`` is called with a function, a task as text, further plain data, and the
        keyword ``seconds``: the limit, which it holds itself and does not pass on. The function
        returns bytes.

        Raises:
            ConfigurationError: If it cannot be started.
        """


EXECUTORS: Registry[type[ExecutorKind]] = Registry(
    "pytest_dura.executors",
    "executor",
    lambda value: is_subclass(value, ExecutorKind),
    "a subclass of pytest_dura.ExecutorKind",
)


@dataclass(frozen=True)
class ExecutorChoice:
    """Choice of an executor.

    Args:
        name: Its registered name.
        kind: The executor; ``None`` for this process.
        seconds: Limit of an episode in another process, beside its component's time budgets.
    """

    name: str = "in-process"
    kind: ExecutorKind | None = None
    seconds: float = MAX_SECONDS

    @classmethod
    def parse(cls, text: str | None) -> ExecutorChoice:
        """Parse a registered name, or such a name with an argument after a colon.

        Raises:
            ConfigurationError: For anything else.
        """
        if text in (None, "in-process"):
            return cls()
        name, colon, argument = str(text).partition(":")
        form, remedy = ", ".join(["auto", *EXECUTORS]), did_you_mean(name, EXECUTORS)
        if name in EXECUTORS:
            kind = EXECUTORS[name]
            form, remedy = kind.form, f"for example {KEY}=processes:4"
            with suppress(ValueError):
                if argument or not colon:
                    return cls(name, kind(argument))
        raise ConfigurationError(
            "there is no such executor", key=KEY, found=text, expected=form, remedy=remedy
        )

    @property
    def processes(self) -> int | None:
        """How many processes of this machine simulate, if any do."""
        return None if self.kind is None else self.kind.local_processes

    def connect(self) -> None:
        """Check that the executor can be started; see :meth:`ExecutorKind.connect`."""
        if self.kind is not None:
            self.kind.connect()

    def execution(self) -> Execution:
        """Start the executor.

        Raises:
            ConfigurationError: If it cannot be started.
        """
        if self.kind is None:
            return Execution()
        width = self.processes if self.kind.makes_copies else None
        copies = None if width is None else Copies(width, self.kind.start, self.kind.memory)
        return Execution(self.name, self.kind.start(), self.seconds, copies=copies)


T = TypeVar("T")
P = ParamSpec("P")


class InProcessExecutor(Executor):
    """Executor that carries out each call at once, in this process."""

    width = 1

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """The future of a call that is over."""
        future: Future[T] = Future()
        future.set_running_or_notify_cancel()
        try:
            future.set_result(fn(*args, **kwargs))
        except BaseException as error:  # also ctrl-C is raised where the result is taken
            future.set_exception(error)
        return future


class InProcess(ExecutorKind):
    """The process of pytest itself; the default."""

    form = "in-process"
    where = "in pytest's own process"

    def start(self) -> Executor:
        """Make an executor that carries out each call at once."""
        return InProcessExecutor()


@dataclass(eq=False)
class Execution:
    """Executor of episodes.

    Args:
        name: As users and the evidence call it.
        executor: Takes a function with plain data, and returns plain data.
        seconds: Limit of an episode elsewhere, beside the time that its component is given.
        here: Episodes that were simulated in this process though there is another executor, by
            component and reason.
        staying: Components whose episodes turned out to need this process, and why.
    """

    name: str = "in-process"
    executor: Executor = field(default_factory=InProcessExecutor)
    seconds: float = MAX_SECONDS
    here: Counter[tuple[str, str]] = field(default_factory=Counter)
    staying: dict[str, str] = field(default_factory=dict)
    threads: Executor | None = None
    """Takes the episodes that wait for what a guest provides, if there is such an executor."""
    copies: Copies | None = None
    """Takes what only a copy of this process can simulate, such as a class of a test function."""
    in_test: bool = False
    """Whether a test asks, which may have replaced what is simulated."""
    _steady: Executor | None = None
    """Takes the episodes of a test while it waits for several."""
    alone: bool = True
    """Whether no other process of the session runs tests."""
    modules: LoadedModules = field(default_factory=LoadedModules)
    """Modules of this process, which must be the same wherever an episode is simulated."""

    @property
    def width(self) -> int:
        """How many episodes the executor works on at the same time, by now."""
        return 1 if self.inside else int(getattr(self.executor, "width", 1))

    def width_of(self, task: EpisodeTask) -> int:
        """How many episodes like this it works on at the same time, by now.

        0 for one that :meth:`submit` carries out at once.
        """
        executor = self._executor_of(task)
        return 0 if executor is None else int(getattr(executor, "width", 1))

    def most_of(self, task: EpisodeTask) -> int:
        """How many episodes like this are under way at most, so that no worker waits."""
        in_flight = getattr(self._executor_of(task), "in_flight", IN_FLIGHT)
        return int(in_flight) * self.width_of(task)

    @property
    def is_lost(self) -> bool:
        """Whether the cluster is gone."""
        return bool(getattr(self.executor, "is_lost", False))

    @property
    def inside(self) -> bool:
        """Whether this process simulates, apart from its threads one episode at a time."""
        return isinstance(self.executor, InProcessExecutor)

    def _executor_of(self, task: EpisodeTask) -> Executor | Copies | None:
        """Who simulates an episode; ``None`` for this thread."""
        if self.threads is not None and task.waits and not task.local:
            return self.threads
        if self.inside or task.stays or (task.spec.component in self.staying):
            return None
        is_copy = bool(getattr(self.executor, "is_copy", False))
        is_portable = task.portable_to_copy if is_copy else task.portable
        if is_portable and (self.copies is None or not self.in_test):
            return self.executor
        if self._steady is not None and task.portable_to_copy:
            return self._steady
        return self.copies if self.copies is not None and self.copies.is_possible else None

    @contextmanager
    def steady(self) -> Iterator[None]:
        """Context of several episodes that a test waits for, so that it changes nothing meanwhile.

        Children are forked from one copy of this process then, in place of a copy an episode.
        """
        copies = self.copies if self.in_test and self._steady is None else None
        pool = copies.pool() if copies is not None and copies.is_possible else None
        if pool is None or not getattr(pool, "is_copy", False):
            yield
            return
        self._steady = pool
        try:
            yield
        finally:
            self._steady = None
            pool.shutdown(wait=False, cancel_futures=True)

    def submit(self, task: EpisodeTask) -> Future[JudgedEpisode] | Future[bytes]:
        """Begin an episode; the future is of the episode, or of a packed one from elsewhere.

        An episode that is not portable is simulated here, wherever the others are: in a thread if
        there are any for it.

        Args:
            task: The episode to simulate.
        """
        executor = self._executor_of(task)
        if executor is None:
            return InProcessExecutor().submit(self.run_here, task)
        if executor is self.threads:
            return self.threads.submit(self.run_here, task)
        # A repetition may follow another episode in its process.
        seconds = time_limit_of(task.spec, self.seconds) * (2 if task.again else 1)
        if isinstance(executor, Copies):
            return executor.submit(partial(simulate_copied, task, surroundings()), seconds)
        is_copy = bool(getattr(executor, "is_copy", False))
        # A formula means the same everywhere, a function where the same files are imported; this
        # process judges by the others.
        same_files = getattr(self.executor, "imports_same_files", False)
        checks = tuple(
            check
            for check in task.checks
            if is_copy or not is_function_path(check) or (same_files and is_same_elsewhere(check))
        )
        return executor.submit(
            simulate,
            json.dumps(replace(task, checks=checks).to_json()),
            None if is_copy else conditions_of(self.modules),
            surroundings(),
            seconds=seconds,
        )

    def result_of(self, task: EpisodeTask, future: Future[Any]) -> JudgedEpisode | bytes:
        """The result of :meth:`submit`, after what was printed elsewhere was shown here.

        An episode that needs this process is simulated again, here.

        Raises:
            ProcessLostError: If its process ended.
            CallFailedError: If there is no process for it.
        """
        try:
            return cast("JudgedEpisode | bytes", future.result())
        except SessionWantedHereError as error:
            self.staying[task.spec.component] = str(error)
        finally:
            captured = vars(future).get("captured")
            if captured is not None:
                captured.show()
        return self.run_here(task)

    def run_here(self, task: EpisodeTask) -> JudgedEpisode:
        """Simulate an episode in this process; counted in `here` where that is the exception.

        Raises:
            ConfigurationError: If a part cannot be built, or other processes might use the
                simulator or the component, of which one instance exists.
        """
        if task.single is not None and not self.alone:
            raise ConfigurationError(
                f"one instance of the {task.single} exists, and several processes run tests",
                key="-n",
                found=(
                    task.spec.simulator.path
                    if task.single == "simulator"
                    else task.spec.roles["generator"].path
                ),
                expected=f'a {task.single} whose `instances` is not "one"',
                remedy="run the session without -n",
            )
        inside = self.inside or self._executor_of(task) is not None
        staying = self.staying.get(task.spec.component)
        reason = None if inside else staying or reason_not_portable(task) or _NO_COPY
        if reason is not None:
            self.here[task.spec.component, reason] += 1
        return task.run()

    def close(self) -> None:
        """Give up episodes that are still under way, and end the processes that simulate."""
        if self.threads is not None:
            self.threads.shutdown(wait=False, cancel_futures=True)
        if self.copies is not None:
            self.copies.close()
        self.executor.shutdown(wait=False, cancel_futures=True)


def time_limit_of(spec: EpisodeSpec, seconds: float) -> float:
    """Limit of an episode, in seconds of wall-clock time.

    Args:
        spec: What it is run from; the component may use up its time budget in each proposal.
        seconds: Limit of everything else.
    """
    decisions = spec.termination.last_index(spec.time_step) + 1
    if spec.termination.iterations is not None:
        decisions = min(decisions, spec.termination.iterations)
    proposals = decisions * (1 + spec.policy.attempts)
    paced = spec.termination.time_limit if spec.clock.kind == "wall" else 0.0
    return seconds + paced + proposals * (spec.time_budget or 0.0)
