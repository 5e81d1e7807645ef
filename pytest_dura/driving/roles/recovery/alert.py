"""AlertOnly: a recovery that does nothing but say that there was reason to act."""

from __future__ import annotations

from pytest_dura.core.roles import Recovery, RecoveryPlanner
from pytest_dura.core.state import RoleView
from pytest_dura.driving.maneuvers import Command, Maneuver


class AlertOnly(RecoveryPlanner):
    """Lets the proposal stand. That it was called is recorded; it takes no action of its own.

    Where the component made no valid proposal, the car keeps its speed, as without any recovery.
    """

    def run(self, view: RoleView) -> Recovery:
        """The proposal itself."""
        action = Command(Maneuver.PROCEED, 0.0)
        if view.proposal is not None:
            action = view.proposal.action
        return Recovery(action, "alert", "; ".join(view.reasons))
