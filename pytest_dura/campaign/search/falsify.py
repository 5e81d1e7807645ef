"""Falsify: search a case for violations, confirm and shrink what is found, and keep it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pytest_dura.campaign.cases import Case
from pytest_dura.campaign.fault_campaigns import FaultCampaign
from pytest_dura.campaign.progress import RunningCampaign
from pytest_dura.campaign.search.baselines import Baseline, run_baselines
from pytest_dura.campaign.search.confirming import Keep, confirm, kept
from pytest_dura.campaign.search.limits import Limits
from pytest_dura.campaign.search.loop import Outcome, SearchLog, Trial, search
from pytest_dura.campaign.search.portfolio import Batch, Portfolio, trivial_names
from pytest_dura.campaign.search.reports import finite, parameter_told, searcher_report
from pytest_dura.campaign.search.result import (
    Falsification,
    SearchOutcome,
    Word,
)
from pytest_dura.campaign.search.space.coverage import CoverageCount
from pytest_dura.campaign.search.space.search_space import SearchSpace
from pytest_dura.campaign.search.space.searched import SearchedCase
from pytest_dura.campaign.search.trials import Asked, Trials
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.seeding import derive_seed
from pytest_dura.requirements.verdicts.judging import MAX_INVALID_SHARE

if TYPE_CHECKING:
    from pytest_dura.campaign.runner import Bench


def falsify(
    bench: Bench,
    case: Case,
    asked: Sequence[Asked],
    *,
    limits: Limits | None = None,
    faults: Sequence[FaultCampaign] = (),
    seed: int | None = None,
    keep: Keep | None = None,
    unkept: Callable[[ConfigurationError], None] | None = None,
) -> Falsification:
    """Search a case for episodes that violate requirements.

    Args:
        bench: Runs the episodes, and is told what came of the search.
        case: The case.
        asked: The requirements; the search ends once each of them is violated.
        limits: What it may use.
        faults: Faults that the search may add to those of the case.
        seed: From which its draws follow; by default from the bench's seed and the case.
        keep: Keeps a confirmed counterexample; ``None`` keeps it nowhere.
        unkept: Told why a counterexample could not be kept, which is found all the same; without
            one that is raised.

    Raises:
        ConfigurationError: If nothing can differ, or something cannot be built or judged.
    """
    limits = limits or Limits()
    space = SearchSpace.of(
        case,
        faults,
        at_most=limits.at_most,
        simulator=bench.simulator,
        lasting=_lasting(bench, case) if faults else None,
    )
    if faults and "fault_injector" not in case.roles(bench.roles):
        raise ConfigurationError(
            f"no fault can be added to the case {case.id!r}, for no role injects any",
            file=case.scenario.file or None,
            key="roles.fault_injector",
            found="none",
            expected="the role fault_injector",
            remedy='add `fault_injector: "pytest_dura.faults.injector:CampaignInjector"`',
        )
    names = [one.requirement.id for one in asked]
    seed = derive_seed(bench.base_seed, "search", case.id, *names) if seed is None else seed
    trials = Trials(bench, space, asked)
    portfolio = Portfolio(space.layout, seed, limits.budget, len(asked))
    log, coverage = _searched(trials, portfolio, limits.budget)
    baselines: tuple[Baseline, ...] = ()
    if limits.baselines and len(log.open) < len(asked):
        baselines = run_baselines(trials, seed, log.simulations)
    judging = _Outcomes(trials, log, baselines, limits, keep, unkept)
    outcomes = tuple(judging.of(number) for number in range(len(asked)))
    found = Falsification(
        case=case.id,
        component=case.roles(bench.roles)["generator"].label,
        seed=seed,
        budget=limits.budget,
        simulations=log.simulations,
        refused=log.refused,
        unknown=log.silent,
        idle=log.idle,
        rule=portfolio.RULE,
        parameters=tuple(parameter_told(one) for one in space.parameters),
        searchers=tuple(
            searcher_report(name, count, names, trivial=name in trivial_names())
            for name, count in log.searchers.items()
        ),
        baselines=tuple(
            searcher_report(one.name, count, names, trivial=True)
            for one in baselines
            for count in one.log.searchers.values()
        ),
        coverage=coverage.coverage(),
        outcomes=outcomes,
    )
    bench.on_search(case, found)
    return found


def _lasting(bench: Bench, case: Case) -> float | None:
    """Seconds that the campaign's first run lasts: a fault that begins later meets nobody."""
    episode = bench.searched(case)
    return float(episode.time[-1]) if episode.ticks > 1 and episode.failure is None else None


def _searched(trials: Trials, portfolio: Portfolio, budget: int) -> tuple[SearchLog, CoverageCount]:
    bench, coverage = trials.bench, CoverageCount(trials.space.layout)
    subject = "search " + ", ".join(one.requirement.id for one in trials.asked)
    running = RunningCampaign(trials.space.case.id, subject, budget)
    done = 0
    bench.on_progress(running.reach(done, budget, bench.store.simulated))

    def evaluate(batch: Batch) -> Iterable[Outcome]:
        nonlocal done
        for point, outcome in zip(batch.points, trials.evaluate(batch), strict=True):
            if outcome.simulated:
                coverage.add(point)
                done += 1
                bench.on_progress(running.reach(done, budget, bench.store.simulated))
            yield outcome

    try:
        log = search(portfolio, evaluate, budget, len(trials.asked))
    finally:
        bench.on_progress(running.end())
    if not log.simulations:
        # Every point contradicts itself; the first one tells how.
        batch = portfolio.ask()
        bench.search_task(trials.case(batch.points[0].tolist(), batch.worlds[0]))
        raise ConfigurationError(
            f"nearly every point contradicts itself in {trials.space.case.id!r}",
            key="variation",
            found=f"{log.refused} points, all of them refused",
            expected="ranges of which most combinations are possible",
            remedy="narrow the ranges under `variation`",
        )
    return log, coverage


@dataclass(frozen=True)
class _Outcomes:
    """Makes an outcome of what a search and its baselines saw."""

    trials: Trials
    log: SearchLog
    baselines: tuple[Baseline, ...]
    limits: Limits
    keep: Keep | None
    unkept: Callable[[ConfigurationError], None] | None

    def of(self, number: int) -> SearchOutcome:
        """That of the requirement of this number."""
        asked, best = self.trials.asked[number], self.log.best[number]
        name, least = asked.requirement.id, None if best is None else finite(best.margin)
        first = self.log.first[number]
        if first is not None:
            case = self.trials.case(first.point.tolist(), first.world)
            return self._claimed(asked, case, first, least)
        for baseline in self.baselines:
            # A violation counts, whoever meets it.
            seen, met = baseline.case(self.trials, number), baseline.log.first[number]
            if seen is not None and met is not None:
                return self._claimed(asked, seen, met, least)
        silent = self.log.silent / self.log.simulations
        word: Word = "undecided" if silent > MAX_INVALID_SHARE else "nothing found"
        return SearchOutcome(name, asked.name, word, self.log.simulations, None, least)

    def _claimed(
        self, asked: Asked, case: SearchedCase, first: Trial, least: float | None
    ) -> SearchOutcome:
        confirmed = confirm(self.trials, asked, case, self.limits.shrink)
        found = confirmed.found
        word: Word = "falsified" if found.repeats.confirmed else "not repeatable"
        if self.keep is not None and word == "falsified":
            how = f"simulation {first.number} of a search ({first.searcher})"
            try:
                found = kept(self.trials, asked, confirmed, self.keep, how)
            except ConfigurationError as error:
                if self.unkept is None:
                    raise
                self.unkept(error)
        return SearchOutcome(
            asked.requirement.id, asked.name, word, first.number, first.searcher, least, found
        )
