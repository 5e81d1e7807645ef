"""Sensor channels of the ego: what is measured, before any fault."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.state import Lazy
from pytest_dura.driving.bodies import CAR_LENGTH, VX, VY, BodyList
from pytest_dura.driving.junction import ARM_LENGTH, SPEED_LIMIT, Route

RANGE = 80.0
"""m; reach of lidar and radar, all around, without occlusion."""


class Imu(NamedTuple):
    """Accelerations in m/s2 along and across the ego, and yaw rate in rad/s."""

    acceleration: float
    lateral_acceleration: float
    yaw_rate: float


class Odometry(NamedTuple):
    """Wheel speed in m/s."""

    speed: float


class Pose(NamedTuple):
    """GNSS pose in metres and radians."""

    x: float
    y: float
    heading: float


class RouteMap(NamedTuple):
    """The planned route; the same object at every tick.

    ``route`` gives poses along it; ``stop_line`` and ``exit`` are metres along it, ``destination``
    an arm. ``speed_limit`` is in m/s.
    """

    route: Route
    stop_line: float
    exit: float
    speed_limit: float


class Sign(NamedTuple):
    """A sign or signal that concerns the ego, and where it stands along the route in metres."""

    kind: str
    at: float


class EgoState(NamedTuple):
    """Ground truth of the ego; ``s`` and ``lateral`` are metres along and beside its route."""

    x: float
    y: float
    heading: float
    speed: float
    acceleration: float
    commanded: float
    yaw_rate: float
    s: float
    lateral: float

    @property
    def front(self) -> float:
        """``s`` of its front bumper."""
        return self.s + CAR_LENGTH / 2


def route_map(route: Route) -> RouteMap:
    """The map channel of a route."""
    return RouteMap(route, ARM_LENGTH, route.exit, SPEED_LIMIT)


def signs(route: Route) -> tuple[Sign, ...]:
    """The signs of a route: the north-south road gives way."""
    return (Sign("priority_road" if route.origin % 2 else "give_way", ARM_LENGTH),)


def radar_returns(ego: EgoState, bodies: BodyList) -> NDArray[np.float64]:
    """One row per object, ``(n, 3)``: range in m, azimuth left of ahead in rad, rate in m/s."""
    data = bodies.data
    dx, dy = data[:, 0] - ego.x, data[:, 1] - ego.y
    distance = np.hypot(dx, dy)
    c, s = math.cos(ego.heading), math.sin(ego.heading)
    relative_vx = data[:, VX] - ego.speed * c
    relative_vy = data[:, VY] - ego.speed * s
    returns = np.empty((len(bodies), 3))
    returns[:, 0] = distance
    returns[:, 1] = np.arctan2(-(c * dy - s * dx), c * dx + s * dy)
    returns[:, 2] = (dx * relative_vx + dy * relative_vy) / np.maximum(distance, 0.1)
    returns.flags.writeable = False
    return returns


def channels(
    ego: EgoState,
    bodies: BodyList,
    route: RouteMap,
    controls: tuple[Sign, ...],
    camera: Callable[[str], Any],
) -> dict[str, Any]:
    """All channels of one tick. Radar measures the same objects as lidar, independently of it."""
    data = bodies.data
    if len(bodies):
        near = (data[:, 0] - ego.x) ** 2 + (data[:, 1] - ego.y) ** 2 < RANGE * RANGE
        bodies = bodies.only(near)
    return {
        "lidar": bodies,
        "radar": radar_returns(ego, bodies),
        "camera_front": Lazy(lambda: camera("front")),
        "camera_third_person": Lazy(lambda: camera("third_person")),
        "imu": Imu(ego.acceleration, ego.speed * ego.yaw_rate, ego.yaw_rate),
        "odometry": Odometry(ego.speed),
        "localisation": Pose(ego.x, ego.y, ego.heading),
        "map": route,
        "controls": controls,
    }
