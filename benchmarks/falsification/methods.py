"""The methods that are compared: each looks for a point of negative robustness."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import cma
import numpy as np
from hypothesis import HealthCheck, Phase, given, settings, strategies, target
from hypothesis import seed as with_seed
from scipy.optimize import dual_annealing

from falsification.systems import Floats
from pytest_dura.search import Batch, Layout, Outcome, Portfolio, search, trivial_searchers
from pytest_dura.search.searchers import Pushes, Searcher


class OverError(Exception):
    """Nothing more is to be evaluated."""


@dataclass
class Count:
    """An objective that counts, and ends at the first negative value or with the budget.

    Args:
        robustness: At points, shape ``(k, size)``.
        budget: Evaluations.
    """

    robustness: Callable[[Floats], Floats]
    budget: int
    done: int = 0
    found: int | None = None

    def __call__(self, point: Floats) -> float:
        """The robustness at one point.

        Raises:
            OverError: If that was the end of it.
        """
        value = float(self.robustness(np.asarray(point)[None])[0])
        self.done += 1
        if value < 0:
            self.found = self.done
        if value < 0 or self.done >= self.budget:
            raise OverError
        return value


class Alone:
    """A searcher that has the whole budget."""

    def __init__(self, searcher: Searcher) -> None:
        self._searcher = searcher

    def ask(self) -> Batch:
        """Its next points."""
        return Batch(self._searcher.name, self._searcher.ask())

    def tell(self, batch: Batch, values: Floats, open_objectives: frozenset[int]) -> None:  # noqa: ARG002 - the loop's
        """What they came to."""
        self._searcher.tell(batch.points[: len(values)], values[:, 0])


def first_by_search(proposer: Alone | Portfolio, count: Count) -> int | None:
    """Evaluations up to the first violation that our loop sees, ``None`` for none."""

    def evaluate(batch: Batch) -> list[Outcome]:
        values = count.robustness(batch.points)
        return [Outcome((float(value),), (bool(value < 0),)) for value in values]

    first = search(proposer, evaluate, count.budget).first[0]
    return None if first is None else first.number


def trivial(name: str) -> Callable[[Layout, int, Count], int | None]:
    """One of the searchers that learn nothing, by itself."""

    def method(layout: Layout, seed: int, count: Count) -> int | None:
        return first_by_search(Alone(dict(trivial_searchers(layout, seed))[name]), count)

    return method


def pushes(layout: Layout, seed: int, count: Count) -> int | None:
    """Constant inputs and pushes at the start by themselves, which learn nothing either."""
    return first_by_search(Alone(Pushes(layout, np.random.default_rng(seed))), count)


def portfolio(layout: Layout, seed: int, count: Count) -> int | None:
    """All of ours."""
    return first_by_search(Portfolio(layout, seed, count.budget), count)


def with_surrogate(layout: Layout, seed: int, count: Count) -> int | None:
    """The portfolio with a surrogate, which is off by default."""
    return first_by_search(Portfolio(layout, seed, count.budget, surrogate=True), count)


def annealing(layout: Layout, seed: int, count: Count) -> int | None:
    """scipy's dual annealing as PSY-TaLiRo calls it (without local search), restarted."""
    random, bounds = np.random.default_rng(seed), [(0.0, 1.0)] * layout.size
    try:
        while True:
            dual_annealing(count, bounds, seed=random, maxiter=count.budget, no_local_search=True)
    except OverError:
        return count.found


def plain_cma(layout: Layout, seed: int, count: Count) -> int | None:
    """The package `cma` over all coordinates from points by chance; begun again when it ends."""
    random = np.random.default_rng(seed)
    try:
        while True:
            options = {
                "bounds": [0.0, 1.0],
                "seed": int(random.integers(1, 2**31)),
                "verbose": -9,
            }
            strategy = cma.CMAEvolutionStrategy(random.random(layout.size), 0.3, options)
            while not strategy.stop():
                points = strategy.ask()
                strategy.tell(points, [count(point) for point in points])
    except OverError:
        return count.found


def hypothesis_target(layout: Layout, seed: int, count: Count) -> int | None:
    """Hypothesis, which `target` guides; begun again with another seed when it ends."""
    over = False

    def look(point: tuple[float, ...]) -> None:
        nonlocal over
        if over:  # it goes on to the end of its examples, and nothing more is simulated
            return
        try:
            target(-count(np.array(point)))
        except OverError:
            over = True

    examples = given(strategies.tuples(*[strategies.floats(0.0, 1.0)] * layout.size))
    limits = settings(
        max_examples=count.budget,
        database=None,
        deadline=None,
        phases=[Phase.generate, Phase.target],
        suppress_health_check=list(HealthCheck),
    )
    for run in itertools.count():
        with_seed(1000 * seed + run)(limits(examples(look)))()
        if over:
            break
    return count.found


METHODS: dict[str, Callable[[Layout, int, Count], int | None]] = {
    "uniform": trivial("uniform"),
    "dual annealing": annealing,
    "CMA-ES": plain_cma,
    "Hypothesis target": hypothesis_target,
    "constant": trivial("constant"),
    "bang-bang": trivial("bang-bang"),
    "pushes": pushes,
    "portfolio": portfolio,
    "with surrogate": with_surrogate,
}
