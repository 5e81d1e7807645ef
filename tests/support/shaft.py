"""The lift of ``tests/third_party`` where it is not installed: its roles by import paths."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from lift_dura.domain import LIFT

from pytest_dura import Requirement
from pytest_dura.library import Library, Scenario

SHAFT = replace(LIFT, roles={"generator": "lift_dura.domain:Steady"})
IN_SHAFT = {"simulator": "lift_dura.domain:Lift", "domain": "shaft:SHAFT"}
"""Keys of a scenario."""


def lift_scenario(name: str = "shaft/up", **fields: Any) -> Scenario:
    """A lift that is called to a floor, which varies."""
    varied = {"world.floor": {"min": 4.0, "max": 8.0}}
    return Scenario.model_validate(
        {"name": name, "duration": 12.0, "variation": varied, **IN_SHAFT, **fields}
    )


def lift_library() -> Library:
    """Lifts with and without a fault, and whether they stop in time."""
    top = Requirement("TOP-1", "It stops in time.", kind="safety", check="always (height < 9)")
    fault = {"type": "bias", "activation": {"at": 1.0}, "parameters": {"offset": -2.0}}
    scenarios = (
        lift_scenario(requirements=[top.id]),
        lift_scenario("shaft/biased", faults=[fault], requirements=[top.id]),
    )
    return Library({scenario.name: scenario for scenario in scenarios}, {top.id: top})
