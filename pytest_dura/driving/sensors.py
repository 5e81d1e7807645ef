"""Sensor channels of the ego: what is measured, before any fault."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.percepts import Lazy, sealed
from pytest_dura.driving.bodies import CAR_LENGTH, BodyList
from pytest_dura.driving.lanes import Route
from pytest_dura.driving.roads import Road
from pytest_dura.driving.visibility import ego_box, visible
from pytest_dura.faults.model import Channel

RANGE = 80.0
"""m; reach of lidar and radar, all around; whom others hide they see unless the world says so."""


WAYPOINT_SPACING = 5.0
"""m between two waypoints of the map."""


class Imu(NamedTuple):
    """Accelerations in m/s2 along and across the ego, yaw rate in rad/s, and heading in rad.

    The heading is the unit's own, by its compass: a fault of ``localisation`` leaves it as it is.
    """

    acceleration: float
    lateral_acceleration: float
    yaw_rate: float
    heading: float


class Odometry(NamedTuple):
    """Wheel speed in m/s."""

    speed: float


class Pose(NamedTuple):
    """GNSS pose in metres and radians."""

    x: float
    y: float
    heading: float


class Waypoint(NamedTuple):
    """A point of the middle of the ego's lane: ``s`` metres along the route, place and heading."""

    s: float
    x: float
    y: float
    heading: float


class RouteMap(NamedTuple):
    """The planned route on its road; the same object at every tick.

    ``route`` gives poses along it; ``stop_line`` and ``exit`` are metres along it. ``speed_limit``
    is in m/s. ``waypoints`` are ``WAYPOINT_SPACING`` apart. ``road`` has the geometry of all arms.
    """

    route: Route
    stop_line: float
    exit: float
    speed_limit: float
    waypoints: tuple[Waypoint, ...] = ()

    @property
    def road(self) -> Road:
        """The road that the route crosses."""
        return self.route.road


TRAFFIC_LIGHT = "traffic_light"
"""Kind of a signal that shows a state."""


class Sign(NamedTuple):
    """A sign or signal that concerns the ego, and where it stands along the route in metres.

    ``text`` is what can be read on it, as far as that is more than its kind says. ``state`` is
    what a traffic light shows now: ``red``, ``yellow`` or ``green``; a sign has none.
    """

    kind: str
    at: float
    text: str = ""
    state: str = ""


_WORLD = "world: x east, y south, from the middle; angles clockwise from east"

CHANNELS: Mapping[str, Channel] = {
    "lidar": Channel(
        "objects",
        frame=_WORLD,
        meaning=f"who and what is within {RANGE:g} m: id, place in m, heading in rad, velocity in "
        "m/s, length and width in m",
    ),
    "radar": Channel(
        "array",
        columns=3,
        units=("m", "rad", "m/s"),
        frame="ego: azimuth to the left of ahead",
        meaning="the same objects, measured independently: range, azimuth, range rate",
    ),
    "camera_front": Channel(
        "image", frame="ego: ahead", meaning="the view through the windscreen, in RGB"
    ),
    "camera_third_person": Channel(
        "image", frame="ego: from behind and above", meaning="the ego and its surroundings, in RGB"
    ),
    "imu": Channel(
        "numbers",
        Imu._fields,
        units=("m/s2", "m/s2", "rad/s", "rad"),
        frame="ego: along and across; heading and yaw clockwise, heading from east",
        meaning="accelerations, yaw rate, and heading by a compass of its own",
    ),
    "odometry": Channel(
        "numbers", Odometry._fields, units=("m/s",), frame="ego: ahead", meaning="wheel speed"
    ),
    "localisation": Channel(
        "pose", Pose._fields, units=("m", "m", "rad"), frame=_WORLD, meaning="pose by GNSS"
    ),
    "map": Channel("other", frame=_WORLD, meaning="the route, its stop line, exit and speed limit"),
    "controls": Channel("signs", meaning="signs and traffic lights that concern the ego"),
    "command": Channel("numbers", ("acceleration",), units=("m/s2",)),
}
"""Content of the channels, for the faults that act on them."""

CHANNEL_ALIASES: Mapping[str, str] = {"objects": "lidar"}
"""Second names: what lidar reports are perceived objects, not ranges."""

FAULT_TARGETS: Mapping[str, str] = {
    "number": "odometry.speed",
    "any": "localisation",
    "command": "command.acceleration",
    "objects": "lidar",
    "image": "camera_front",
    "pose": "localisation",
    "signs": "controls",
}
"""Target of a fault that names none, by what its type can act on.

Any value will do for a fault of delivery; the pose changes at every tick and is what planners read,
while of objects there may be none.
"""


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


@cache
def route_map(route: Route) -> RouteMap:
    """The map channel of a route."""
    along = np.append(np.arange(0.0, route.length, WAYPOINT_SPACING), route.length)
    points = zip(along.tolist(), *(column.tolist() for column in route.pose(along)), strict=True)
    waypoints = tuple(Waypoint(*point) for point in points)
    return RouteMap(route, route.stop_line, route.exit, route.road.speed_limit, waypoints)


@cache
def signs(route: Route, light: str = "") -> tuple[Sign, ...]:
    """The sign of a route's arm and the traffic light at its stop line, as far as there are any.

    Args:
        route: Whose arm they stand on.
        light: What the light shows; empty without one.
    """
    kind, at = route.road.sign(route.origin), route.stop_line
    shown = [Sign(kind, at)] if kind else []
    if light:
        shown.append(Sign(TRAFFIC_LIGHT, at, "", light))
    return tuple(shown)


def radar_returns(ego: EgoState, bodies: BodyList) -> NDArray[np.float64]:
    """One row per object, ``(n, 3)``: range in m, azimuth left of ahead in rad, rate in m/s.

    Plain arithmetic, which for the few objects in reach is quicker than arrays.
    """
    c, s = math.cos(ego.heading), math.sin(ego.heading)
    ego_vx, ego_vy = ego.speed * c, ego.speed * s
    rows = []
    for x, y, _, vx, vy, _, _ in bodies.numbers:
        dx, dy = x - ego.x, y - ego.y
        distance = math.hypot(dx, dy)
        azimuth = math.atan2(s * dx - c * dy, c * dx + s * dy)
        rate = (dx * (vx - ego_vx) + dy * (vy - ego_vy)) / max(distance, 0.1)
        rows.append((distance, azimuth, rate))
    return sealed(np.array(rows) if rows else np.empty((0, 3)))


def _in_reach(ego: EgoState, bodies: BodyList) -> BodyList:
    """The bodies within the sensors' reach."""
    own_x, own_y, numbers = ego.x, ego.y, bodies.numbers
    rows = [
        row
        for row, (x, y, _, _, _, _, _) in enumerate(numbers)
        if (x - own_x) ** 2 + (y - own_y) ** 2 < RANGE * RANGE
    ]
    if len(rows) == len(numbers):
        return bodies
    ids = tuple([bodies.ids[row] for row in rows])
    return BodyList(ids, bodies.data[rows], tuple([numbers[row] for row in rows]))


def channels(
    ego: EgoState,
    bodies: BodyList,
    route: RouteMap,
    controls: tuple[Sign, ...],
    camera: Callable[[str], Any],
    *,
    occlusion: bool = False,
) -> dict[str, Any]:
    """All channels of one tick. Radar measures the same objects as lidar, independently of it."""
    bodies = _in_reach(ego, bodies)
    if occlusion:
        bodies = visible(ego_box(ego), bodies)
    return {
        "lidar": bodies,
        "radar": radar_returns(ego, bodies),
        "camera_front": Lazy(lambda: camera("front")),
        "camera_third_person": Lazy(lambda: camera("third_person")),
        "imu": Imu(ego.acceleration, ego.speed * ego.yaw_rate, ego.yaw_rate, ego.heading),
        "odometry": Odometry(ego.speed),
        "localisation": Pose(ego.x, ego.y, ego.heading),
        "map": route,
        "controls": controls,
    }
