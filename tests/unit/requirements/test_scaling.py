"""Margins in declared units of importance."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.requirements import evaluate, parse
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.scaling import scaled_formula

CHECK = "always (gap >= 0.5) and always (speed <= 10 implies jerk < 5)"


def scaled(check=CHECK, **scale):
    return scaled_formula(Requirement("SAF-1", check=check, scale=scale))


def margin(formula, **columns):
    time = np.arange(len(next(iter(columns.values())))) * 0.1
    return evaluate(formula, time, columns).margin


def test_each_comparison_is_divided_by_the_unit_of_its_signal() -> None:
    trace = {"gap": [0.25, 1.0], "speed": [5.0, 5.0], "jerk": [9.0, 0.0]}
    # The jerk is missed by 4 m/s3, the gap by 0.25 m, which weighs more.
    assert margin(parse(CHECK), **trace) == -4.0
    assert margin(scaled(gap=0.05, jerk=5.0), **trace) == pytest.approx(-5.0)


@settings(deadline=None)
@given(
    gap=st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=5),
    amount=st.floats(0.001, 1000.0),
)
def test_a_single_comparison_keeps_its_sign_and_divides_its_margin(gap, amount) -> None:
    plain = margin(parse("always (gap > 2)"), gap=gap)
    divided = margin(scaled("always (gap > 2)", gap=amount), gap=gap)
    assert divided == pytest.approx(plain / amount, abs=1e-9)
    assert divided * plain >= 0.0


def test_without_a_unit_nothing_is_scaled() -> None:
    assert scaled() is None


@pytest.mark.parametrize(
    "check, scale, message",
    [
        (CHECK, {"gab": 1.0}, "names a signal that its check does not read"),
        ("module:function", {"gap": 1.0}, "scales nothing, since its check is no formula"),
        ("", {"gap": 1.0}, "scales nothing, since its check is no formula"),
        ("always (gap > speed)", {"gap": 1.0}, "different units"),
        ("always (gap > speed)", {"gap": 1.0, "speed": 2.0}, "different units"),
    ],
)
def test_a_scale_that_fits_no_check_is_refused(check, scale, message) -> None:
    with pytest.raises(ConfigurationError, match=message):
        scaled(check, **scale)


def test_signals_of_one_comparison_may_share_a_unit() -> None:
    formula = scaled("always (gap > speed)", gap=2.0, speed=2.0)
    assert margin(formula, gap=[3.0], speed=[7.0]) == -2.0
