"""Trials: run searched cases, judge them, and run the trivial searchers as baselines."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pytest_dura.campaign.falsification import ReplayCount
from pytest_dura.campaign.runner import EpisodeRunner
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.execution.task import UpcomingTasks
from pytest_dura.library.cases import Case, SearchedCase, make_searched_case
from pytest_dura.requirements.checks import Check, check_name
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.verdicts.episodes import (
    SearchedEpisode,
    SearchVerdict,
    judge_searched,
)
from pytest_dura.search.portfolio import Batch, Outcome, SearchLog, search, trivial_searchers
from pytest_dura.search.searchers import Searcher
from pytest_dura.search.space import SearchSpace

_CONCLUSIVE = ("violated", "satisfied")
_REPLAYS = 10
"""Runs of a violation that does not repeat itself exactly, from which its repeat rate follows."""


@dataclass(frozen=True)
class Objective:
    """A requirement that a search tries to violate.

    Args:
        requirement: The requirement.
        check: In place of the requirement's own.
    """

    requirement: Requirement
    check: Check | None = None

    @property
    def name(self) -> str:
        """The text of its check."""
        return check_name(self.requirement.check if self.check is None else self.check)

    def judge(self, episode: SearchedEpisode) -> SearchVerdict:
        """What it says of an episode."""
        return judge_searched(self.requirement, episode, self.check)


class Trials:
    """Runs searched cases on a runner.

    Args:
        runner: The runner.
        space: What the points of a search mean.
        asked: The requirements.
    """

    def __init__(
        self, runner: EpisodeRunner, space: SearchSpace, asked: Sequence[Objective]
    ) -> None:
        self.runner, self.space, self.asked = runner, space, tuple(asked)

    def case(self, point: Sequence[float], world: int) -> SearchedCase:
        """The case at a point, with the seed of the campaign's run of this number.

        Raises:
            ConfigurationError: If its values contradict each other.
        """
        seed = self.space.case.seed(world, self.runner.base_seed)
        return self.space.made(self.space.values(point), seed)

    def case_of_run(self, run: int) -> SearchedCase:
        """What the campaign's run of this number was drawn to be."""
        case = self.space.case
        spec = case.spec(
            run,
            self.runner.base_seed,
            self.runner.roles,
            simulator=self.runner.simulator,
            resolver=self.runner.resolver,
        )
        return make_searched_case(case, spec.scenario["world"], spec.faults, spec.seed)

    def evaluate(self, batch: Batch) -> Iterator[Outcome]:
        """The outcomes of a batch one by one; those to come are begun ahead where there is room."""
        points = zip(batch.points.tolist(), batch.worlds, strict=True)
        return self._outcomes([self._possible(point, world) for point, world in points])

    def random_runs(self, batch: Batch) -> Iterator[Outcome]:
        """What random seeds come to: the campaign's own runs of these numbers."""
        return self._outcomes([(self.space.case, world) for world in batch.worlds])

    def _outcomes(self, runs: Sequence[tuple[Case, int] | None]) -> Iterator[Outcome]:
        """The outcomes of runs of cases; ``None`` stands for one that contradicts itself."""
        runner = self.runner
        ahead = UpcomingTasks(
            len(runs), lambda step: [runner.search_task(*run)] if (run := runs[step]) else []
        )
        try:
            for number, run in enumerate(runs):
                ahead.reach(number)
                if run is None:
                    yield self.refused
                else:
                    yield self.outcome(runner.searched(*run, ahead=ahead))
        finally:
            runner.store.cancel()

    @property
    def refused(self) -> Outcome:
        """Of a point whose values contradict each other."""
        return Outcome((math.nan,) * len(self.asked), (False,) * len(self.asked), simulated=False)

    def outcome(self, episode: SearchedEpisode) -> Outcome:
        """What all requirements make of an episode."""
        verdicts = [item.judge(episode) for item in self.asked]
        return Outcome(
            tuple(_margin(verdict, episode) for verdict in verdicts),
            tuple(verdict.word == "violated" for verdict in verdicts),
            tuple(
                verdict.word in _CONCLUSIVE or _is_not_manifested(verdict, episode)
                for verdict in verdicts
            ),
            idle=any(_is_not_manifested(verdict, episode) for verdict in verdicts),
            acted=len(episode.not_manifested) < len(episode.spec.faults),
        )

    def repeated(
        self, case: Case, asked: Objective, run: int = 0
    ) -> tuple[SearchedEpisode, ReplayCount]:
        """A violating episode, and what came of simulating it again.

        One replay with an equal digest confirms it. Where a digest differs, further replays tell
        how often it violates.

        Args:
            case: The case.
            asked: What it violates.
            run: Number of the run.
        """
        first = self.runner.searched(case, run)
        runs = violated = equal = 0
        while runs < (1 if equal == runs else _REPLAYS):
            runs += 1
            again = self.runner.searched(case, run, again=runs)
            violated += asked.judge(again).word == "violated"
            equal += again.digest == first.digest
        return first, ReplayCount(runs, violated, equal)

    def _possible(self, point: Sequence[float], world: int) -> tuple[Case, int] | None:
        try:
            case = self.case(point, world)
            self.runner.search_task(case)
        except ConfigurationError:
            return None
        return case, 0


def _is_not_manifested(verdict: SearchVerdict, episode: SearchedEpisode) -> bool:
    """Whether all that is amiss is a fault that never came to act: the rest is a run without it."""
    whole = episode.failure is None and not episode.ended_early
    return verdict.word == "invalid" and whole and bool(episode.not_manifested)


def _margin(verdict: SearchVerdict, episode: SearchedEpisode) -> float:
    if verdict.margin is None or not (
        verdict.word in _CONCLUSIVE or _is_not_manifested(verdict, episode)
    ):
        return math.nan
    return float(verdict.margin)


RANDOM = "random seeds"
"""The runs of the campaign itself."""


class _SingleSearcher:
    """A searcher that has the whole budget; each of its points has a seed of its own."""

    def __init__(self, searcher: Searcher | None) -> None:
        self._searcher, self._asked = searcher, 0

    def ask(self) -> Batch:
        """The next points."""
        name = RANDOM if self._searcher is None else self._searcher.name
        points = np.zeros((1, 0)) if self._searcher is None else self._searcher.ask()
        first, self._asked = self._asked, self._asked + len(points)
        return Batch(name, points, world=first, spread=True)

    def tell(
        self, batch: Batch, values: NDArray[np.float64], open_objectives: frozenset[int]
    ) -> None:
        """Trivial searchers learn nothing, and this one tells them nothing."""


def run_alone(trials: Trials, searcher: Searcher | None, budget: int) -> SearchLog:
    """What a searcher comes to by itself.

    Args:
        trials: Runs the episodes.
        searcher: A trivial one; ``None`` for random seeds, which are the campaign's own runs.
        budget: Simulations.
    """
    run = trials.random_runs if searcher is None else trials.evaluate
    return search(_SingleSearcher(searcher), run, budget, len(trials.asked))


@dataclass(frozen=True)
class Baseline:
    """What a baseline came to.

    Args:
        name: Its name.
        random: Whether it is the runs of the campaign itself.
        log: What it saw.
    """

    name: str
    random: bool
    log: SearchLog

    def case(self, trials: Trials, number: int) -> SearchedCase | None:
        """The case in which it was the first to violate a requirement; ``None`` for none."""
        first = self.log.first[number]
        if first is None:
            return None
        if self.random:
            return trials.case_of_run(first.world)
        return trials.case(first.point.tolist(), first.world)


def run_baselines(trials: Trials, seed: int, budget: int) -> tuple[Baseline, ...]:
    """What each baseline comes to by itself.

    Args:
        trials: Runs the episodes.
        seed: From which their draws follow, as those of the search do.
        budget: Simulations of each of them.
    """
    random = Baseline(RANDOM, True, run_alone(trials, None, budget))
    return (
        random,
        *(
            Baseline(name, False, run_alone(trials, searcher, budget))
            for name, searcher in trivial_searchers(trials.space.layout, seed)
        ),
    )
