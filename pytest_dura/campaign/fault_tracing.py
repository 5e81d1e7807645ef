"""FaultTracer: trace each fault of an episode to its outcome, by runs without faults."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable, Sequence

from pytest_dura.campaign.causal_chains import CausalChain, causal_chains
from pytest_dura.campaign.progress import RunningCampaign
from pytest_dura.campaign.runner import EpisodeRunner
from pytest_dura.core.episode import Divergence
from pytest_dura.execution.store import EpisodeKey, key_of
from pytest_dura.execution.task import EpisodeTask, UpcomingTasks
from pytest_dura.library.cases import Case
from pytest_dura.requirements.verdicts.episodes import JudgedEpisode

TWINS_SUBJECT = "fault-free twins"
"""What runs when it is found out what came of faults, as progress calls it."""
_MAX_RECENT_CHAINS = 64
"""Episodes whose chains are kept: they are asked for while one is looked at."""


class FaultTracer:
    """Follows each fault of an episode from plan to outcome, once.

    Args:
        runner: Whose episodes they are.
    """

    def __init__(self, runner: EpisodeRunner) -> None:
        self.runner = runner
        self._told: set[EpisodeKey] = set()
        self._chains: OrderedDict[EpisodeKey, list[CausalChain]] = OrderedDict()

    def follow(self, case: Case, runs: Sequence[int]) -> None:
        """See :meth:`pytest_dura.runner.Runner.follow`."""
        runner = self.runner
        tasks = {run: runner.task(case, run) for run in runs}
        due = [run for run in runs if key_of(tasks[run]) not in self._told]
        upcoming = UpcomingTasks(len(due), lambda step: [runner.twin(case, tasks[due[step]].spec)])
        running = RunningCampaign(case.id, TWINS_SUBJECT, len(due))
        try:
            for step, run in enumerate(due):
                upcoming.reach(step)
                runner.on_progress(running.reach(step, len(due), runner.store.simulated))
                episode = runner.again(case, run)
                self._told.add(key_of(tasks[run]))
                runner.on_chains(case, episode, self.chains(case, episode, upcoming))
        finally:
            runner.store.cancel()
            runner.on_progress(running.end())

    def chains(
        self, case: Case, episode: JudgedEpisode, ahead: Iterable[EpisodeTask] = ()
    ) -> list[CausalChain]:
        """See :meth:`pytest_dura.runner.Runner.chains`.

        Args:
            case: The case that it belongs to.
            episode: One of its runs.
            ahead: What will be wanted next.
        """
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
            # Not even a bare instance is spared it: one that remembers earlier episodes differs
            # there as well, and then nothing can be said of the faults.
            return runner.store.get(task.repeated(), ahead)

        twin = runner.store.get(task, ahead)
        divergence = Divergence.of(episode, twin, second)
        return causal_chains(episode, requirements, twin, divergence)
