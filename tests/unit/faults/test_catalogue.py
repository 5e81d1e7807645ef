"""Faults as data: what is accepted, and what the messages say."""

from __future__ import annotations

from typing import Any

import pytest

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.faults.catalogue import (
    FAULT_TYPES,
    default_fault,
    fault_class,
    load_fault,
    parse_fault,
)
from pytest_dura.faults.activation import Activation
from pytest_dura.faults.model import Fault

GHOST: dict[str, Any] = {"type": "ghost-obstacle", "activation": {"at": 2.0}, "duration": 4.0}


@pytest.mark.parametrize("name", sorted(FAULT_TYPES))
def test_every_type_has_a_default_that_is_complete(name: str) -> None:
    fault = default_fault(name)
    assert issubclass(fault_class(name), Fault)
    assert fault["type"] == fault["id"] == name
    assert fault["target"] == "lidar"
    assert fault["activation"] == {"at": 2.0, "every": None, "by": "fault_injector"}
    assert parse_fault(fault) == fault, "complete data is left as it is"


@pytest.mark.parametrize("name", sorted(FAULT_TYPES))
def test_every_parameter_says_what_it_means_and_its_unit(name: str) -> None:
    fields = fault_class(name).model_fields["parameters"].annotation.model_fields  # type: ignore[union-attr]
    for field in fields.values():
        assert field.description


def test_defaults_are_filled_in() -> None:
    fault = parse_fault(GHOST)
    assert fault["parameters"] == {"ahead": 14.0, "length": 5.0, "width": 2.0}
    assert parse_fault({**GHOST, "id": "g2"})["id"] == "g2"
    assert parse_fault({**GHOST, "duration": None})["duration"] is None


@pytest.mark.parametrize(
    "change, key, told",
    [
        ({"type": "ghost-obstcle"}, "type", ["unknown fault", "did you mean 'ghost-obstacle'?"]),
        ({"type": "meteor"}, "type", ["one of ghost-obstacle, trajectory-spoof", "catalogue"]),
        ({"type": None}, "type", ["unknown fault None"]),
        ({"duraton": 3.0}, "duraton", ["did you mean 'duration'?"]),
        ({"duration": -1.0}, "duration", ["greater than 0", "found:    -1.0"]),
        ({"duration": 0.0}, "duration", ["greater than 0"]),
        ({"duration": "4"}, "duration", ["number", "found:    '4'"]),
        ({"duration": float("inf")}, "duration", ["finite"]),
        ({"activation": {"at": -1.0}}, "activation.at", ["greater than or equal to 0"]),
        ({"activation": {"at": float("nan")}}, "activation.at", ["found:    nan"]),
        ({"activation": {}}, "activation.at", ["required"]),
        ({"activation": {"att": 1.0}}, "activation.att", ["did you mean 'at'?"]),
        ({"activation": {"at": 1.0, "every": 0.0}}, "activation.every", ["greater than 0"]),
        ({"activation": {"at": 1.0, "by": "nobody"}}, "activation.by", ["security_assessor"]),
        ({"activation": 2.0}, "activation", ["found:    2.0"]),
        ({"target": "radar"}, "target", ["'lidar'", "found:    'radar'"]),
        ({"target": "lidr"}, "target", ["'lidar'"]),
        ({"parameters": {"ahed": 3.0}}, "parameters.ahed", ["did you mean 'ahead'?"]),
        ({"parameters": {"ahead": -3.0}}, "parameters.ahead", ["greater than 0"]),
        ({"parameters": {"colour": "red"}}, "parameters.colour", ["ahead, length, width"]),
    ],
    ids=lambda value: str(value)[:40] if isinstance(value, dict) else "",
)
def test_what_is_no_fault_is_refused_at_its_key(
    change: dict[str, Any], key: str, told: list[str]
) -> None:
    with pytest.raises(ConfigurationError) as caught:
        load_fault({**GHOST, **change})
    assert caught.value.key == key
    for part in told:
        assert part in str(caught.value)
    assert "pydantic" not in str(caught.value)


def test_a_fault_without_a_type_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="unknown fault"):
        load_fault({"duration": 3.0})


@pytest.mark.parametrize("magnitude", [-0.1, 1.1])
def test_a_spoof_s_magnitude_is_a_share(magnitude: float) -> None:
    with pytest.raises(ConfigurationError) as caught:
        load_fault({**default_fault("trajectory-spoof"), "parameters": {"magnitude": magnitude}})
    assert caught.value.key == "parameters.magnitude"


def due_ticks(activation: Activation, dt: float, count: int) -> list[int]:
    times = [index * dt for index in range(count)]
    before = [-1.0, *times]
    return [
        index
        for index, (since, time) in enumerate(zip(before, times, strict=False))
        if activation.due(time, since)
    ]


@pytest.mark.parametrize("dt", [0.1, 0.05, 0.2])
def test_an_activation_falls_due_at_the_first_tick_at_or_past_its_time(dt: float) -> None:
    for at in (0.0, 0.4, 2.0, 3.6):
        assert due_ticks(Activation(at=at), dt, 100) == [round(at / dt)]
    assert due_ticks(Activation(at=0.41), 0.1, 100) == [5]


def test_a_periodic_activation_falls_due_at_each_multiple() -> None:
    found = due_ticks(Activation(at=1.0, every=2.5), 0.1, 120)
    assert found == [10, 35, 60, 85, 110]
    assert due_ticks(Activation(at=0.3, every=0.1), 0.1, 20) == list(range(3, 20))
    assert due_ticks(Activation(at=0.0, every=0.3), 0.1, 13) == [0, 3, 6, 9, 12]
