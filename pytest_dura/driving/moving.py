"""What moves alike in every simulator of driving: the ego's actuator, and pedestrians.

A simulator's own classes take these in beside its library's; only how cars drive is the library's.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pytest_dura.driving.maneuvers import MAX_ACCELERATION, MAX_BRAKING
from pytest_dura.driving.roads import Arm


class Actuated:
    """Drive and brake of the ego: ``commanded`` is asked for, ``executed`` follows, in m/s2."""

    SLEW = 40.0
    """m/s3; the brake or drive builds up from zero to full in about a fifth of a second."""

    speed: float
    commanded = 0.0
    executed = 0.0

    def actuate(self, acceleration: float, dt: float) -> None:
        """Command an acceleration in m/s2 for the next ``dt`` seconds.

        The car does not reverse, and the brake is let off in time for a stop within the slew rate.
        """
        self.commanded = acceleration
        step = self.SLEW * dt
        target = max(-MAX_BRAKING, min(MAX_ACCELERATION, acceleration))
        target = max(target, -_braking_to_stop(self.speed / dt, step))
        executed = max(self.executed - step, min(self.executed + step, target))
        if self.speed + executed * dt < 0.0:
            executed = -self.speed / dt
        self.executed = executed


def _braking_to_stop(speed: float, step: float) -> float:
    """Greatest braking from which the brake can be let off by ``step`` a tick until the car stands.

    ``speed`` is in m/s per tick, the unit of ``step`` and of the result m/s2.
    """
    ticks = 1
    while (braking := speed / ticks + step * (ticks - 1) / 2) > step * ticks:
        ticks += 1
    return braking


class Walking:
    """A pedestrian who goes straight ahead, and stops for a car within a metre before it."""

    body_id: str
    position: NDArray[np.float64]
    direction: NDArray[np.float64]
    speed: float
    crashed: bool
    walking = 1.3
    start = 0.0
    distance = 20.0
    walked = 0.0

    def walk(self, time: float, dt: float, vehicles: Iterable[Any]) -> None:
        """Advance by one tick from ``time`` on."""
        going = time >= self.start and self.walked < self.distance and not self.crashed
        if going and any(self._blocked_by(vehicle) for vehicle in vehicles):
            going = False
        self.speed = self.walking if going else 0.0
        self.position = self.position + self.speed * dt * self.direction
        self.walked += self.speed * dt

    def clearance(self) -> float:
        """Metres beside a path within which a driver stops: more while the pedestrian walks."""
        return 3.5 if self.speed > 0.0 else 2.0

    def _blocked_by(self, vehicle: Any) -> bool:
        ahead = self.position + 1.0 * self.direction
        offset = ahead - vehicle.position
        along = abs(float(offset @ vehicle.direction))
        across = abs(vehicle.direction[0] * offset[1] - vehicle.direction[1] * offset[0])
        return bool(along < vehicle.LENGTH / 2 + 0.5 and across < vehicle.WIDTH / 2 + 0.5)


def crossing_length(arm: Arm) -> float:
    """Metres that a pedestrian walks: from a metre beside the road to a metre beside it."""
    return 2 * (arm.lane_width + 1.0)


def kerb(arm: Arm, offset: float, side: str) -> tuple[float, float, float]:
    """Place and heading of a pedestrian who is about to cross an arm.

    Args:
        arm: Which one.
        offset: Metres out from the stop line.
        side: Where it comes from, seen by a driver on that arm who nears the junction.
    """
    sign = 1.0 if side == "right" else -1.0
    x, y = arm.place(arm.stop_line + offset, sign * crossing_length(arm) / 2)
    return x, y, arm.angle + (math.pi if side == "right" else 0.0)


def placed(arm: Arm, offset: float, beside: float) -> tuple[float, float, float]:
    """Place and heading on an arm: metres out from the stop line, and right of its middle."""
    return (*arm.place(arm.stop_line + offset, beside), arm.angle - math.pi / 2)
