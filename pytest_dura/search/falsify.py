"""Falsify: search a case for violations of requirements, and describe the outcome."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

from pytest_dura.campaign.events import SearchEnded
from pytest_dura.campaign.falsification import Limits
from pytest_dura.campaign.runner import Runner
from pytest_dura.core.errors import ConfigurationError, DuraError, did_you_mean
from pytest_dura.core.percepts import NOTHING
from pytest_dura.core.seeding import derive_seed
from pytest_dura.library.cases import Case, SearchedCase
from pytest_dura.library.fault_campaigns import FaultCampaign
from pytest_dura.library.requirements import check_formula
from pytest_dura.requirements.checks import check_name, is_function_path
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.searches import Falsification, SearchOutcome, search_status
from pytest_dura.search.counterexamples import (
    CounterexampleStore,
    confirm_violation,
    store_counterexample,
)
from pytest_dura.search.portfolio import (
    Batch,
    Outcome,
    Portfolio,
    SearchLog,
    Trial,
    finite_or_none,
    parameter_report,
    search,
    searcher_report,
    trivial_names,
)
from pytest_dura.search.regions import KeptPoints, RegionSearch
from pytest_dura.search.space import CoverageCount, SearchSpace
from pytest_dura.search.trials import Baseline, Objective, Trials, run_baselines


def falsify(
    runner: Runner,
    case: Case,
    objectives: Sequence[Objective],
    *,
    limits: Limits | None = None,
    faults: Sequence[FaultCampaign] = (),
    seed: int | None = None,
    store: CounterexampleStore | None = None,
    on_store_error: Callable[[ConfigurationError], None] | None = None,
) -> Falsification:
    """Search a case for episodes that violate requirements.

    Args:
        runner: Runs the episodes, and emits that the search has ended.
        case: The case.
        objectives: The requirements; the search ends once each of them is violated as often as the
            limits ask for.
        limits: Budgets of the search.
        faults: Faults that the search may add to those of the case.
        seed: From which its draws follow; by default from the runner's seed and the case.
        store: Stores a confirmed counterexample; by default it is not stored.
        on_store_error: Receives the error of a counterexample that cannot be stored; by default
            the error is raised.

    Raises:
        ConfigurationError: If nothing can differ, or something cannot be built or judged.
    """
    limits = limits or Limits()
    space = SearchSpace.of(
        case,
        faults,
        at_most=limits.at_most,
        simulator=runner.simulator,
        begin_within=_nominal_duration(runner, case) if faults else None,
    )
    if faults and "fault_injector" not in case.roles(runner.roles):
        raise ConfigurationError(
            f"no fault can be added to the case {case.id!r}, for no role injects any",
            file=case.scenario.file or None,
            key="roles.fault_injector",
            found="none",
            expected="the role fault_injector",
            remedy="leave `fault_injector: null` out for the default one",
        )
    names = [objective.requirement.id for objective in objectives]
    seed = derive_seed(runner.base_seed, "search", case.id, *names) if seed is None else seed
    trials = Trials(runner, space, objectives)
    portfolio = Portfolio(
        space.layout, seed, limits.budget, len(objectives), surrogate=limits.surrogate
    )
    kept = KeptPoints(len(objectives)) if limits.regions else None
    log, coverage = _run_search(trials, portfolio, limits, kept)
    baselines: tuple[Baseline, ...] = ()
    if limits.baselines and any(log.violations):
        baselines = run_baselines(trials, seed, log.simulations)
    result = _SearchResult(trials, log, baselines, limits, store, on_store_error)
    outcomes = tuple(result.outcome(number) for number in range(len(objectives)))
    falsification = Falsification(
        case=case.id,
        component=case.roles(runner.roles)["generator"].label,
        seed=seed,
        budget=limits.budget,
        simulations=log.simulations,
        refused=log.refused,
        unknown=log.inconclusive,
        not_manifested=log.not_manifested,
        rule=portfolio.rule,
        parameters=tuple(parameter_report(parameter) for parameter in space.parameters),
        searchers=tuple(
            searcher_report(name, count, names, trivial=name in trivial_names())
            for name, count in log.searchers.items()
        ),
        baselines=tuple(
            searcher_report(baseline.name, count, names, trivial=True)
            for baseline in baselines
            for count in baseline.log.searchers.values()
        ),
        coverage=coverage.coverage(),
        outcomes=outcomes,
    )
    runner.events.emit(SearchEnded(case, falsification))
    if kept is not None:
        RegionSearch(
            trials, kept, seed, limits.region_runs, limits.shrink, store, on_store_error
        ).emit()
    return falsification


def _nominal_duration(runner: Runner, case: Case) -> float | None:
    """Return the seconds that the campaign's first run lasts: later faults have no effect."""
    episode = runner.searched(case)
    return float(episode.time[-1]) if episode.ticks > 1 and episode.failure is None else None


def _run_search(
    trials: Trials, portfolio: Portfolio, limits: Limits, kept: KeptPoints | None
) -> tuple[SearchLog, CoverageCount]:
    budget, at_least = limits.budget, math.inf if limits.all else limits.at_least
    runner, coverage = trials.runner, CoverageCount(trials.space.layout)
    subject = "search " + ", ".join(objective.requirement.id for objective in trials.objectives)
    with runner.progress(trials.space.case, subject, budget) as reach:
        done = 0
        reach(done, budget)

        def evaluate(batch: Batch) -> Iterable[Outcome]:
            nonlocal done
            outcomes = zip(batch.points, batch.worlds, trials.evaluate(batch), strict=True)
            for point, world, outcome in outcomes:
                if outcome.simulated:
                    coverage.add(point)
                    if kept is not None:
                        kept.add(point, world, outcome)
                    done += 1
                    reach(done, budget)
                yield outcome

        log = search(portfolio, evaluate, budget, len(trials.objectives), at_least)
    if not log.simulations:
        # Every point contradicts itself: making one raises an error that says how.
        batch = portfolio.ask()
        runner.search_task(trials.case(batch.points[0].tolist(), batch.worlds[0]))
        raise ConfigurationError(
            f"nearly every point contradicts itself in {trials.space.case.id!r}",
            key="variation",
            found=f"{log.refused} points, all of them refused",
            expected="ranges of which most combinations are possible",
            remedy="narrow the ranges under `variation`",
        )
    return log, coverage


@dataclass(frozen=True)
class _SearchResult:
    """Makes outcomes of the logs of a search and its baselines."""

    trials: Trials
    log: SearchLog
    baselines: tuple[Baseline, ...]
    limits: Limits
    store: CounterexampleStore | None
    on_store_error: Callable[[ConfigurationError], None] | None

    def outcome(self, number: int) -> SearchOutcome:
        """Make the outcome of the objective of this number; store its counterexample."""
        objective, best = self.trials.objectives[number], self.log.best[number]
        least = None if best is None else finite_or_none(best.margin)
        first = self.log.first[number]
        if first is not None:
            case = self.trials.case(first.point.tolist(), first.world)
            return self._violated(objective, case, first, least)
        for baseline in self.baselines:
            # A violation counts, whichever searcher proposed it.
            violating, trial = baseline.case(self.trials, number), baseline.log.first[number]
            if violating is not None and trial is not None:
                return self._violated(objective, violating, trial, least)
        status = search_status(None, self.log.inconclusive, self.log.simulations)
        return SearchOutcome(
            objective.requirement.id, objective.name, status, self.log.simulations, None, least
        )

    def _violated(
        self, objective: Objective, case: SearchedCase, first: Trial, least: float | None
    ) -> SearchOutcome:
        confirmed = confirm_violation(self.trials, objective, case, self.limits.shrink)
        counterexample = confirmed.counterexample
        status = search_status(counterexample, self.log.inconclusive, self.log.simulations)
        if self.store is not None and status == "falsified":
            origin = f"simulation {first.number} of a search ({first.searcher})"
            try:
                counterexample = store_counterexample(
                    self.trials, objective, confirmed, self.store, origin
                )
            except ConfigurationError as error:
                if self.on_store_error is None:
                    raise
                self.on_store_error(error)
        return SearchOutcome(
            objective.requirement.id,
            objective.name,
            status,
            first.number,
            first.searcher,
            least,
            counterexample,
        )


_ID = re.compile(r"[A-Za-z][A-Za-z0-9_.]*-[A-Za-z0-9_.-]+")
"""Texts that look like the id of a requirement rather than like a formula."""


class Falsified(DuraError):  # noqa: N818 - it is an outcome, not an error
    """A search found a violation, or too many simulations were undecided.

    Args:
        message: The outcomes in short.
        falsification: The report of the search.
        not_kept: Why counterexamples could not be kept.
        units: Of signals, by name.
    """

    def __init__(
        self,
        message: str,
        falsification: Falsification,
        not_kept: Sequence[str] = (),
        units: Mapping[str, str] = NOTHING,
    ) -> None:
        self.falsification, self.not_kept = falsification, tuple(not_kept)
        self.units = units
        super().__init__(message)


def falsify_case(
    runner: Runner,
    case: Case,
    own: Requirement | None,
    given: Any,
    *,
    faults: FaultCampaign | Sequence[FaultCampaign],
    seed: int | None,
    store: CounterexampleStore | None = None,
    **limited: Any,
) -> Falsification:
    """Search a case; see :meth:`pytest_dura.campaign.campaign.Campaign.falsify`."""
    __tracebackhide__ = True
    limits = Limits(**limited)
    objectives = [_objective(runner, case, own, each) for each in _as_list(given)]
    store_errors: list[ConfigurationError] = []
    falsification = falsify(
        runner,
        case,
        objectives,
        limits=limits,
        faults=_faults(faults),
        seed=_seed(seed),
        store=store,
        on_store_error=store_errors.append,
    )
    failed = [outcome for outcome in falsification.outcomes if outcome.status != "nothing found"]
    if failed:
        on = f"{falsification.case} ({falsification.component})"
        texts = [f"{outcome.status}: {outcome.requirement} on {on}" for outcome in failed]
        not_kept, system = [str(error) for error in store_errors], case.scenario.system
        units = {} if system is None else system.units
        raise Falsified("; ".join(texts), falsification, not_kept, units)
    return falsification


def _faults(given: Any) -> Sequence[FaultCampaign]:
    if isinstance(given, (str, Mapping)):
        return [given]
    if not isinstance(given, Sequence):
        raise ConfigurationError(
            "this names no faults",
            key="faults",
            found=given,
            expected="a fault's name or data, or a list of them",
            remedy='for example faults=["delay"]',
        )
    return given


def _seed(given: Any) -> int | None:
    whole = isinstance(given, int) and not isinstance(given, bool)
    if given is None or (whole and given >= 0):
        return cast("int | None", given)
    raise ConfigurationError(
        "the seed of a search is a whole number of at least 0",
        key="seed",
        found=given,
        expected="0 or more",
    )


def _as_list(given: Any) -> list[Any]:
    if isinstance(given, Sequence) and not isinstance(given, str):
        if not given:
            raise ConfigurationError(
                "the search is asked for nothing",
                key="requirement",
                found="an empty list",
                expected="ids of requirements, or formulas",
            )
        return list(given)
    return [given]


def _objective(runner: Runner, case: Case, own: Requirement | None, given: Any) -> Objective:
    """Make an objective of what a user gave, and check that the case can be judged by it."""
    requirement, check = _requirement(runner, own, given)
    if requirement.paired is not None:
        raise ConfigurationError(
            f"the requirement {requirement.id!r} is about pairs, and a search runs none",
            key=requirement.id,
            expected="a requirement with a check on one episode",
            remedy="search for a violation of its check: campaign.falsify('always (...)')",
        )
    if not (check or requirement.check):
        raise ConfigurationError(
            f"requirement {requirement.id!r} has no check to violate",
            key="check",
            found=requirement.id,
            expected="a check, or a requirement with one in its file",
            remedy="call campaign.falsify('always (gap > 0)'), or add a `check` to the file",
        )
    if runner.simulator is None:  # another simulator's signals show at run time
        check_formula(case.scenario, check or requirement.check)
    return Objective(requirement, check)


def is_formula(text: str) -> bool:
    """Whether a text that is no known requirement is a formula, and no id or import path."""
    return _ID.fullmatch(text) is None and not is_function_path(text)


def _requirement(runner: Runner, own: Requirement | None, given: Any) -> tuple[Requirement, Any]:
    known = runner.library().requirements
    if given is None:
        if own is None:
            raise ConfigurationError(
                "there is no requirement to search a violation of",
                key="requirement",
                found="a test without a marker `requirement`",
                expected="a requirement's id or a formula",
                remedy="call campaign.falsify('SAF-1'), or add the marker",
            )
        return own, None
    if isinstance(given, Requirement):
        return given, None
    if isinstance(given, str) and given in known:
        return known[given], None
    if isinstance(given, str) and _ID.fullmatch(given) and not is_function_path(given):
        raise ConfigurationError(
            f"unknown requirement {given!r}",
            key="requirement",
            found=given,
            expected="one of " + ", ".join(known) + ", or a formula",
            remedy=did_you_mean(given, known),
        )
    if not (isinstance(given, str) or callable(given)):
        raise ConfigurationError(
            "this is nothing that an episode could violate",
            key="requirement",
            found=given,
            expected="a requirement's id, a formula, or a function of the episode",
        )
    if isinstance(given, str):
        return Requirement(check_name(given), check=given), None
    return Requirement(check_name(given)), given
