"""Masquerade: what is forged suits the channel, or is refused before anything runs."""

from __future__ import annotations

from typing import Any

import pytest
from fault_runs import check_place

from pytest_dura import ConfigurationError
from pytest_dura.driving import CHANNELS
from pytest_dura.faults import Channel, parse_fault


def forger(target: str, **parameters: Any) -> Any:
    return parse_fault({
        "type": "masquerade", "id": "f", "target": target, "activation": {"at": 1.0},
        "duration": 1.0, "parameters": parameters,
    })  # fmt: skip


@pytest.mark.parametrize(
    "target, parameters",
    [
        ("lidar", {}),
        ("odometry.speed", {"value": 3}),
        ("radar.0.2", {"value": -3.0}),
        ("localisation", {"forged": {"x": 3.0, "heading": 0}}),
        ("command", {"forged": {"acceleration": 1.0}}),
        ("radar", {"forged": {"0.1": 0.2}}),
        ("radar.0", {"forged": {"1": 0.2}}),
        ("controls", {"forged": {"0.text": "30"}}),
        ("map", {"forged": {"stop_line": 90.0}}),
    ],
)
def test_what_the_channel_may_hold_is_accepted(target: str, parameters: Any) -> None:
    check_place(forger(target, **parameters), CHANNELS)


@pytest.mark.parametrize(
    "target, parameters, key, told",
    [
        ("lidar", {"value": 3.0}, "value", "is a whole message"),
        ("localisation", {"value": 3.0}, "value", "name one field as the target"),
        ("camera_front", {"value": "dark"}, "value", "expected: `forged`"),
        ("odometry.speed", {"value": "fast"}, "value", "is no number, where one belongs"),
        ("odometry.speed", {"value": True}, "value", "is no number"),
        ("odometry.speed", {"forged": {"speed": 3.0}}, "forged", "give `value`"),
        ("odometry", {"forged": {"sped": 3.0}}, "forged", "did you mean 'speed'?"),
        ("odometry", {"forged": {"speed": "fast"}}, "forged", "is no number"),
        ("localisation", {"forged": {"z": 3.0}}, "forged", "one of x, y, heading"),
        ("lidar", {"forged": {"x": 3.0}}, "forged", "expected: another target, with fields"),
        ("radar", {"forged": {"0.3": 3.0}}, "forged", "one of <row>.<column>"),
        ("radar", {"forged": {"count": 3.0}}, "forged", "is no number in 'radar'"),
    ],
)
def test_what_it_cannot_hold_is_refused(target: str, parameters: Any, key: str, told: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        check_place(forger(target, **parameters), CHANNELS)
    assert caught.value.key == f"parameters.{key}"
    assert told in str(caught.value)
    assert caught.value.remedy


def test_of_a_channel_of_another_kind_nothing_is_known() -> None:
    channels = {"room": Channel("other"), "list": Channel("array")}
    check_place(forger("room", value=20.0), channels)
    check_place(forger("list", forged={"0": 1.0}), channels)
    with pytest.raises(ConfigurationError, match="another target"):
        check_place(forger("list", forged={"0.1": 1.0}), channels)
