"""Portfolio: searchers that share one budget, and the loop that evaluates their points."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.seeding import stream
from pytest_dura.requirements.searches import SearcherReport, SearchParameter
from pytest_dura.search.searchers import (
    BangBang,
    CmaEs,
    CmaEsOfPulses,
    Constants,
    Points,
    Pushes,
    QuasiRandom,
    Searcher,
    Uniform,
    Values,
)
from pytest_dura.search.space import FaultSlot, Interval, Layout, OneOf, Parameter
from pytest_dura.search.surrogate import Surrogate

OPENING = 24
"""Simulations that constant and bang-bang inputs and pushes have to themselves: most published
benchmarks fall to them within so many, and their margins tell the others where to begin."""

SHARES: dict[type[Searcher], int] = {
    Constants: 8,
    BangBang: 16,
    Pushes: 22,
    QuasiRandom: 4,
    CmaEsOfPulses: 30,
    CmaEs: 20,
}
"""Percent of the simulations after the opening, favoured turns apart. Half goes to searchers that
learn; of that, most to the one with the fewest dimensions. Those that learn nothing have the rest,
for objectives that are flat or mislead. The ratios of the others were chosen on
`benchmarks/falsification/development.py`; pushes joined later, for requirements that no other
searcher violated."""

SURROGATE_SHARE = 40
"""Share of a surrogate beside those of the others. It was chosen on the same systems, from 40 and
100."""

PATIENCE = 24
"""Simulations without an improvement after which a searcher is not favoured any more; about two
generations of CMA-ES. It was chosen on the same systems."""


@dataclass(frozen=True)
class Batch:
    """Points that may be evaluated at once, in this order.

    Args:
        searcher: Name of the searcher that proposes them.
        points: Shape ``(k, layout.size)``.
        objective: Number of the objective that they are to make small.
        world: Number of the seed that the first is run with; equal numbers are equal seeds.
        spread: Whether the others have seeds of their own, numbered from there on; otherwise all
            have the same seed.
    """

    searcher: str
    points: Points
    objective: int = 0
    world: int = 0
    spread: bool = False

    @property
    def worlds(self) -> tuple[int, ...]:
        """The number of each point's seed."""
        return tuple(self.world + i * self.spread for i in range(len(self.points)))


class Portfolio:
    """Searchers that propose batches in turn; the same ones for the same seed and answers.

    After the opening, every second turn goes to the searcher that improved last. Restarts of CMA-ES
    take the objectives that are still open in turn. Those that begin at a good point take the best
    point of a trivial searcher, each once, and keep its seed.

    Args:
        layout: What the coordinates of a point mean.
        seed: From which all draws follow.
        budget: Points that may be evaluated, all together.
        objectives: How many objectives there are.
        surrogate: Whether a surrogate takes part, first after the opening.
    """

    RULE = (
        f"Constant and bang-bang inputs and pushes take turns for the first {OPENING} simulations."
        " After that, every second turn goes to the searcher that improved the least robustness of"
        f" an open requirement last, until {PATIENCE} simulations of it have improved none. Of the"
        " others, each searcher gets its share, the one furthest behind coming next: "
        + ", ".join(f"{kind.name} {share} %" for kind, share in SHARES.items())
        + "."
    )

    def __init__(
        self,
        layout: Layout,
        seed: int,
        budget: int,
        objectives: int = 1,
        *,
        surrogate: bool = False,
    ) -> None:
        self.budget, self.objectives = budget, objectives
        more: dict[type[Searcher], int] = {Surrogate: SURROGATE_SHARE} if surrogate else {}
        self._members = [
            _Member(kind(layout, stream(seed, f"search:{kind.name}")), share)
            for kind, share in (more | SHARES).items()
            if kind.suits(layout)
        ]
        searchers = [member.searcher for member in self._members]
        self._surrogates = [each for each in searchers if isinstance(each, Surrogate)]
        self._starts: list[list[_StartPoint]] = [[] for _ in range(objectives)]
        """Per objective, a heap of points that restarts may begin at."""
        self._open = frozenset(range(objectives))
        self._active = self._members[0]
        self._evaluated = self._worlds = self._pushed = 0
        self._least = np.full(objectives, np.inf)
        """Per objective, the least value by now."""
        self._favoured: _Member | None = None
        self._is_favour = False
        """Whether the turn is one of the favoured member's own."""

    @property
    def rule(self) -> str:
        """The rule by which the searchers take turns, in words."""
        if not self._surrogates:
            return self.RULE
        return (
            f"{self.RULE} Beside them a {Surrogate.name}, a Gaussian process of all values so far,"
            f" comes first after the opening and has a share of {SURROGATE_SHARE} to their 100."
        )

    def ask(self) -> Batch:
        """Return the next points."""
        opening = self._evaluated < OPENING
        self._is_favour = not opening and self._favoured is not None and not self._is_favour
        able = [member for member in self._members if member.opens or not opening]
        if self._is_favour and self._favoured is not None:
            self._active = self._favoured
        else:
            self._active = min(
                able,
                key=lambda member: member.opened if opening else member.later / member.share,
            )
        searcher = self._active.searcher
        if isinstance(searcher, CmaEs):
            if not (searcher.running and self._active.aim[0] in self._open):
                self._active.aim = self._begin(self._active, searcher)
            return Batch(searcher.name, searcher.ask(), *self._active.aim)
        objective = 0
        if isinstance(searcher, Surrogate):
            turn = sorted(self._open)
            objective = searcher.objective = turn[self._active.restarts % len(turn)]
            self._active.restarts += 1
        points = searcher.ask()
        world = self._new_worlds(len(points))
        return Batch(searcher.name, points, objective, world, spread=True)

    def tell(self, batch: Batch, values: Values, open_objectives: frozenset[int]) -> None:
        """Learn from the values of a batch.

        Args:
            batch: The batch that :meth:`ask` returned last.
            values: The values of the points that were evaluated, which may be fewer than proposed;
                shape ``(k, objectives)``, to be made small, NaN where nothing is known.
            open_objectives: Those that no point has violated yet.
        """
        improved = self._improves(values)
        for surrogate in self._surrogates:
            surrogate.observe(batch.points[: len(values)], values)
        if self._evaluated < OPENING:
            self._active.opened += len(values)
        else:
            self._active.later += 0 if self._is_favour else len(values)
            self._favour(len(values), improved=improved)
        self._evaluated += len(values)
        self._open = open_objectives
        if self._active.searcher.trivial:
            for row, point, world in zip(values, batch.points, batch.worlds, strict=False):
                for starts, value in zip(self._starts, row, strict=True):
                    if not np.isnan(value):
                        heapq.heappush(
                            starts, _StartPoint(float(value), self._pushed, point, world)
                        )
                        self._pushed += 1
        self._active.searcher.tell(batch.points[: len(values)], values[:, batch.objective])

    def _improves(self, values: Values) -> bool:
        """Take in the values of a batch; whether one is the least of an open objective by now."""
        if not len(values):
            return False
        known = np.where(np.isnan(values), np.inf, values).min(axis=0)
        improved = [i for i in self._open if known[i] < self._least[i]]
        self._least = np.minimum(self._least, known)
        return bool(improved)

    def _favour(self, simulations: int, *, improved: bool) -> None:
        """Favour the active member if it improved, and no one who has not for long."""
        if improved:
            self._favoured, self._active.idle = self._active, 0
        elif self._active is self._favoured:
            self._active.idle += simulations
            if self._active.idle >= PATIENCE:
                self._favoured = None

    def _begin(self, member: _Member, searcher: CmaEs) -> tuple[int, int]:
        """Begin a restart, and return its objective and world."""
        turn = sorted(self._open)
        # Every objective sees all plans before the next has its turn.
        objective = turn[member.restarts // len(searcher.plans) % len(turn)]
        member.restarts += 1
        if searcher.near and self._starts[objective]:
            best = heapq.heappop(self._starts[objective])
            searcher.begin(best.point)
            return objective, best.world
        searcher.begin()
        return objective, self._new_worlds(1)

    def _new_worlds(self, count: int) -> int:
        self._worlds += count
        return self._worlds - count


@dataclass
class _Member:
    searcher: Searcher
    share: int
    opened: int = 0
    later: int = 0
    restarts: int = 0
    idle: int = 0
    """Simulations since it improved anything, while it is favoured."""
    aim: tuple[int, int] = (0, 0)
    """Objective and world of the restart that runs."""

    @property
    def opens(self) -> bool:
        return isinstance(self.searcher, (Constants, BangBang, Pushes))


@dataclass(frozen=True, slots=True, order=True)
class _StartPoint:
    """A point of a trivial searcher; the least value comes first."""

    value: float
    number: int
    point: Points = field(compare=False)
    world: int = field(compare=False)


def trivial_searchers(layout: Layout, seed: int) -> tuple[tuple[str, Searcher], ...]:
    """Make the baselines: names, and searchers that learn nothing from values."""
    kinds = (Uniform, Constants, BangBang)
    return tuple((kind.name, kind(layout, stream(seed, f"baseline:{kind.name}"))) for kind in kinds)


def trivial_names() -> frozenset[str]:
    """Return the names of the portfolio's own searchers that learn nothing."""
    return frozenset(kind.name for kind in SHARES if kind.trivial)


@dataclass(frozen=True, slots=True)
class Outcome:
    """The result of a point, objective by objective.

    Args:
        margins: Robustness; NaN where nothing is known.
        violated: Whether the requirement is violated; this does not follow from the margin.
        known: Whether anything is known; by default where there is a margin or a violation.
        not_manifested: Whether a fault was never manifested, and the run was valid otherwise.
        manifested: Whether a fault was manifested.
        simulated: Whether it was simulated; a point whose values contradict each other was not.
        events: What each violated requirement came to, in words; empty texts for the others.
    """

    margins: tuple[float, ...]
    violated: tuple[bool, ...]
    known: tuple[bool, ...] | None = None
    not_manifested: bool = False
    manifested: bool = False
    simulated: bool = True
    events: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Trial:
    """A point that was evaluated.

    Args:
        number: Its place among the simulated points, from 1.
        searcher: Name of the searcher that proposed it.
        point: Coordinates in [0, 1].
        world: Number of its seed.
        margin: Robustness of the objective at hand.
    """

    number: int
    searcher: str
    point: NDArray[np.float64]
    world: int
    margin: float


@dataclass
class SearcherCount:
    """Counts of one searcher.

    Args:
        simulations: Its own points that were simulated.
        best: Its least margin of each objective; infinite for none.
        first: Of each objective, its own simulations up to its first violation; ``None`` for none.
    """

    simulations: int
    best: list[float]
    first: list[int | None]


@dataclass
class SearchLog:
    """Counts of a search, its first violations and least margins.

    Args:
        budget: Greatest number of simulations.
        objectives: How many objectives it has.
        at_least: Violations of each objective after which it is not open any more.
    """

    budget: int
    objectives: int
    at_least: float = 1
    simulations: int = 0
    refused: int = 0
    """Points whose values contradict each other; none of them was simulated."""
    unknown: int = 0
    """Simulations that leave some objective undecided."""
    not_manifested: int = 0
    """Simulations in which a fault was never manifested."""
    manifested: int = 0
    """Simulations in which a fault was manifested."""
    first: list[Trial | None] = field(init=False)
    """The first violation of each objective."""
    best: list[Trial | None] = field(init=False)
    """The least margin of each objective."""
    violations: list[int] = field(init=False)
    """How many simulations violate each objective."""
    searchers: dict[str, SearcherCount] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Begin without violations and margins."""
        self.first = [None] * self.objectives
        self.best = [None] * self.objectives
        self.violations = [0] * self.objectives

    @property
    def inconclusive(self) -> int:
        """Simulations that count as undecided.

        Those without a manifested fault count only if no simulation at all manifested one: then
        nothing is known of the faults, however much was simulated.
        """
        # A simulation may be both: without a manifested fault, and unknown for another requirement.
        return min(self.unknown + (0 if self.manifested else self.not_manifested), self.simulations)

    @property
    def open(self) -> frozenset[int]:
        """Numbers of the objectives that too few points have violated."""
        return frozenset(i for i, count in enumerate(self.violations) if count < self.at_least)

    def add(self, batch: Batch, index: int, outcome: Outcome) -> None:
        """Count the outcome of one point of a batch."""
        if not outcome.simulated:
            self.refused += 1
            return
        self.simulations += 1
        self.not_manifested += outcome.not_manifested
        self.manifested += outcome.manifested
        count = self.searchers.setdefault(
            batch.searcher,
            SearcherCount(0, [math.inf] * self.objectives, [None] * self.objectives),
        )
        count.simulations += 1
        for i, (margin, violated) in enumerate(zip(outcome.margins, outcome.violated, strict=True)):
            trial = Trial(
                self.simulations, batch.searcher, batch.points[index], batch.worlds[index], margin
            )
            best = self.best[i]
            if not math.isnan(margin) and (best is None or margin < best.margin):
                self.best[i] = trial
            if not math.isnan(margin):
                count.best[i] = min(count.best[i], margin)
            if violated:
                self.violations[i] += 1
                count.first[i] = count.first[i] or count.simulations
                self.first[i] = self.first[i] or trial
        known = outcome.known or tuple(
            violated or not math.isnan(margin)
            for margin, violated in zip(outcome.margins, outcome.violated, strict=True)
        )
        self.unknown += not all(known)


class Proposer(Protocol):
    """Proposes points to :func:`search`, as a :class:`Portfolio` does."""

    def ask(self) -> Batch:
        """Return the next points."""

    def tell(
        self, batch: Batch, values: NDArray[np.float64], open_objectives: frozenset[int]
    ) -> None:
        """Learn from their values."""


_REFUSALS = 20
"""Points that may be refused for each simulation of the budget; a thousand more in any case."""


def search(
    proposer: Proposer,
    evaluate: Callable[[Batch], Iterable[Outcome]],
    budget: int,
    objectives: int = 1,
    at_least: float = 1,
) -> SearchLog:
    """Search until every objective is violated often enough, or the budget is used up.

    Args:
        proposer: Proposes the points.
        evaluate: Yields the outcomes of a batch, in its order. The rest is not consumed once every
            objective is violated or the budget is used up, so it should evaluate lazily.
        budget: Greatest number of simulations.
        objectives: How many objectives there are.
        at_least: Violations of each objective that are enough; infinite for the whole budget.
    """
    log = SearchLog(budget, objectives, at_least)
    while log.open and log.simulations < budget and log.refused < _REFUSALS * budget + 1000:
        batch = proposer.ask()
        margins = []
        for index, outcome in enumerate(evaluate(batch)):
            log.add(batch, index, outcome)
            margins.append(outcome.margins)
            if not log.open or log.simulations >= budget:
                break
        proposer.tell(batch, np.array(margins, float).reshape(-1, objectives), log.open)
    return log


def searcher_report(
    name: str, count: SearcherCount, requirements: Sequence[str], *, trivial: bool
) -> SearcherReport:
    """Report a searcher's counts by the ids of the requirements."""
    best = zip(requirements, map(finite_or_none, count.best), strict=True)
    first = zip(requirements, count.first, strict=True)
    return SearcherReport(name, trivial, count.simulations, dict(best), dict(first))


def parameter_report(parameter: Parameter) -> SearchParameter:
    """Report what a search may choose for a parameter."""
    path = parameter.path
    if isinstance(parameter, Interval):
        return SearchParameter(
            path, parameter.low, parameter.high, parameter.pieces, unit=parameter.unit
        )
    if isinstance(parameter, OneOf):
        return SearchParameter(path, choice=list(parameter.values), unit=parameter.unit)
    assert isinstance(parameter, FaultSlot)
    faults = {
        choice.fault.id: tuple(map(parameter_report, choice.inner)) for choice in parameter.choices
    }
    return SearchParameter(path, faults=faults)


def finite_or_none(value: float) -> float | None:
    """Return a number that JSON can hold; ``None`` for NaN and infinities."""
    return float(value) if math.isfinite(value) else None
