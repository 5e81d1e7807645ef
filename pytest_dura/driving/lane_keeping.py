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

    def keep_lane(self) -> float:
        """Go on to the next lane where one ends, and the steering angle in rad that follows it.

        ``follow_road`` and ``steering_control`` in one, which measure the same otherwise.
        """
        lane = self.road.network.get_lane(self.target_lane_index)
        along, offset = lane.local_coordinates(self.position)
        if lane.after_end(self.position, along):
            self.follow_road()
            return self.steering_control(self.target_lane_index)
        return self._steering(lane, along, offset)

    def steering_control(self, target_lane_index: Any) -> float:
        """The steering angle in rad that follows the centre of a lane."""
        lane = self.road.network.get_lane(target_lane_index)
        return self._steering(lane, *lane.local_coordinates(self.position))

    def _steering(self, lane: Any, along: float, offset: float) -> float:
        """Offset to lateral speed, to heading; its error to a rate of turn, and that to an angle.

        See ``highway_env.vehicle.controller.ControlledVehicle.steering_control``. Sine and tangent
        stay numpy's, which may differ from the standard library's in the last bit.
        """
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
