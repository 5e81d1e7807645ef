"""The bounds language: reading a formula, and judging a trace by it."""

from __future__ import annotations

import math
from typing import Any

import pytest

from pytest_dura import ConfigurationError
from pytest_dura.requirements.bounds import Evaluation, check_time_step, evaluate, parse
from pytest_dura.requirements.formula import Formula, Term


def judge(text: str, time: Any = None, *, complete: bool = True, **signals: Any) -> Evaluation:
    first = next(iter(signals.values()))
    time = range(len(first)) if time is None else time
    return evaluate(parse(text), list(time), signals, complete=complete)


@pytest.mark.parametrize(
    "text, terms",
    [
        ("always (gap > 0)", [Term("always", "gap", ">", 0.0)]),
        ("always(gap>0)", [Term("always", "gap", ">", 0.0)]),
        ("eventually[0:2.5] (x <= -1e-3)", [Term("eventually", "x", "<=", -0.001, 0.0, 2.5)]),
        ("always [1 : 2] (percept.gap >= +.5)", [Term("always", "percept.gap", ">=", 0.5, 1, 2)]),
        (
            "always (a > 0) and\n  eventually (b < 1)",
            [Term("always", "a", ">", 0.0), Term("eventually", "b", "<", 1.0)],
        ),
        ("((always (a > 0)) and (always (b > 0)))", [Term("always", n, ">", 0.0) for n in "ab"]),
    ],
)
def test_formulas_that_can_be_read(text: str, terms: list[Term]) -> None:
    formula = parse(text)
    assert list(formula.terms) == terms
    assert parse(str(formula)) == formula


@pytest.mark.parametrize(
    "text, column, expected",
    [
        ("", 1, "`always` or `eventually`"),
        ("gap > 0", 1, "`always` or `eventually`"),
        ("alway (gap > 0)", 1, "`always` or `eventually`"),
        ("always gap > 0", 8, "`(`"),
        ("always (gap >> 0)", 14, "a number"),
        ("always (gap == 0)", 13, "signals, numbers"),
        ("always (gap = 0)", 13, "signals, numbers"),
        ("always (gap > zero)", 15, "a number"),
        ("always (0 < gap)", 9, "the name of a signal"),
        ("always (and > 0)", 9, "the name of a signal"),
        ("always (gap > 0", 16, "`)`"),
        ("always (gap > 0) or always (x > 0)", 18, "`and` or the end"),
        ("always (gap > 0) and", 21, "`always` or `eventually`"),
        ("always (gap > 0) always (x > 0)", 18, "`and` or the end"),
        ("always (gap > 0)\nnonsense", 18, "`and` or the end"),
        ("always[2:1] (gap > 0)", 8, "0 <= a <= b"),
        ("always[-1:1] (gap > 0)", 8, "0 <= a <= b"),
        ("always[0:] (gap > 0)", 10, "seconds"),
        ("always[0:1e999] (gap > 0)", 10, "finite"),
        ("always[0:2ms] (gap > 0)", 10, "signals, numbers"),
        ("always (gap > 1.2.3)", 15, "signals, numbers"),
        ("always (gap > 0) $", 18, "signals, numbers"),
        ("(" * 100, 52, "at most 50 levels"),
    ],
)
def test_an_error_points_at_its_place(text: str, column: int, expected: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        parse(text)
    error = caught.value
    assert f"at column {column}" in error.problem
    assert expected in str(error.expected)
    caret = error.problem.splitlines()[-1]
    assert caret.index("^") == 4 + column - 1
    assert "always (gap > 0)" in str(error.remedy)


def test_a_long_formula_is_refused_shortly() -> None:
    with pytest.raises(ConfigurationError, match="too long") as caught:
        parse("always (gap > 0) and " * 1000)
    assert len(str(caught.value)) < 500


def test_an_unknown_signal_is_marked_and_the_known_ones_are_listed() -> None:
    with pytest.raises(ConfigurationError) as caught:
        parse("always (speed > 0) and always (gapp > 0)", ("gap", "speed"))
    error = caught.value
    assert error.expected == "one of gap, speed"
    assert error.remedy == "did you mean 'gap'?"
    formula, caret = error.problem.splitlines()[1:]
    assert formula[caret.index("^") :].startswith("gapp")


def test_what_a_formula_says_of_itself() -> None:
    formula = parse("always[0:3] (b > 0) and eventually[1:2] (percept.a < 1) and always (b < 9)")
    assert formula.signals == ("b", "percept.a")
    assert formula.percept_signals == ("percept.a",)
    assert formula.horizon == 3.0
    assert parse("always (b > 0)").horizon is None


def test_always_takes_the_worst_sample() -> None:
    found = judge("always (x >= 2)", x=[5, 3, 4])
    assert (found.status, found.margin, found.worst_time) == ("satisfied", 1.0, 1.0)
    assert (found.lower, found.upper, found.time) == (1.0, 1.0, None)


def test_a_violation_has_its_first_time_and_its_worst_margin() -> None:
    found = judge("always (x < 2)", x=[1, 2.5, 7, 3], time=[0, 0.1, 0.2, 0.3])
    assert (found.status, found.time) == ("violated", 0.1)
    assert (found.margin, found.worst_time) == (-5.0, 0.2)


def test_eventually_takes_the_best_sample() -> None:
    assert judge("eventually (x > 2)", x=[1, 4, 3]).margin == 2.0
    found = judge("eventually (x > 5)", x=[1, 4, 3], time=[0, 1, 2])
    assert (found.status, found.margin, found.worst_time) == ("violated", -1.0, 1.0)
    assert found.time == 2.0, "only the end of the episode decides that it never was"


@pytest.mark.parametrize(
    "text, status",
    [
        ("always (x > 0)", "violated"),
        ("always (x >= 0)", "satisfied"),
        ("always (x < 0)", "violated"),
        ("always (x <= 0)", "satisfied"),
        ("eventually (x > 0)", "violated"),
        ("eventually (x >= 0)", "satisfied"),
    ],
)
def test_on_the_bound_strictness_decides_and_the_margin_is_zero(text: str, status: str) -> None:
    found = judge(text, x=[0.0, 0.0])
    assert (found.status, found.margin) == (status, 0.0)


def test_a_window_counts_from_the_start_and_is_closed() -> None:
    x = [9, 1, 2, 3, 9]
    assert judge("always[1:3] (x <= 3)", x=x).status == "satisfied"
    assert judge("always[1:4] (x <= 3)", x=x).status == "violated"
    assert judge("always[1:3] (x < 3)", x=x).time == 3.0
    late = judge("always[1:3] (x < 3)", x=x, time=[10, 11, 12, 13, 14])
    assert late.time == 13.0


def test_window_bounds_forgive_the_sum_of_float_steps() -> None:
    time = [i * 0.1 for i in range(11)]
    assert time[3] != 0.3
    x = [0.0] * 11
    x[3] = -1.0
    assert judge("always[0:0.3] (x >= 0)", time=time, x=x).status == "violated"
    assert judge("always[0.3:1] (x >= 0)", time=time, x=x).status == "violated"
    summed = [0.0]
    for _ in range(10):
        summed.append(summed[-1] + 0.1)
    assert summed[8] < 0.8
    x = [0.0] * 11
    x[8] = -1.0
    assert judge("always[0.8:1] (x >= 0)", time=summed, x=x).status == "violated"


@pytest.mark.parametrize(
    "text, x, status, interval",
    [
        ("always[0:5] (x > 0)", [1, 2, 3], "undecided", (-math.inf, 1.0)),
        ("always[0:5] (x > 0)", [1, -2, 3], "violated", (-math.inf, -2.0)),
        ("eventually[0:5] (x > 0)", [-1, -2, -3], "undecided", (-1.0, math.inf)),
        ("eventually[0:5] (x > 0)", [-1, 2, -3], "satisfied", (2.0, math.inf)),
        ("always[4:5] (x > 0)", [1, 2, 3], "undecided", (-math.inf, math.inf)),
        ("always[0:2] (x > 0)", [1, 2, 3], "satisfied", (1.0, 1.0)),
    ],
)
def test_a_trace_that_ends_before_the_window(
    text: str, x: list[float], status: str, interval: tuple[float, float]
) -> None:
    found = judge(text, x=x)
    assert found.status == status
    assert (found.lower, found.upper) == interval
    if status == "undecided":
        assert "the trace ends at 2 s" in found.detail
        assert found.robustness == interval[0], "a comparison with a limit fails closed"


def test_a_prefix_decides_only_what_no_further_sample_can_change() -> None:
    assert judge("always (x > 0)", x=[1, 2], complete=False).status == "undecided"
    assert judge("always (x > 0)", x=[1, -2], complete=False).status == "violated"
    assert judge("eventually (x > 0)", x=[-1, -2], complete=False).status == "undecided"
    assert judge("eventually (x > 0)", x=[-1, 2], complete=False).status == "satisfied"
    assert judge("always[0:1] (x > 0)", x=[1, 2], complete=False).status == "satisfied"


def test_a_conjunction_is_as_good_as_its_worst_part() -> None:
    found = judge("always (x > 0) and always (y < 5)", x=[3, 2], y=[1, 4])
    assert (found.status, found.margin, found.worst_time) == ("satisfied", 1.0, 1.0)


def test_a_conjunction_is_violated_first_where_any_part_is() -> None:
    found = judge("always (x > 0) and always (y > 0)", x=[1, 1, -9], y=[1, -1, 1])
    assert (found.status, found.time, found.margin) == ("violated", 1.0, -9.0)


def test_one_violated_part_decides_whatever_is_still_open() -> None:
    found = judge("always[0:9] (x > 0) and always (y > 0)", x=[1, 1], y=[-1, 1])
    assert (found.status, found.margin) == ("violated", -1.0)
    assert judge("always[0:9] (x > 0) and always (y > 0)", x=[1, 1], y=[1, 1]).status == "undecided"
    far = judge("eventually[0:9] (x > 5) and always (y > 0)", x=[1, 1], y=[1, -1])
    assert (far.status, far.margin) == ("violated", -1.0), "the margin is that of the violation"


def test_huge_values_make_no_warning() -> None:
    assert judge("always (x > -1e308)", x=[1e308]).status == "satisfied"


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_samples_that_are_not_finite_are_refused(bad: float) -> None:
    with pytest.raises(ConfigurationError, match=r"'x' is not finite at t = 2\.00 s"):
        judge("always (x >= 2)", x=[5, 5, bad, 5, -9])


def test_an_empty_trace_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="empty trace"):
        judge("always (x > 0)", x=[])


def test_a_trace_of_one_sample_is_judged() -> None:
    assert judge("always (x > 0) and eventually (x > 0)", x=[1]).margin == 1.0


def test_a_signal_that_the_trace_does_not_have() -> None:
    with pytest.raises(ConfigurationError) as caught:
        judge("always (xx > 0)", x=[1], y=[1])
    assert caught.value.expected == "one of x, y"
    assert caught.value.remedy == "did you mean 'x'?"


def test_columns_of_another_length_are_refused() -> None:
    with pytest.raises(ConfigurationError, match="different lengths"):
        judge("always (x > 0)", time=[0, 1, 2], x=[1, 2])


def test_an_interval_between_two_samples_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="no sample falls"):
        judge("always[0.2:0.8] (x > 0)", x=[1, 2, 3])
    formula = parse("always[0.2:0.8] (x > 0)")
    with pytest.raises(ConfigurationError, match="no sample falls"):
        check_time_step(formula, 1.0)
    check_time_step(formula, 0.2)
    check_time_step(Formula((Term("always", "x", ">", 0.0, 0.3, 0.3),)), 0.1)
