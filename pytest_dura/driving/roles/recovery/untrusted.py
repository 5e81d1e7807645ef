"""IgnoreUntrusted: judges the proposal anew, without what the SecurityAssessor distrusts."""

from __future__ import annotations

from collections.abc import Mapping

from pytest_dura.core.roles import Assessed, Assessment, Recovery, RecoveryPlanner, RoleContext
from pytest_dura.core.state import Percept, RoleView
from pytest_dura.driving.bodies import BodyList
from pytest_dura.driving.maneuvers import Command, Maneuver
from pytest_dura.driving.radar import with_unexplained_returns
from pytest_dura.driving.roles.recovery.outlook import SecondOpinion, lidar


class IgnoreUntrusted(RecoveryPlanner):
    """Lets the proposal stand if it is safe without the objects under suspicion; else brakes.

    An object is distrusted for a while after any SecurityAssessor has alerted to it. The
    SeparationMonitor's own predicate is asked again without it; what radar sees at a place where
    lidar then reports nothing counts as a car. If another role refused the proposal as well, or
    nothing is distrusted, it brakes as hard as it can.

    **It trusts the assessor, and that can be abused.** Whoever makes a real car look implausible,
    to lidar and radar alike, has it driven into; so has a failing sensor that lets a real object
    vanish and appear again, or leap. Radar is the only safeguard, and it knows no course: a car
    that it sees is taken to keep the speed that its road lets expect. Ids are what is distrusted:
    a real object that takes over the id of a ghost is ignored with it.

    Args:
        memory: Seconds for which an alert counts.
        monitor: Parameters of the SeparationMonitor whose predicate is asked; give those of the
            scenario's own monitor, if it has any.
    """

    def __init__(self, memory: float = 5.0, monitor: Mapping[str, float] | None = None) -> None:
        self.memory = memory
        self._opinion = SecondOpinion(monitor)

    def reset(self, context: RoleContext) -> None:
        """Forget the bodies seen."""
        self._opinion.reset(context)

    def run(self, view: RoleView) -> Recovery:
        """The proposal, or full braking."""
        distrusted = {
            alert.subject for time, alert in view.alerts if view.time - time <= self.memory
        }
        present = [name for name in lidar(view.percept).ids if name in distrusted]
        why = "; ".join(view.reasons)
        if present and view.proposal is not None and not _others_refuse(view):

            def trusted(percept: Percept) -> BodyList:
                return _without(percept, distrusted)

            judged = self._opinion.judge(view, view.proposal.action, trusted)
            if judged.verdict is not Assessed.UNSAFE and not judged.critical:
                told = f"safe without {', '.join(present)} ({why})"
                return Recovery(view.proposal.action, "ignore_untrusted", told)
            why = "; ".join(judged.reasons)
        return Recovery(Command(Maneuver.EMERGENCY_BRAKE), "emergency_brake", why)


def _others_refuse(view: RoleView) -> bool:
    """Whether somebody refuses for reasons that the SeparationMonitor's predicate cannot answer."""
    return any(
        isinstance(output, Assessment)
        and (output.critical or (output.verdict is Assessed.UNSAFE and name != "safety_monitor"))
        for name, output in view.outputs.items()
    )


def _without(percept: Percept, distrusted: set[str]) -> BodyList:
    """The objects that are trusted, and a car for each radar return that they do not explain."""
    bodies = lidar(percept)
    kept = bodies.rows([row for row, name in enumerate(bodies.ids) if name not in distrusted])
    names = ("localisation", "odometry", "radar")
    return with_unexplained_returns({"lidar": kept, **{name: percept[name] for name in names}})
