"""Scene for driving on: where the ego is on its route, how fast, and who is around it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from pytest_dura.core.percepts import shared
from pytest_dura.driving.bodies import CAR_LENGTH, CAR_WIDTH, WIDTH, Body, BodyList
from pytest_dura.driving.lanes import Crossing, Route, crossings, joined
from pytest_dura.driving.percepts import own_pose, own_speed, plausible_objects
from pytest_dura.driving.sensors import Pose, RouteMap


class Ego(NamedTuple):
    """Pose, speed in m/s, the route, and ``s``: metres of the centre along the route."""

    pose: Pose
    speed: float
    way: RouteMap
    s: float

    @property
    def to_stop_line(self) -> float:
        """Metres from the front bumper to the stop line; negative past it."""
        return self.way.stop_line - self.s - CAR_LENGTH / 2


def ego_of(percept: Mapping[str, Any]) -> Ego:
    """The ego of the channels localisation, odometry and map, computed once for a percept."""
    return shared(_ego, percept)


def _ego(percept: Mapping[str, Any]) -> Ego:
    pose, way = own_pose(percept), percept["map"]
    s, _ = way.route.project(pose.x, pose.y)
    return Ego(pose, own_speed(percept), way, s)


HALF = CAR_LENGTH / 2


class InLane(NamedTuple):
    """A body on the ego's path ahead: metres between bumpers, and its speed along the path."""

    body: Body
    distance: float
    speed: float


@dataclass(slots=True)
class Scene:
    """The ego on its route, as perceived. ``s`` is metres along the route."""

    route: Route
    s: float
    x: float
    y: float
    speed: float
    stop_line: float
    exit: float
    bodies: BodyList

    @classmethod
    def of(cls, percept: Mapping[str, Any]) -> Scene:
        """The scene of the channels localisation, odometry, map and lidar."""
        ego = ego_of(percept)
        way = ego.way
        return cls(
            way.route, ego.s, ego.pose.x, ego.pose.y, max(ego.speed, 0.0),
            way.stop_line, way.exit, plausible_objects(percept),
        )  # fmt: skip

    @property
    def to_stop_line(self) -> float:
        """Metres from the front bumper to the stop line; negative past it."""
        return self.stop_line - self.s - HALF

    @property
    def limit(self) -> float:
        """Speed limit of the road, in m/s."""
        return self.route.road.speed_limit

    @property
    def entered(self) -> bool:
        """Whether the front has crossed the stop line."""
        return self.to_stop_line < 0.0

    @property
    def cleared(self) -> bool:
        """Whether the rear has left the junction."""
        return self.s - HALF > self.exit

    def leader(self) -> InLane | None:
        """The nearest body on the ego's path that stands or moves along it."""
        nearest: InLane | None = None
        bodies, own = self.bodies, self.s
        for row, (s, lateral) in enumerate(bodies.beside(self.route)):
            if s <= own or abs(lateral) > (bodies.numbers[row][WIDTH] + CAR_WIDTH) / 2 + 0.2:
                continue
            body = bodies[row]
            distance = s - own - HALF - body.length / 2
            heading = self.route.sampled_heading(s)
            c, sn = math.cos(heading), math.sin(heading)
            along, across = body.vx * c + body.vy * sn, abs(body.vy * c - body.vx * sn)
            if across > max(along, 1.0):  # it crosses: that is no leader
                continue
            if nearest is None or distance < nearest.distance:
                nearest = InLane(body, distance, along)
        return nearest


class Approach(NamedTuple):
    """A car with right of way that comes towards the ego's lane on another arm, ``arm``.

    ``distance`` is metres from its front to the ego's lane, and ``past`` metres until its rear has
    left that lane. ``meets`` is the ``s`` at which the ego's lane meets its path.
    """

    body: Body
    arm: str
    distance: float
    past: float
    speed: float
    meets: float


_BESIDE_ROAD = 0.5
"""m beside a road, within which a car is on it."""
_SAME_COURSE = 0.5
"""Cosine of the angle to a road up to which a car drives along it."""


def crossing(scene: Scene) -> list[Approach]:
    """Cars with right of way that have yet to cross the ego's lane.

    Of who comes on a crossing road, the turn is unknown and taken to be straight on, which crosses
    the lane. Who comes against an ego that turns left, or on a road that the ego joins, is taken to
    follow the lane to where the two routes conflict.
    """
    route = scene.route
    approaches = []
    for body in scene.bodies:
        if body.is_pedestrian:
            continue
        approach = next(
            (seen for way in crossings(route) if (seen := _across(body, way)) is not None), None
        )
        if approach is None and joined(route):
            approach = _joining(body, route)
        if approach is not None and approach.past > 0.0:
            approaches.append(approach)
    return approaches


def _across(body: Body, way: Crossing) -> Approach | None:
    """The body as it comes along a crossing road; ``None`` if it does not."""
    arm = way.arm
    if abs(arm.beside(body.x, body.y)) > arm.lane_width + _BESIDE_ROAD:
        return None
    dx, dy = arm.inward
    if math.cos(body.heading) * dx + math.sin(body.heading) * dy < _SAME_COURSE:
        return None
    to_lane = (way.x - body.x) * dx + (way.y - body.y) * dy
    sine = abs(way.sine)
    half = body.length / 2 + CAR_WIDTH / 2 / sine + _BESIDE_ROAD / sine
    half += body.width / 2 * abs(way.cosine) / sine
    beyond = ((body.x - way.foot[0]) * dy - (body.y - way.foot[1]) * dx) / way.sine
    speed = math.hypot(body.vx, body.vy)
    return Approach(
        body, arm.name, max(to_lane - half, 0.0), to_lane + half, speed, way.at + beyond
    )


def _joining(body: Body, route: Route) -> Approach | None:
    """The body as it follows a lane with which the route conflicts; ``None`` if it does not."""
    for other, (_, ends, begins, leaves) in joined(route):
        s, lateral = other.project(body.x, body.y)
        if abs(lateral) > other.arm.offset + _BESIDE_ROAD:
            continue
        if math.cos(body.heading - other.heading_at(s)) < _SAME_COURSE:
            continue
        half, speed = body.length / 2, math.hypot(body.vx, body.vy)
        distance = max(begins - half - s, 0.0)
        return Approach(body, other.arm.name, distance, leaves + half - s, speed, ends)
    return None


def time_to_cover(distance: float, speed: float, acceleration: float, top: float) -> float:
    """Seconds to cover a distance when accelerating to a top speed."""
    if distance <= 0.0:
        return 0.0
    if speed >= top:
        return distance / max(speed, 0.1)
    ramp = (top * top - speed * speed) / (2.0 * acceleration)
    if distance <= ramp:
        return (math.sqrt(speed * speed + 2.0 * acceleration * distance) - speed) / acceleration
    return (top - speed) / acceleration + (distance - ramp) / top
