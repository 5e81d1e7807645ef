"""Reduction: the smallest set of an episode's faults that still violates a requirement.

Delta debugging (Zeller and Hildebrandt, "Simplifying and isolating failure-inducing input", IEEE
Transactions on Software Engineering 28, 2002): halves, quarters, ... of the set and their
complements are tried until no single fault can be left out. Whatever smaller sets are left are then
tried as far as the budget goes, since a set from which nothing can be left out need not be the
smallest one.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

from pytest_dura.core.episode import Episode, EpisodeSpec
from pytest_dura.requirements.episode_verdicts import judge_episode
from pytest_dura.requirements.model import Requirement

Run = Callable[[EpisodeSpec], Episode]
FaultSet = tuple[str, ...]

BUDGET = 100
_REPEATS = 5
"""Runs of one set of faults where the component is not deterministic; most of them decide."""


class BudgetUsedUp(Exception):  # noqa: N818 - an ending, not an error
    """No more runs are left."""


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
    budget: int = BUDGET,
    on_run: Callable[[FaultSet, Sequence[str]], None] = lambda *_: None,
) -> Reduction:
    """The smallest set of an episode's faults that still violates one of the requirements.

    Args:
        spec: What the episode was run from.
        requirements: Those that it violated.
        run: Runs an episode.
        budget: Episodes that may be run.
        on_run: Called with each run's faults, and the requirements that it violated.
    """
    trials = _Trials(spec, requirements, run, budget, on_run)
    whole = trials.connected(tuple(fault["id"] for fault in spec.faults))
    try:
        reproduced = trials.violates(whole)
    except BudgetUsedUp:
        return Reduction(whole, None, False, False, trials.runs, None, (), trials.missing)
    if not reproduced:
        return Reduction(whole, False, False, False, trials.runs, None, (), trials.missing)
    best, one_minimal, smallest = whole, False, False
    try:
        best = () if trials.violates(()) else [whole, *_shrinking(whole, trials)][-1]
        one_minimal = True
        best = _smallest(whole, best, trials)
        smallest = True
    except BudgetUsedUp:
        # A set whose runs the budget cut short may have violated once by chance.
        confirmed = (faults for faults, violates in trials.known.items() if violates)
        best = min(confirmed, key=len)
        one_less = itertools.combinations(best, len(best) - 1)
        one_minimal = one_minimal or all(faults in trials.known for faults in one_less)
    episode, violated = trials.violating[best]
    if trials.missing:
        one_minimal = smallest = False
    return Reduction(
        best, True, smallest, one_minimal, trials.runs, episode, violated, trials.missing
    )


class _Trials:
    """Runs sets of faults, each until it is known whether it violates."""

    def __init__(
        self,
        spec: EpisodeSpec,
        requirements: Sequence[Requirement],
        run: Run,
        budget: int,
        on_run: Callable[[FaultSet, Sequence[str]], None],
    ) -> None:
        self.runs = self.missing = 0
        self.known: dict[FaultSet, bool] = {}
        self.violating: dict[FaultSet, tuple[Episode, tuple[str, ...]]] = {}
        self._spec, self._requirements, self._run = spec, requirements, run
        self._budget, self._on_run = budget, on_run

    def violates(self, faults: FaultSet) -> bool:
        """Whether most runs of this set violate; two equal runs stand for all.

        Raises:
            BudgetUsedUp: If no run is left for it.
        """
        faults = self.connected(faults)
        if faults not in self.known:
            self.known[faults] = self._confirmed(faults)
        return self.known[faults]

    def connected(self, faults: FaultSet) -> FaultSet:
        """The set without faults that wait for one that is not in it: they never become active."""
        planned = self._spec.faults
        awaited = {
            fault["id"]: (fault["activation"].get("after") or {}).get("fault") for fault in planned
        }
        connected = [fault["id"] for fault in planned if fault["id"] in faults]
        while orphans := [
            fault for fault in connected if awaited[fault] and awaited[fault] not in connected
        ]:
            connected = [fault for fault in connected if fault not in orphans]
        return tuple(connected)

    def _confirmed(self, faults: FaultSet) -> bool:
        spec = with_faults(self._spec, faults)
        digests: set[str] = set()
        hits = 0
        for number in range(1, _REPEATS + 1):
            if self.runs >= self._budget:
                raise BudgetUsedUp
            self.runs += 1
            episode = self._run(spec)
            violated = tuple(
                requirement.id
                for requirement in self._requirements
                if judge_episode(requirement, episode).verdict == "violated"
            )
            self._on_run(faults, violated)
            self.missing += episode.failure is not None and not violated
            if violated:
                hits += 1
                self.violating.setdefault(faults, (episode, violated))
            same = episode.digest in digests
            digests.add(episode.digest)
            if same or 2 * hits > _REPEATS or 2 * (number - hits) > _REPEATS:
                break
        confirmed = 2 * hits > number
        if not confirmed:
            self.violating.pop(faults, None)
        return confirmed


def with_faults(spec: EpisodeSpec, faults: FaultSet) -> EpisodeSpec:
    """The spec with these of its faults only: all else, their draws included, stays as it was."""
    remaining = tuple(fault for fault in spec.faults if fault["id"] in faults)
    if remaining == spec.faults:
        return replace(spec, timeouts=None)
    scenario = spec.case.partition("+")[0].partition("~")[0]
    case = "+".join([scenario, *(faults or ("none",))])
    return replace(spec, case=case, faults=remaining, timeouts=None)


def _shrinking(whole: FaultSet, trials: _Trials) -> Iterator[FaultSet]:
    """Ever smaller sets that violate; the last one is 1-minimal."""
    current, parts = whole, 2
    while len(current) > 1:
        chunks = _chunks(current, min(parts, len(current)))
        complements = [tuple(fault for fault in current if fault not in chunk) for chunk in chunks]
        smaller = next((chunk for chunk in [*chunks, *complements] if trials.violates(chunk)), None)
        if smaller is not None:
            parts = 2 if smaller in chunks else max(parts - 1, 2)
            current = trials.connected(smaller)
            yield current
        elif parts >= len(current):
            return
        else:
            parts = min(2 * parts, len(current))


def _chunks(faults: FaultSet, parts: int) -> list[FaultSet]:
    size, rest = divmod(len(faults), parts)
    ends = list(itertools.accumulate(size + (i < rest) for i in range(parts)))
    return [faults[start:end] for start, end in zip([0, *ends], ends, strict=False)]


def _smallest(whole: FaultSet, best: FaultSet, trials: _Trials) -> FaultSet:
    """The first set in order of size that violates; ``best`` if none smaller does."""
    for size in range(1, len(best)):
        for faults in itertools.combinations(whole, size):
            if trials.connected(faults) == faults and trials.violates(faults):
                return faults
    return best
