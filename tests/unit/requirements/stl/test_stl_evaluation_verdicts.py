"""Verdicts on traces: status, margin, interval, times and texts."""

from __future__ import annotations

import math

import numpy as np
import pytest
from stl_intervals import robustness_interval
from stl_judging import judge

from pytest_dura.requirements import parse, robustness, robustness_batch

INF = math.inf


def test_always_takes_the_worst_sample() -> None:
    found = judge("always (x >= 2)", x=[5, 3, 4])
    assert (found.status, found.margin, found.worst_time) == ("satisfied", 1.0, 1.0)
    assert (found.lower, found.upper, found.time) == (1.0, 1.0, None)
    assert found.robustness == 1.0
    assert found.detail == "always (x >= 2)"


def test_a_violation_has_its_first_time_and_its_worst_margin() -> None:
    found = judge("always (x < 2)", x=[1, 2.5, 7, 3], time=[0, 0.1, 0.2, 0.3])
    assert (found.status, found.time) == ("violated", 0.1)
    assert (found.margin, found.worst_time) == (-5.0, 0.2)


def test_eventually_takes_the_best_sample() -> None:
    assert judge("eventually (x > 2)", x=[1, 4, 3]).margin == 2.0
    found = judge("eventually (x > 5)", x=[1, 4, 3])
    assert (found.status, found.margin, found.worst_time) == ("violated", -1.0, 1.0)
    assert found.time == 2.0, "only the end of the episode decides that it never was"


@pytest.mark.parametrize(
    "text, status",
    [
        ("always (x > 0)", "violated"),
        ("always (x >= 0)", "satisfied"),
        ("always (x < 0)", "violated"),
        ("always (x <= 0)", "satisfied"),
        ("always (x == 0)", "satisfied"),
        ("always (x != 0)", "violated"),
        ("eventually (x > 0)", "violated"),
        ("eventually (x >= 0)", "satisfied"),
        ("not (x > 0)", "satisfied"),
        ("not (x >= 0)", "violated"),
        ("(x > 0) iff (x >= 0)", "violated"),
        ("(x > 0) xor (x >= 0)", "satisfied"),
        ("(x > 0) iff (x < 0)", "satisfied"),
    ],
)
def test_on_the_bound_strictness_decides_and_the_margin_is_zero(text: str, status: str) -> None:
    found = judge(text, x=[0.0, 0.0])
    assert (found.status, found.margin) == (status, 0.0)


def test_equality_never_has_a_positive_margin_and_holds_at_zero() -> None:
    assert judge("x == 3", x=[3]).status == "satisfied"
    assert (judge("x == 3", x=[4.5]).status, judge("x == 3", x=[4.5]).margin) == ("violated", -1.5)
    assert (judge("x != 3", x=[4.5]).status, judge("x != 3", x=[4.5]).margin) == ("satisfied", 1.5)


def test_iff_and_xor_have_the_margin_of_their_implications() -> None:
    # rtamt gives -2 for the first: false, though both sides hold.
    found = judge("(x > 0) iff (y > 0)", x=[5], y=[3])
    assert (found.status, found.margin) == ("satisfied", 3.0)
    found = judge("(x > 0) xor (y > 0)", x=[5], y=[3])
    assert (found.status, found.margin) == ("violated", -3.0)


def test_a_window_counts_from_the_start_and_is_closed() -> None:
    x = [9, 1, 2, 3, 9]
    assert judge("always[1:3] (x <= 3)", x=x).status == "satisfied"
    assert judge("always[1:4] (x <= 3)", x=x).status == "violated"
    late = judge("always[1:3] (x < 3)", x=x, time=[10, 11, 12, 13, 14])
    assert (late.time, late.worst_time) == (13.0, 13.0)


def test_window_bounds_forgive_the_sum_of_float_steps() -> None:
    summed = [0.0]
    for _ in range(10):
        summed.append(summed[-1] + 0.1)
    assert summed[8] < 0.8
    x = [0.0] * 11
    x[8] = -1.0
    assert judge("always[0.8:1] (x >= 0)", time=summed, x=x).status == "violated"
    assert judge("always[0:0.8] (x >= 0)", time=summed, x=x).status == "violated"
    assert judge("always[0:0.7] (x >= 0)", time=summed, x=x).status == "satisfied"


@pytest.mark.parametrize(
    "text, x, status, interval",
    [
        ("always[0:5] (x > 0)", [1, 2, 3], "undecided", (-INF, 1.0)),
        ("always[0:5] (x > 0)", [1, -2, 3], "violated", (-INF, -2.0)),
        ("eventually[0:5] (x > 0)", [-1, -2, -3], "undecided", (-1.0, INF)),
        ("eventually[0:5] (x > 0)", [-1, 2, -3], "satisfied", (2.0, INF)),
        ("always[4:5] (x > 0)", [1, 2, 3], "undecided", (-INF, INF)),
        ("always[0:2] (x > 0)", [1, 2, 3], "satisfied", (1.0, 1.0)),
        ("always ((x > 0) implies (eventually[0:1] (x < 0)))", [1, -2, 3], "undecided", (-3.0, 2)),
        ("always ((x > 0) implies (eventually[0:1] (x < 0)))", [1, 2, -1], "violated", (-1, -1)),
        ("(x > 0) until[0:1] (x < 0)", [2], "undecided", (-2.0, 2.0)),
        ("(x > 0) until[0:1] (x < 0)", [2, 1], "violated", (-1.0, -1.0)),
        ("next (x > 0)", [1], "undecided", (-INF, INF)),
        ("s_next (x > 0)", [1], "undecided", (-INF, INF)),
        ("(x > 0) until[0:5] (x < -5)", [1, 2, 3], "undecided", (-5 - 1, 1)),
        ("(x > 0) until[0:2] (x < -5)", [1, 2, 3], "violated", (-6, -6)),
        ("(x > 0) until (x < -5)", [1, 2, 3], "violated", (-6, -6)),
        ("prev (x > 0)", [1], "satisfied", (INF, INF)),
        ("s_prev (x > 0)", [1], "violated", (-INF, -INF)),
        ("once[1:2] (x > 0)", [1], "violated", (-INF, -INF)),
    ],
)
def test_what_the_end_of_a_trace_leaves_open(
    text: str, x: list[float], status: str, interval: tuple[float, float]
) -> None:
    found = judge(text, x=x, step=1.0)
    assert found.status == status
    assert (found.lower, found.upper) == interval
    if status == "undecided":
        assert f"the trace ends at {len(x) - 1} s, which does not decide `" in found.detail
        assert found.robustness == interval[0], "a comparison with a limit fails closed"


def test_a_prefix_decides_only_what_no_further_sample_can_change() -> None:
    assert judge("always (x > 0)", x=[1, 2], ending="open").status == "undecided"
    assert judge("always (x > 0)", x=[1, -2], ending="open").status == "violated"
    assert judge("eventually (x > 0)", x=[-1, -2], ending="open").status == "undecided"
    assert judge("eventually (x > 0)", x=[-1, 2], ending="open").status == "satisfied"
    assert judge("always[0:1] (x > 0)", x=[1, 2], ending="open").status == "satisfied"
    assert judge("(x > 0) until (x > 5)", x=[1, 2], ending="open").status == "undecided"
    assert judge("(x > 0) until (x > 5)", x=[1, -2], ending="open").status == "violated"
    assert judge("(x > 0) until (x > 5)", x=[1, 6], ending="open").status == "satisfied"


def test_a_response_that_fails_is_decided_when_its_window_ends() -> None:
    text = "always ((x > 5) implies (eventually[0:2] (y < 0)))"
    found = judge(text, x=[0, 9, 0, 0, 0, 0], y=[1, 1, 1, 1, -1, -1])
    assert (found.status, found.time) == ("violated", 3.0)
    assert found.worst_time == 1.0


def test_what_the_whole_trace_shows_does_not_date_the_violation() -> None:
    text = "always ((x > 5) implies (always[0:3] (y > 0)))"
    found = judge(text, x=[0, 9, 0, 0, 0, 0], y=[1, 1, 1, -1, 1, 1])
    assert (found.status, found.time, found.worst_time) == ("violated", 3.0, 1.0)


def test_the_worst_time_is_where_the_margin_is_reached_and_not_where_it_might_be() -> None:
    text = "always (((always[2:2] (y > 0)) or (z > 0)) and (w > 0))"
    found = judge(text, y=[9, 9, 9], z=[1, 1, 9], w=[9, 9, 1])
    assert (found.status, found.lower, found.upper) == ("satisfied", 1.0, 1.0)
    assert found.worst_time == 2.0


def test_a_conjunction_is_as_good_as_its_worst_part() -> None:
    found = judge("always (x > 0) and always (y < 5)", x=[3, 2], y=[1, 4])
    assert (found.status, found.margin, found.worst_time) == ("satisfied", 1.0, 1.0)
    assert found.detail in ("always (y < 5)", "always (x > 0)")


def test_a_conjunction_is_violated_first_where_any_part_is() -> None:
    found = judge("always (x > 0) and always (y > 0)", x=[1, 1, -9], y=[1, -1, 1])
    assert (found.status, found.time, found.margin) == ("violated", 1.0, -9.0)
    assert found.worst_time == 2.0
    assert found.detail == "always (y > 0); always (x > 0)"


def test_one_violated_part_decides_whatever_is_still_open() -> None:
    found = judge("always[0:9] (x > 0) and always (y > 0)", x=[1, 1], y=[-1, 1])
    assert (found.status, found.margin, found.detail) == ("violated", -1.0, "always (y > 0)")
    assert judge("always[0:9] (x > 0) and always (y > 0)", x=[1, 1], y=[1, 1]).status == "undecided"
    far = judge("eventually[0:9] (x > 5) and always (y > 0)", x=[1, 1], y=[1, -1])
    assert (far.status, far.margin) == ("violated", -1.0), "the margin is that of the violation"


def test_other_roots_have_the_time_of_the_violation_or_the_start() -> None:
    assert judge("(x > 0) until (y > 0)", x=[1, -1, 1], y=[-1, -1, 1]).worst_time == 1.0
    assert judge("(x > 0) until (y > 0)", x=[1, 1, 1], y=[-1, -1, 1]).worst_time == 0.0


def test_huge_values_make_no_warning() -> None:
    assert judge("always (x > -1e308)", x=[1e308]).status == "satisfied"
    assert judge("always (x < -1e308)", x=[1e308]).margin == -INF


def test_a_trace_of_one_sample_is_judged() -> None:
    assert judge("always (x > 0) and eventually (x > 0)", x=[1]).margin == 1.0
    assert judge("always[0:0.3] (x > 0)", x=[1]).status == "undecided"
    assert judge("always[0:0.3] (x > 0)", x=[-1]).status == "violated"
    assert judge("always[0:0] (x > 0)", x=[1]).status == "satisfied"
    assert judge("once[0.3:0.7] (x > 0)", x=[1]).status == "violated"


def test_rows_of_equal_length_are_computed_together() -> None:
    rows = np.random.default_rng(1).normal(size=(150, 7))
    formula = parse("always ((x > 0) implies (eventually[1:2] (x < 0)))")
    whole = robustness(formula, {"x": rows}, 1.0)
    assert whole.shape == rows.shape
    for row, values in zip(rows, whole, strict=True):
        assert robustness(formula, {"x": row}, 1.0).tolist() == values.tolist()
    lower, upper = robustness_interval(formula, {"x": rows[:3]}, 1.0, complete=False)
    one = robustness_interval(formula, {"x": rows[2]}, 1.0, complete=False)
    assert (lower[2].tolist(), upper[2].tolist()) == (one[0].tolist(), one[1].tolist())


def test_no_traces_give_no_results() -> None:
    assert robustness_batch(parse("x > 0"), [], 1.0) == []


def test_of_violated_parts_the_first_one_decides_and_the_worst_one_has_the_margin() -> None:
    found = judge("always (x > 0) and always (y <= 10)", x=[1, 1, 1, -3], y=[9, 11, 9, 9])
    assert (found.status, found.time) == ("violated", 1.0)
    assert found.detail == "always (y <= 10); always (x > 0)"
    assert (found.margin, found.worst_time) == (-3.0, 3.0)


def test_a_worst_part_without_a_place_of_its_own_has_its_own_time() -> None:
    never = "((x < 9) until (z > 0))"
    found = judge(f"always (y <= 10) and {never}", x=[1, 1, 9, 1], y=[9, 11, 9, 9], z=[-5] * 4)
    assert (found.time, found.margin) == (1.0, -5.0)
    assert found.worst_time == judge(never, x=[1, 1, 9, 1], z=[-5] * 4).time == 2.0
