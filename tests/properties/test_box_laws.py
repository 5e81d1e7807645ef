"""Laws of the boxes in which points violate, and of the probability of a violation there."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pytest_dura.requirements.rate_tests import lower_bound, upper_bound
from pytest_dura.search.boxes import Box, boxes, separation
from pytest_dura.search.region_data import Mass

SEEDS = st.integers(0, 2**32 - 1)


def drawn(seed, count=300, size=4):
    return np.random.default_rng(seed).random((count, size))


@given(seed=SEEDS)
def test_a_box_that_was_planted_is_found_and_other_coordinates_stay_open(seed) -> None:
    points = drawn(seed)
    violating = (points[:, 1] > 0.6) & (points[:, 3] < 0.5)
    box = next(boxes(points, violating, 1))
    inside = box.contains(points)
    assert violating[inside].mean() >= 0.9
    assert inside[violating].mean() >= 0.7
    assert list(np.flatnonzero(box.bounded)) == [1, 3]
    assert set(np.argsort(-separation(box, points, violating))[:2]) == {1, 3}


def test_a_middle_in_which_every_second_point_violates_is_found() -> None:
    found = 0
    for seed in range(100):
        points = drawn(seed, 90, 5)
        middle = abs(points[:, 2] - 0.5) < 0.2
        violating = middle & (np.cumsum(middle) % 2 == 0)
        box = next(boxes(points, violating, 1))
        found += box.low[2] > 0.2 and box.high[2] < 0.8
    assert found >= 80


@given(seed=SEEDS)
def test_two_boxes_that_lie_apart_are_two(seed) -> None:
    points = drawn(seed, 400, 2)
    low, high = (points < 0.3).all(axis=1), (points > 0.7).all(axis=1)
    made = list(boxes(points, low | high, 3))
    assert len(made) >= 2
    for planted in (low, high):
        assert max(box.contains(points)[planted].mean() for box in made[:2]) >= 0.6


@given(seed=SEEDS, share=st.floats(0.0, 1.0))
def test_boxes_hold_violations_and_lie_in_the_space(seed, share) -> None:
    points = drawn(seed, 60, 3)
    violating = np.random.default_rng(seed + 1).random(60) < share
    left = violating.copy()
    for box in boxes(points, violating, 3):
        assert (box.low >= 0.0).all()
        assert (box.high <= 1.0).all()
        assert (box.low < box.high).all()
        assert np.count_nonzero(left & box.contains(points)) >= 3
        left &= ~box.contains(points)
        assert violating[box.contains(points)].mean() >= violating.mean() - 0.02


@pytest.mark.parametrize(
    "count, size, share, most", [(150, 6, 0.1, 10), (60, 4, 0.1, 10), (100, 10, 0.05, 14)]
)
def test_violations_by_chance_alone_seldom_make_a_bound(count, size, share, most) -> None:
    bounded = 0
    for seed in range(100):
        points = drawn(seed, count, size)
        violating = np.random.default_rng(seed + 1000).random(count) < share
        bounded += any(box.bounded.any() for box in boxes(points, violating, 1))
    assert bounded <= most


def test_fewer_than_three_violations_make_no_box() -> None:
    points = drawn(0, 20, 2)
    assert list(boxes(points, np.arange(20) < 2, 3)) == []


@given(seed=SEEDS)
def test_points_that_are_drawn_lie_within(seed) -> None:
    rng = np.random.default_rng(seed)
    low = rng.random(3) / 2
    box = Box(low, low + rng.random(3) / 2)
    assert box.contains(box.draw(rng, 50)).all()
    assert box.volume == pytest.approx(np.prod(box.high - box.low))


@settings(deadline=None)  # the first call imports scipy
@given(runs=st.integers(1, 200), data=st.data())
def test_the_interval_of_a_probability_is_that_of_the_share_times_the_box(runs, data) -> None:
    violated = data.draw(st.integers(0, runs))
    unknown = data.draw(st.integers(0, runs - violated))
    volume = data.draw(st.floats(0.001, 1.0))
    mass = Mass(volume, runs, violated, unknown)
    assert 0.0 <= mass.low <= mass.estimate <= mass.high <= volume
    assert mass.low == volume * lower_bound(violated, runs, 0.975)
    # What is not known may be a violation, and may be none.
    assert mass.high == volume * upper_bound(violated + unknown, runs, 0.975)


def test_the_interval_of_a_probability_holds_it_as_often_as_it_says() -> None:
    rng, volume, share = np.random.default_rng(0), 0.01, 0.3
    counts = rng.binomial(40, share, 2000)
    masses = [Mass(volume, 40, int(count), 0) for count in counts]
    held = np.mean([mass.low <= volume * share <= mass.high for mass in masses])
    assert held >= 0.95
