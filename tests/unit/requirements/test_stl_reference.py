"""rtamt as the reference: that it reads our texts as we do, and its traps."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from pytest_dura import ConfigurationError
from pytest_dura.requirements.stl.language.grammar import rtamt_modules
from pytest_dura.requirements.stl.language.parsing import parse
from pytest_dura.requirements.stl.offline.reference import rtamt_robustness

TRACE = {
    "a": [3.0, -1.0, 2.0, 5.0, -4.0, 1.0, 0.5],
    "b": [-2.0, 4.0, 1.0, -3.0, 2.0, 6.0, -1.0],
    "c": [1.0, 7.0, -5.0, 2.5, 3.0, -2.0, 4.0],
}


def raw(text: str) -> list[float]:
    """What rtamt itself makes of a text."""
    specification: Any = rtamt_modules().rtamt.StlDiscreteTimeOfflineSpecification()
    for name in TRACE:
        specification.declare_var(name, "float")
    specification.spec = text
    specification.parse()
    columns = {name: list(column) for name, column in TRACE.items()}
    return [x for _, x in specification.evaluate({"time": list(range(7)), **columns})]


@pytest.mark.parametrize(
    "text",
    [
        "not a > 1",
        "not a > 1 and b > 2",
        "a > 1 and b > 2 or c > 3",
        "a > 1 or b > 2 and c > 3",
        "a > 1 and b > 2 -> c > 3",
        "a - b - c > 0",
        "a / b / c > 0",
        "a + b - c > 0",
        "a * b / c + 2 > 0",
        "a - b * c !== 2",
        "a == b or a < c or b <= c or a >= 2",
        "always a > 1",
        "G[0:2] (a > 1) and F[1:3] (b > 2)",
        "O[0:2] (a > 1) or H[1,3] (b > 2)",
        "a > -4.5 U[0:3] b > 2",
        "a > -4.5 until b > 2",
        "a > -4.5 S[1:3] b > 2",
        "a > -4.5 since b > 2",
        "a > 0 unless[1:2] b > 2",
        "a > 1 implies eventually[0:2] b > 2",
        "(X (a > 1)) or (Y (b > 1))",
        "next a > 1",
        "prev a > 1",
        "s_next a > 1",
        "s_prev a > 1",
        "rise(a > 1) or fall(b > 1)",
        "abs(a) > sqrt(exp(b)) + pow(c, 2)",
        "historically (once (a > 1))",
        "always[0:2000ms] (a > 1)",
        "eventually[1s:3000000us] (a > 1)",
    ],
)
def test_a_text_means_what_it_means_to_rtamt(text: str) -> None:
    assert rtamt_robustness(parse(text), TRACE, 1.0).tolist() == raw(text)


@pytest.mark.parametrize(
    "surprising, read",
    [
        ("a - b + c > 0", "a - (b + c) > 0"),
        ("a / b * c > 0", "a / (b * c) > 0"),
        ("a > 0 -> b > 0 -> c > 0", "((a > 0) -> (b > 0)) -> (c > 0)"),
        ("a > 0 until b > 0 and c > 0", "((a > 0) until (b > 0)) and (c > 0)"),
        ("always (a > 0) implies (b > 0)", "(always (a > 0)) implies (b > 0)"),
    ],
)
def test_what_we_refuse_is_read_by_rtamt_against_expectation(surprising: str, read: str) -> None:
    assert raw(surprising) == raw(read)
    with pytest.raises(ConfigurationError):
        parse(surprising)
    assert rtamt_robustness(parse(read), TRACE, 1.0).tolist() == raw(read)


def test_iff_and_xor_are_written_out_because_rtamts_have_one_sign() -> None:
    assert max(raw("(a > 0) iff (b > 0)")) <= 0.0
    assert min(raw("(a > 0) xor (b > 0)")) >= 0.0
    a, b = np.array(TRACE["a"]), np.array(TRACE["b"])
    both = np.minimum(np.maximum(-a, b), np.maximum(-b, a))
    assert rtamt_robustness(parse("a > 0 iff b > 0"), TRACE, 1.0).tolist() == both.tolist()
    assert rtamt_robustness(parse("a > 0 xor b > 0"), TRACE, 1.0).tolist() == (-both).tolist()
    assert 0 < (both > 0).sum() < len(both)


def test_what_rtamt_itself_fails_on() -> None:
    with pytest.raises(Exception, match="Attempting full context"):
        raw("a - 1 > 0")
    assert rtamt_robustness(parse("a - 1 > 0"), TRACE, 1.0).tolist() == [
        x - 1.0 for x in TRACE["a"]
    ]
    with pytest.raises(AttributeError):
        raw("(a > 0) unless (b > 0)")
    unless = rtamt_robustness(parse("(a > 0) unless (b > 0)"), TRACE, 1.0)
    written = raw("(always (a > 0)) or ((a > 0) until (b > 0))")
    assert unless.tolist() == written


@pytest.mark.parametrize("step", [0.1, 0.3, 1 / 15, 1e-3, 2.0])
def test_windows_follow_the_time_step(step: float) -> None:
    formula = parse(f"eventually[{step!r}:{3 * step!r}] (a > 1)")
    assert rtamt_robustness(formula, TRACE, step).tolist() == raw("eventually[1:3] (a > 1)")


def test_signals_may_have_any_name() -> None:
    names = ("time", "s", "out", "percept.a", "F", "true")
    formula = parse("time > s and (out > percept.a or F > true)", names)
    found = rtamt_robustness(
        formula, {name: TRACE["abc"[i % 3]] for i, name in enumerate(names)}, 1.0
    )
    assert found.tolist() == raw("a > b and (c > a or b > c)")


def test_inputs_are_left_alone() -> None:
    column = [1.0, 2.0]
    array = np.array(column)
    rtamt_robustness(parse("always[0:5] (a > b)"), {"a": column, "b": array}, 1.0)
    assert (column, array.tolist()) == ([1.0, 2.0], [1.0, 2.0])


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_samples_that_are_not_finite_are_refused(bad: float) -> None:
    with pytest.raises(ConfigurationError, match="'a' is not finite at sample 2"):
        rtamt_robustness(parse("always (a >= 2)"), {"a": [5, 5, bad, 5, -9]}, 1.0)


@pytest.mark.parametrize(
    "columns",
    [{"a": [], "b": []}, {"a": [1], "b": [1]}, {"a": [1, 2], "b": [1, 2, 3]}, {"a": 1, "b": 2}],
)
def test_columns_of_no_or_of_several_lengths_are_refused(columns: dict[str, Any]) -> None:
    with pytest.raises(ConfigurationError, match="cannot evaluate these columns") as caught:
        rtamt_robustness(parse("a > b"), columns, 1.0)
    assert "shape" in str(caught.value.found)


def test_a_signal_without_a_column_is_unknown() -> None:
    with pytest.raises(ConfigurationError, match="unknown signal 'aa'"):
        rtamt_robustness(parse("aa > 1"), TRACE, 1.0)


def test_windows_between_samples_are_refused() -> None:
    with pytest.raises(ConfigurationError, match="falls between two samples"):
        rtamt_robustness(parse("always[0:0.5] (a > 1)"), TRACE, 1.0)


@pytest.mark.parametrize(
    "text", ["1 / a > 1", "sqrt(a) > 1", "exp(a * 1000) > 1", "pow(a, -1) > 1"]
)
def test_expressions_without_a_value_are_one_clear_error(text: str) -> None:
    with pytest.raises(ConfigurationError, match="rtamt cannot evaluate"):
        rtamt_robustness(parse(text), {"a": [0.0, -1.0, 1.0]}, 1.0)
