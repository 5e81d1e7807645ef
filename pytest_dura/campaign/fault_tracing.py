"""Causal chains: each fault of an episode from its plan to what came of it.

FaultTracer compares a run with faults with the run of the same seed without any.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from pytest_dura.campaign.events import CausalChain, FaultsTraced
from pytest_dura.campaign.runner import EpisodeRunner
from pytest_dura.core.episode import Divergence, Episode, outcome_of
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.metrics import FaultRecord
from pytest_dura.execution.store import EpisodeKey, key_of
from pytest_dura.execution.task import EpisodeTask, UpcomingTasks
from pytest_dura.library.cases import Case
from pytest_dura.requirements.episode_verdicts import JudgedEpisode, judge_episode
from pytest_dura.requirements.model import Requirement


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


class FaultTracer:
    """Follows each fault of an episode from plan to outcome, once.

    Args:
        runner: Runs the episodes, and emits the chains of each that is traced.
    """

    def __init__(self, runner: EpisodeRunner) -> None:
        self.runner = runner
        self._reported: set[EpisodeKey] = set()

    def follow(self, case: Case, runs: Sequence[int]) -> None:
        """Emit the causal chains of episodes that were run before, each once.

        Args:
            case: The case.
            runs: Numbers of the runs.
        """
        runner = self.runner
        tasks = {run: runner.task(case, run) for run in runs}
        due = [run for run in runs if key_of(tasks[run]) not in self._reported]
        if not runner.store.execution.inside:
            self._fetch_twins(case, [tasks[run] for run in due])
        upcoming = UpcomingTasks(len(due), lambda step: self._twins(case, tasks[due[step]]))
        with runner.progress(case, TWINS_SUBJECT, len(due)) as reach:
            for step, run in enumerate(due):
                upcoming.reach(step)
                reach(step, len(due))
                episode = runner.fetch(case, run)
                self._reported.add(key_of(tasks[run]))
                chains = self.chains(case, episode, upcoming)
                runner.events.emit(FaultsTraced(case, episode, chains))

    def _fetch_twins(self, case: Case, tasks: Sequence[EpisodeTask]) -> None:
        """Let other processes simulate all twins first: then it is known which are repeated."""
        store = self.runner.store
        compared = [task for task in tasks if self._has_twin(store.get(task))]
        twins = [self.runner.twin(case, task.spec) for task in compared]
        for number, twin in enumerate(twins, 1):
            store.get(twin, twins[number:])

    def _has_twin(self, episode: JudgedEpisode) -> bool:
        """Whether an episode is compared with its twin."""
        return self.runner.twins and any(
            fault.manifested_at is not None for fault in episode.faults
        )

    def _twins(self, case: Case, task: EpisodeTask) -> list[EpisodeTask]:
        """The twin of an episode, and its repetition where it is known to be needed."""
        twin = self.runner.twin(case, task.spec)
        first, second = (self.runner.store.memory.find(each) for each in (task, twin))
        if first is None or second is None or Divergence.of(first, second).at is None:
            return [twin]
        return [twin, twin.repeated()]

    def chains(
        self, case: Case, episode: JudgedEpisode, ahead: Iterable[EpisodeTask] = ()
    ) -> list[CausalChain]:
        """See :meth:`pytest_dura.runner.Runner.chains`; ``ahead`` are tasks that come next."""
        runner, requirements = self.runner, self.runner.requirements_of(case)
        if not self._has_twin(episode):
            return causal_chains(episode, requirements)
        task = runner.twin(case, episode.spec)

        def second() -> JudgedEpisode:
            # A component that remembers earlier episodes differs here as well, and then nothing
            # can be said of the faults.
            return runner.store.get(task.repeated(), ahead)

        twin = runner.store.get(task, ahead)
        divergence = Divergence.of(episode, twin, second)
        return causal_chains(episode, requirements, twin, divergence)
