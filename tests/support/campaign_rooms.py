"""Heated rooms that are quickly simulated, count their simulations, and have campaigns."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

from thermostat import Controller, Thermostat

from pytest_dura import (
    Episode,
    FaultInjector,
    GeneratorView,
    Injection,
    Proposal,
    RoleContext,
    RoleView,
    Runner,
    Tick,
)
from pytest_dura.library import load_library
from pytest_dura.search import falsify_case

INJECTOR = "pytest_dura.faults.injector:CampaignInjector"
BIAS = (
    "[{type: bias, id: bias, target: thermometer, activation: {at: 0.1}, "
    "parameters: {offset: 5.0}}]"
)
SCENARIO = """
name: room/it
simulator: campaign_rooms:CountedRoom
duration: {duration}
runs: {runs}
world: {{start: 15.0}}
variation: {{world.start: {{min: 10.0, max: 20.0}}}}
roles:
  generator: {generator}
  safety_monitor: thermostat:HeatMonitor
  recovery_planner: thermostat:SwitchOff
  fault_injector: {injector}
faults: {faults}
requirements: [{requirements}]
{more}
"""
REQUIREMENTS = """
requirements:
  - {id: COLD-1, text: Never boils., kind: safety, check: always (temperature < 99)}
  - {id: SOON-1, text: Is a room at once., kind: safety, check: "always[0:0.1] (temperature < 99)"}
"""


class CountedRoom(Thermostat):
    """Notes the seed of each simulation."""

    seeds: ClassVar[list[int]] = []

    def reset(self, scenario: Mapping[str, Any], seed: int) -> Tick:
        """Note it."""
        self.seeds.append(seed)
        return super().reset(scenario, seed)


class NeverInjects(FaultInjector):
    """Leaves every planned fault out."""

    def run(self, view: RoleView) -> Injection:
        """Nothing."""
        return Injection()


def warmest(episode: Episode) -> float:
    """A measure: the highest temperature."""
    return float(episode.signals["temperature"].max())


def rooms(
    folder: Path,
    *,
    runs: object = 3,
    faults: str = "[]",
    injector: str = INJECTOR,
    generator: str = "thermostat:Controller",
    requirements: str = "COLD-1",
    duration: float = 0.4,
    more: str = "",
    **options: Any,
) -> Runner:
    """A bench of the one scenario ``room/it``, with nothing simulated yet."""
    folder.mkdir(parents=True, exist_ok=True)
    text = SCENARIO.format(
        runs=runs, faults=faults, injector=injector, generator=generator,
        requirements=requirements, duration=duration, more=more,
    )  # fmt: skip
    (folder / "it.yaml").write_text(text)
    (folder / "requirements.yaml").write_text(REQUIREMENTS)
    library = load_library([folder], builtin=False)
    CountedRoom.seeds.clear()
    return Runner(lambda: library, falsifier=falsify_case, **options)


class Drifting(Controller):
    """Never acts the same twice, by less than matters; only ``where`` the room starts, if given."""

    count: ClassVar[int] = 0

    def __init__(self, where: float | None = None) -> None:
        super().__init__()
        self.where = where

    def reset(self, context: RoleContext) -> None:
        """Count."""
        start = context.scenario["world"]["start"]
        type(self).count += self.where is None or abs(start - self.where) < 1e-9
        self.shift = self.count * 1e-6

    def propose(self, view: GeneratorView) -> Proposal:
        """Nearly the same."""
        return Proposal(super().propose(view).action * (1.0 - self.shift))
