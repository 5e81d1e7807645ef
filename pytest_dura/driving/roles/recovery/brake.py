"""EmergencyBrake: the default recovery."""

from __future__ import annotations

from pytest_dura.core.roles import Recovery, RecoveryPlanner
from pytest_dura.core.state import RoleView
from pytest_dura.driving.maneuvers import Command, Maneuver


class EmergencyBrake(RecoveryPlanner):
    """Brakes as hard as the car can, wherever it is.

    Inside the conflict zone that may get it struck by others: braking is no general benefit, and
    the paired runs of the benchmark say by how much.
    """

    def run(self, view: RoleView) -> Recovery:
        """Full braking."""
        reasons = "; ".join(view.reasons)
        return Recovery(Command(Maneuver.EMERGENCY_BRAKE), "emergency_brake", reasons)
