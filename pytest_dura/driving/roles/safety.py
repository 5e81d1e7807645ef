"""SafetyMonitor: predicted separation, following distance and right of way for the proposal."""

from __future__ import annotations

from pytest_dura.core.roles import Assessed, Assessment, RoleContext, SafetyMonitor
from pytest_dura.core.state import RoleView
from pytest_dura.driving import prediction
from pytest_dura.driving.junction import SPEED_LIMIT
from pytest_dura.driving.maneuvers import MAX_BRAKING, acceleration_for, braking_distance
from pytest_dura.driving.nearest import nearest
from pytest_dura.driving.plausible import doubtful
from pytest_dura.driving.roles.performance import STANDING
from pytest_dura.driving.scene import Scene, crossing, time_to_cover

SEPARATION_CAP = 10.0
"""m; the score saturates here."""

ENTRY = 0.5
"""Seconds after which a proposal that could not stop before the stop line any more is held to the
right of way."""


class SeparationMonitor(SafetyMonitor):
    """Sees whether the proposed command, kept up for a while, comes too near to somebody.

    Args:
        horizon: Seconds that are predicted.
        unsafe: Predicted separation in m below which the proposal is unsafe.
        warning: The same for a warning.
        reaction: Seconds before the ego can answer a braking leader.

    A proposal to go on standing is no more than a warning: who comes near then, comes by itself.

    The score is the least predicted separation in m. What it cannot judge is unsafe, with a score
    of 0 at most: a percept with an own pose or speed that cannot be, or with such numbers of an
    object that may be near.
    """

    def __init__(
        self, horizon: float = 2.0, unsafe: float = 0.3, warning: float = 1.0, reaction: float = 0.3
    ) -> None:
        self.horizon, self.unsafe, self.warning, self.reaction = horizon, unsafe, warning, reaction
        self._predictor = prediction.Predictor(horizon, 0.25)

    def reset(self, context: RoleContext) -> None:
        """Forget the bodies seen."""
        self._predictor.reset()

    def run(self, view: RoleView) -> Assessment:
        """The worst of separation, following distance and right of way."""
        scene = Scene.of(view.percept)
        self._predictor.observe(view.index, scene.bodies)
        if view.proposal is None:
            return Assessment(Assessed.SAFE, SEPARATION_CAP)
        acceleration = acceleration_for(view.proposal.action, scene.speed, scene.to_stop_line)
        separation, who = self._separation(scene, acceleration, view.dt)
        reasons, verdict = [], Assessed.SAFE
        doubts = doubtful(view.percept)
        if doubts:
            verdict, separation = Assessed.UNSAFE, min(separation, 0.0)
            reasons += [f"cannot judge: {one.subject} {one.detail}" for one in doubts]
        elif separation < self.warning:
            # Who stands and means to is refused in vain: no brake makes that any safer.
            stands = scene.speed < STANDING and acceleration <= 0.0
            unsafe = separation < self.unsafe and not stands
            verdict = Assessed.UNSAFE if unsafe else Assessed.WARNING
            reasons.append(f"comes within {max(separation, 0.0):.1f} m of {who}")
        following = self._following(scene, acceleration)
        if following is not None:
            verdict = Assessed.UNSAFE
            reasons.append(following)
        taken = self._right_of_way(scene, acceleration)
        if taken is not None:
            verdict = Assessed.UNSAFE
            reasons.append(taken)
        return Assessment(verdict, separation, tuple(reasons))

    def _separation(self, scene: Scene, acceleration: float, dt: float) -> tuple[float, str]:
        # Who is named is in no reason unless it comes within the cap, or the warning's distance.
        cap = max(SEPARATION_CAP, self.warning)
        apart, who = nearest(self._predictor, scene, acceleration, dt, cap) or (SEPARATION_CAP, "")
        return min(apart, SEPARATION_CAP), who

    def _following(self, scene: Scene, acceleration: float) -> str | None:
        """Why the ego could not stop behind its leader if that braked as hard as it can."""
        leader = scene.leader()
        if leader is None or acceleration <= -0.9 * MAX_BRAKING:
            return None
        speed = max(scene.speed + acceleration * self.reaction, 0.0)
        needed = scene.speed * self.reaction + braking_distance(speed, MAX_BRAKING)
        needed -= braking_distance(max(leader.speed, 0.0), MAX_BRAKING)
        if scene.speed > 0.5 and leader.distance < needed:
            distance = max(leader.distance, 0.0)
            return f"follows {leader.body.id} at {distance:.1f} m, needs {needed:.1f} m"
        return None

    def _right_of_way(self, scene: Scene, acceleration: float) -> str | None:
        """Why the proposal enters the junction in front of a car that must then brake."""
        to_line = scene.to_stop_line
        if scene.entered or braking_distance(scene.speed, MAX_BRAKING) > to_line:
            return None
        # Who could not stop before the line any more once this is under way has taken it.
        reached = max(scene.speed + acceleration * ENTRY, 0.0)
        (driven,) = prediction.driven(scene.speed, acceleration, (ENTRY,), SPEED_LIMIT)
        if driven + braking_distance(reached, MAX_BRAKING) < to_line:
            return None
        through = scene.exit - scene.s
        clears = time_to_cover(through, scene.speed, max(acceleration, 1.5), SPEED_LIMIT)
        for other in crossing(scene):
            if other.speed > 1.0 and 0.0 < other.distance < other.speed * clears:
                return f"takes the right of way of {other.body.id}"
        return None
