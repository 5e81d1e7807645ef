"""By how much a check is missed: what the text says is what the trace shows, in its unit."""

from __future__ import annotations

import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pytest_dura.requirements.model import Paired
from pytest_dura.requirements.shortfalls import pair_shortfall, shortfall
from pytest_dura.requirements.stl.evaluation import evaluate
from pytest_dura.requirements.stl.parser import parse

UNITS = {
    "gap": "m", "speed": "m/s", "limit": "m/s", "jerk": "m/s3", "cleared": "0 or 1", "ratio": "1",
}  # fmt: skip
NUMBERS = st.integers(-4000, 4000).map(lambda number: number / 8)
"""Exact in binary, so that a margin gives the value back."""
TRACES = st.lists(NUMBERS, min_size=1, max_size=12)


def judged(check: str, **signals: list[float]) -> tuple[float, float | None]:
    length = len(next(iter(signals.values())))
    time = [0.1 * sample for sample in range(length)]
    found = evaluate(parse(check, None), time, signals)
    return found.robustness, found.time


def amounts(text: str) -> list[float]:
    return [float(number) for number in re.findall(r"(-?[\d.]+(?:e[+-]?\d+)?) m\b", text)]


@settings(derandomize=True)
@given(TRACES, NUMBERS, st.sampled_from([">=", ">", "<=", "<"]))
def test_a_bound_that_is_missed_states_the_worst_value_and_the_bound(
    gaps: list[float], bound: float, sign: str
) -> None:
    check = f"always (gap {sign} {bound})"
    margin, time = judged(check, gap=gaps)
    if margin > 0 or (margin == 0 and "=" in sign):
        return
    text = shortfall(check, margin, time, UNITS)
    worst = min(gaps) if ">" in sign else max(gaps)
    shown, stated = amounts(text)
    assert shown == pytest.approx(worst, rel=6e-3)
    assert stated == bound
    assert (shown == bound) == (worst == bound)  # rounding hides no violation
    assert f"first at t = {time:.2f} s" in text


@settings(derandomize=True)
@given(st.lists(st.tuples(NUMBERS, NUMBERS), min_size=1, max_size=12))
def test_a_condition_and_its_bound_are_both_true_of_some_sample(
    samples: list[tuple[float, float]],
) -> None:
    gaps, speeds = map(list, zip(*samples, strict=True))
    check = "always (gap < 5 implies speed <= 6)"
    margin, time = judged(check, gap=gaps, speed=speeds)
    if margin >= 0:
        return
    text = shortfall(check, margin, time, UNITS)
    match = re.match(r"speed is (\S+) m/s or more where .*, while gap is (\S+) m or less", text)
    assert match, text
    least, most = float(match[1]), float(match[2])
    slack = 6e-3 * max(1.0, abs(least), abs(most))
    assert any(gap <= most + slack and speed >= least - slack for gap, speed in samples)


@pytest.mark.parametrize(
    "check, margin, text",
    [
        ("eventually[0:35] (cleared >= 1)", -1.0, "`cleared` does not hold within 35 s"),
        (
            "eventually (cleared >= 1)", -1.0,
            "`cleared` does not hold until the end at t = 5.20 s",
        ),
        (
            "eventually[0:10] (speed >= 5)", -1.25,
            "speed is 3.75 m/s at most where at least 5 m/s is required within 10 s",
        ),
        (
            "always (loop.recovering_for <= 10)", -25.6,
            "loop.recovering_for is 35.6 s where at most 10 s is allowed, first at t = 5.20 s",
        ),
        ("always (cleared <= 0)", -1.0, "`cleared <= 0` does not hold, first at t = 5.20 s"),
        (
            "always (ratio < 2)", -1.0,
            "ratio is 3 where less than 2 is allowed, first at t = 5.20 s",
        ),
        ("always (speed <= limit)", -2.5, "it is missed by 2.5 m/s, first at t = 5.20 s"),
        (
            "always (jerk <= 45) and always (jerk >= -45)", -3.2,
            "it is missed by 3.2 m/s3, first at t = 5.20 s",
        ),
        # Where units differ, or nothing is known of the margin, no amount is made up.
        ("always (gap + speed > 1)", -1.0, "first at t = 5.20 s"),
        ("always (gap * 2 > 1)", -1.0, "first at t = 5.20 s"),
        ("always (gap >= 0.5)", float("-inf"), "first at t = 5.20 s"),
        ("always (gap >= 0.5)", None, "first at t = 5.20 s"),
        ("module:check", -2.5, "the margin is -2.5, first at t = 5.20 s"),
        ("", None, "first at t = 5.20 s"),
    ],
)  # fmt: skip
def test_what_each_form_says(check: str, margin: float | None, text: str) -> None:
    assert shortfall(check, margin, 5.2, UNITS) == text


def test_a_pair_says_what_its_measure_grew_by() -> None:
    paired = Paired("faults", "pytest_dura.driving.measures:clearance_time", 10.0)
    assert pair_shortfall(paired, -1.6, "s") == (
        "clearance time grows by 11.6 s with the faults where 10 s is allowed"
    )
    assert pair_shortfall(paired, float("-inf"), "s") == ""
