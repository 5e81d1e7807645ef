"""Faults of single numbers: what they refuse, and numbers of other kinds than floats."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from fault_runs import CHANNEL, fault, through

from pytest_dura.core import ConfigurationError
from pytest_dura.faults import parse_fault

NUMBERS = ["bias", "drift", "noise", "gain", "stuck-at", "bit-flip", "out-of-range"]
RANGE = {"low": 0.0, "high": 50.0}


def of(kind: str, **given: Any) -> dict[str, Any]:
    """The fault; a bit flip of many bits, which shows in numbers of any kind."""
    needed = {"out-of-range": RANGE, "bit-flip": {"bits": 20}}.get(kind, {})
    return fault(kind, **{**needed, **given})


@pytest.mark.parametrize(
    "kind, parameters, key, told",
    [
        ("bias", {"offset": float("inf")}, "parameters.offset", "finite"),
        ("bias", {"offset": "1"}, "parameters.offset", "number"),
        ("noise", {"sigma": -0.1}, "parameters.sigma", "greater than or equal to 0"),
        ("noise", {"distribution": "cauchy"}, "parameters.distribution", "'laplace'"),
        ("gain", {"factor": float("nan")}, "parameters.factor", "finite"),
        ("bit-flip", {"bits": -1}, "parameters.bits", "greater than or equal to 0"),
        ("bit-flip", {"bits": 33}, "parameters.bits", "less than or equal to 32"),
        ("bit-flip", {"bits": 1.5}, "parameters.bits", "integer"),
        ("out-of-range", {}, "parameters.low", "Lower end"),
        ("out-of-range", {"low": 2.0, "high": 1.0}, "parameters", "low is above high"),
        ("out-of-range", {**RANGE, "excess": 0.0}, "parameters.excess", "greater than 0"),
        ("out-of-range", {"low": 0.0, "high": 1e300}, "parameters", "change the excess"),
        ("out-of-range", {**RANGE, "side": "left"}, "parameters.side", "'below'"),
    ],
)
def test_what_is_no_magnitude_is_refused(kind, parameters, key, told) -> None:
    data = {"type": kind, "target": CHANNEL, "activation": {"at": 1.0}, "parameters": parameters}
    with pytest.raises(ConfigurationError) as caught:
        parse_fault(data)
    assert caught.value.key == key
    assert told in str(caught.value)


@pytest.mark.parametrize("kind", NUMBERS)
@pytest.mark.parametrize("value", ["12", None, True, [1.0], {"speed": 1.0}])
def test_what_is_no_number_is_told(kind: str, value: Any) -> None:
    with pytest.raises(ConfigurationError, match="acts on a number"):
        through([value], of(kind))


@pytest.mark.parametrize("kind", NUMBERS)
@pytest.mark.parametrize("value", [7, np.float32(7.0), np.int64(7)])
def test_any_kind_of_number_becomes_a_float(kind: str, value: Any) -> None:
    (shown,) = through([value], of(kind))
    if kind != "drift":  # which is nothing at first
        assert type(shown) is float


@pytest.mark.parametrize("kind", NUMBERS)
def test_a_row_of_numbers_is_changed_number_by_number(kind: str) -> None:
    rows = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    rows.flags.writeable = False
    found = through([rows] * 2, of(kind, target=f"{CHANNEL}.1"))[1]
    assert np.array_equal(found[0], rows[0])
    assert (found[1] != rows[1]).all()
    assert not found.flags.writeable
    if kind in ("noise", "bit-flip"):
        assert len(set((found[1] - rows[1]).tolist())) == 3, "each draws its own"


def test_a_bias_in_percent_is_a_share_of_the_number_itself() -> None:
    assert through([20.0, -20.0], of("bias", offset=0.0, percent=10.0)) == [22.0, -22.0]


def test_an_activation_anew_begins_the_drift_anew() -> None:
    data = {"type": "drift", "target": CHANNEL, "duration": 0.3}
    data |= {"activation": {"at": 0.1, "every": 0.5}, "parameters": {"rate": 10.0}}
    found = through([0.0] * 10, parse_fault({**data, "id": "d"}))
    assert found == pytest.approx([0, 0, 1, 2, 0, 0, 0, 1, 2, 0])


@pytest.mark.parametrize("value", [float("inf"), float("nan")])
def test_what_is_not_finite_is_not_flipped(value: float) -> None:
    (found,) = through([value], of("bit-flip"))
    assert np.array_equal(found, value, equal_nan=True)


def test_the_shorter_floats_of_a_channel_are_flipped_as_they_are_and_stay_finite() -> None:
    rows = np.linspace(0.5, 3.0, 6, dtype=np.float32).reshape(2, 3)
    for field in ("1", "1.2"):
        for found in through([rows] * 200, of("bit-flip", target=f"{CHANNEL}.{field}", bits=2)):
            assert found.dtype == np.float32
            assert np.isfinite(found).all()
            assert (found[1] != rows[1]).sum() == (3 if field == "1" else 1)
