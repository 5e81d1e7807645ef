"""Executors: which one the user chose, and how episodes are handed to it."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable
from concurrent.futures import Executor, Future
from dataclasses import asdict, dataclass, field
from typing import Literal, ParamSpec, TypeVar

from pytest_dura.core.episode import Episode, EpisodeSpec
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.execution.address import Address, simulate
from pytest_dura.execution.task import EpisodeTask, reason_not_portable

KEY = "--dura-executor"
MAX_SECONDS = 3600.0
"""Limit of an episode in another process, beside the time that its component is given."""
Kind = Literal["in-process", "processes", "dask"]
_LAST_PORT = 65535


@dataclass(frozen=True)
class ExecutorChoice:
    """Choice of an executor.

    Args:
        kind: Which executor.
        count: How many processes; by default one for each core that may be used.
        address: Of Dask's scheduler.
        seconds: Limit of an episode in another process, beside its component's time budgets.
    """

    kind: Kind = "in-process"
    count: int | None = None
    address: str | None = None
    seconds: float = MAX_SECONDS

    @classmethod
    def parse(cls, text: str | None) -> ExecutorChoice:
        """Parse ``in-process``, ``processes``, ``processes:N`` or ``dask://HOST:PORT``.

        Raises:
            ConfigurationError: For anything else.
        """
        if text in (None, "in-process"):
            return cls()
        processes = re.fullmatch(r"processes(?::([1-9][0-9]{0,3}))?", text or "")
        if processes:
            return cls("processes", int(processes[1]) if processes[1] else None)
        dask = re.fullmatch(r"dask://(\[[0-9A-Fa-f:.]+\]|[^/:@?#\s]+):([0-9]{1,5})/?", text or "")
        if dask and 0 < int(dask[2]) <= _LAST_PORT:
            return cls("dask", address=f"tcp://{dask[1]}:{dask[2]}")
        raise ConfigurationError(
            "there is no such executor",
            key=KEY,
            found=text,
            expected="in-process, processes, processes:N with N of 1 to 9999, or dask://HOST:PORT",
            remedy=f"for example {KEY}=processes:4",
        )

    @property
    def processes(self) -> int | None:
        """How many processes of this machine simulate, if any do."""
        if self.kind != "processes":
            return None
        from pytest_dura.execution.processes import usable_cores

        return self.count or usable_cores()

    def connect(self) -> None:
        """Connect to the cluster and disconnect again, where the choice is one.

        Raises:
            ConfigurationError: If Dask is not installed, or no server listens at the address.
        """
        if self.address is not None:
            from pytest_dura.execution.dask import connect

            connect(self.address)

    def execution(self) -> Execution:
        """Make the executor; a cluster is connected to, and compared with this process.

        Raises:
            ConfigurationError: If the cluster cannot be used.
        """
        if self.processes is not None:
            from pytest_dura.execution.processes import ProcessPool

            return Execution("processes", ProcessPool(self.processes), self.seconds)
        if self.address is not None:
            from pytest_dura.execution.dask import DaskExecutor

            return Execution("dask", DaskExecutor(self.address), self.seconds)
        return Execution()


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


@dataclass(frozen=True)
class Execution:
    """Executor of episodes.

    Args:
        name: As users and the evidence call it.
        executor: Takes a function with plain data, and returns plain data.
        seconds: Limit of an episode elsewhere, beside the time that its component is given.
        here: Episodes that were simulated in this process though there is another executor, by
            component and reason.
    """

    name: str = "in-process"
    executor: Executor = field(default_factory=InProcessExecutor)
    seconds: float = MAX_SECONDS
    here: Counter[tuple[str, str]] = field(default_factory=Counter, compare=False)

    @property
    def width(self) -> int:
        """How many episodes it works on at the same time, by now."""
        return int(getattr(self.executor, "width", 1))

    @property
    def is_lost(self) -> bool:
        """Whether the cluster is gone."""
        return bool(getattr(self.executor, "is_lost", False))

    @property
    def inside(self) -> bool:
        """Whether this process simulates, one episode at a time."""
        return isinstance(self.executor, InProcessExecutor)

    def submit(
        self, task: EpisodeTask, address: Address | None = None
    ) -> Future[Episode] | Future[bytes]:
        """Begin an episode; the future is of the episode, or of a packed one from elsewhere.

        An episode that is not portable is simulated here, wherever the others are.

        Args:
            task: The episode to simulate.
            address: Its address here, which it must have wherever it is simulated.
        """
        if self.inside or not task.portable:
            return InProcessExecutor().submit(self.run_here, task)
        conditions = None if address is None else asdict(address)
        return self.executor.submit(
            simulate,
            json.dumps(task.to_json()),
            conditions,
            seconds=time_limit_of(task.spec, self.seconds),
        )

    def run_here(self, task: EpisodeTask) -> Episode:
        """Simulate an episode in this process; counted in `here` where that is the exception.

        Raises:
            ConfigurationError: If a part cannot be built.
        """
        reason = None if self.inside else reason_not_portable(task)
        if reason is not None:
            self.here[task.spec.component, reason] += 1
        return task.run()

    def close(self) -> None:
        """Give up episodes that are still under way, and end the processes that simulate."""
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
    return seconds + proposals * (spec.time_budget or 0.0)
