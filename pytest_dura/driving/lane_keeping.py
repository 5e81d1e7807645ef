"""highway-env's lateral control, in plain arithmetic: the same angle for a fraction of its cost."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from highway_env.utils import not_zero, wrap_to_pi
from highway_env.vehicle.controller import ControlledVehicle

_SHARPEST_COURSE = math.pi / 4
"""Greatest angle in rad between lane and course that is steered for."""


class LaneKeeping(ControlledVehicle):
    """Steers along a lane as highway-env does, to the last bit."""

    def steering_control(self, target_lane_index: Any) -> float:
        """The steering angle in rad that follows the centre of a lane.

        Offset to lateral speed, that to a heading, its error to a rate of turn and that to an
        angle, see ``highway_env.vehicle.controller.ControlledVehicle.steering_control``. Sine and
        tangent stay numpy's, which may differ from the standard library's in the last bit.
        """
        lane = self.road.network.get_lane(target_lane_index)
        along, offset = lane.local_coordinates(self.position)
        course = lane.heading_at(along + self.speed * self.TAU_PURSUIT)
        speed = not_zero(self.speed)
        heading = float(np.arcsin(within(-self.KP_LATERAL * offset / speed, 1.0)))
        wanted = course + within(heading, _SHARPEST_COURSE)
        rate = self.KP_HEADING * wrap_to_pi(wanted - self.heading)
        slip = np.arcsin(within(self.LENGTH / 2 / speed * rate, 1.0))
        return within(float(np.arctan(2 * np.tan(slip))), self.MAX_STEERING_ANGLE)


def within(value: float, most: float) -> float:
    """The value between ``-most`` and ``most``; what is not a number stays none."""
    if value > most:
        return most
    if value < -most:
        return -most
    return value
