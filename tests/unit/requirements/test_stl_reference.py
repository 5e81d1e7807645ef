"""rtamt by example: that it reads our texts as we do, and its traps."""

from __future__ import annotations

import numpy as np
import pytest
from rtamt_oracle import raw_robustness, robustness

from pytest_dura import ConfigurationError
from pytest_dura.requirements import parse

TRACE = {
    "a": [3.0, -1.0, 2.0, 5.0, -4.0, 1.0, 0.5],
    "b": [-2.0, 4.0, 1.0, -3.0, 2.0, 6.0, -1.0],
    "c": [1.0, 7.0, -5.0, 2.5, 3.0, -2.0, 4.0],
}


def raw(text: str) -> list[float]:
    return raw_robustness(text, TRACE)


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
    assert robustness(parse(text), TRACE, 1.0) == raw(text)


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
    assert robustness(parse(read), TRACE, 1.0) == raw(read)


def test_iff_and_xor_are_written_out_because_rtamts_have_one_sign() -> None:
    assert max(raw("(a > 0) iff (b > 0)")) <= 0.0
    assert min(raw("(a > 0) xor (b > 0)")) >= 0.0
    a, b = np.array(TRACE["a"]), np.array(TRACE["b"])
    both = np.minimum(np.maximum(-a, b), np.maximum(-b, a))
    assert robustness(parse("a > 0 iff b > 0"), TRACE, 1.0) == both.tolist()
    assert robustness(parse("a > 0 xor b > 0"), TRACE, 1.0) == (-both).tolist()
    assert 0 < (both > 0).sum() < len(both)


def test_what_rtamt_itself_fails_on() -> None:
    with pytest.raises(Exception, match="Attempting full context"):
        raw("a - 1 > 0")
    assert robustness(parse("a - 1 > 0"), TRACE, 1.0) == [x - 1.0 for x in TRACE["a"]]
    with pytest.raises(AttributeError):
        raw("(a > 0) unless (b > 0)")
    unless = robustness(parse("(a > 0) unless (b > 0)"), TRACE, 1.0)
    written = raw("(always (a > 0)) or ((a > 0) until (b > 0))")
    assert unless == written


@pytest.mark.parametrize("step", [0.1, 0.3, 1 / 15, 1e-3, 2.0])
def test_windows_follow_the_time_step(step: float) -> None:
    formula = parse(f"eventually[{step!r}:{3 * step!r}] (a > 1)")
    assert robustness(formula, TRACE, step) == raw("eventually[1:3] (a > 1)")


def test_signals_may_have_any_name() -> None:
    names = ("time", "s", "out", "percept.a", "F", "true")
    formula = parse("time > s and (out > percept.a or F > true)", names)
    found = robustness(formula, {name: TRACE["abc"[i % 3]] for i, name in enumerate(names)}, 1.0)
    assert found == raw("a > b and (c > a or b > c)")
