"""What a check function may return, and what becomes of it."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from typing import Any

import numpy as np
import pytest

from pytest_dura import CheckResult
from pytest_dura.requirements.checks import check_result


@pytest.mark.parametrize(
    "value, holds, margin",
    [
        (True, True, None),
        (np.bool_(False), False, None),
        (0, True, 0.0),
        (-0.25, False, -0.25),
        (np.float32(1.5), True, 1.5),
        (np.array(-2.0), False, -2.0),
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


@pytest.mark.parametrize("value", [None, "yes", [True], 1j, CheckResult(1), CheckResult(None)])
def test_what_is_neither_is_refused(value: Any) -> None:
    with pytest.raises(TypeError, match="not a truth value"):
        check_result(value)


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
