"""Causal chains: each fault of an episode from its plan to what came of it.

FaultTracer compares a run with faults with the run of the same seed without any.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from pytest_dura.campaign.reporting import RunningCampaign
from pytest_dura.campaign.runner import EpisodeRunner, ignore_event
from pytest_dura.core.episode import (
    Divergence,
    Episode,
    OutcomeStatus,
    PropagationStatus,
    outcome_of,
)
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.metrics import FaultRecord
from pytest_dura.execution.store import EpisodeKey, key_of
from pytest_dura.execution.task import EpisodeTask, UpcomingTasks
from pytest_dura.library.cases import Case
from pytest_dura.requirements.episode_verdicts import JudgedEpisode, judge_episode
from pytest_dura.requirements.model import Requirement


@dataclass(frozen=True)
class CausalChain:
    """One fault of one episode, from plan to outcome; times in s, ``None`` for what never was.

    Args:
        record: From plan to recovery, as the loop saw it.
        propagation: Whether the proposals left those of the fault-free twin; ``None`` if the fault
            never manifested or that was not measured.
        propagated_at: When they did.
        unknown: Why that cannot be said.
        outcome: See :func:`outcome_of`.
        violated: Requirements that were violated from its manifestation on.
        violated_without: Those among them that the fault-free twin violates, too; ``None`` if
            there is no twin to tell.
    """

    record: FaultRecord
    propagation: PropagationStatus | None
    propagated_at: float | None
    unknown: str
    outcome: OutcomeStatus
    violated: tuple[str, ...] = ()
    violated_without: tuple[str, ...] | None = None

    def to_json(self) -> dict[str, Any]:
        """Plain data for the evidence record."""
        own = {key: value for key, value in vars(self).items() if key != "record"}
        return {
            **asdict(self.record),
            **{
                key: list(value) if isinstance(value, tuple) else value
                for key, value in own.items()
            },
        }


def causal_chains(
    episode: Episode,
    requirements: Sequence[Requirement],
    twin: Episode | None = None,
    divergence: Divergence | None = None,
) -> list[CausalChain]:
    """The chains of all faults of an episode.

    Args:
        episode: The episode.
        requirements: Those that apply to its case.
        twin: The run of the same seed without any fault, if there is one.
        divergence: Where the episode leaves it.
    """
    violated = _violations(episode, requirements)
    without = None
    if twin is not None and twin.failure is None:
        without = _violations(twin, requirements)
    return [_chain(fault, episode, violated, without, divergence) for fault in episode.faults]


def _chain(
    fault: FaultRecord,
    episode: Episode,
    violated: Mapping[str, float | None],
    without: Mapping[str, float | None] | None,
    divergence: Divergence | None,
) -> CausalChain:
    propagation = divergence.of_fault(fault) if divergence is not None else None
    since = fault.manifested_at
    reached = tuple(
        name
        for name, time in violated.items()
        if since is not None and (time is None or time >= since - 1e-9)
    )
    also = None if without is None else tuple(name for name in reached if name in without)
    status = propagation.status if propagation is not None else None
    return CausalChain(
        fault,
        status,
        propagation.at if propagation is not None else None,
        propagation.reason if propagation is not None else "",
        outcome_of(fault, status, reached, also, missing=episode.failure is not None),
        reached,
        also,
    )


def _violations(episode: Episode, requirements: Sequence[Requirement]) -> dict[str, float | None]:
    """Time of violation by requirement, of those that an episode violates by itself."""
    violated: dict[str, float | None] = {}
    for requirement in requirements:
        if requirement.paired or not requirement.check:
            continue
        try:
            verdict = judge_episode(requirement, episode)
        except ConfigurationError:  # reported where the requirement itself is judged
            continue
        if verdict.verdict == "violated":
            violated[requirement.id] = verdict.time
    return violated


TWINS_SUBJECT = "fault-free twins"
"""Subject of these runs in reports of progress."""
_MAX_RECENT_CHAINS = 64
"""Episodes whose chains are kept while a viewer shows them."""


class FaultTracer:
    """Follows each fault of an episode from plan to outcome, once.

    Args:
        runner: Runs the episodes.
        on_chains: Called with the chains of each episode that is traced, once.
    """

    def __init__(
        self,
        runner: EpisodeRunner,
        on_chains: Callable[[Case, JudgedEpisode, list[CausalChain]], None] = ignore_event,
    ) -> None:
        self.runner = runner
        self._on_chains = on_chains
        self._reported: set[EpisodeKey] = set()
        self._chains: OrderedDict[EpisodeKey, list[CausalChain]] = OrderedDict()

    def follow(self, case: Case, runs: Sequence[int]) -> None:
        """See :meth:`pytest_dura.runner.Runner.follow`."""
        runner = self.runner
        tasks = {run: runner.task(case, run) for run in runs}
        due = [run for run in runs if key_of(tasks[run]) not in self._reported]
        upcoming = UpcomingTasks(len(due), lambda step: [runner.twin(case, tasks[due[step]].spec)])
        running = RunningCampaign(case.id, TWINS_SUBJECT, len(due))
        try:
            for step, run in enumerate(due):
                upcoming.reach(step)
                runner.on_progress(running.reach(step, len(due), runner.store.simulated))
                episode = runner.fetch(case, run)
                self._reported.add(key_of(tasks[run]))
                self._on_chains(case, episode, self.chains(case, episode, upcoming))
        finally:
            runner.store.cancel()
            runner.on_progress(running.end())

    def chains(
        self, case: Case, episode: JudgedEpisode, ahead: Iterable[EpisodeTask] = ()
    ) -> list[CausalChain]:
        """See :meth:`pytest_dura.runner.Runner.chains`; ``ahead`` are tasks that come next."""
        key = self.runner.key(episode)
        if key not in self._chains:
            self._chains[key] = self._linked(case, episode, ahead)
        while len(self._chains) > _MAX_RECENT_CHAINS:
            self._chains.popitem(last=False)
        return self._chains[key]

    def _linked(
        self, case: Case, episode: JudgedEpisode, ahead: Iterable[EpisodeTask]
    ) -> list[CausalChain]:
        runner, requirements = self.runner, self.runner.requirements_of(case)
        reached = any(fault.manifested_at is not None for fault in episode.faults)
        if not (runner.twins and reached):
            return causal_chains(episode, requirements)
        task = runner.twin(case, episode.spec)

        def second() -> JudgedEpisode:
            # A component that remembers earlier episodes differs here as well, and then nothing
            # can be said of the faults.
            return runner.store.get(task.repeated(), ahead)

        twin = runner.store.get(task, ahead)
        divergence = Divergence.of(episode, twin, second)
        return causal_chains(episode, requirements, twin, divergence)
