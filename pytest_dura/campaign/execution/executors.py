"""Where episodes are simulated: an executor, and how many of them it should have at a time."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from concurrent.futures import Executor, Future
from dataclasses import dataclass, field
from typing import ParamSpec, TypeVar

from pytest_dura.campaign.episodes.address import Address
from pytest_dura.campaign.episodes.portability import why_here
from pytest_dura.campaign.episodes.task import EpisodeTask
from pytest_dura.campaign.execution.choice import MOST_SECONDS
from pytest_dura.campaign.execution.replies import ProcessLostError
from pytest_dura.campaign.execution.simulating import Conditions, simulate
from pytest_dura.core.episode import Episode, EpisodeSpec

__all__ = ["MOST_SECONDS", "Execution", "InProcessExecutor", "ProcessLostError", "limit_of"]

T = TypeVar("T")
P = ParamSpec("P")


class InProcessExecutor(Executor):
    """Carries out each call at once, in this process."""

    width = 1

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """The future of a call that is over."""
        future: Future[T] = Future()
        future.set_running_or_notify_cancel()
        try:
            future.set_result(fn(*args, **kwargs))
        except BaseException as error:  # also ctrl-C is told where the result is asked for
            future.set_exception(error)
        return future


@dataclass(frozen=True)
class Execution:
    """Who simulates episodes.

    Args:
        name: As users and the evidence call it.
        executor: Takes a function with plain data, and returns plain data.
        seconds: What an episode may take elsewhere, beside the time that its component is given.
        here: Episodes that were simulated in this process though there is another executor, by
            component and reason.
    """

    name: str = "in-process"
    executor: Executor = field(default_factory=InProcessExecutor)
    seconds: float = MOST_SECONDS
    here: Counter[tuple[str, str]] = field(default_factory=Counter, compare=False)

    @property
    def width(self) -> int:
        """Episodes that it works on at the same time, by now."""
        return int(getattr(self.executor, "width", 1))

    @property
    def is_lost(self) -> bool:
        """Whether whoever simulates is gone."""
        return bool(getattr(self.executor, "is_lost", False))

    @property
    def inside(self) -> bool:
        """Whether this process simulates, one episode at a time."""
        return isinstance(self.executor, InProcessExecutor)

    def submit(
        self, task: EpisodeTask, address: Address | None = None
    ) -> Future[Episode] | Future[bytes]:
        """The future of an episode, or of a packed one that another process makes.

        What is not portable is simulated here, whoever simulates the others.

        Args:
            task: What it is had by.
            address: What has to be equal wherever it is simulated.
        """
        if self.inside or not task.portable:
            return InProcessExecutor().submit(self.run_here, task)
        conditions = None if address is None else Conditions.of(address).to_json()
        return self.executor.submit(
            simulate,
            json.dumps(task.to_json()),
            conditions,
            seconds=limit_of(task.spec, self.seconds),
        )

    def run_here(self, task: EpisodeTask) -> Episode:
        """The episode, simulated in this process; noted where that is the exception.

        Raises:
            ConfigurationError: If a part cannot be built.
        """
        reason = None if self.inside else why_here(task)
        if reason is not None:
            self.here[task.spec.component, reason] += 1
        return task.run()

    def close(self) -> None:
        """Give up whatever is still under way, and end the processes that simulate."""
        self.executor.shutdown(wait=False, cancel_futures=True)


def limit_of(spec: EpisodeSpec, seconds: float) -> float:
    """Seconds of wall-clock time that an episode may take.

    Args:
        spec: What it is run from; the component may use up its time budget in each proposal.
        seconds: What it may take beside that.
    """
    decisions = spec.termination.last_index(spec.time_step) + 1
    if spec.termination.iterations is not None:
        decisions = min(decisions, spec.termination.iterations)
    proposals = decisions * (1 + spec.policy.attempts)
    return seconds + proposals * (spec.time_budget or 0.0)
