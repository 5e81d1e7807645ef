"""Laws of the portfolio: its points lie in the space, and follow from seed and answers alone."""

from __future__ import annotations

from collections import defaultdict
from itertools import combinations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from pytest_dura.search import Batch, Group, Layout, Portfolio, Pulses, trivial_searchers
from pytest_dura.search.searchers import Description, Steps, filled

lawful = settings(derandomize=True, deadline=None, max_examples=15)

groups = st.one_of(
    st.builds(Group, st.just("number")),
    st.builds(Group, st.just("input"), size=st.integers(2, 12)),
    st.builds(Group, st.just("choice"), options=st.integers(2, 4)),
)
layouts = st.lists(groups, min_size=1, max_size=4).map(lambda found: Layout(tuple(found)))
answers = st.sampled_from([0.0, -1.5, 2.0, float("nan"), float("inf"), float("-inf")])
seeds = st.integers(0, 2**53 - 1)


def batches(
    layout: Layout, seed: int, replies: list[float], objectives: int = 1, count: int = 14
) -> list[Batch]:
    """What a portfolio asks when it is answered so, again and again, or by the sum of a point."""
    portfolio, asked = Portfolio(layout, seed, 1000, objectives), []
    for _ in range(count):
        batch = portfolio.ask()
        values = batch.points.sum(axis=1)[:, None] * (1.0 + np.arange(objectives))
        if replies:
            values = np.resize(np.array(replies), values.shape)
        asked.append(batch)
        portfolio.tell(batch, values, frozenset(range(objectives)))
    return asked


@lawful
@given(layouts, seeds, st.lists(answers, max_size=5), st.integers(1, 3))
def test_points_lie_in_the_space_whatever_is_answered(layout, seed, replies, objectives) -> None:
    for batch in batches(layout, seed, replies, objectives):
        assert batch.points.shape == (len(batch.points), layout.size)
        assert len(batch.points) >= 1
        assert np.all((batch.points >= 0.0) & (batch.points <= 1.0))
        assert 0 <= batch.objective < objectives


@lawful
@given(layouts, seeds, st.lists(answers, max_size=5))
def test_the_same_seed_and_answers_give_the_same_batches(layout, seed, replies) -> None:
    np.random.seed(1)  # noqa: NPY002 - the global generator is what must not matter
    first = batches(layout, seed, replies)
    np.random.seed(2)  # noqa: NPY002
    again = batches(layout, seed, replies)
    for one, other in zip(first, again, strict=True):
        assert np.array_equal(one.points, other.points)
        assert (one.searcher, one.objective, one.worlds) == (
            other.searcher,
            other.objective,
            other.worlds,
        )


@lawful
@given(layouts, seeds)
def test_the_global_generator_is_left_alone(layout, seed) -> None:
    np.random.seed(3)  # noqa: NPY002
    before = np.random.get_state()[1].tobytes()  # noqa: NPY002
    batches(layout, seed, [])
    assert np.random.get_state()[1].tobytes() == before  # noqa: NPY002


@lawful
@given(layouts, seeds)
def test_trivial_searchers_lie_in_the_space_and_need_no_answers(layout, seed) -> None:
    for name, searcher in trivial_searchers(layout, seed):
        assert searcher.trivial
        assert searcher.name == name
        for _ in range(5):
            points = searcher.ask()
            assert points.shape[1] == layout.size
            assert np.all((points >= 0.0) & (points <= 1.0))


@settings(lawful, max_examples=6)
@given(st.integers(24, 64), seeds)
def test_no_searcher_and_no_baseline_draws_what_another_draws(size, seed) -> None:
    """So a baseline is another sample, and one searcher more or less shifts nobody's draws."""
    layout = Layout((Group("input", size=size), Group("number")))
    drawn: dict[str, set[tuple[float, ...]]] = defaultdict(set)
    for batch in batches(layout, seed, []):
        drawn[f"search {batch.searcher}"] |= set(map(tuple, batch.points.tolist()))
    for name, searcher in trivial_searchers(layout, seed):
        for _ in range(8):
            drawn[f"baseline {name}"] |= set(map(tuple, searcher.ask().tolist()))
    # Corners and the centre are nobody's draws.
    fixed = {0.0, 0.5, 1.0}
    own = {name: {point for point in drawn[name] if {*point} - fixed} for name in drawn}
    assert all(own.values())
    for name, other in combinations(sorted(own), 2):
        assert not own[name] & own[other], (name, other)


@lawful
@given(layouts, st.integers(1, 15), st.data())
def test_a_shape_of_all_pieces_changes_nothing(layout, count, data) -> None:
    random = np.random.default_rng(data.draw(seeds))
    points = random.random((count, layout.size))
    every = Description(layout, Steps(99))
    described = np.array([every.described(point) for point in points])
    assert np.array_equal(every.points(described, points), points)


@lawful
@given(layouts, seeds)
def test_shapes_keep_the_options_of_the_template(layout, seed) -> None:
    random = np.random.default_rng(seed)
    template = random.random(layout.size)
    for shape in (Steps(1), Steps(3), Pulses()):
        own = Description(layout, shape)
        point = own.points(random.random((1, own.size)), template)[0]
        for group, where in layout.slices():
            if group.options:
                assert np.array_equal(point[where], template[where])
            assert len(np.unique(point[where])) <= (3 if shape == Steps(3) else 2)


@lawful
@given(st.lists(st.one_of(answers, st.floats(-1e6, 1e6)), min_size=1, max_size=12))
def test_unknown_values_are_finite_and_worse_than_all_others(values) -> None:
    given_ = np.array(values)
    found = filled(given_)
    assert np.all(np.isfinite(found))
    known = ~np.isnan(given_)
    for i in np.flatnonzero(known):
        assert np.all(found[~known] > found[i])
        for j in np.flatnonzero(known):
            assert (given_[i] < given_[j]) == (found[i] < found[j])
