"""Minimisation of counterexamples: fewer faults, simpler values, by one loop within one budget.

What can be made simpler is a list of parts, each with levels from 0, the simplest, to the level
that it has. Delta debugging (Zeller and Hildebrandt, "Simplifying and isolating failure-inducing
input", IEEE Transactions on Software Engineering 28, 2002) sets all parts to 0, then halves of
them, quarters, ..., and halves the levels of those that are needed, until no single part can be
simpler. :func:`shrink` makes faults, world and seed of a searched case simpler;
:func:`reduce_faults` leaves out faults of an episode.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Hashable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

from pytest_dura.core.episode import Episode, EpisodeSpec, canonical
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.library.cases import Case, SearchedCase, make_searched_case
from pytest_dura.requirements.episode_verdicts import judge_episode
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.searches import ParameterChange, Shrinking
from pytest_dura.search.simplification import (
    Nominal,
    Simplification,
    changes_of,
    count_parameters,
)

Levels = tuple[int, ...]
"""A level for each part; 0 is the simplest."""


class BudgetUsedUp(Exception):  # noqa: N818 - an ending, not an error
    """No more runs are left."""


@dataclass
class Budget:
    """Runs that a minimisation may take, those that it took, and what they showed.

    Args:
        limit: Greatest number of runs.
    """

    limit: int
    runs: int = 0
    used_up: bool = False
    known: dict[Hashable, bool] = field(default_factory=dict)

    def spend(self) -> None:
        """Count a run.

        Raises:
            BudgetUsedUp: If none is left.
        """
        if self.runs >= self.limit:
            self.used_up = True
            raise BudgetUsedUp
        self.runs += 1

    def once(self, key: Hashable, violates: Callable[[], bool]) -> bool:
        """Whether the candidate of a key violates, which is found out once."""
        if key not in self.known:
            self.known[key] = violates()
        return self.known[key]


def minimise(start: Sequence[int], violates: Callable[[Levels], bool]) -> Levels:
    """Lower the levels of parts as long as the candidate violates.

    Earlier parts are lowered before later ones. Of the result no single part can have the level 0,
    or the next lower one.

    Args:
        start: A candidate that violates.
        violates: Whether a candidate violates. Each that does is taken, so that the last of them
            is the result also where an exception ends the minimisation.
    """
    descent = _Descent(tuple(start), violates)
    parts = range(len(start))
    descent.clear(parts)
    for part in parts:
        descent.halve(part)
    # What was needed before may not be needed any more.
    while sum(descent.lower(part) for part in parts):
        pass
    return descent.levels


@dataclass
class _Descent:
    """The simplest candidate so far, and the ways to a simpler one."""

    levels: Levels
    violates: Callable[[Levels], bool]

    def clear(self, parts: Sequence[int]) -> None:
        """Set parts to 0: all at once, else one half of them after the other."""
        parts = [part for part in parts if self.levels[part]]
        if parts and not self._accept(dict.fromkeys(parts, 0)) and len(parts) > 1:
            half = (len(parts) + 1) // 2
            self.clear(parts[:half])
            self.clear(parts[half:])

    def halve(self, part: int) -> None:
        """Find the lowest level of a part that cannot be 0, by halving."""
        low = 0
        while self.levels[part] - low > 1:
            middle = (low + self.levels[part]) // 2
            if not self._accept({part: middle}):
                low = middle

    def lower(self, part: int) -> bool:
        """Lower a part that can be lower; whether it can."""
        level = self.levels[part]
        if not level or not (self._accept({part: 0}) or self._accept({part: level - 1})):
            return False
        self.halve(part)
        return True

    def _accept(self, changes: dict[int, int]) -> bool:
        """Try the candidate with some levels changed, and keep it if it violates."""
        levels = tuple(changes.get(part, level) for part, level in enumerate(self.levels))
        violates = self.violates(levels)
        if violates:
            self.levels = levels
        return violates


Violates = Callable[[SearchedCase], bool]


@dataclass(frozen=True)
class Shrunk:
    """The result of shrinking.

    Args:
        case: The simplest violating case that was seen.
        changes: Its parameters that differ from the nominal case.
        shrinking: How many parameters differed before and after, and what that took.
    """

    case: SearchedCase
    changes: tuple[ParameterChange, ...]
    shrinking: Shrinking


def shrink(
    case: Case,
    counterexample: SearchedCase,
    violates: Violates,
    *,
    budget: int,
    simulator: RoleSpec | None = None,
) -> Shrunk:
    """Make a counterexample as simple as a budget of simulations allows.

    Preferred are, in this order: fewer faults, fewer entries of lists (such as vehicles),
    fewer optional parts, later and shorter activation, smaller magnitudes, rounder numbers. What
    the seed draws is written out first where the domain can do that, so that single drawn vehicles
    can be left out.

    Args:
        case: The nominal case, whose values are the simplest.
        counterexample: A case that violates.
        violates: Simulates a case; equal cases must have equal answers. A ``ConfigurationError``
            means that the case contradicts itself: it does not violate, and costs nothing.
        budget: Calls of ``violates``.
        simulator: In place of the scenario's.

    Raises:
        ConfigurationError: If the counterexample does not belong to ``case``.
    """
    nominal = Nominal.of(case, simulator)
    spent = Budget(budget)
    spent.known[_key(counterexample)] = True
    current = counterexample

    def simulate(trial: SearchedCase) -> bool:
        spent.spend()
        try:
            return violates(trial)
        except ConfigurationError:
            spent.runs -= 1
            return False

    def accept(trial: SearchedCase) -> bool:
        nonlocal current
        if accepted := spent.once(_key(trial), lambda: simulate(trial)):
            current = trial
        return accepted

    with suppress(BudgetUsedUp):
        accept(_concrete(nominal, counterexample))
    before = count_parameters(changes_of(case, current, simulator=simulator))
    # From what is simpler other values come into reach: again, until nothing new comes of it.
    seen: set[bytes] = set()
    with suppress(BudgetUsedUp):
        while _key(current) not in seen:
            seen.add(_key(current))
            _minimise_case(Simplification(nominal, current), accept)
    changes = changes_of(case, current, simulator=simulator)
    after = count_parameters(changes)
    shrinking = Shrinking(before, after, spent.runs, budget, not spent.used_up)
    return Shrunk(current, changes, shrinking)


def _key(searched: SearchedCase) -> bytes:
    return canonical(searched.data)


def _concrete(nominal: Nominal, case: SearchedCase) -> SearchedCase:
    """Write out what the seed draws in the case's world."""
    world, seed = nominal.checked(case.scenario.world), case.scenario.seed or 0
    concrete = nominal.checked(nominal.concrete(world, seed))
    if concrete == world:
        return case
    faults = [fault.plain() for fault in case.faults]
    return make_searched_case(nominal.case, concrete, faults, seed)


def _minimise_case(start: Simplification, accept: Violates) -> None:
    """Minimise the parts of a case; each simpler case that violates is accepted."""

    def violates(levels: Levels) -> bool:
        try:
            trial = start.case_at(levels)
        except ConfigurationError:
            return False
        return accept(trial)

    minimise([len(knob.values) - 1 for knob in start.knobs], violates)


Run = Callable[[EpisodeSpec], Episode]
FaultSet = tuple[str, ...]

REDUCTION_BUDGET = 100
_REPEATS = 5
"""Runs of one set of faults where the component is not deterministic; most of them decide."""


@dataclass(frozen=True)
class Reduction:
    """Result of a reduction.

    Args:
        faults: Ids of the smallest set that was found, in declared order; empty if the requirement
            is violated without any fault.
        reproduced: Whether the whole set violated it again at all; ``None`` if the budget ended
            before that was known.
        smallest: Whether every smaller set was tried, and none violates it.
        one_minimal: Whether every set with one fault less was tried, and none violates it.
        runs: Episodes that were run.
        episode: A violating run of that set; ``None`` if it was not reproduced.
        violated: The requirements that it violates.
        missing: Runs that failed; with any, no set is known to be the smallest.
    """

    faults: FaultSet
    reproduced: bool | None
    smallest: bool
    one_minimal: bool
    runs: int
    episode: Episode | None
    violated: tuple[str, ...]
    missing: int = 0


def reduce_faults(
    spec: EpisodeSpec,
    requirements: Sequence[Requirement],
    run: Run,
    *,
    budget: int = REDUCTION_BUDGET,
    on_run: Callable[[FaultSet, Sequence[str]], None] = lambda *_: None,
) -> Reduction:
    """Find the smallest set of an episode's faults that still violates one of the requirements.

    Delta debugging comes to a set of which no single fault can be left out. Whatever smaller sets
    are left are then tried as far as the budget goes, since such a set need not be the smallest.

    Args:
        spec: What the episode was run from.
        requirements: Those that it violated.
        run: Runs an episode.
        budget: Episodes that may be run.
        on_run: Called with each run's faults, and the requirements that it violated.
    """
    trials = _FaultSets(spec, requirements, run, Budget(budget), on_run)
    whole = trials.connected([fault.id for fault in spec.faults])
    reproduced: bool | None = None
    with suppress(BudgetUsedUp):
        reproduced = trials.violates(whole)
        if reproduced:
            minimise(
                [1] * len(whole),
                lambda levels: trials.violates(list(itertools.compress(whole, levels))),
            )
            for size in range(1, len(trials.smallest)):
                sets = itertools.combinations(whole, size)
                if any(trials.connected(each) == each and trials.violates(each) for each in sets):
                    break
    if not reproduced:
        return Reduction(
            whole, reproduced, False, False, trials.spent.runs, None, (), trials.missing
        )
    best, known = trials.smallest, trials.spent.known
    one_less = itertools.combinations(best, len(best) - 1) if best else ()
    episode, violated = trials.violating[best]
    return Reduction(
        best,
        True,
        not (trials.spent.used_up or trials.missing),
        not trials.missing and all(trials.connected(each) in known for each in one_less),
        trials.spent.runs,
        episode,
        violated,
        trials.missing,
    )


@dataclass
class _FaultSets:
    """Runs sets of an episode's faults, each until it is known whether it violates."""

    spec: EpisodeSpec
    requirements: Sequence[Requirement]
    run: Run
    spent: Budget
    on_run: Callable[[FaultSet, Sequence[str]], None]
    missing: int = 0
    violating: dict[FaultSet, tuple[Episode, tuple[str, ...]]] = field(default_factory=dict)

    @property
    def smallest(self) -> FaultSet:
        """The smallest set that is known to violate, of equal ones the first that was tried."""
        # A set whose runs the budget cut short may have violated once by chance.
        return min((faults for faults in self.violating if self.spent.known.get(faults)), key=len)

    def violates(self, faults: Sequence[str]) -> bool:
        """Whether most runs of this set violate; two equal runs stand for all.

        Raises:
            BudgetUsedUp: If no run is left for it.
        """
        connected = self.connected(faults)
        return self.spent.once(connected, lambda: self._confirmed(connected))

    def connected(self, faults: Sequence[str]) -> FaultSet:
        """The set without faults that wait for one that is not in it: they never become active."""
        planned = self.spec.faults
        awaited = {
            fault.id: (fault.activation.get("after") or {}).get("fault") for fault in planned
        }
        connected = [fault.id for fault in planned if fault.id in faults]
        while orphans := [
            fault for fault in connected if awaited[fault] and awaited[fault] not in connected
        ]:
            connected = [fault for fault in connected if fault not in orphans]
        return tuple(connected)

    def _confirmed(self, faults: FaultSet) -> bool:
        spec = with_faults(self.spec, faults)
        digests: set[str] = set()
        hits = 0
        for number in range(1, _REPEATS + 1):
            self.spent.spend()
            episode = self.run(spec)
            violated = tuple(
                requirement.id
                for requirement in self.requirements
                if judge_episode(requirement, episode).verdict == "violated"
            )
            self.on_run(faults, violated)
            self.missing += episode.failure is not None and not violated
            if violated:
                hits += 1
                self.violating.setdefault(faults, (episode, violated))
            same = episode.digest in digests
            digests.add(episode.digest)
            if same or 2 * hits > _REPEATS or 2 * (number - hits) > _REPEATS:
                break
        return 2 * hits > number


def with_faults(spec: EpisodeSpec, faults: FaultSet) -> EpisodeSpec:
    """The spec with these of its faults only: all else, their draws included, stays as it was."""
    remaining = tuple(fault for fault in spec.faults if fault.id in faults)
    if remaining == spec.faults:
        return replace(spec, timeouts=None)
    scenario = spec.case.partition("+")[0].partition("~")[0]
    case = "+".join([scenario, *(faults or ("none",))])
    return replace(spec, case=case, faults=remaining, timeouts=None)
