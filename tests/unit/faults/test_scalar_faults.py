"""Faults of single numbers: what they refuse, and numbers of other kinds than floats."""

from __future__ import annotations

import numpy as np
import pytest
from fault_runs import CHANNEL, fault, through

from pytest_dura.faults import parse_fault


def test_an_activation_anew_begins_the_drift_anew() -> None:
    data = {"type": "drift", "target": CHANNEL, "duration": 0.3}
    data |= {"activation": {"at": 0.1, "every": 0.5}, "parameters": {"rate": 10.0}}
    found = through([0.0] * 10, parse_fault({**data, "id": "d"}))
    assert found == pytest.approx([0, 0, 1, 2, 0, 0, 0, 1, 2, 0])


@pytest.mark.parametrize("value", [float("inf"), float("nan")])
def test_what_is_not_finite_is_not_flipped(value: float) -> None:
    (found,) = through([value], fault("bit-flip", bits=20))
    assert np.array_equal(found, value, equal_nan=True)


def test_the_shorter_floats_of_a_channel_are_flipped_as_they_are_and_stay_finite() -> None:
    rows = np.linspace(0.5, 3.0, 6, dtype=np.float32).reshape(2, 3)
    for field in ("1", "1.2"):
        for found in through([rows] * 200, fault("bit-flip", target=f"{CHANNEL}.{field}", bits=2)):
            assert found.dtype == np.float32
            assert np.isfinite(found).all()
            assert (found[1] != rows[1]).sum() == (3 if field == "1" else 1)
