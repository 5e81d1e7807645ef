"""Seeded defects of the pole's controller, monitor and recovery, for ``--dura-qualify``.

Their actions are choices, left or right, so that mutants which change numbers change nothing here.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar

from cartpole_parts import LEFT, RIGHT, Pole

from pytest_dura import Assessment, GeneratorView, Proposal, Recovery, RoleView
from pytest_dura.qualification import MUTANTS, AlteredPercept, Parameter
from pytest_dura.qualification.mutants.component import ComponentMutation
from pytest_dura.qualification.mutants.monitor import MonitorMutation, RecoveryMutation


def other(side: int) -> int:
    """Return the other side."""
    return RIGHT if side == LEFT else LEFT


@MUTANTS.register("generator.other_side")
class OtherSide(ComponentMutation):
    """Left and right are swapped."""

    about = "pushes to the other side"
    provokes = True

    def propose(self, view: GeneratorView) -> Proposal:
        """Push the other way."""
        proposal = self.part.propose(view)
        return proposal.with_action(other(proposal.action))


@MUTANTS.register("generator.no_rate")
class NoRate(ComponentMutation):
    """Sees the angle alone."""

    about = "takes the pole's rate to be 0"
    provokes = True

    def propose(self, view: GeneratorView) -> Proposal:
        """Propose as if the pole stood still."""

        def change(channel: str, value: Any) -> Any:
            return Pole(value.angle, 0.0) if channel == "pole" else value

        return self.part.propose(replace(view, percept=AlteredPercept(view.percept, change)))


@MUTANTS.register("generator.off_centre")
class OffCentre(ComponentMutation):
    """Takes another place for the middle."""

    about = "takes its place for another"
    parameters: ClassVar = (Parameter("metres", (0.5, 2.0), "m"),)
    metres: float

    def propose(self, view: GeneratorView) -> Proposal:
        """Propose as if the cart stood farther to the right."""

        def change(channel: str, value: Any) -> Any:
            return value + self.metres if channel == "position" else value

        return self.part.propose(replace(view, percept=AlteredPercept(view.percept, change)))


@MUTANTS.register("safety_monitor.one_sided")
class OneSided(MonitorMutation):
    """Looks to one side."""

    about = "takes a pole that falls to the left to be upright"

    def run(self, view: RoleView) -> Assessment:
        """Assess a pole that leans to the right, or stands."""

        def change(channel: str, value: Any) -> Any:
            return Pole(max(0.0, value.angle), value.rate) if channel == "pole" else value

        return self.part.run(replace(view, percept=AlteredPercept(view.percept, change)))


@MUTANTS.register("recovery_planner.pushes_it_over")
class PushesItOver(RecoveryMutation):
    """Helps the pole to fall."""

    about = "pushes the cart away from under the pole"

    def run(self, view: RoleView) -> Recovery:
        """Push the other way."""
        recovery = self.part.run(view)
        return replace(recovery, action=other(recovery.action))
