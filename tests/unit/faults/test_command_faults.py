"""Faults of commands, on commands as domains have them."""

from __future__ import annotations

import numpy as np
import pytest
from fault_runs import CHANNEL, commanded, fault

from pytest_dura.core import ConfigurationError
from pytest_dura.driving import Command, Maneuver
from pytest_dura.faults import parse_fault

BRAKE, GO = Command(Maneuver.EMERGENCY_BRAKE, -8.0), Command(Maneuver.PROCEED, 2.0)


@pytest.mark.parametrize(
    "kind, parameters, expected",
    [
        ("loss-of-effectiveness", {"percent": 25.0}, [1.5, 1.5, -6.0]),
        ("inversion", {}, [-2.0, -2.0, 8.0]),
        ("stuck-command", {}, [2.0, 2.0, 2.0]),
        ("lag", {"s": 0.1 / np.log(2.0)}, [2.0, 2.0, -3.0]),
        ("bias", {"offset": 1.0}, [3.0, 3.0, -7.0]),
        ("delay", {"s": 0.1}, [2.0, 2.0, 2.0]),
    ],
)
def test_the_field_of_a_command_is_changed_and_the_rest_is_left(kind, parameters, expected) -> None:
    found = commanded([GO, GO, BRAKE], fault(kind, target="command.acceleration", **parameters))
    assert [one.acceleration for one in found] == pytest.approx(expected)
    assert [one.maneuver for one in found] == [GO.maneuver, GO.maneuver, BRAKE.maneuver]
    assert (GO.acceleration, BRAKE.acceleration) == (2.0, -8.0)


@pytest.mark.parametrize("kind", ["denial", "stuck-command"])
def test_a_whole_command_can_stay(kind) -> None:
    found = commanded([GO, GO, BRAKE, BRAKE], fault(kind, target="command", at=0.1))
    assert found == [GO, GO, GO, GO]


def test_an_array_of_commands_is_changed_number_by_number() -> None:
    (found,) = commanded([np.array([1.0, -2.0])], fault("inversion", target="command"))
    assert found.tolist() == [-1.0, 2.0]
    lag = fault("lag", target="command", s=0.1 / np.log(2.0))
    _, found = commanded([np.array([0.0, 4.0]), np.array([2.0, 0.0])], lag)
    assert found == pytest.approx([1.0, 2.0])


def test_a_command_that_is_no_number_is_told() -> None:
    with pytest.raises(ConfigurationError, match="acts on a number"):
        commanded(["left"], fault("inversion", target="command"))


@pytest.mark.parametrize(
    "kind, parameters, key",
    [
        ("loss-of-effectiveness", {"percent": 101.0}, "parameters.percent"),
        ("loss-of-effectiveness", {"percent": -1.0}, "parameters.percent"),
        ("lag", {"s": -0.1}, "parameters.s"),
        ("inversion", {"sign": -1.0}, "parameters.sign"),
    ],
)
def test_what_is_no_magnitude_is_refused(kind, parameters, key) -> None:
    data = {"type": kind, "target": CHANNEL, "activation": {"at": 1.0}, "parameters": parameters}
    with pytest.raises(ConfigurationError) as caught:
        parse_fault(data)
    assert caught.value.key == key
