"""Trials: run searched cases, judge them, and run the trivial searchers as baselines."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pytest_dura.campaign.runner import Runner
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.execution.task import EpisodeTask, UpcomingTasks
from pytest_dura.library.cases import Case, SearchedCase, make_searched_case
from pytest_dura.requirements.checks import Check, check_name, is_function_path
from pytest_dura.requirements.episode_verdicts import (
    SearchedEpisode,
    SearchVerdict,
    evaluate_episode,
    judge_searched,
)
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.scaling import scaled_formula
from pytest_dura.requirements.searches import ReplayCount
from pytest_dura.search.portfolio import Batch, Outcome, SearchLog, search, trivial_searchers
from pytest_dura.search.searchers import Searcher
from pytest_dura.search.space import SearchSpace

_CONCLUSIVE = ("violated", "satisfied")
_FIGURE = re.compile(r"-?\d+(\.\d+)?(e[-+]?\d+)?")
_REPLAYS = 10
"""Replays of a violation whose digest differs, to count how often it violates."""


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
        """The check as text."""
        return check_name(self.requirement.check if self.check is None else self.check)

    def judge(self, episode: SearchedEpisode) -> SearchVerdict:
        """Judge an episode of a searched case."""
        return judge_searched(self.requirement, episode, self.check)

    def margin(self, verdict: SearchVerdict, episode: SearchedEpisode) -> float | None:
        """Return the margin that guides a search: in units of importance where any are declared."""
        formula = None if self.check is not None else scaled_formula(self.requirement)
        if formula is None or verdict.margin is None:
            return verdict.margin
        evaluation, _ = evaluate_episode(formula, episode)
        return None if evaluation is None else evaluation.margin

    def event(self, verdict: SearchVerdict, episode: SearchedEpisode) -> str:
        """Say what a violation is, in words that are the same for all of its kind.

        That is the part of a formula that is violated, or what a function says without its figures,
        and how the episode ended.
        """
        check = self.requirement.check if self.check is None else self.check
        formula = isinstance(check, str) and not is_function_path(check)
        what = verdict.detail if formula else _FIGURE.sub("#", verdict.detail)
        return f"{what or self.name}; ended: {episode.termination}"


class Trials:
    """Runs the points of a search as cases, and judges them.

    Args:
        runner: Runs the episodes.
        space: Turns points into cases.
        objectives: The requirements, in the order of an outcome's values.
    """

    def __init__(self, runner: Runner, space: SearchSpace, objectives: Sequence[Objective]) -> None:
        self.runner, self.space, self.objectives = runner, space, tuple(objectives)

    def case(self, point: Sequence[float], world: int) -> SearchedCase:
        """Make the case at a point, with the seed of the campaign's run number ``world``.

        Raises:
            ConfigurationError: If its values contradict each other.
        """
        seed = self.space.case.seed(world, self.runner.base_seed)
        return self.space.case_with(self.space.values(point), seed)

    @contextmanager
    def phase(self, subject: str, most: int) -> Iterator[Callable[[], None]]:
        """Emit the progress of what a search does besides asking its searchers.

        Args:
            subject: What the simulations are for.
            most: How many there are at most.

        Yields:
            A function to call after each simulation.
        """
        with self.runner.progress(self.space.case, subject, most) as reach:
            done = itertools.count(1)
            reach(0, most)
            yield lambda: reach(min(next(done), most), most)

    def case_of_run(self, run: int) -> SearchedCase:
        """Make a searched case of the campaign's run of this number."""
        case = self.space.case
        spec = case.spec(
            run,
            self.runner.base_seed,
            self.runner.roles,
            simulator=self.runner.simulator,
            resolver=self.runner.resolver,
        )
        faults = [fault.plain() for fault in spec.faults]
        return make_searched_case(case, spec.scenario["world"], faults, spec.seed)

    def evaluate(self, batch: Batch) -> Iterator[Outcome]:
        """Yield the outcomes of a batch; an executor with room begins the next ones ahead."""
        points = zip(batch.points.tolist(), batch.worlds, strict=True)
        return self._outcomes([self._run_at(point, world) for point, world in points])

    def random_runs(self, batch: Batch) -> Iterator[Outcome]:
        """Yield the outcomes of random seeds: the campaign's own runs of these numbers."""
        return self._outcomes([(self.space.case, world) for world in batch.worlds])

    def _outcomes(self, runs: Sequence[tuple[Case, int] | None]) -> Iterator[Outcome]:
        """Yield the outcomes of cases and run numbers; ``None`` is a contradictory point."""
        runner = self.runner
        # Runs of the campaign itself draw their own worlds.
        beside = [run[0] for run in runs if run is not None and isinstance(run[0], SearchedCase)]

        def task_of(step: int) -> list[EpisodeTask]:
            run = runs[step]
            return [] if run is None else [runner.search_task(*run, beside=beside)]

        ahead = UpcomingTasks(len(runs), task_of)
        try:
            for number, run in enumerate(runs):
                ahead.reach(number)
                if run is None:
                    yield self._refused
                else:
                    yield self.outcome(runner.searched(*run, ahead=ahead, beside=beside))
        finally:
            runner.store.cancel()

    @property
    def _refused(self) -> Outcome:
        """The outcome of a point whose values contradict each other."""
        count = len(self.objectives)
        return Outcome((math.nan,) * count, (False,) * count, simulated=False)

    def outcome(self, episode: SearchedEpisode) -> Outcome:
        """Judge an episode by all requirements."""
        verdicts = [objective.judge(episode) for objective in self.objectives]
        return Outcome(
            tuple(
                _margin(objective, verdict, episode)
                for objective, verdict in zip(self.objectives, verdicts, strict=True)
            ),
            tuple(verdict.status == "violated" for verdict in verdicts),
            tuple(
                verdict.status in _CONCLUSIVE or _is_not_manifested(verdict, episode)
                for verdict in verdicts
            ),
            not_manifested=any(_is_not_manifested(verdict, episode) for verdict in verdicts),
            manifested=len(episode.not_manifested) < len(episode.spec.faults),
            events=tuple(
                objective.event(verdict, episode) if verdict.status == "violated" else ""
                for objective, verdict in zip(self.objectives, verdicts, strict=True)
            ),
        )

    def replay(
        self, case: Case, objective: Objective, run: int = 0
    ) -> tuple[SearchedEpisode, ReplayCount]:
        """Simulate a violating episode again; return the first run and the counts of replays.

        One replay with an equal digest confirms it. Where a digest differs, further replays count
        how often it violates.

        Args:
            case: The case.
            objective: What it violates.
            run: Number of the run.
        """
        first = self.runner.searched(case, run)
        runs = violated = equal = 0
        while runs < (1 if equal == runs else _REPLAYS):
            runs += 1
            again = self.runner.searched(case, run, again=runs)
            violated += objective.judge(again).status == "violated"
            equal += again.digest == first.digest
        return first, ReplayCount(runs, violated, equal)

    def _run_at(self, point: Sequence[float], world: int) -> tuple[Case, int] | None:
        try:
            case = self.case(point, world)
            self.runner.search_task(case)
        except ConfigurationError:
            return None
        return case, 0


def _is_not_manifested(verdict: SearchVerdict, episode: SearchedEpisode) -> bool:
    """Whether a run is invalid only since a fault was never manifested: a run without the fault."""
    complete = episode.failure is None and not episode.ended_early
    return verdict.status == "invalid" and complete and bool(episode.not_manifested)


def _margin(objective: Objective, verdict: SearchVerdict, episode: SearchedEpisode) -> float:
    counts = verdict.status in _CONCLUSIVE or _is_not_manifested(verdict, episode)
    margin = objective.margin(verdict, episode) if counts else None
    return math.nan if margin is None else float(margin)


RANDOM = "random seeds"
"""Name of the baseline that is the campaign's own runs."""


class _SingleSearcher:
    """Proposes the points of one trivial searcher, each with a seed of its own."""

    def __init__(self, searcher: Searcher | None) -> None:
        self._searcher, self._proposed = searcher, 0
        self.name = RANDOM if searcher is None else searcher.name

    def ask(self) -> Batch:
        """Return the next points."""
        points = np.zeros((1, 0)) if self._searcher is None else self._searcher.ask()
        first, self._proposed = self._proposed, self._proposed + len(points)
        return Batch(self.name, points, world=first, spread=True)

    def tell(
        self, batch: Batch, values: NDArray[np.float64], open_objectives: frozenset[int]
    ) -> None:
        """Do nothing: trivial searchers learn nothing."""


def run_alone(trials: Trials, searcher: Searcher | None, budget: int) -> SearchLog:
    """Search with one searcher alone.

    Args:
        trials: Runs the episodes.
        searcher: A trivial searcher; ``None`` for random seeds, which are the campaign's own runs.
        budget: Greatest number of simulations.
    """
    run = trials.random_runs if searcher is None else trials.evaluate
    alone = _SingleSearcher(searcher)
    with trials.phase(f"{alone.name} alone", budget) as simulated:

        def evaluate(batch: Batch) -> Iterator[Outcome]:
            for outcome in run(batch):
                yield outcome
                simulated()

        return search(alone, evaluate, budget, len(trials.objectives))


@dataclass(frozen=True)
class Baseline:
    """A trivial searcher's search.

    Args:
        name: The searcher's name.
        random: Whether its points are the campaign's own runs.
        log: Its counts and violations.
    """

    name: str
    random: bool
    log: SearchLog

    def case(self, trials: Trials, number: int) -> SearchedCase | None:
        """Make the case of its first violation of an objective; ``None`` if it has none."""
        first = self.log.first[number]
        if first is None:
            return None
        if self.random:
            return trials.case_of_run(first.world)
        return trials.case(first.point.tolist(), first.world)


def run_baselines(trials: Trials, seed: int, budget: int) -> tuple[Baseline, ...]:
    """Run each baseline alone, random seeds first.

    Args:
        trials: Runs the episodes.
        seed: From which their draws follow, as those of the search do.
        budget: Greatest number of simulations of each.
    """
    searchers = trivial_searchers(trials.space.layout, seed)
    return (
        Baseline(RANDOM, True, run_alone(trials, None, budget)),
        *(Baseline(name, False, run_alone(trials, each, budget)) for name, each in searchers),
    )
