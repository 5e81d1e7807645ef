"""The portfolio: who proposes what, in which order, with which seeds, and for whose share."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from pytest_dura.search import Batch, Group, Layout, Portfolio, Pulses, trivial_searchers
from pytest_dura.search.portfolio import OPENING, PATIENCE, SHARES
from pytest_dura.search.searchers import (
    GENERATIONS,
    BangBang,
    CmaEs,
    CmaEsOfPulses,
    Constants,
    Pushes,
    QuasiRandom,
)
from pytest_dura.search.surrogate import Surrogate

OVER_TIME = Layout((Group("throttle", 10), Group("brake", 10), Group("speed")))
NUMBERS = Layout((Group("speed"), Group("grip")))
CHOICES = Layout((Group("weather", options=3), Group("sensor", options=2)))


def random(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def asked(portfolio: Portfolio, simulations: int, open_: frozenset[int] | None = None):
    """Batches of so many simulations; each point's values are its distances from two targets."""
    found, done = [], 0
    while done < simulations:
        batch = portfolio.ask()
        values = np.stack(
            [np.abs(batch.points - target).sum(axis=1) for target in (0.3, 0.8)], axis=1
        )[:, : portfolio.objectives]
        found.append(batch)
        done += len(values)
        everything = frozenset(range(portfolio.objectives))
        portfolio.tell(batch, values, everything if open_ is None else open_)
    return found


def test_corners_come_first_each_followed_by_its_opposite_then_the_centre() -> None:
    searcher = Constants(NUMBERS, random())
    points = np.vstack([searcher.ask(), searcher.ask()])
    expected = [[0, 0], [1, 1], [0, 1], [1, 0], [0.5, 0.5]]
    assert points[:5].tolist() == expected
    assert np.all((points[5:] > 0) & (points[5:] < 1))


def test_of_many_numbers_each_is_once_alone_against_the_others() -> None:
    searcher = Constants(Layout(tuple(Group(f"n{i}") for i in range(5))), random())
    points = np.vstack([searcher.ask() for _ in range(3)])
    assert sorted(points[2:12:2].tolist()) == sorted(np.eye(5).tolist())
    assert np.array_equal(points[1:12:2], 1 - points[0:12:2])


def test_constant_inputs_stay_as_they_are() -> None:
    searcher = Constants(OVER_TIME, random())
    for _ in range(6):
        for point in searcher.ask():
            assert len(set(point[:10])) == len(set(point[10:20])) == 1


def test_options_take_turns() -> None:
    searcher = Constants(CHOICES, random())
    points = np.vstack([searcher.ask() for _ in range(3)])
    assert Counter((points[:, 0] * 3).astype(int)) == {0: 4, 1: 4, 2: 4}
    assert Counter((points[:, 1] * 2).astype(int)) == {0: 6, 1: 6}


def test_bang_bang_inputs_are_at_their_ends_and_the_first_ones_jump_seldom() -> None:
    searcher = BangBang(OVER_TIME, random())
    points = np.vstack([searcher.ask() for _ in range(40)])
    assert set(np.unique(points[:, :20])) == {0.0, 1.0}
    jumps = np.abs(np.diff(points[:, :10], axis=1)).sum(axis=1)
    assert jumps[[0, 2]].max() <= 2
    assert jumps[0::4][20:].mean() > jumps[0::4][:5].mean()
    assert 0 < np.mean((points[:, 20] == 0) | (points[:, 20] == 1)) < 1


def test_a_push_is_at_the_start_alone_and_half_of_all_inputs_are_constant() -> None:
    searcher = Pushes(Layout((Group("throttle", 20), Group("speed"))), random())
    points = np.vstack([searcher.ask() for _ in range(200)])
    jumps = np.count_nonzero(np.diff(points[:, :20], axis=1), axis=1)
    assert set(jumps) == {0, 1}
    assert 0.4 < np.mean(jumps == 0) < 0.6
    pushed, rest = points[jumps == 1, 0], points[jumps == 1, 19]
    assert set(rest) == {0.0, 1.0}
    assert 0.4 < rest.mean() < 0.6
    lasted = np.argmax(np.diff(points[jumps == 1, :20]) != 0, axis=1) + 1
    # Of lengths spread evenly over their logarithm, those up to 4 are about half, not a fifth.
    assert 0.4 < np.mean(lasted <= 4) < 0.65
    gentle = np.abs(pushed - rest) < 0.1
    assert 0.25 < gentle.mean() < 0.55
    assert np.abs(pushed - rest).min() < 0.01
    assert np.all((points >= 0.0) & (points <= 1.0))


def test_inputs_that_jump_together_jump_at_the_same_times() -> None:
    searcher = BangBang(Layout((Group("one", 64), Group("two", 64))), random())
    points = np.vstack([searcher.ask() for _ in range(30)])[2::4]
    one, two = points[:, :64], points[:, 64:]
    changed = (np.diff(one) != 0) | (np.diff(two) != 0)
    assert all(changes.sum() <= 2 + 4 * number + 2 for number, changes in enumerate(changed))
    both = (np.diff(one) != 0) & (np.diff(two) != 0)
    assert both.sum() > 0.3 * changed.sum()


def test_a_pulse_has_its_period_duty_and_levels() -> None:
    group = Group("input", 16)
    # 16 ** 0.5 = 4 times the shortest period of two pieces.
    wave = Pulses().pieces(group, np.array([[0.5, 0.0, 0.25, 0.9, 0.1]]))[0]
    assert wave.tolist() == ([0.9, 0.9] + [0.1] * 6) * 2


def test_quasi_random_points_fill_a_space_more_evenly_than_independent_ones() -> None:
    searcher = QuasiRandom(NUMBERS, random())
    points = np.vstack([searcher.ask() for _ in range(16)])
    cells = {(int(x * 8), int(y * 8)) for x, y in points}
    assert len(cells) == 64


def test_cma_es_finds_the_bottom_of_a_bowl_and_begins_again() -> None:
    searcher = CmaEs(NUMBERS, random())
    best, restarts = [np.inf], 0
    for _ in range(3 * GENERATIONS):
        restarts += not searcher.running
        points = searcher.ask()
        values = np.sum((points - [0.2, 0.9]) ** 2, axis=1)
        best.append(values.min())
        searcher.tell(points, values)
    assert min(best) < 1e-4
    assert restarts >= 2


def test_a_restart_without_differences_ends() -> None:
    searcher = CmaEs(NUMBERS, random())
    for _ in range(10):
        points = searcher.ask()
        searcher.tell(points, np.full(len(points), np.nan))
        if not searcher.running:
            return
    pytest.fail("it goes on where nothing differs")


def test_the_portfolio_opens_with_corners_and_jumps() -> None:
    batches = asked(Portfolio(OVER_TIME, 1, 1000), OPENING)
    assert Counter(batch.searcher for batch in batches) == {
        "constant": 2,
        "bang-bang": 2,
        "pushes": 2,
    }
    assert np.array_equal(batches[0].points[0], np.zeros(21))
    assert np.array_equal(batches[0].points[1], np.ones(21))


def turns(portfolio: Portfolio, simulations: int, value):
    """Searchers of the batches after the opening; ``value`` gives the values of a batch."""
    searchers, done = [], 0
    while done < simulations:
        batch = portfolio.ask()
        values = np.full((len(batch.points), 1), float(value(batch)))
        if done >= OPENING:
            searchers += [(batch.searcher, len(values))]
        done += len(values)
        portfolio.tell(batch, values, frozenset({0}))
    return searchers


def test_where_nothing_improves_everyone_gets_its_share() -> None:
    counts: Counter[str] = Counter()
    for searcher, size in turns(Portfolio(OVER_TIME, 1, 5000), 5000, lambda _: 1.0):
        counts[searcher] += size
    for kind, share in SHARES.items():
        assert counts[kind.name] == pytest.approx(share * counts.total() / 100, abs=20)


def test_every_second_turn_goes_to_the_searcher_that_improved_last() -> None:
    best = iter(range(0, -10_000, -1))
    made = turns(
        Portfolio(OVER_TIME, 1, 2000),
        2000,
        lambda batch: next(best) if batch.searcher == "cma-es of pulses" else 1.0,
    )
    names = [name for name, _ in made]
    begun = names.index("cma-es of pulses")
    after = names[begun + 1 :]
    assert len(after) > 50
    # The first turn after the improvement is its own, then it is another's by the shares.
    assert set(after[::2]) == {"cma-es of pulses"}
    assert set(after[1::2]) > {"pushes", "bang-bang", "cma-es"}


def test_a_searcher_that_improves_nothing_for_long_is_not_favoured_any_more() -> None:
    given = iter([0.0])
    made = turns(
        Portfolio(OVER_TIME, 1, 1000),
        1000,
        lambda batch: next(given, 1.0) if batch.searcher == "quasi-random" else 1.0,
    )
    names = [name for name, _ in made]
    begun = names.index("quasi-random")
    sizes = dict(made)
    favoured = PATIENCE // sizes["quasi-random"]
    assert names[begun + 1 : begun + 2 * favoured : 2] == ["quasi-random"] * favoured
    assert "quasi-random" not in names[begun + 2 * favoured : begun + 2 * favoured + 8]


def test_values_that_are_not_known_improve_nothing() -> None:
    unknown = turns(Portfolio(OVER_TIME, 1, 5000), 1000, lambda _: np.nan)
    assert unknown == turns(Portfolio(OVER_TIME, 1, 5000), 1000, lambda _: 1.0)


def test_the_rule_says_the_shares() -> None:
    assert sum(SHARES.values()) == 100
    assert all(f"{kind.name} {share} %" in Portfolio.RULE for kind, share in SHARES.items())
    assert f"first {OPENING} simulations" in Portfolio.RULE
    assert f"until {PATIENCE} simulations" in Portfolio.RULE


def test_only_searchers_that_have_something_to_propose_take_part() -> None:
    with_numbers = {batch.searcher for batch in asked(Portfolio(NUMBERS, 1, 500), 500)}
    assert with_numbers == {"constant", "bang-bang", "quasi-random", "cma-es"}
    of_choices = {batch.searcher for batch in asked(Portfolio(CHOICES, 1, 500), 500)}
    assert of_choices == {"constant", "bang-bang", "quasi-random"}


def test_a_restart_keeps_its_seed_and_points_without_answers_never_share_one() -> None:
    batches = asked(Portfolio(OVER_TIME, 1, 2000), 2000)
    trivial = [batch for batch in batches if batch.spread]
    seeds = [world for batch in trivial for world in batch.worlds]
    assert len(set(seeds)) == len(seeds)
    learning = [batch for batch in batches if not batch.spread]
    assert learning
    assert all(len(set(batch.worlds)) == 1 for batch in learning)
    pulses = [batch.world for batch in learning if batch.searcher == CmaEsOfPulses.name]
    assert not set(pulses) & set(seeds)
    assert 1 < len(set(pulses)) < len(pulses)


def test_a_restart_near_a_good_point_has_the_seed_of_that_point() -> None:
    batches = asked(Portfolio(NUMBERS, 1, 1500), 1500)
    good = {
        world: point
        for batch in batches
        if batch.spread
        for point, world in zip(batch.points, batch.worlds, strict=True)
    }
    near: dict[int, Batch] = {}
    for batch in batches:
        if not batch.spread and batch.world in good:
            near.setdefault(batch.world, batch)
    assert len(near) >= 2
    for world, batch in near.items():
        assert np.abs(batch.points - good[world]).max() < 0.75
        assert np.abs(batch.points.mean(axis=0) - good[world]).max() < 0.25


def test_every_kind_of_restart_takes_the_open_objectives_in_turn() -> None:
    batches = asked(Portfolio(OVER_TIME, 1, 8000, 2), 8000)
    trivial = {world for batch in batches if batch.spread for world in batch.worlds}
    kinds = {
        (batch.searcher, batch.world in trivial, batch.objective)
        for batch in batches
        if not batch.spread
    }
    everyone = [(CmaEsOfPulses.name, False), (CmaEs.name, False), (CmaEs.name, True)]
    assert kinds == {(*kind, objective) for kind in everyone for objective in (0, 1)}


def test_a_restart_is_left_when_its_objective_is_settled() -> None:
    portfolio = Portfolio(OVER_TIME, 1, 4000, 2)
    asked(portfolio, 200)
    later = asked(portfolio, 400, open_=frozenset({1}))
    objectives = [batch.objective for batch in later if not batch.spread]
    assert objectives.count(0) <= 1
    assert set(objectives[1:]) == {1}


def test_baselines_are_named() -> None:
    assert [name for name, _ in trivial_searchers(OVER_TIME, 1)] == [
        "uniform",
        "constant",
        "bang-bang",
    ]


def bowl(points):
    """A smooth objective of numbers, least at 0.3 each."""
    return np.sum((points - 0.3) ** 2, axis=1)


BOWL = Layout((Group("a"), Group("b"), Group("c"), Group("d")))


def least(proposer, budget=80):
    """The least value of the bowl within so many points."""
    best, done = np.inf, 0
    while done < budget:
        batch = proposer.ask()
        values = bowl(batch.points)
        best, done = min(best, values.min()), done + len(values)
        proposer.tell(batch, values[:, None], frozenset({0}))
    return best


def test_a_surrogate_gets_nearer_within_few_simulations() -> None:
    nearer = [
        least(Portfolio(BOWL, seed, 80, surrogate=True)) < least(Portfolio(BOWL, seed, 80))
        for seed in range(10)
    ]
    assert sum(nearer) >= 9


def test_a_surrogate_learns_from_the_points_of_others() -> None:
    searcher = Surrogate(BOWL, random())
    known = np.random.default_rng(3).random((60, 4))
    searcher.observe(known, np.column_stack([np.zeros(60), bowl(known)]))
    searcher.objective = 1
    assert bowl(searcher.ask()).max() < np.quantile(bowl(known), 0.05)


def test_a_surrogate_comes_first_after_the_opening_and_only_where_it_is_asked_for() -> None:
    for surrogate in (True, False):
        portfolio = Portfolio(OVER_TIME, 1, 100, surrogate=surrogate)
        names = [name for name, _ in turns(portfolio, 100, lambda _: 1.0)]
        assert (names[0] == "surrogate") == surrogate
        assert ("surrogate" in names) == surrogate
        assert ("surrogate" in portfolio.rule) == surrogate
        assert Portfolio.RULE in portfolio.rule


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1.0])
def test_a_surrogate_takes_values_of_any_kind(value) -> None:
    layout = Layout((Group("a"), Group("fault", 1, 3), Group("input", 12)))
    made = turns(Portfolio(layout, 1, 200, surrogate=True), 200, lambda _: value)
    assert "surrogate" in dict(made)


def test_searches_with_a_surrogate_are_the_same_for_the_same_seed() -> None:
    first, second = (asked(Portfolio(OVER_TIME, 4, 200, surrogate=True), 120) for _ in range(2))
    assert all(np.array_equal(a.points, b.points) for a, b in zip(first, second, strict=True))
    assert "surrogate" in {batch.searcher for batch in first}
