"""What a check function may return, and what becomes of it."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from decimal import Decimal
from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np
import pytest

from pytest_dura import CheckResult
from pytest_dura.requirements import check_name
from pytest_dura.requirements.checks import check_result


@pytest.mark.parametrize(
    "value, holds, margin",
    [
        (True, True, None),
        (np.bool_(False), False, None),
        (0.0, True, 0.0),
        (np.float64(0.0), True, 0.0),
        (-0.25, False, -0.25),
        (np.float32(1.5), True, 1.5),
        (np.array(-2.0), False, -2.0),
        (np.array(False), False, None),
        (np.array([False]), False, None),
        (np.array([0.5]), True, 0.5),
        (math.inf, True, math.inf),
    ],
)
def test_a_truth_value_or_a_margin(value: Any, holds: bool, margin: float | None) -> None:
    assert check_result(value) == CheckResult(holds, margin)


def test_a_result_is_made_plain_so_that_the_record_can_hold_it() -> None:
    given: Any = CheckResult(
        np.bool_(False),  # type: ignore[arg-type]
        margin=np.float32(-1.5),  # type: ignore[arg-type]
        time=np.float32(0.5),  # type: ignore[arg-type]
        detail=7,  # type: ignore[arg-type]
        vacuous=np.bool_(True),  # type: ignore[arg-type]
    )
    found = check_result(given)
    assert found == CheckResult(False, -1.5, 0.5, "7", True)
    assert json.loads(json.dumps(asdict(found)))["holds"] is False


@pytest.mark.parametrize(
    "value",
    [
        None, "yes", [True], 1j, CheckResult(1), CheckResult(None),
        0, 1, -1, np.int64(0), np.array(1), np.array([0]), Fraction(1, 2), Decimal(1),
    ],
)  # fmt: skip
def test_what_is_neither_is_refused(value: Any) -> None:
    with pytest.raises(TypeError, match="not a truth value"):
        check_result(value)


def test_a_whole_number_is_refused_with_the_remedy() -> None:
    with pytest.raises(TypeError, match=r"returned the int 0, .* compare it, as in `count == 0`"):
        check_result(0)


def test_a_result_that_contradicts_itself_is_refused() -> None:
    with pytest.raises(ValueError, match="it holds, and its margin is negative"):
        check_result(CheckResult(True, margin=-0.5))
    assert not check_result(CheckResult(False, margin=0.5)).holds


class Callable:
    def __call__(self, episode: Any) -> bool:
        return True


@pytest.mark.parametrize(
    "check, name",
    [
        (partial(max, 0), "functools:partial"),
        (Callable(), f"{__name__}:Callable"),
        (Callable, f"{__name__}:Callable"),
    ],
)
def test_whatever_can_be_called_has_a_name(check: Any, name: str) -> None:
    assert check_name(check) == name


@pytest.mark.parametrize(
    "value, name",
    [
        (math.nan, "margin"),
        (CheckResult(True, margin=math.nan), "margin"),
        (CheckResult(False, time=math.nan), "time"),
        (CheckResult(False, time=math.inf), "time"),
    ],
)
def test_no_number_is_refused(value: Any, name: str) -> None:
    with pytest.raises(ValueError, match=f"its {name} is not a number"):
        check_result(value)
