"""Faults of commands, on commands as domains have them."""

from __future__ import annotations

import numpy as np
import pytest
from fault_runs import commanded, fault

from pytest_dura.driving import Command, Maneuver

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
