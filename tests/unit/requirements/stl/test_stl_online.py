"""A formula judged sample by sample: long windows, what is kept, and what is refused."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from pytest_dura.core import ConfigurationError
from pytest_dura.requirements import OnlineFormula, parse, robustness
from pytest_dura.requirements.stl import online
from pytest_dura.requirements.stl.online import Sample


def judged(text: str, values: Any, time_step: float = 0.5) -> list[Sample]:
    monitor = OnlineFormula(parse(text), time_step)
    return [monitor.update({"x": value}) for value in values]


def refusal(text: str, *values: Any) -> ConfigurationError:
    with pytest.raises(ConfigurationError) as caught:
        judged(text, values)
    return caught.value


@pytest.mark.parametrize(
    "text, holds",
    [
        ("historically (x > 0)", [True, True, False, False, False, False]),
        ("historically[0:1] (x > 0)", [True, True, False, False, False, True]),
        ("historically[0.5:1] (x > 0)", [True, True, True, False, False, True]),
        ("once[1:1] (x == 0)", [False, False, False, False, True, False]),
        ("(x > 0) since (x == 2)", [False, True, False, False, False, False]),
        ("(x < 3) since[0.5:1] (x == 2)", [False, False, True, False, False, False]),
        ("(x > 0) since[0.5:1] (x <= 0)", [False, False, False, True, True, False]),
        ("prev (x == 1)", [True, True, False, False, False, False]),
        ("rise (x > 1)", [False, True, False, True, False, False]),
        ("fall (x > 1)", [True, False, True, False, False, False]),
    ],
)
def test_what_holds_when(text: str, holds: list[bool]) -> None:
    found = judged(text, [1, 2, 0, 3, 4, 5])
    assert [one.holds for one in found] == holds


def test_on_the_bound_the_margin_is_zero_and_the_comparison_tells_the_truth() -> None:
    assert judged("historically (x >= 2)", [3, 2, 3]) == [(1.0, True), (0.0, True), (0.0, True)]
    assert judged("historically (x > 2)", [3, 2, 3]) == [(1.0, True), (0.0, False), (0.0, False)]
    both = judged("historically ((x >= 2) and (x > 1.5))", [2.5, 2])
    assert both == [(0.5, True), (0.0, True)]


def test_before_the_first_sample_nothing_was() -> None:
    assert judged("once[0.5:1] (x > 0)", [1])[0] == (-math.inf, False)
    assert judged("historically[0.5:1] (x > 0)", [-1])[0] == (math.inf, True)
    assert judged("s_prev (x > 0)", [1])[0] == (-math.inf, False)


@pytest.mark.parametrize(
    "text",
    [
        "historically[0:100] (x > 0)",
        "once[30:130] (x > 1.5)",
        "(x > -1.5) since[20:90] (x > 1)",
        "historically (once[0:5] (x > 0.5))",
        "(exp(x / 3) > 1.1) and (pow(abs(x) + 0.1, 0.3) > sqrt(abs(x)) / 2)",
    ],
)
def test_long_traces_and_windows(text: str) -> None:
    values = np.random.default_rng(3).normal(size=3000)
    expected = robustness(parse(text), {"x": values}, 0.5).tolist()
    assert [one.robustness for one in judged(text, values)] == expected


@pytest.mark.parametrize("values", [range(4000), range(4000, 0, -1), [1.0] * 4000])
@pytest.mark.parametrize("least", [True, False])
def test_no_more_is_kept_than_the_window_holds(values: Any, least: bool) -> None:
    stream = online.Sliding(5, 24, least=least)
    for value in values:
        stream((float(value), value > 2000))
        assert len(stream._queue) <= 20
        assert len(stream._delay._held) <= 5


def test_equal_parts_keep_a_state_each() -> None:
    formula = "(rise (x > 0)) and (once[0.5:0.5] (not (rise (x > 0))))"
    assert [one.holds for one in judged(formula, [1, 0, 1, 0])] == [False, False, True, False]


def test_a_reset_forgets_the_trace() -> None:
    monitor = OnlineFormula(parse("historically (x > 0)"), 0.1)
    assert not monitor.update({"x": -1.0}).holds
    assert not monitor.update({"x": 1.0}).holds
    monitor.reset()
    assert monitor.update({"x": 1.0}) == (1.0, True)
    with pytest.raises(ConfigurationError, match=r"at t = 0\.10 s"):
        monitor.update({})


def test_other_signals_may_be_given_and_need_no_value() -> None:
    monitor = OnlineFormula(parse("x > 0"), 0.1)
    assert monitor.update({"x": np.float32(0.5), "y": math.nan}) == (0.5, True)
    assert monitor.update({"x": True}) == (1.0, True)


def test_a_look_ahead_is_refused_and_so_is_a_bound_between_samples() -> None:
    with pytest.raises(ConfigurationError, match="the gap watch cannot know the future") as caught:
        OnlineFormula(parse("always[0:1] (x > 0)"), 0.1, "the gap watch")
    assert "historically" in str(caught.value)
    with pytest.raises(ConfigurationError, match="falls between two samples"):
        OnlineFormula(parse("once[0:0.25] (x > 0)"), 0.1)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, np.float64("nan")])
def test_a_sample_that_is_not_finite_is_refused(bad: float) -> None:
    error = refusal("once (x > 0)", 1.0, 1.0, bad)
    assert error.problem == "the signal 'x' is not finite at t = 1.00 s"
    assert str(error.found) == str(float(bad))


@pytest.mark.parametrize("bad", ["3", None, [1.0], np.array([1.0]), {}])
def test_a_sample_that_is_no_number_is_refused(bad: Any) -> None:
    error = refusal("once (x > 0)", 1.0, bad)
    assert error.problem == "the signal 'x' is no number at t = 0.50 s"


@pytest.mark.parametrize("text", ["1 / x > 0", "sqrt(x - 0.5) > 0", "exp(x + 1000) > 0"])
def test_an_expression_without_a_value_is_refused(text: str) -> None:
    error = refusal(text, 1.0 if "exp" not in text else -1000.0, 0.0)
    expression = text.removesuffix(" > 0").replace("0.5", "(0.5)")
    assert error.problem == f"the expression `{expression}` is not finite at t = 0.50 s"


def test_a_signal_that_is_missing_is_named_and_marked() -> None:
    monitor = OnlineFormula(parse("once (gap > 0)"), 0.1)
    monitor.update({"gap": 1.0})
    with pytest.raises(ConfigurationError) as caught:
        monitor.update({"gaps": 1.0, "speed": 2.0})
    text = str(caught.value)
    assert "no signal 'gap' at t = 0.10 s" in text
    assert "once (gap > 0)\n          ^" in text
    assert "one of gaps, speed" in text
    assert "did you mean 'gaps'?" in text
    with pytest.raises(ConfigurationError, match="no signals at all"):
        monitor.update({})


def test_a_refused_sample_changes_nothing() -> None:
    monitor = OnlineFormula(parse("(historically (x > 0)) and (1 / y > 0)"), 0.1)
    assert monitor.update({"x": 1.0, "y": 1.0}).holds
    with pytest.raises(ConfigurationError):
        monitor.update({"x": -1.0, "y": 0.0})
    assert monitor.update({"x": 1.0, "y": 1.0}).holds
