"""The search loop: what it counts, when it ends, and what it tells the portfolio."""

from __future__ import annotations

import math

import numpy as np

from pytest_dura.search import Batch, Outcome, search


class Counting:
    """Proposes the numbers 0, 1, 2, ... in threes, and keeps what it is told."""

    def __init__(self) -> None:
        self.next = 0
        self.told: list[tuple[np.ndarray, frozenset[int]]] = []

    def ask(self) -> Batch:
        points = np.arange(self.next, self.next + 3.0)[:, None]
        self.next += 3
        return Batch("counting", points, world=self.next, spread=True)

    def tell(self, batch: Batch, values: np.ndarray, open_objectives: frozenset[int]) -> None:
        self.told.append((values, open_objectives))


def below(*limits: float):
    """One objective for each limit: how far a number is below it, violated from there on."""

    def evaluate(batch: Batch):
        for (x,) in batch.points:
            margins = tuple(limit - x for limit in limits)
            yield Outcome(margins, tuple(margin <= 0 for margin in margins))

    return evaluate


def test_it_ends_at_the_violation_in_the_middle_of_a_batch() -> None:
    proposer = Counting()
    log = search(proposer, below(4.0), 100)
    assert log.simulations == 5
    first = log.first[0]
    assert (first.number, first.point.tolist(), first.margin) == (5, [4.0], 0.0)
    assert first.world == 7
    assert [values.tolist() for values, _ in proposer.told] == [[[4], [3], [2]], [[1], [0]]]
    assert not log.open


def test_it_ends_with_the_budget_and_keeps_the_best() -> None:
    log = search(Counting(), below(100.0), 10)
    assert log.simulations == 10
    assert log.first == [None]
    assert log.best[0].margin == 91.0
    assert log.open == {0}


def test_it_goes_on_until_every_objective_is_violated() -> None:
    proposer = Counting()
    log = search(proposer, below(1.0, 6.0), 100, 2)
    assert [trial.number for trial in log.first] == [2, 7]
    assert log.searchers["counting"].first == [2, 7]
    assert [open_ for _, open_ in proposer.told] == [{1}, {1}, frozenset()]


def test_what_was_not_simulated_costs_no_budget_and_has_an_end() -> None:
    def evaluate(batch: Batch):
        return [Outcome((math.nan,), (False,), simulated=False) for _ in batch.points]

    proposer = Counting()
    log = search(proposer, evaluate, 10)
    assert log.simulations == 0
    assert log.refused >= 1000
    assert all(np.isnan(values).all() for values, _ in proposer.told)


def test_simulations_that_say_nothing_are_counted_and_are_no_best() -> None:
    def evaluate(batch: Batch):
        return [Outcome((math.nan,), (False,)) for _ in batch.points]

    log = search(Counting(), evaluate, 10)
    assert (log.simulations, log.unknown, log.best) == (10, 10, [None])


def test_a_violation_without_a_margin_is_a_violation() -> None:
    def evaluate(batch: Batch):
        return [Outcome((math.nan,), (x == 2,)) for (x,) in batch.points]

    log = search(Counting(), evaluate, 10)
    assert log.first[0].number == 3
    assert log.unknown == 2


def test_it_evaluates_no_more_of_a_batch_than_it_needs() -> None:
    evaluated = []

    def evaluate(batch: Batch):
        for (x,) in batch.points:
            evaluated.append(x)
            yield Outcome((-1.0,), (True,))

    search(Counting(), evaluate, 10)
    assert evaluated == [0.0]
