"""Traces, times and expressions that no formula is judged on."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from stl_judging import judge

from pytest_dura import ConfigurationError
from pytest_dura.requirements import evaluate, parse, robustness, robustness_batch
from pytest_dura.requirements.stl.evaluation import _time_step

INF = math.inf


@pytest.mark.parametrize("bad", [math.nan, INF, -INF])
def test_samples_that_are_not_finite_are_refused(bad: float) -> None:
    with pytest.raises(ConfigurationError, match=r"'x' is not finite at t = 2\.00 s"):
        judge("always (x >= 2)", x=[5, 5, bad, 5, -9])
    found = judge("always (x >= 2)", x=[5, 5], other=[bad, bad])
    assert found.status == "satisfied", "of signals that are not read, nothing is asked"


@pytest.mark.parametrize(
    "text, x, expression, found",
    [
        ("always (1 / x > 0)", [2, 1, 0], "1 / x", INF),
        ("always (1 / (1 / x) >= 0)", [2, 1, 0], "1 / x", INF),
        ("always (sqrt(x) >= 0)", [2, 1, -1], "sqrt(x)", math.nan),
        ("always (exp(x) >= 0)", [2, 1, 1000], "exp(x)", INF),
        ("always (pow(x, -1) >= 0)", [2, 1, 0], "pow(x, -1)", INF),
        ("always (x * 1e307 * 10 > 0)", [1, 1, 2], "(x * 1e+307) * 10", INF),
    ],
)
def test_expressions_that_are_not_finite_are_refused(
    text: str, x: list[float], expression: str, found: float
) -> None:
    with pytest.raises(ConfigurationError) as caught:
        judge(text, x=x)
    assert caught.value.problem == f"the expression `{expression}` is not finite at t = 2.00 s"
    assert caught.value.found == pytest.approx(found, nan_ok=True)


def test_an_empty_trace_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="empty trace"):
        judge("always (x > 0)", x=[])
    with pytest.raises(ConfigurationError, match="empty trace"):
        robustness(parse("x > 0"), {"x": []}, 1.0)
    with pytest.raises(ConfigurationError, match="empty trace"):
        robustness_batch(parse("x > 0"), [{"x": [1]}, {"x": []}], 1.0)


def test_a_signal_that_the_trace_does_not_have() -> None:
    with pytest.raises(ConfigurationError) as caught:
        judge("always (xx > 0)", x=[1], y=[1])
    assert caught.value.expected == "one of x, y"
    assert caught.value.remedy == "did you mean 'x'?"


@pytest.mark.parametrize("x", [[1, 2], [[1, 2, 3]], 4.0])
def test_columns_of_another_shape_are_refused(x: Any) -> None:
    with pytest.raises(ConfigurationError, match="different lengths"):
        evaluate(parse("always (x > 0)"), [0, 1, 2], {"x": x})


@pytest.mark.parametrize("x", ["abc", [1, "b", 3], [[1], [1, 2], 3], {"a": 1}])
def test_columns_that_are_no_numbers_are_refused(x: Any) -> None:
    with pytest.raises(ConfigurationError, match="'x' is no array of numbers"):
        evaluate(parse("always (x > 0)"), [0, 1, 2], {"x": x})


def test_columns_that_do_not_fit_each_other_are_refused_without_a_time() -> None:
    with pytest.raises(ConfigurationError, match="different lengths"):
        robustness(parse("x > y"), {"x": [1, 2], "y": [1, 2, 3]}, 1.0)
    with pytest.raises(ConfigurationError, match="traces or rows"):
        robustness(parse("x > 0"), {"x": np.zeros((2, 2, 2))}, 1.0)
    with pytest.raises(ConfigurationError, match="trace 1 is not one trace"):
        robustness_batch(parse("x > 0"), [{"x": [1]}, {"x": [[1]]}], 1.0)


@pytest.mark.parametrize(
    "time, said",
    [
        ([0, 1, 2.02, 3.02], "1.02 s after t = 1.00 s"),
        ([0, 1, 1, 2], "0 s after t = 1.00 s"),
        ([3, 2, 1, 0], "even distances"),
        ([0, 0, 0, 0], "even distances"),
        ([0, 1, math.nan, 3], "a time is not finite"),
        ([0, 1, 2, INF], "a time is not finite"),
    ],
)
def test_uneven_sampling_is_refused(time: list[float], said: str) -> None:
    with pytest.raises(ConfigurationError, match=said):
        judge("always (x > 0)", time=time, x=[1, 2, 3, 4])


def test_sums_of_float_steps_have_the_step_they_were_made_of() -> None:
    assert _time_step(np.cumsum([0.0] + [0.1] * 200), None) == 0.1


def test_sampling_may_jitter_by_one_percent_and_must_fit_a_declared_step() -> None:
    assert judge("always (x > 0)", time=[0, 1.005, 2, 3], x=[1, 2, 3, 4]).status == "satisfied"
    with pytest.raises(ConfigurationError, match="even distances") as caught:
        judge("always (x > 0)", time=[0, 1, 2, 3], x=[1, 2, 3, 4], step=0.5)
    assert "the declared time step" in str(caught.value.expected)


def test_a_window_between_two_samples_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="falls between two samples"):
        judge("always[0.2:0.8] (x > 0)", x=[1, 2, 3])
    with pytest.raises(ConfigurationError, match="falls between two samples"):
        robustness(parse("once[0.2:0.8] (x > 0)"), {"x": [1, 2, 3]}, 1.0)


def test_a_batch_names_the_trace_that_it_refuses() -> None:
    traces = [{"x": [1.0] * 5}, {"x": [1.0, 2.0]}, {"x": [1.0, 2.0, math.nan]}]
    with pytest.raises(ConfigurationError, match=r"not finite at t = 0\.20 s of trace 2"):
        robustness_batch(parse("x > 0"), traces, 0.1)
    traces[2] = {"x": [1.0, 2.0, 0.0]}
    with pytest.raises(
        ConfigurationError, match=r"`1 / x` is not finite at t = 0\.20 s of trace 2"
    ):
        robustness_batch(parse("1 / x > 0"), traces, 0.1)


def test_a_sample_that_is_not_finite_is_found_in_the_last_of_many_rows() -> None:
    rows = np.ones((150, 4))
    rows[140, 3] = np.nan
    with pytest.raises(ConfigurationError, match=r"not finite at t = 0\.30 s of trace 140"):
        robustness(parse("always (x > 0)"), {"x": rows}, 0.1)
