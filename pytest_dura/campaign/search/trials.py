"""Trials: runs searched cases on a bench, and says what requirements make of them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pytest_dura.campaign.cases import Case
from pytest_dura.campaign.episodes.upcoming import Upcoming
from pytest_dura.campaign.search.loop import Outcome
from pytest_dura.campaign.search.portfolio import Batch
from pytest_dura.campaign.search.result import Repeats
from pytest_dura.campaign.search.space.search_space import SearchSpace
from pytest_dura.campaign.search.space.searched import SearchedCase, searched_case
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.requirements.checks import Check, check_name
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.verdicts.searched import (
    SearchedEpisode,
    SearchVerdict,
    judge_searched,
)

if TYPE_CHECKING:
    from pytest_dura.campaign.runner import Bench

_TELLING = ("violated", "satisfied")
REPLAYS = 10
"""Runs of a violation that does not repeat itself exactly, from which its repeat rate follows."""


@dataclass(frozen=True)
class Asked:
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
    """Runs searched cases on a bench.

    Args:
        bench: The bench.
        space: What the points of a search mean.
        asked: The requirements.
    """

    def __init__(self, bench: Bench, space: SearchSpace, asked: Sequence[Asked]) -> None:
        self.bench, self.space, self.asked = bench, space, tuple(asked)

    def case(self, point: Sequence[float], world: int) -> SearchedCase:
        """The case at a point, with the seed of the campaign's run of this number.

        Raises:
            ConfigurationError: If its values contradict each other.
        """
        seed = self.space.case.seed(world, self.bench.base_seed)
        return self.space.made(self.space.values(point), seed)

    def case_of_run(self, run: int) -> SearchedCase:
        """What the campaign's run of this number was drawn to be."""
        case = self.space.case
        spec = case.spec(
            run,
            self.bench.base_seed,
            self.bench.roles,
            simulator=self.bench.simulator,
            resolver=self.bench.resolver,
        )
        return searched_case(case, spec.scenario["world"], spec.faults, spec.seed)

    def evaluate(self, batch: Batch) -> Iterator[Outcome]:
        """The outcomes of a batch one by one; those to come are begun ahead where there is room."""
        points = zip(batch.points.tolist(), batch.worlds, strict=True)
        return self._outcomes([self._possible(point, world) for point, world in points])

    def random_runs(self, batch: Batch) -> Iterator[Outcome]:
        """What random seeds come to: the campaign's own runs of these numbers."""
        return self._outcomes([(self.space.case, world) for world in batch.worlds])

    def _outcomes(self, runs: Sequence[tuple[Case, int] | None]) -> Iterator[Outcome]:
        """The outcomes of runs of cases; ``None`` stands for one that contradicts itself."""
        bench = self.bench
        ahead = Upcoming(
            len(runs), lambda step: [bench.search_task(*run)] if (run := runs[step]) else []
        )
        try:
            for number, run in enumerate(runs):
                ahead.reach(number)
                if run is None:
                    yield self.refused
                else:
                    yield self.outcome(bench.searched(*run, ahead=ahead))
        finally:
            bench.store.cancel()

    @property
    def refused(self) -> Outcome:
        """Of a point whose values contradict each other."""
        return Outcome((math.nan,) * len(self.asked), (False,) * len(self.asked), simulated=False)

    def outcome(self, episode: SearchedEpisode) -> Outcome:
        """What all requirements make of an episode."""
        verdicts = [one.judge(episode) for one in self.asked]
        return Outcome(
            tuple(_margin(one, episode) for one in verdicts),
            tuple(one.word == "violated" for one in verdicts),
            tuple(one.word in _TELLING or _is_idle(one, episode) for one in verdicts),
            idle=any(_is_idle(one, episode) for one in verdicts),
            acted=len(episode.idle_faults) < len(episode.spec.faults),
        )

    def repeated(self, case: Case, asked: Asked, run: int = 0) -> tuple[SearchedEpisode, Repeats]:
        """A violating episode, and what came of simulating it again.

        One replay with an equal digest confirms it. Where a digest differs, further replays tell
        how often it violates.

        Args:
            case: The case.
            asked: What it violates.
            run: Number of the run.
        """
        first = self.bench.searched(case, run)
        runs = violated = equal = 0
        while runs < (1 if equal == runs else REPLAYS):
            runs += 1
            again = self.bench.searched(case, run, again=runs)
            violated += asked.judge(again).word == "violated"
            equal += again.digest == first.digest
        return first, Repeats(runs, violated, equal)

    def _possible(self, point: Sequence[float], world: int) -> tuple[Case, int] | None:
        try:
            case = self.case(point, world)
            self.bench.search_task(case)
        except ConfigurationError:
            return None
        return case, 0


def _is_idle(verdict: SearchVerdict, episode: SearchedEpisode) -> bool:
    """Whether all that is amiss is a fault that never came to act: the rest is a run without it."""
    whole = episode.failure is None and not episode.ended_early
    return verdict.word == "invalid" and whole and bool(episode.idle_faults)


def _margin(verdict: SearchVerdict, episode: SearchedEpisode) -> float:
    if verdict.margin is None or not (verdict.word in _TELLING or _is_idle(verdict, episode)):
        return math.nan
    return float(verdict.margin)
