"""Seeded defects of a planner for a mobile robot, for ``--dura-qualify``."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from mobile_robot.world import ANGLES, Wheels
from pytest_dura import GeneratorView, Proposal
from pytest_dura.qualification import AlteredPercept, Parameter
from pytest_dura.qualification.mutants.component import ComponentMutation


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
