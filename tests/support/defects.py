"""Driving components and cars with one seeded defect each, and sound ones to set beside them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from pytest_dura import (
    Assessed,
    Assessment,
    Generator,
    Proposal,
    Recovery,
    RecoveryPlanner,
    RoleContext,
    RoleView,
)
from pytest_dura.core import GeneratorView, Tick
from pytest_dura.driving import (
    MAX_BRAKING,
    Command,
    HighwaySimulator,
    Maneuver,
    RuleBased,
    Scene,
    SeparationMonitor,
)
from pytest_dura.driving.scene import InLane


class BlindToPedestrians(RuleBased):
    """Stops for no pedestrian."""

    def _for_pedestrians(self, scene: Scene) -> float:
        return math.inf


class StopsTooClose(RuleBased):
    """Takes itself to be 1.2 m farther from a pedestrian than it is."""

    def _for_pedestrians(self, scene: Scene) -> float:
        return super()._for_pedestrians(replace(scene, s=scene.s - 1.2))


class BrakesLate(RuleBased):
    """Brakes behind a slower leader at the last moment only, and then hard enough."""

    @staticmethod
    def _follow(leader: InLane | None, speed: float) -> float:
        if leader is None:
            return math.inf
        closing = max(speed - leader.speed, 0.0)
        needed = closing**2 / (2.0 * max(leader.distance - 2.0, 0.1))
        return -min(needed, 8.0) if needed > 6.0 else math.inf


class NeverGivesWay(RuleBased):
    """Takes every gap before its stop line, and is careful behind it."""

    def _who_comes(self, scene: Scene, dt: float) -> str | None:
        return None


class TrustsLidar(RuleBased):
    """Does not look what radar sees where lidar sees nothing."""

    def propose(self, view: GeneratorView) -> Proposal:
        explained = {**view.percept, "radar": view.percept["radar"][:0]}
        return super().propose(_Shown(view, explained))


class FreezesAtGhosts(RuleBased):
    """Brakes from the first object that radar does not confirm, for ever."""

    def propose(self, view: GeneratorView) -> Proposal:
        if view.index == 0:
            self.frozen = False
        if len(view.percept["lidar"]) > len(view.percept["radar"]):
            self.frozen = True
        if self.frozen:
            return Proposal(Command(Maneuver.EMERGENCY_BRAKE), "frozen")
        return super().propose(view)


class _Shown:
    """A view with another percept."""

    def __init__(self, view: GeneratorView, percept: Mapping[str, Any]) -> None:
        self.index, self.time, self.dt, self.percept = view.index, view.time, view.dt, percept


class Steady(Generator):
    """The same command at every tick.

    Args:
        maneuver: Its maneuver.
        acceleration: In m/s2, if not the maneuver's own.
        latency: Seconds that it says it took.
    """

    def __init__(
        self,
        maneuver: str = "proceed",
        acceleration: float | None = None,
        latency: float | None = None,
    ) -> None:
        self.command, self.latency = Command(Maneuver(maneuver), acceleration), latency

    def propose(self, view: GeneratorView) -> Proposal:
        """Always the same."""
        return Proposal(self.command, "steady", latency=self.latency)


class AtSpeed(Generator):
    """Keeps a speed in m/s, and stops for good at a distance from its stop line if told to."""

    def __init__(self, speed: float, stop_before: float | None = None) -> None:
        self.speed, self.stop_before = speed, stop_before

    def propose(self, view: GeneratorView) -> Proposal:
        """Towards the speed, or braking."""
        scene = Scene.of(view.percept)
        if self.stop_before is not None and scene.to_stop_line < self.stop_before:
            return Proposal(Command(Maneuver.EMERGENCY_BRAKE), "stops for good")
        wanted = max(-3.0, min(2.0, self.speed - scene.speed))
        return Proposal(Command(Maneuver.PROCEED, wanted), "keeps its speed")


class StopsHard(Generator):
    """Brakes as hard as it can, stands, and goes on: it asks the car for all it has."""

    def propose(self, view: GeneratorView) -> Proposal:
        """By the clock."""
        brakes = 1.0 < view.time < 3.0
        command = Maneuver.EMERGENCY_BRAKE if brakes else Maneuver.ACCELERATE
        return Proposal(Command(command), "by the clock")


class BrakesTooHard(HighwaySimulator):
    """A car whose brake gives a tenth more than it should, though it builds up no faster."""

    def reset(self, scenario: Mapping[str, Any], seed: int) -> Tick:
        """The road as it is, with this car."""
        tick = super().reset(scenario, seed)
        ego, actuate = self._ego, self._ego.actuate

        def too_much(acceleration: float, dt: float) -> None:
            before = ego.executed
            actuate(acceleration, dt)
            if ego.executed <= -MAX_BRAKING and ego.speed > 2.0:
                ego.executed = max(before - ego.SLEW * dt, -1.1 * MAX_BRAKING)

        ego.actuate = too_much
        return tick


class BrakesAtOnce(HighwaySimulator):
    """A car whose brake builds up twice as fast as it should."""

    def reset(self, scenario: Mapping[str, Any], seed: int) -> Tick:
        """The road as it is, with this car."""
        tick = super().reset(scenario, seed)
        self._ego.SLEW *= 2.0
        return tick


class StandsInTheJunction(RecoveryPlanner):
    """Drives into the junction and stays there."""

    def run(self, view: RoleView) -> Recovery:
        scene = Scene.of(view.percept)
        inside = scene.to_stop_line < -6.0
        return Recovery("emergency_brake" if inside else "proceed", "stand", "stands still")


class NeverForgives(SeparationMonitor):
    """Once it has found a proposal unsafe, it finds every later one so, too."""

    def reset(self, context: RoleContext) -> None:
        super().reset(context)
        self._offended = False

    def run(self, view: RoleView) -> Assessment:
        found = super().run(view)
        self._offended |= found.verdict is Assessed.UNSAFE
        return replace(found, verdict=Assessed.UNSAFE) if self._offended else found
