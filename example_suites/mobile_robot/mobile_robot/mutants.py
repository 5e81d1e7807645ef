"""Seeded defects of a mobile robot's planner, monitor and recovery, for ``--dura-qualify``."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from mobile_robot.world import ANGLES, TOP_SPEED, Wheels
from pytest_dura import Assessment, GeneratorView, Proposal, Recovery, RoleView
from pytest_dura.qualification import AlteredPercept, Parameter
from pytest_dura.qualification.mutants.component import ComponentMutation
from pytest_dura.qualification.mutants.monitor import MonitorMutation, RecoveryMutation


class CrossedWheels(ComponentMutation):
    """Left and right are swapped."""

    about = "drives the left wheel as the right one should, and the other way round"

    def propose(self, view: GeneratorView) -> Proposal:
        """Swap the wheels' speeds."""
        proposal = self.part.propose(view)
        wheels = proposal.action
        return proposal.with_action(Wheels(wheels.right, wheels.left))


class BlindAhead(ComponentMutation):
    """Sees nothing straight ahead."""

    about = "sees nothing within an angle of straight ahead"
    parameters: ClassVar = (Parameter("angle", (0.2, 0.8), "rad"),)
    angle: float

    def propose(self, view: GeneratorView) -> Proposal:
        """Propose where the beams ahead reach as far as the farthest."""

        def change(channel: str, value: Any) -> Any:
            if channel != "lidar":
                return value
            return np.where(np.abs(ANGLES) < self.angle, np.max(value), value)

        return self.part.propose(replace(view, percept=AlteredPercept(view.percept, change)))


class FarSighted(MonitorMutation):
    """Takes things for farther away."""

    about = "takes whatever the lidar sees to be farther away"
    parameters: ClassVar = (Parameter("metres", (0.2, 1.0), "m"),)
    metres: float

    def run(self, view: RoleView) -> Assessment:
        """Assess on longer ranges."""

        def change(channel: str, value: Any) -> Any:
            return value + self.metres if channel == "lidar" else value

        return self.part.run(replace(view, percept=AlteredPercept(view.percept, change)))


class RollsOn(RecoveryMutation):
    """Does not stop."""

    about = "drives ahead at half speed where it should stop"

    def run(self, view: RoleView) -> Recovery:
        """Keep the turn, and add half of the top speed."""
        recovery = self.part.run(view)
        left, right = recovery.action
        return replace(recovery, action=Wheels(left + TOP_SPEED / 2, right + TOP_SPEED / 2))
