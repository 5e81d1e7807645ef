"""Laws of faults as data: what is read once need not be read again."""

from __future__ import annotations

import copy
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pytest_dura.core import ConfigurationError
from pytest_dura.driving import FAULT_TARGETS
from pytest_dura.faults import FAULT_TYPES, default_fault, load_fault, plain_fault

SECONDS = st.floats(0.001, 40.0) | st.integers(1, 40)
ACTIVATIONS = st.fixed_dictionaries(
    {"at": SECONDS | st.just(0.1 + 0.2)}
) | st.fixed_dictionaries(
    {"probability": st.floats(0.0, 1.0, exclude_min=True)},
    optional={"not_before": SECONDS, "by": st.just("security_assessor")},
) | st.fixed_dictionaries(
    {"when": st.sampled_from(["odometry.speed > 3", "odometry.speed >= 0.30000000000000004"])}
)  # fmt: skip
DURATIONS = (
    SECONDS
    | st.none()
    | st.just("once")
    | st.tuples(SECONDS, SECONDS).map(lambda both: {"min": min(both), "max": max(both)})
    | st.fixed_dictionaries({"until": st.just("odometry.speed < 1"), "at_most": SECONDS})
    | st.fixed_dictionaries({"on": SECONDS, "off": SECONDS, "lasting": SECONDS})
)
NUMBERS = st.floats(-1e3, 1e3) | st.integers(-20, 20) | st.sampled_from([0.1 + 0.2, 1e-7, -0.0])


@st.composite
def varied(draw: st.DrawFn, name: str) -> dict[str, Any]:
    """A fault of the type as a file may have it, with other numbers and another time."""
    data = copy.deepcopy(default_fault(name, FAULT_TARGETS))
    for key, parts in (("activation", ACTIVATIONS), ("duration", DURATIONS)):
        if draw(st.booleans()):
            data[key] = draw(parts)
    numbers = [key for key, value in data["parameters"].items() if type(value) in (int, float)]
    if numbers:
        for key in draw(st.sets(st.sampled_from(numbers))):
            data["parameters"][key] = draw(NUMBERS)
    for key in draw(st.sets(st.sampled_from(sorted({"parameters", "duration", "id"})))):
        data.pop(key)
    return data


@pytest.mark.parametrize("name", sorted(FAULT_TYPES))
@settings(derandomize=True, deadline=None, max_examples=8)
@given(data=st.data())
def test_what_a_type_tells_of_a_fault_makes_the_same_fault_again(
    name: str, data: st.DataObject
) -> None:
    """The faults of a campaign are validated once, as they are read, and not as they are told."""
    try:
        fault = load_fault(data.draw(varied(name)), FAULT_TARGETS)
    except ConfigurationError:
        return  # what is refused is never told
    told = plain_fault(fault)
    again = load_fault(told)
    assert again == fault
    assert repr(again) == repr(fault), "also the types of its numbers, and the sign of a zero"
    assert plain_fault(again) == told
    assert again.by_chance == fault.by_chance


@pytest.mark.parametrize("name", sorted(FAULT_TYPES))
def test_the_law_is_about_faults_that_are_accepted(name: str) -> None:
    """Each type as it is in the catalogue, so that none escapes by being refused throughout."""
    told = default_fault(name, FAULT_TARGETS)
    assert plain_fault(load_fault(told)) == told
