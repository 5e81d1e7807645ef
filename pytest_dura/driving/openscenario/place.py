"""Places in the world of a file as places at our junction.

OpenSCENARIO has x east, y north and angles counter-clockwise; see ``junction`` for ours.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from pytest_dura.driving.junction import LANE_OFFSET, STOP_LINE, TURNS

LANE_WIDTH = 2 * LANE_OFFSET
_NEAR_CENTRE = 3.0
"""m from the centre, within which a route's end does not tell an arm."""


@dataclass(frozen=True)
class Pose:
    """A place in the world of a file: m, m, rad."""

    x: float
    y: float
    heading: float = 0.0

    def moved(self, ahead: float, left: float = 0.0, turn: float = 0.0) -> Pose:
        """Return the pose that lies so many metres ahead and to the left."""
        c, s = math.cos(self.heading), math.sin(self.heading)
        return Pose(
            self.x + c * ahead - s * left, self.y + s * ahead + c * left, self.heading + turn
        )


@dataclass(frozen=True)
class Spot:
    """A place on an arm.

    Args:
        arm: Number of the arm, 0 for that of the south.
        out: Metres from the stop line outwards.
        beside: Metres to the right of the road's middle, for a driver who nears the junction.
        turned: Radians from the direction of such a driver, counter-clockwise, in -pi to pi.
    """

    arm: int
    out: float
    beside: float
    turned: float

    @property
    def aside(self) -> float:
        """Metres to the right of the middle of the lane towards the junction."""
        return self.beside - LANE_OFFSET

    @property
    def on_lane(self) -> bool:
        """Whether it is on the lane towards the junction."""
        return abs(self.aside) <= LANE_WIDTH / 2


@dataclass(frozen=True)
class Frame:
    """Where our junction lies in the world of a file.

    Args:
        x: Its centre.
        y: Its centre.
        heading: Direction of its east, in radians counter-clockwise.
        south: Number of the arm, seen from the file, that is our south.
    """

    x: float = 0.0
    y: float = 0.0
    heading: float = 0.0
    south: int = 0

    def spot(self, pose: Pose) -> Spot:
        """Find the place on the arm that the pose is on, the one farthest out."""
        c, s = math.cos(-self.heading), math.sin(-self.heading)
        east = c * (pose.x - self.x) - s * (pose.y - self.y)
        south = -(s * (pose.x - self.x) + c * (pose.y - self.y))
        places = [(self._on_arm(arm, east, south), arm) for arm in range(4)]
        (beside, out), arm = max(places, key=lambda place: place[0][1])
        inwards = self.heading + math.pi / 2 - arm * math.pi / 2
        turned = (pose.heading - inwards + math.pi) % (2 * math.pi) - math.pi
        return Spot((arm - self.south) % 4, out - STOP_LINE, beside, turned)

    @staticmethod
    def _on_arm(arm: int, east: float, south: float) -> tuple[float, float]:
        turn = arm * math.pi / 2
        c, s = math.cos(turn), math.sin(turn)
        return c * east + s * south, c * south - s * east


def turn_between(arm: int, end: Spot) -> str | None:
    """Return the turn from an arm to where a route ends; ``None`` if there is none."""
    if end.out < _NEAR_CENTRE - STOP_LINE or end.arm == arm:
        return None
    return TURNS[(end.arm - arm) % 4 - 1]
