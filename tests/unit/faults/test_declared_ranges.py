"""Defaults of faults and spans of searches that follow from what a channel declares."""

from __future__ import annotations

from typing import Any

import pytest

from pytest_dura import Action, Channel, Domain, Signal
from pytest_dura.core import ConfigurationError
from pytest_dura.faults import Span
from pytest_dura.faults.parts import Quantity
from pytest_dura.library.cases import expand_cases
from pytest_dura.library.fault_campaigns import expand_campaign
from pytest_dura.library.planned_faults import example_fault, parse_fault, spans_in
from pytest_dura.library.scenario import Scenario
from pytest_dura.search.space import FaultSlot, SearchSpace

SENSED = Domain(
    name="sensed",
    signals=(Signal("level", "1", "of the ticks"),),
    actions=(Action("power", "W", "of the heater", 2.0, 8.0),),
    channels={
        "cgm": Channel(
            "numbers", ("glucose", "other"), units=("mg/dL", "1"),
            ranges=((40.0, 400.0), None), errors=(9.0, None),
        ),
    },
    fault_targets={"number": "cgm.glucose", "any": "cgm", "command": "command.power"},
)  # fmt: skip
"""Its simulator is never run here."""
ERROR, MOST, HIGH = 27.0, 90.0, 400.0


def scenario(**keys: Any) -> Scenario:
    given = {"name": "a", "simulator": "clockwork:Clockwork", "duration": 36_000, "time_step": 300}
    return Scenario.model_validate({**given, "domain": f"{__name__}:SENSED", **keys})


@pytest.mark.parametrize(
    "name,parameters",
    [
        ("bias", {"offset": ERROR, "percent": 0.0}),
        ("noise", {"sigma": ERROR / 2, "distribution": "gaussian"}),
        ("gain", {"factor": 1.0 + ERROR / HIGH}),
        ("stuck-at", {"value": 40.0}),
        ("out-of-range", {"low": 40.0, "high": 400.0, "excess": 36.0, "side": "above"}),
        ("drift", {"rate": ERROR / 11_900.0}),
    ],
)
def test_the_fault_of_a_name_has_the_size_of_its_sensor(name: str, parameters: Any) -> None:
    assert example_fault(scenario(), name).parameters == pytest.approx(parameters)


def test_a_drift_becomes_a_fault_error_by_its_end() -> None:
    drawn = {"min": 300.0, "max": 900.0}
    for lasting, seconds in (
        (600.0, 600.0), (None, 36_000.0), (90_000.0, 36_000.0), (drawn, 900.0)
    ):  # fmt: skip
        data = {"type": "drift", "activation": {"at": 0.0}, "duration": lasting}
        fault = parse_fault(scenario(), data)
        assert fault.parameters["rate"] * seconds == pytest.approx(ERROR)


def test_what_is_given_stays_and_where_nothing_is_declared_nothing_changes() -> None:
    given = {"type": "drift", "activation": {"at": 0.0}, "parameters": {"rate": 0.5}}
    assert parse_fault(scenario(), given).parameters == {"rate": 0.5}
    elsewhere = {"type": "bias", "target": "cgm.other", "activation": {"at": 0.0}}
    assert parse_fault(scenario(), elsewhere).parameters == {"offset": 1.0, "percent": 0.0}
    assert parse_fault(scenario(domain=None), elsewhere).parameters["offset"] == 1.0


def test_a_grid_over_durations_sizes_each_drift_by_its_own() -> None:
    """Those of the grid's other rows are made of parts of faults that were read before."""
    fault = {"type": "drift", "activation": {"at": 0.0}}
    grid = {"duration": [300, 3000], "activation.at": [0.0, 600.0]}
    faults = expand_campaign(scenario(), (), {"fault": fault, "grid": grid})
    sizes = [each.parameters["rate"] * each.duration for (each,) in faults]  # type: ignore[operator]
    assert sizes == pytest.approx([ERROR] * 4)


def test_a_search_tries_errors_of_up_to_ten_typical_ones() -> None:
    spans = {
        name: spans_in(scenario(), example_fault(scenario(), name).plain())
        for name in ("bias", "noise", "gain", "stuck-at", "out-of-range")
    }
    assert spans["bias"]["parameters.offset"] == Span(-MOST, MOST)
    assert spans["bias"]["parameters.percent"] == Span(-22.5, 22.5)
    assert spans["noise"]["parameters.sigma"] == Span(0.0, MOST / 2)
    assert spans["gain"]["parameters.factor"] == Span(0.775, 1.225, neutral=1.0)
    assert spans["stuck-at"]["parameters.value"] == Span(40.0, 400.0, neutral=40.0)
    assert spans["out-of-range"]["parameters.excess"] == Span(3.6, 360.0, neutral=3.6)


def test_no_drift_of_a_search_is_larger_whatever_its_duration() -> None:
    (case,) = expand_cases([scenario()])
    (slot,) = SearchSpace.of(case, ["drift"]).parameters
    assert isinstance(slot, FaultSlot)
    inner = {parameter.path: parameter for parameter in slot.choices[0].inner}
    longest, rate = inner["duration"], inner["parameters.rate"]
    assert (rate.high * longest.high, rate.low) == (pytest.approx(MOST), -rate.high)  # type: ignore[attr-defined]


def test_the_range_of_an_action_is_that_of_its_part_of_the_command() -> None:
    fault = parse_fault(
        scenario(), {"type": "stuck-at", "target": "command.power", "activation": {"at": 0.0}}
    )
    assert fault.parameters == {"value": 2.0}


@pytest.mark.parametrize(
    "step,begins,lasts", [(0.1, 2.0, 4.0), (1.0, 20.0, 40.0), (300.0, 6000.0, 11_900.0)]
)
def test_the_fault_of_a_name_begins_and_lasts_in_ticks_of_a_slow_world(
    step: float, begins: float, lasts: float
) -> None:
    """At steps of 300 s, one of 2 to 6 s would act at no tick."""
    fault = example_fault(scenario(time_step=step), "bias")
    assert (fault.activation["at"], fault.duration) == (begins, pytest.approx(lasts))


def test_a_column_of_an_array_has_its_own_range() -> None:
    array = Channel("array", columns=2, ranges=((0.0, 9.0), None), errors=(None, 0.5))
    assert array.quantity("3.0") == Quantity(0.0, 9.0)
    assert array.quantity("3.1") == Quantity(error=0.5)
    assert array.quantity("3") == Quantity()


@pytest.mark.parametrize(
    "declared,problem",
    [
        ({"ranges": ((0.0, 1.0),)}, "a channel of 2 numbers has 1 ranges"),
        ({"ranges": ((1.0, 0.0), None)}, "a range that is not in order"),
        ({"ranges": ((0.0, float("inf")), None)}, "a range that is not in order"),
        ({"errors": (0.0, None)}, "a typical error that is not above 0"),
        ({"errors": (1.0, 2.0, 3.0)}, "a channel of 2 numbers has 3 errors"),
    ],
)
def test_a_range_or_error_that_cannot_be_is_refused(declared: Any, problem: str) -> None:
    with pytest.raises(ConfigurationError, match=problem):
        Channel("numbers", ("a", "b"), **declared)
