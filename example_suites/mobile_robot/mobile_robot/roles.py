"""The planner under test, and the roles around it."""

from __future__ import annotations

import math

import numpy as np

from mobile_robot.world import ANGLES, RADIUS, TOP_SPEED, TRACK, Wheels
from pytest_dura import (
    Assessed,
    Assessment,
    Generator,
    GeneratorView,
    Proposal,
    Recovery,
    RecoveryPlanner,
    RoleView,
    SafetyMonitor,
)

BRAKING = 1.5
"""m/s2 that the monitor counts on."""
MARGIN = 0.12
"""m that are kept free, ahead and to the sides: what it moves before the monitor looks again."""
REACTION = 0.25
"""s until the brakes act: a tick and the wheels' lag."""


def free_way(ranges: np.ndarray, directions: np.ndarray, half_width: float) -> np.ndarray:
    """How far a body of this half width gets in each direction, in m."""
    turned = ANGLES[None, :] - directions[:, None]
    ahead, beside = ranges * np.cos(turned), np.abs(ranges * np.sin(turned))
    return np.where((ahead > 0.0) & (beside < half_width), ahead, np.inf).min(axis=1)


class FollowGap(Generator):
    """Drives towards the goal, in the direction nearest to it that is free for long enough."""

    margin, look_ahead, pace = 0.12, 1.5, 0.8

    def propose(self, view: GeneratorView) -> Proposal:
        """Turn to the best direction, the slower the less there is ahead."""
        goal, ranges = view.percept["goal"], view.percept["lidar"]
        wanted = min(self.look_ahead, goal.distance)
        free = free_way(ranges, ANGLES, RADIUS + self.margin)
        off = np.abs(np.angle(np.exp(1j * (ANGLES - goal.bearing))))
        cost = off + 0.2 * np.abs(ANGLES) + 4.0 * np.maximum(0.0, wanted - free)
        direction = float(ANGLES[int(np.argmin(cost))])
        ahead = float(free_way(ranges, np.zeros(1), RADIUS + self.margin / 2)[0])
        speed = TOP_SPEED * self.pace * max(0.0, math.cos(direction))
        speed = min(speed, max(0.0, 0.9 * (ahead - RADIUS - 0.1)))
        turn = max(-1.0, min(1.0, 2.0 * direction)) * TRACK
        return Proposal(Wheels(speed + turn / 2, speed - turn / 2), f"towards {direction:+.2f} rad")


class Hasty(FollowGap):
    """Looks no farther than half a metre, and drives at full speed."""

    margin, look_ahead, pace = 0.0, 0.5, 1.0

    def propose(self, view: GeneratorView) -> Proposal:
        """Full speed, whatever is ahead."""
        left, right = super().propose(view).action
        return Proposal(Wheels(TOP_SPEED, TOP_SPEED - (left - right)), "in a hurry")


class BrakingMonitor(SafetyMonitor):
    """Refuses to drive on where the robot could not stop any more; the score is the rest in m."""

    def run(self, view: RoleView) -> Assessment:
        """Compare the way ahead with the way to stop, at the speed that odometry reports."""
        assert view.proposal is not None
        speed = max(0.0, view.percept["odometry"].speed)
        ahead = float(free_way(view.percept["lidar"], np.zeros(1), RADIUS + MARGIN / 2)[0])
        rest = min(ahead, 10.0) - RADIUS - MARGIN
        rest -= speed * REACTION + speed * speed / (2 * BRAKING)
        if rest < 0.0 and sum(view.proposal.action) > 0.0:
            return Assessment(Assessed.UNSAFE, rest, (f"{-rest:.2f} m too near to stop",))
        return Assessment(Assessed.SAFE, rest)


class Stop(RecoveryPlanner):
    """Stops both wheels; a robot that stands may turn where it is."""

    def run(self, view: RoleView) -> Recovery:
        """Stand, or keep the proposed turn."""
        left, right = (0.0, 0.0) if view.proposal is None else view.proposal.action
        turn = (left - right) / 2
        return Recovery(Wheels(turn, -turn), "stop", "; ".join(view.reasons))
