"""Following: what came of the faults of a bench's episodes, by runs without them."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from pytest_dura.campaign.cases import Case
from pytest_dura.campaign.chains import CausalChain, causal_chains
from pytest_dura.campaign.episodes.memory import Key, key_of
from pytest_dura.campaign.episodes.task import EpisodeTask
from pytest_dura.campaign.episodes.upcoming import Upcoming
from pytest_dura.campaign.progress import RunningCampaign
from pytest_dura.core.propagation import Divergence
from pytest_dura.requirements.verdicts import JudgedEpisode

if TYPE_CHECKING:
    from pytest_dura.campaign.runner import Bench

TWINS = "fault-free twins"
"""What runs when it is found out what came of faults, as progress calls it."""
RECENT = 64
"""Episodes whose chains are kept: they are asked for while one is looked at."""


class Following:
    """Follows each fault of an episode from plan to outcome, once.

    Args:
        bench: Whose episodes they are.
    """

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self._told: set[Key] = set()
        self._chains: OrderedDict[Key, list[CausalChain]] = OrderedDict()

    def follow(self, case: Case, runs: Sequence[int]) -> None:
        """See :meth:`pytest_dura.campaign.runner.Bench.follow`."""
        bench = self.bench
        tasks = {run: bench.task(case, run) for run in runs}
        due = [run for run in runs if key_of(tasks[run]) not in self._told]
        upcoming = Upcoming(len(due), lambda step: [bench.twin(case, tasks[due[step]].spec)])
        running = RunningCampaign(case.id, TWINS, len(due))
        try:
            for step, run in enumerate(due):
                upcoming.reach(step)
                bench.on_progress(running.reach(step, len(due), bench.store.simulated))
                episode = bench.again(case, run)
                self._told.add(key_of(tasks[run]))
                bench.on_chains(case, episode, self.chains(case, episode, upcoming))
        finally:
            bench.store.cancel()
            bench.on_progress(running.end())

    def chains(
        self, case: Case, episode: JudgedEpisode, ahead: Iterable[EpisodeTask] = ()
    ) -> list[CausalChain]:
        """See :meth:`pytest_dura.campaign.runner.Bench.chains`.

        Args:
            case: The case that it belongs to.
            episode: One of its runs.
            ahead: What will be wanted next.
        """
        key = self.bench.key(episode)
        if key not in self._chains:
            self._chains[key] = self._linked(case, episode, ahead)
        while len(self._chains) > RECENT:
            self._chains.popitem(last=False)
        return self._chains[key]

    def _linked(
        self, case: Case, episode: JudgedEpisode, ahead: Iterable[EpisodeTask]
    ) -> list[CausalChain]:
        bench, requirements = self.bench, self.bench.requirements_of(case)
        reached = any(fault.manifested_at is not None for fault in episode.faults)
        if not (bench.twins and reached):
            return causal_chains(episode, requirements)
        task = bench.twin(case, episode.spec)

        def second() -> JudgedEpisode:
            # Not even a bare instance is spared it: one that remembers earlier episodes differs
            # there as well, and then nothing can be said of the faults.
            return bench.store.get(task.repeated(), ahead)

        twin = bench.store.get(task, ahead)
        divergence = Divergence.of(episode, twin, second)
        return causal_chains(episode, requirements, twin, divergence)
