"""Portfolio: searchers that share one budget, and the loop that evaluates their points."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pytest_dura.campaign.falsification import SearcherReport
from pytest_dura.core.seeding import stream
from pytest_dura.search.searchers import (
    BangBang,
    CmaEs,
    CmaEsOfPulses,
    Constants,
    Points,
    QuasiRandom,
    Searcher,
    Uniform,
    Values,
)
from pytest_dura.search.space import FaultSlot, Interval, Layout, OneOf, Parameter

OPENING = 24
"""Simulations that constant and bang-bang inputs have to themselves: most published benchmarks
fall to them within so many, and what they saw tells the others where to begin."""

SHARES: dict[type[Searcher], int] = {
    Constants: 10,
    BangBang: 20,
    QuasiRandom: 5,
    CmaEsOfPulses: 40,
    CmaEs: 25,
}
"""Percent of the simulations after the opening. Most goes to what learns; of that, most to what has
the fewest dimensions. What learns nothing keeps a third, for objectives that are flat or mislead.
Chosen on `benchmarks/falsification/development.py`."""


@dataclass(frozen=True)
class Batch:
    """Points that may be evaluated at once, in this order.

    Args:
        searcher: Name of who proposes them.
        points: Shape ``(k, layout.size)``.
        objective: Number of the objective that they are to make small.
        world: Number of the seed that the first is run with; equal numbers are equal seeds.
        spread: Whether the others have seeds of their own, numbered on from there; otherwise all
            have the same one.
    """

    searcher: str
    points: Points
    objective: int = 0
    world: int = 0
    spread: bool = False

    @property
    def worlds(self) -> tuple[int, ...]:
        """Of each point, the number of its seed."""
        return tuple(self.world + i * self.spread for i in range(len(self.points)))


class Portfolio:
    """Proposes batches until nobody asks any more; the same ones for the same seed and answers.

    Restarts of CMA-ES take the objectives that are still open in turn. Those that begin at a good
    point take the best one that a trivial searcher saw, each once, and keep its seed.

    Args:
        layout: What the coordinates of a point mean.
        seed: From which all draws follow.
        budget: Points that may be evaluated, all together.
        objectives: How many objectives there are.
    """

    RULE = (
        f"Constant and bang-bang inputs take turns for the first {OPENING} simulations. Of the "
        "others, each searcher gets its share, whoever is furthest behind coming next: "
        + ", ".join(f"{kind.name} {share} %" for kind, share in SHARES.items())
        + "."
    )

    def __init__(self, layout: Layout, seed: int, budget: int, objectives: int = 1) -> None:
        self.budget, self.objectives = budget, objectives
        self._members = [
            _Member(kind(layout, stream(seed, f"search:{kind.name}")), share)
            for kind, share in SHARES.items()
            if kind.suits(layout)
        ]
        self._seen: list[list[_Seen]] = [[] for _ in range(objectives)]
        self._open = frozenset(range(objectives))
        self._asked = self._members[0]
        self._done = self._worlds = self._pushed = 0

    def ask(self) -> Batch:
        """The next points."""
        opening = self._done < OPENING
        able = [member for member in self._members if member.opens or not opening]
        self._asked = min(
            able, key=lambda item: item.opened if opening else item.later / item.share
        )
        searcher = self._asked.searcher
        if isinstance(searcher, CmaEs):
            if not (searcher.running and self._asked.aim[0] in self._open):
                self._asked.aim = self._begin(self._asked, searcher)
            return Batch(searcher.name, searcher.ask(), *self._asked.aim)
        points = searcher.ask()
        return Batch(searcher.name, points, world=self._new_worlds(len(points)), spread=True)

    def tell(self, batch: Batch, values: Values, open_objectives: frozenset[int]) -> None:
        """What a batch came to.

        Args:
            batch: The batch that was asked last.
            values: Of the points that were evaluated, which may be fewer than proposed; shape
                ``(k, objectives)``, to be made small, NaN where nothing is known.
            open_objectives: Those that nothing has violated yet.
        """
        if self._done < OPENING:
            self._asked.opened += len(values)
        else:
            self._asked.later += len(values)
        self._done += len(values)
        self._open = open_objectives
        if self._asked.searcher.trivial:
            for row, point, world in zip(values, batch.points, batch.worlds, strict=False):
                for seen, value in zip(self._seen, row, strict=True):
                    if not np.isnan(value):
                        heapq.heappush(seen, _Seen(float(value), self._pushed, point, world))
                        self._pushed += 1
        self._asked.searcher.tell(batch.points[: len(values)], values[:, batch.objective])

    @property
    def trivial(self) -> frozenset[str]:
        """Names of the searchers that learn nothing from what they have seen."""
        return frozenset(
            member.searcher.name for member in self._members if member.searcher.trivial
        )

    def _begin(self, member: _Member, searcher: CmaEs) -> tuple[int, int]:
        """The objective and the world of the restart that begins."""
        turn = sorted(self._open)
        # Every objective sees all plans before the next has its turn.
        objective = turn[member.restarts // len(searcher.plans) % len(turn)]
        member.restarts += 1
        if searcher.near and self._seen[objective]:
            best = heapq.heappop(self._seen[objective])
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
    aim: tuple[int, int] = (0, 0)
    """Objective and world of the restart that runs."""

    @property
    def opens(self) -> bool:
        return isinstance(self.searcher, (Constants, BangBang))


@dataclass(frozen=True, slots=True, order=True)
class _Seen:
    """A point of a searcher that does not follow it up; the least value comes first."""

    value: float
    number: int
    point: Points = field(compare=False)
    world: int = field(compare=False)


def trivial_searchers(layout: Layout, seed: int) -> tuple[tuple[str, Searcher], ...]:
    """Baselines: names, and searchers that learn nothing from what they have seen."""
    kinds = (Uniform, Constants, BangBang)
    return tuple((kind.name, kind(layout, stream(seed, f"baseline:{kind.name}"))) for kind in kinds)


def trivial_names() -> frozenset[str]:
    """The names of the portfolio's own searchers that learn nothing."""
    return frozenset(kind.name for kind in SHARES if kind.trivial)


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a point came to, objective by objective.

    Args:
        margins: Robustness; NaN where nothing is known.
        violated: Whether the requirement is violated, which is Boolean and no matter of the margin.
        known: Whether anything is known; by default where there is a margin or a violation.
        idle: Whether a fault never came to act, and nothing else was amiss.
        acted: Whether a fault came to act.
        simulated: Whether it took a simulation; a point whose values contradict each other did not.
    """

    margins: tuple[float, ...]
    violated: tuple[bool, ...]
    known: tuple[bool, ...] | None = None
    idle: bool = False
    acted: bool = False
    simulated: bool = True


@dataclass(frozen=True, slots=True)
class Trial:
    """A point that was evaluated.

    Args:
        number: Its place among those that were simulated, from 1.
        searcher: Who proposed it.
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
    """What one searcher did.

    Args:
        simulations: Points of its own that were simulated.
        best: Its least margin of each objective; infinite for none.
        first: Of each objective, its own simulations up to its first violation; ``None`` for none.
    """

    simulations: int
    best: list[float]
    first: list[int | None]


@dataclass
class SearchLog:
    """All that a search saw, as counts.

    Args:
        budget: Simulations that it was allowed.
        objectives: How many objectives it had.
    """

    budget: int
    objectives: int
    simulations: int = 0
    refused: int = 0
    """Points whose values contradict each other; none of them was simulated."""
    unknown: int = 0
    """Simulations that said nothing of some objective."""
    idle: int = 0
    """Simulations in which a fault that was added never came to act."""
    acted: int = 0
    """Simulations in which a fault came to act."""
    first: list[Trial | None] = field(init=False)
    """The first violation of each objective."""
    best: list[Trial | None] = field(init=False)
    """The least margin of each objective."""
    searchers: dict[str, SearcherCount] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Nothing was seen yet."""
        self.first = [None] * self.objectives
        self.best = [None] * self.objectives

    @property
    def silent(self) -> int:
        """Simulations that count as having said nothing.

        Where faults were planned and not one of all of them ever came to act, nothing was said of
        what was asked, however much was simulated.
        """
        # One simulation may be both: idle for one requirement, without an answer for another.
        return min(self.unknown + (0 if self.acted else self.idle), self.simulations)

    @property
    def open(self) -> frozenset[int]:
        """The objectives that nothing has violated."""
        return frozenset(i for i, trial in enumerate(self.first) if trial is None)

    def add(self, batch: Batch, index: int, outcome: Outcome) -> None:
        """Count what one point of a batch came to."""
        if not outcome.simulated:
            self.refused += 1
            return
        self.simulations += 1
        self.idle += outcome.idle
        self.acted += outcome.acted
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
                count.first[i] = count.first[i] or count.simulations
                self.first[i] = self.first[i] or trial
        known = outcome.known or tuple(
            violated or not math.isnan(margin)
            for margin, violated in zip(outcome.margins, outcome.violated, strict=True)
        )
        self.unknown += not all(known)


class Proposer(Protocol):
    """What a portfolio has that the loop needs."""

    def ask(self) -> Batch:
        """The next points."""

    def tell(
        self, batch: Batch, values: NDArray[np.float64], open_objectives: frozenset[int]
    ) -> None:
        """What they came to."""


_REFUSALS = 20
"""Points that may be refused for each simulation of the budget; a thousand more in any case."""


def search(
    proposer: Proposer,
    evaluate: Callable[[Batch], Iterable[Outcome]],
    budget: int,
    objectives: int = 1,
) -> SearchLog:
    """Search until every objective is violated, or the budget is used up.

    Args:
        proposer: Proposes the points.
        evaluate: The outcomes of a batch, in its order; it is left off in the middle where nothing
            more is wanted, and so should work only as far as it is asked.
        budget: Simulations.
        objectives: How many objectives there are.
    """
    log = SearchLog(budget, objectives)
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
    """What a searcher did, by the ids of the requirements."""
    return SearcherReport(
        name,
        trivial,
        count.simulations,
        {
            requirement: finite_or_none(best)
            for requirement, best in zip(requirements, count.best, strict=True)
        },
        dict(zip(requirements, count.first, strict=True)),
    )


def parameter_report(parameter: Parameter) -> dict[str, Any]:
    """What a search may do with a parameter."""
    told: dict[str, Any] = {"path": parameter.path}
    if isinstance(parameter, Interval):
        told |= {"low": parameter.low, "high": parameter.high}
        return told if parameter.pieces is None else told | {"pieces": parameter.pieces}
    if isinstance(parameter, OneOf):
        return told | {"choice": list(parameter.values)}
    assert isinstance(parameter, FaultSlot)
    faults = {
        choice.fault["id"]: [parameter_report(item) for item in choice.inner]
        for choice in parameter.choices
    }
    return told | {"faults": faults}


def finite_or_none(value: float) -> float | None:
    """A number that JSON has; ``None`` for any other."""
    return float(value) if math.isfinite(value) else None
