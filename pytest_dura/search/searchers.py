"""Searchers: propose points of a search space, and learn from what they came to."""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from pytest_dura.search.space import Group, Layout

if TYPE_CHECKING:
    from cma import CMAEvolutionStrategy


Points = NDArray[np.float64]
Values = NDArray[np.float64]

_BATCH = 4
"""Points that a searcher which learns nothing proposes at once: enough to keep a few processes
busy, few enough that the searchers take turns from the first simulations on."""


class Searcher(ABC):
    """One member of a portfolio.

    ``name`` stands in reports. ``trivial`` says that it learns nothing from what it has seen, so
    that it is a baseline that any claim about the others is compared with.

    Args:
        layout: What the coordinates of a point mean.
        rng: Its own random numbers.
    """

    name: ClassVar[str]
    trivial: ClassVar[bool]

    def __init__(self, layout: Layout, rng: np.random.Generator) -> None:
        self.layout, self.rng = layout, rng

    @classmethod
    def suits(cls, layout: Layout) -> bool:  # noqa: ARG003 - most suit all
        """Whether it has anything to propose for such points."""
        return True

    @abstractmethod
    def ask(self) -> Points:
        """The next points, which may be evaluated at once; shape ``(k, layout.size)``, k >= 1."""

    def tell(self, points: Points, values: Values) -> None:  # noqa: B027 - a baseline learns nothing
        """What the points came to that were asked last, or the first of them.

        Args:
            points: The points.
            values: The objective at each, to be made small; NaN where nothing is known.
        """


class OptionCycle:
    """Gives every option its turn, in an order of its own for each group.

    Args:
        layout: What the coordinates of a point mean.
        rng: From which the orders are drawn.
    """

    def __init__(self, layout: Layout, rng: np.random.Generator) -> None:
        self._layout, self._rng = layout, rng
        self._left: dict[int, list[int]] = {}

    def points(self, count: int) -> Points:
        """Points of which only the options are set, to the middle of their parts."""
        made = np.full((count, self._layout.size), 0.5)
        for row in made:
            for group, where in self._layout.slices():
                if group.options:
                    row[where] = (self._next(where.start, group.options) + 0.5) / group.options
        return made

    def _next(self, start: int, options: int) -> int:
        left = self._left.setdefault(start, [])
        if not left:
            left += self._rng.permutation(options).tolist()
        return left.pop()


Floats = NDArray[np.float64]


class Shape(ABC):
    """How the pieces of one group follow from fewer coordinates in [0, 1]."""

    @abstractmethod
    def size(self, group: Group) -> int:
        """Coordinates that describe the group."""

    @abstractmethod
    def pieces(self, group: Group, described: Floats) -> Floats:
        """The group's own coordinates, shape ``(k, group.size)``, from ``(k, size(group))``."""


@dataclass(frozen=True)
class Steps(Shape):
    """Inputs of a few steps of equal length.

    Args:
        most: Steps; an input of fewer pieces has as many steps as pieces.
    """

    most: int

    def size(self, group: Group) -> int:
        """One for each step."""
        return min(self.most, group.size)

    def pieces(self, group: Group, described: Floats) -> Floats:
        """Each piece has the value of the step in which it begins."""
        return described[:, np.arange(group.size) * self.size(group) // group.size]


@dataclass(frozen=True)
class Pulses(Shape):
    """Inputs that beat between two levels: period, phase, duty, and the levels.

    Periods are spread evenly over their logarithms, from two pieces to twice the whole time; a
    single value stays one. The pulse generator is a usual input of falsification tools, such as
    Breach (Donze, CAV 2010).
    """

    def size(self, group: Group) -> int:
        """Five for an input over time."""
        return 1 if group.size == 1 else 5

    def pieces(self, group: Group, described: Floats) -> Floats:
        """Each piece has the level of its middle."""
        if group.size == 1:
            return described
        period, phase, duty, first, second = (column[:, None] for column in described.T)
        beat = np.mod((np.arange(group.size) + 0.5) / (2.0 * group.size**period) + phase, 1.0)
        where: Floats = np.where(beat < duty, first, second)
        return where


class Description:
    """All groups of a layout in one shape; groups of options are left out.

    Args:
        layout: What the coordinates of a point mean.
        shape: Of the inputs over time.
    """

    def __init__(self, layout: Layout, shape: Shape) -> None:
        self.layout, self.shape = layout, shape
        self._parts: list[tuple[Group, slice, slice]] = []
        self.size = 0
        for group, where in layout.slices():
            if not group.options:
                size = shape.size(group)
                self._parts.append((group, where, slice(self.size, self.size + size)))
                self.size += size

    def points(self, described: Floats, template: Floats) -> Floats:
        """Whole points, with the template's options.

        Args:
            described: Shape ``(k, size)``.
            template: A point, or one for each; shape ``(layout.size,)`` or ``(k, layout.size)``.
        """
        made = np.array(np.broadcast_to(template, (len(described), self.layout.size)))
        for group, where, part in self._parts:
            made[:, where] = self.shape.pieces(group, described[:, part])
        return made

    def described(self, point: Floats) -> Floats:
        """Coordinates of a point, in a shape that has one for each piece; shape ``(size,)``.

        Args:
            point: Shape ``(layout.size,)``.
        """
        empty = np.empty(self.size)
        for _, where, part in self._parts:
            empty[part] = point[where]
        return empty


class Uniform(Searcher):
    """Every point is as likely as any other."""

    name = "uniform"
    trivial = True

    def ask(self) -> Points:
        """One point."""
        return self.rng.random((1, self.layout.size))


class Sobol:
    """A scrambled Sobol sequence.

    Args:
        size: Coordinates.
        rng: From which its seed is drawn, and nothing more.
    """

    def __init__(self, size: int, rng: np.random.Generator) -> None:
        from scipy.stats import qmc

        self._sequence = qmc.Sobol(size, scramble=True, seed=int(rng.integers(2**32)))

    def next(self, count: int) -> Points:
        """The next few, shape ``(count, size)``."""
        # One by one: scipy warns of first draws that are no power of two.
        return np.vstack([self._sequence.random(1) for _ in range(count)])


class QuasiRandom(Searcher):
    """A scrambled Sobol sequence over all coordinates."""

    name = "quasi-random"
    trivial = True

    def __init__(self, layout: Layout, rng: np.random.Generator) -> None:
        super().__init__(layout, rng)
        self._sequence = Sobol(layout.size, rng)

    def ask(self) -> Points:
        """The next of the sequence."""
        return self._sequence.next(_BATCH)


_ALL_CORNERS = 3
"""Up to so many numbers and inputs, every corner is looked at; of more, some that differ much."""


class Constants(Searcher):
    """Corners first, each followed by its opposite; the centre; then a low-discrepancy sequence.

    An input over time has the same value in all its pieces. Options take turns.
    """

    name = "constant"
    trivial = True

    def __init__(self, layout: Layout, rng: np.random.Generator) -> None:
        super().__init__(layout, rng)
        self._constant = Description(layout, Steps(1))
        self._options = OptionCycle(layout, rng)
        self._ends = list(_corners(self._constant.size, rng))
        self._ends.append(np.full(self._constant.size, 0.5))
        self._rest = Sobol(max(self._constant.size, 1), rng)

    def ask(self) -> Points:
        """The next few of the sequence."""
        described, self._ends = self._ends[:_BATCH], self._ends[_BATCH:]
        if len(described) < _BATCH:
            rest = self._rest.next(_BATCH - len(described))
            described += list(rest[:, : self._constant.size])
        return self._constant.points(np.array(described), self._options.points(_BATCH))


def _corners(size: int, rng: np.random.Generator) -> Iterator[Points]:
    """Corners in pairs of opposites, from where all is low."""
    if size <= _ALL_CORNERS:
        low = list(itertools.product((0.0, 1.0), repeat=size))[: 2**size // 2]
        halves = np.array(low or [()], float)
    else:
        # Every number alone against the others, in an order by chance: each pair of numbers is
        # seen with equal and with opposite ends.
        halves = np.vstack([np.zeros(size), np.eye(size)[rng.permutation(size)]])
    for half in halves:
        yield half
        if size:
            yield 1.0 - half


KINDS = ("apart", "beat", "together", "beat")
"""In this order, again and again: each input jumps at times of its own, each has a beat of its own,
all jump at the same times."""


class BangBang(Searcher):
    """Every input is at one of its ends at any time; simple inputs come first.

    The number of jumps is drawn evenly up to a limit that begins at two and grows by one with each
    round of the kinds. Where all jump together, each jump goes to another corner of the inputs'
    ends. A single number is at an end, or anywhere between, by equal chance.
    """

    name = "bang-bang"
    trivial = True

    def __init__(self, layout: Layout, rng: np.random.Generator) -> None:
        super().__init__(layout, rng)
        self._options = OptionCycle(layout, rng)
        self._asked = 0

    def ask(self) -> Points:
        """The next few, one of each kind."""
        points = self._options.points(_BATCH)
        for point in points:
            kind = KINDS[self._asked % len(KINDS)]
            most = 2 + self._asked // len(KINDS)
            times = self._times(most)
            for group, where in self.layout.slices():
                if group.options:
                    continue
                if group.size == 1:
                    point[where] = self._single()
                elif kind == "beat":
                    point[where] = self._beat(group)
                else:
                    own = times if kind == "together" else self._times(most)
                    point[where] = self._jumps(group, own, together=kind == "together")
            self._asked += 1
        return points

    def _times(self, most: int) -> Floats:
        return self.rng.random(self.rng.integers(most + 1))

    def _single(self) -> float:
        anywhere = self.rng.random()
        return anywhere if self.rng.random() < 0.5 else float(anywhere < 0.5)

    def _beat(self, group: Group) -> Floats:
        described = self.rng.random((1, 5))
        described[0, 3] = self.rng.integers(2)
        described[0, 4] = 1.0 - described[0, 3]
        piece: Floats = Pulses().pieces(group, described)[0]
        return piece

    def _jumps(self, group: Group, times: Floats, *, together: bool) -> Floats:
        middles = (np.arange(group.size) + 0.5) / group.size
        passed = np.sum(times[:, None] < middles, axis=0)
        if together:
            levels = self.rng.integers(2, size=len(times) + 1)
        else:
            levels = (np.arange(len(times) + 1) + self.rng.integers(2)) % 2
        astype: Floats = levels[passed].astype(np.float64)
        return astype


_SIGMA = 0.3
"""First step of a restart by chance: about a third of the ranges, as the package recommends."""

NEAR = 0.15
"""First step of a restart from a point that was good already."""

GENERATIONS = 30
"""At most so many for a restart: budgets are hundreds of simulations, not tens of thousands."""

TOLERANCE = 1e-3
"""A restart whose steps are smaller has converged: values lie on a grid of a thousand steps."""

ALL = Steps(2**31)
"""Each piece by itself."""


@dataclass(frozen=True, slots=True)
class Plan:
    """How a restart begins.

    Args:
        shape: Of the inputs over time.
        near: Whether at a good point that a trivial searcher saw, and not by chance.
    """

    shape: Shape
    near: bool = False


@dataclass(frozen=True, slots=True)
class Restart:
    """A run of CMA-ES, what its coordinates mean, and a point that has its options."""

    strategy: CMAEvolutionStrategy
    description: Description
    template: Floats


class CmaEs(Searcher):
    """Covariance matrix adaptation (Hansen and Ostermeier, 2001), one restart after the other.

    A restart ends when it has converged, when it sees no differences, or after its generations. It
    keeps its options: those of the point it begins at, or the next in turn.
    """

    name = "cma-es"
    trivial = False
    plans: ClassVar[tuple[Plan, ...]] = (Plan(ALL), Plan(ALL, near=True))
    """Restart by restart, again and again."""

    def __init__(self, layout: Layout, rng: np.random.Generator) -> None:
        super().__init__(layout, rng)
        self._options = OptionCycle(layout, rng)
        self._begun = 0
        self._restart: Restart | None = None
        self._asked: list[Floats] = []

    @classmethod
    def suits(cls, layout: Layout) -> bool:
        """Wherever there are numbers."""
        return any(not group.options for group in layout.groups)

    @property
    def running(self) -> bool:
        """Whether a restart has begun that has not ended."""
        return self._restart is not None

    @property
    def near(self) -> bool:
        """Whether the next restart begins near a good point."""
        return self.plans[self._begun % len(self.plans)].near

    def begin(self, near: Points | None = None) -> Restart:
        """Leave the restart at hand, and begin the next.

        Args:
            near: A good point, shape ``(layout.size,)``, for a restart that begins near one; by
                default it begins by chance.
        """
        plan = self.plans[self._begun % len(self.plans)]
        self._begun += 1
        description = Description(self.layout, plan.shape)
        if near is None:
            template = self._options.points(1)[0]
            start, sigma = self.rng.random(description.size), _SIGMA
        else:
            template, sigma = near, NEAR
            start = description.described(near)
        strategy = _strategy(start, sigma, self.rng)
        self._restart = Restart(strategy, description, template)
        return self._restart

    def ask(self) -> Points:
        """A generation, of about ten points."""
        restart = self._restart or self.begin()
        self._asked = restart.strategy.ask()
        described = np.array(self._asked)[:, : restart.description.size]
        return restart.description.points(described, restart.template)

    def tell(self, points: Points, values: Values) -> None:  # noqa: ARG002 - as the base
        """Learn from a whole generation; the restart may end with it."""
        restart = self._restart
        if restart is None or len(values) < len(self._asked):
            return
        restart.strategy.tell(self._asked, filled(values).tolist())
        if restart.strategy.stop():
            self._restart = None


class CmaEsOfPulses(CmaEs):
    """The same among inputs that beat, which five numbers describe."""

    name = "cma-es of pulses"
    plans = (Plan(Pulses()),)

    @classmethod
    def suits(cls, layout: Layout) -> bool:
        """Wherever there are inputs over time."""
        return any(group.size > 1 for group in layout.groups)


def filled(values: Values) -> Floats:
    """Finite values in the same order; what is not known is worse than all that is."""
    known = values[np.isfinite(values)]
    best, worst = (known.min(), known.max()) if len(known) else (0.0, 0.0)
    return np.nan_to_num(values, nan=worst + 2.0, posinf=worst + 1.0, neginf=best - 1.0)


def _strategy(start: Floats, sigma: float, rng: np.random.Generator) -> CMAEvolutionStrategy:
    import cma

    def normal(*shape: int) -> Floats:
        return rng.standard_normal(shape)

    return cma.CMAEvolutionStrategy(
        # It fails in one dimension; a second one that means nothing does no harm.
        start.tolist() + [0.5] * (len(start) == 1),
        sigma,
        {
            "bounds": [0.0, 1.0],
            # Without these two it seeds the global generator of numpy, and draws from it.
            "seed": float("nan"),
            "randn": normal,
            "maxiter": GENERATIONS,
            "tolx": TOLERANCE,
            "verbose": -9,
            "verb_disp": 0,
            "verb_log": 0,
        },
    )
