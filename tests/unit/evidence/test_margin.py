from __future__ import annotations

import numpy as np
import pytest
from handmade import decided, handmade

from pytest_dura.evidence import Trace
from pytest_dura.reports import formula_of, margin_over_time

GAP = [4.0, 2.0, -1.0, 3.0]


def margins(check, **signals):
    found = margin_over_time(check, handmade(4, **signals))
    return None if found is None else (found[0], found[1].tolist())


def test_an_always_is_told_moment_by_moment():
    assert margins("always (gap > 0.5)", gap=GAP) == ("gap > 0.5", [3.5, 1.5, -1.5, 2.5])


def test_parts_of_a_conjunction_too():
    text, found = margins("always (gap > 0) and always (x < 9)", gap=GAP, x=[8.0] * 4)
    assert "always" not in text
    assert found == [1.0, 1.0, -1.0, 1.0]


def test_other_formulas_are_what_they_are_worth_from_each_tick_on():
    text, found = margins("eventually (gap > 0)", gap=GAP)
    assert text.startswith("eventually")
    assert found == [4.0, 3.0, 3.0, 3.0]
    assert margins("always[0:0.1] (gap > 0)", gap=GAP)[1] == [2.0, -1.0, -1.0, 3.0]


def test_it_ends_where_a_signal_does():
    found = margins("always (gap > 0)", gap=[4.0, 2.0, np.nan, 3.0])[1]
    assert found[:2] == [4.0, 2.0]
    assert np.isnan(found[2:]).all()
    assert margins("always (gap > 0)", gap=[np.nan] * 4) is None


def test_signals_of_the_loop():
    found = margin_over_time("always (loop.recovering < 0.5)", decided("pr", [0, 2]))
    assert found[1].tolist() == [0.5, -0.5, -0.5]


@pytest.mark.parametrize(
    "check", ["always (loop.recovering < 0.5)", "eventually[0:2] (loop.recovering_for > 0.1)"]
)
def test_a_trace_tells_what_its_episode_does(check):
    episode = decided("pprrp", [0, 0, 2, 2, 0])
    of_episode, of_trace = (margin_over_time(check, one) for one in (episode, Trace.of(episode)))
    assert of_trace[0] == of_episode[0]
    np.testing.assert_array_equal(of_trace[1], of_episode[1])


@pytest.mark.parametrize(
    "check", ["", "package.module:function", "test_it:test.<locals>.<lambda>", "always (speed > 0)"]
)
def test_what_is_no_formula_over_these_signals_has_none(check):
    assert margins(check, gap=GAP) is None


def test_a_function_is_no_formula():
    assert formula_of("checks:in_words") is None
    assert formula_of("gap > 0").signals == ("gap",)
