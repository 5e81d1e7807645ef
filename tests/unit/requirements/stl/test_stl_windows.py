"""Sliding and running windows on arrays, against slices taken by hand."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from pytest_dura.requirements.stl import windows

INF = np.inf


law = settings(derandomize=True, deadline=None, max_examples=60)
sizes = st.integers(1, 20)
firsts = st.integers(0, 12)
widths = st.integers(0, 12) | st.just(99)


@law
@given(firsts, widths, sizes, st.sampled_from([(np.minimum, min), (np.maximum, max)]))
def test_sliding_windows_are_cut_at_the_ends(first, width, size, joins) -> None:
    (join, of), last = joins, first + width
    values = np.random.default_rng(size).normal(size=(3, size))
    empty = INF if of is min else -INF
    ahead = windows.sliding(values, join, first, last)
    back = windows.sliding_past(values, join, first, last)
    for row in range(3):
        for t in range(size):
            later = values[row, t + first : t + last + 1].tolist()
            assert ahead[row, t] == of(later, default=empty)
            earlier = values[row, max(t - last, 0) : max(t - first + 1, 0)].tolist()
            assert back[row, t] == of(earlier, default=empty)


@law
@given(firsts, widths | st.none(), sizes)
def test_until_needs_its_left_side_before_the_right_one_and_not_with_it(first, width, size) -> None:
    last = None if width is None else first + width
    left, right = np.random.default_rng(size).normal(size=(2, size))
    found = windows.until(left, right, first, last)
    mirrored = windows.since(left[::-1], right[::-1], first, last)[::-1]
    for t in range(size):
        end = size if last is None else min(t + last + 1, size)
        best = max((min(right[u], *left[t:u], INF) for u in range(t + first, end)), default=-INF)
        assert found[t] == best
        assert mirrored[t] == best


def test_running_windows() -> None:
    values = np.array([3.0, 1.0, 2.0])
    assert windows.running(values, np.minimum).tolist() == [1, 1, 2]
    assert windows.running(values, np.maximum).tolist() == [3, 2, 2]
    assert windows.running_past(values, np.minimum).tolist() == [3, 1, 1]
    assert windows.running_past(values, np.maximum).tolist() == [3, 3, 3]


def test_neighbours_and_unknown_tails() -> None:
    values = np.array([3.0, 1.0, 2.0])
    assert windows.following(values, INF).tolist() == [1, 2, INF]
    assert windows.preceding(values, -INF).tolist() == [-INF, 3, 1]
    assert windows.open_tail(values, 1, INF).tolist() == [3, 1, INF]
    assert windows.open_tail(values, 9, INF).tolist() == [INF] * 3
    assert windows.open_tail(values, 0, INF).tolist() == [3, 1, 2]


def test_no_input_is_changed() -> None:
    values = np.array([3.0, 1.0, 2.0])
    values.flags.writeable = False
    windows.sliding(values, np.minimum, 0, 2)
    windows.sliding_past(values, np.maximum, 1, 2)
    windows.until(values, values, 1, 2)
    windows.since(values, values)
    windows.open_tail(values, 2, INF)
