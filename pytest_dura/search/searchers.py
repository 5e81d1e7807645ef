"""Searchers: propose points of a search space, and learn from their values."""

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


Floats = NDArray[np.float64]
Points = Floats
Values = Floats

_BATCH = 4
"""Points that a trivial searcher proposes at once: enough to keep a few processes busy, few enough
that the searchers take turns from the first simulations on."""


class Searcher(ABC):
    """A member of a portfolio.

    ``name`` stands in reports. A ``trivial`` searcher learns nothing from values: it is a baseline
    for claims about the others.

    Args:
        layout: What the coordinates of a point mean.
        rng: Generator of its random numbers.
    """

    name: ClassVar[str]
    trivial: ClassVar[bool]

    def __init__(self, layout: Layout, rng: np.random.Generator) -> None:
        self.layout, self.rng = layout, rng

    @classmethod
    def suits(cls, layout: Layout) -> bool:  # noqa: ARG003 - most suit all
        """Whether it can propose points of this layout."""
        return True

    @abstractmethod
    def ask(self) -> Points:
        """Return the next points, to be evaluated at once; shape ``(k, layout.size)``, k >= 1."""

    def tell(self, points: Points, values: Values) -> None:  # noqa: B027 - a baseline learns nothing
        """Learn the values of the points that :meth:`ask` returned last, or of the first of them.

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
        """Return points whose options are set, to the middle of their parts; all else is 0.5."""
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


class Shape(ABC):
    """Describes the pieces of a group by fewer coordinates in [0, 1]."""

    @abstractmethod
    def size(self, group: Group) -> int:
        """Return the number of coordinates that describe the group."""

    @abstractmethod
    def pieces(self, group: Group, described: Floats) -> Floats:
        """Compute the group's coordinates, shape ``(k, group.size)``, from ``(k, size(group))``."""


@dataclass(frozen=True)
class Steps(Shape):
    """Inputs of a few steps of equal length.

    Args:
        most: Steps, at most one for each piece.
    """

    most: int

    def size(self, group: Group) -> int:
        """Return one for each step."""
        return min(self.most, group.size)

    def pieces(self, group: Group, described: Floats) -> Floats:
        """Give each piece the value of the step in which it begins."""
        return described[:, np.arange(group.size) * self.size(group) // group.size]


@dataclass(frozen=True)
class Pulses(Shape):
    """Inputs that alternate between two levels: period, phase, duty, and the levels.

    Periods are spread evenly over their logarithms, from two pieces to twice the whole time; a
    single value stays as it is. Pulse generators are a usual input of falsification tools, such as
    Breach (Donze, CAV 2010).
    """

    def size(self, group: Group) -> int:
        """Return five for an input over time."""
        return 1 if group.size == 1 else 5

    def pieces(self, group: Group, described: Floats) -> Floats:
        """Give each piece the level at its middle."""
        if group.size == 1:
            return described
        period, phase, duty, first, second = (column[:, None] for column in described.T)
        phases = np.mod((np.arange(group.size) + 0.5) / (2.0 * group.size**period) + phase, 1.0)
        levels: Floats = np.where(phases < duty, first, second)
        return levels


class Description:
    """Describes all groups of a layout by one shape; groups of options are left out.

    Args:
        layout: What the coordinates of a point mean.
        shape: Shape of the inputs over time.
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
        """Compute whole points, with the template's options.

        Args:
            described: Shape ``(k, size)``.
            template: A point, or one for each; shape ``(layout.size,)`` or ``(k, layout.size)``.
        """
        made = np.array(np.broadcast_to(template, (len(described), self.layout.size)))
        for group, where, part in self._parts:
            made[:, where] = self.shape.pieces(group, described[:, part])
        return made

    def described(self, point: Floats) -> Floats:
        """Describe a point, in a shape with one coordinate for each piece; shape ``(size,)``.

        Args:
            point: Shape ``(layout.size,)``.
        """
        coordinates = np.empty(self.size)
        for _, where, part in self._parts:
            coordinates[part] = point[where]
        return coordinates


class Uniform(Searcher):
    """Points drawn uniformly."""

    name = "uniform"
    trivial = True

    def ask(self) -> Points:
        """Return one point."""
        return self.rng.random((1, self.layout.size))


class Sobol:
    """A scrambled Sobol sequence.

    Args:
        size: Coordinates.
        rng: Draws its seed.
    """

    def __init__(self, size: int, rng: np.random.Generator) -> None:
        from scipy.stats import qmc

        self._sequence = qmc.Sobol(size, scramble=True, seed=int(rng.integers(2**32)))

    def next(self, count: int) -> Points:
        """Return the next points, shape ``(count, size)``."""
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
        """Return the next points of the sequence."""
        return self._sequence.next(_BATCH)


_ALL_CORNERS = 3
"""Up to so many numbers and inputs every corner is tried; of more, some that differ much."""


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
        self._initial = list(_corners(self._constant.size, rng))
        self._initial.append(np.full(self._constant.size, 0.5))
        self._rest = Sobol(max(self._constant.size, 1), rng)

    def ask(self) -> Points:
        """Return the next points of the sequence."""
        described, self._initial = self._initial[:_BATCH], self._initial[_BATCH:]
        if len(described) < _BATCH:
            rest = self._rest.next(_BATCH - len(described))
            described += list(rest[:, : self._constant.size])
        return self._constant.points(np.array(described), self._options.points(_BATCH))


def _corners(size: int, rng: np.random.Generator) -> Iterator[Points]:
    """Yield corners in pairs of opposites, beginning where all is low."""
    if size <= _ALL_CORNERS:
        low = list(itertools.product((0.0, 1.0), repeat=size))[: 2**size // 2]
        halves = np.array(low or [()], float)
    else:
        # Every number alone against the others, in random order: each pair of numbers has equal
        # and opposite ends.
        halves = np.vstack([np.zeros(size), np.eye(size)[rng.permutation(size)]])
    for half in halves:
        yield half
        if size:
            yield 1.0 - half


_KINDS = ("apart", "pulses", "together", "pulses")
"""Kinds of inputs over time, in turn: each jumps at times of its own, each has pulses of its own,
all jump at the same times."""


class BangBang(Searcher):
    """Inputs that are at one of their ends at any time; simple inputs come first.

    The number of jumps is drawn uniformly up to a limit that begins at two and grows by one with
    each round of the kinds. Where all jump together, each jump goes to a random corner of the
    inputs' ends. A single number is at an end, or anywhere between, by equal chance.
    """

    name = "bang-bang"
    trivial = True

    def __init__(self, layout: Layout, rng: np.random.Generator) -> None:
        super().__init__(layout, rng)
        self._options = OptionCycle(layout, rng)
        self._proposed = 0

    def ask(self) -> Points:
        """Return the next points, one of each kind."""
        points = self._options.points(_BATCH)
        for point in points:
            kind = _KINDS[self._proposed % len(_KINDS)]
            most = 2 + self._proposed // len(_KINDS)
            times = self._times(most)
            for group, where in self.layout.slices():
                if group.options:
                    continue
                if group.size == 1:
                    point[where] = self._single()
                elif kind == "pulses":
                    point[where] = self._pulses(group)
                else:
                    own = times if kind == "together" else self._times(most)
                    point[where] = self._jumps(group, own, together=kind == "together")
            self._proposed += 1
        return points

    def _times(self, most: int) -> Floats:
        return self.rng.random(self.rng.integers(most + 1))

    def _single(self) -> float:
        anywhere = self.rng.random()
        return anywhere if self.rng.random() < 0.5 else float(anywhere < 0.5)

    def _pulses(self, group: Group) -> Floats:
        described = self.rng.random((1, 5))
        described[0, 3] = self.rng.integers(2)
        described[0, 4] = 1.0 - described[0, 3]
        pieces: Floats = Pulses().pieces(group, described)[0]
        return pieces

    def _jumps(self, group: Group, times: Floats, *, together: bool) -> Floats:
        middles = (np.arange(group.size) + 0.5) / group.size
        passed = np.sum(times[:, None] < middles, axis=0)
        if together:
            levels = self.rng.integers(2, size=len(times) + 1)
        else:
            levels = (np.arange(len(times) + 1) + self.rng.integers(2)) % 2
        pieces: Floats = levels[passed].astype(np.float64)
        return pieces


class Pushes(Searcher):
    """Inputs that are constant, or moved at the start alone and at rest afterwards.

    Most plants are pushed, and then left to themselves. How long a push lasts is spread evenly over
    its logarithm, from one piece to all of them. So are half of the levels, from a thousandth of
    the range on: a gentle push is another situation than none. Each end of the range may be that of
    rest; a single number has a level alone.
    """

    name = "pushes"
    trivial = True

    def __init__(self, layout: Layout, rng: np.random.Generator) -> None:
        super().__init__(layout, rng)
        self._options = OptionCycle(layout, rng)

    @classmethod
    def suits(cls, layout: Layout) -> bool:
        """Whether there are inputs over time."""
        return any(group.size > 1 for group in layout.groups)

    def ask(self) -> Points:
        """Return the next points."""
        points = self._options.points(_BATCH)
        for point in points:
            for group, where in self.layout.slices():
                if not group.options:
                    point[where] = self._push(group.size)
        return points

    def _push(self, size: int) -> Floats:
        level = self.rng.random()
        if self.rng.random() < 0.5:
            level = _GENTLEST ** float(level)
        pieces = size
        if self.rng.random() < 0.5:
            pieces = min(int(size ** self.rng.random()), size)
        pushed = np.where(np.arange(size) < pieces, level, 0.0)
        return pushed if self.rng.random() < 0.5 else 1.0 - pushed


_GENTLEST = 1e-3
"""Least level of a push that is spread over its logarithm, as a part of the range."""

_SIGMA = 0.3
"""First step of a restart at a random point: about a third of the ranges, as cma recommends."""

_NEAR_SIGMA = 0.15
"""First step of a restart at a good point."""

GENERATIONS = 30
"""Limit of a restart: budgets are hundreds of simulations, not tens of thousands."""

_TOLERANCE = 1e-3
"""A restart whose steps are smaller has converged: values lie on a grid of a thousand steps."""

_EACH_PIECE = Steps(2**31)


@dataclass(frozen=True, slots=True)
class Plan:
    """How a restart begins.

    Args:
        shape: Shape of the inputs over time.
        near: Whether at a good point of a trivial searcher, and not at a random one.
    """

    shape: Shape
    near: bool = False


@dataclass(frozen=True, slots=True)
class Restart:
    """A run of CMA-ES, what its coordinates mean, and a point with its options."""

    strategy: CMAEvolutionStrategy
    description: Description
    template: Floats


class CmaEs(Searcher):
    """Covariance matrix adaptation (Hansen and Ostermeier, 2001), one restart after the other.

    A restart ends when it has converged, when all values are equal, or after its generations. It
    keeps its options: those of the point it begins at, or the next in turn.
    """

    name = "cma-es"
    trivial = False
    plans: ClassVar[tuple[Plan, ...]] = (Plan(_EACH_PIECE, near=True), Plan(_EACH_PIECE))
    """Plans of the restarts, in turn; without inputs over time the second one comes first.

    An input over time has so many pieces that random ones are all alike, and simple ones a better
    beginning. Of single numbers the best corner may lie in a part of the space that leads nowhere.
    """

    def __init__(self, layout: Layout, rng: np.random.Generator) -> None:
        super().__init__(layout, rng)
        self._options = OptionCycle(layout, rng)
        self._begun = 0 if any(group.size > 1 for group in layout.groups) else 1
        self._restart: Restart | None = None
        self._generation: list[Floats] = []

    @classmethod
    def suits(cls, layout: Layout) -> bool:
        """Whether there are numbers."""
        return any(not group.options for group in layout.groups)

    @property
    def running(self) -> bool:
        """Whether a restart has begun and not ended."""
        return self._restart is not None

    @property
    def near(self) -> bool:
        """Whether the next restart begins at a good point."""
        return self.plans[self._begun % len(self.plans)].near

    def begin(self, near: Points | None = None) -> Restart:
        """End the current restart, and begin the next.

        Args:
            near: The point to begin at, shape ``(layout.size,)``; by default a random one.
        """
        plan = self.plans[self._begun % len(self.plans)]
        self._begun += 1
        description = Description(self.layout, plan.shape)
        if near is None:
            template = self._options.points(1)[0]
            start, sigma = self.rng.random(description.size), _SIGMA
        else:
            template, sigma = near, _NEAR_SIGMA
            start = description.described(near)
        strategy = _strategy(start, sigma, self.rng)
        self._restart = Restart(strategy, description, template)
        return self._restart

    def ask(self) -> Points:
        """Return a generation, of about ten points."""
        restart = self._restart or self.begin()
        self._generation = restart.strategy.ask()
        described = np.array(self._generation)[:, : restart.description.size]
        return restart.description.points(described, restart.template)

    def tell(self, points: Points, values: Values) -> None:  # noqa: ARG002 - as the base
        """Learn from a whole generation; the restart may end with it."""
        restart = self._restart
        if restart is None or len(values) < len(self._generation):
            return
        restart.strategy.tell(self._generation, filled(values).tolist())
        if restart.strategy.stop():
            self._restart = None


class CmaEsOfPulses(CmaEs):
    """CMA-ES among pulses, which five numbers describe."""

    name = "cma-es of pulses"
    plans = (Plan(Pulses()),)

    @classmethod
    def suits(cls, layout: Layout) -> bool:
        """Whether there are inputs over time."""
        return any(group.size > 1 for group in layout.groups)


def filled(values: Values) -> Floats:
    """Return finite values in the same order; NaN becomes worse than all others."""
    known = values[np.isfinite(values)]
    best, worst = (known.min(), known.max()) if len(known) else (0.0, 0.0)
    return np.nan_to_num(values, nan=worst + 2.0, posinf=worst + 1.0, neginf=best - 1.0)


def _strategy(start: Floats, sigma: float, rng: np.random.Generator) -> CMAEvolutionStrategy:
    import cma

    def normal(*shape: int) -> Floats:
        return rng.standard_normal(shape)

    return cma.CMAEvolutionStrategy(
        # It fails in one dimension: add a second one without a meaning.
        start.tolist() + [0.5] * (len(start) == 1),
        sigma,
        {
            "bounds": [0.0, 1.0],
            # Without these two it seeds the global generator of numpy, and draws from it.
            "seed": float("nan"),
            "randn": normal,
            "maxiter": GENERATIONS,
            "tolx": _TOLERANCE,
            "verbose": -9,
            "verb_disp": 0,
            "verb_log": 0,
        },
    )
