"""Conflicts: who is on the ego's lane ahead, now or soon, if all keep speed and heading."""

from __future__ import annotations

import math
from typing import NamedTuple

from pytest_dura.driving.bodies import CAR_WIDTH, Body, BodyList
from pytest_dura.driving.maneuvers import Command, Maneuver, acceleration_for
from pytest_dura.driving.scene import HALF, Scene, crossing, time_to_cover
from pytest_dura.driving.sensors import Pose, RouteMap

LATER = 20.0
"""s; what comes later, or never, is as good as never: a crossing takes some 5 s."""
LAUNCH: float = acceleration_for(Command(Maneuver.ACCELERATE), 0.0, 0.0)
"""m/s2 with which ``accelerate`` begins."""

_SIDEWAYS = 0.3
"""m/s; who moves across the lane more slowly does not cross it."""
_BESIDE = 0.2
"""m between two footprints side by side, below which they are taken to touch."""
_STANDING = 0.1
"""m/s."""


def seconds(distance: float, speed: float) -> float:
    """Seconds to a distance at a constant speed, from 0 to :data:`LATER`."""
    if distance <= 0.0:
        return 0.0
    return min(distance / speed, LATER) if speed > _STANDING else LATER


def launched(distance: float, speed: float, limit: float) -> float:
    """Seconds in which the ego covers a distance by ``accelerate``, at most :data:`LATER`."""
    return min(time_to_cover(distance, max(speed, 0.0), LAUNCH, max(limit, 1.0)), LATER)


class Conflict(NamedTuple):
    """An object on the ego's lane ahead, now or soon.

    Args:
        body: Id of the object.
        begins: Where on the lane, in m from the ego's front.
        ends: Where it is past, in m from the ego's rear.
        comes: Seconds until it is on the lane.
        leaves: Seconds until it has left it, at most :data:`LATER`.
        along: Its speed in m/s along the lane, negative against the ego.
    """

    body: str
    begins: float
    ends: float
    comes: float
    leaves: float
    along: float


def conflicts(bodies: BodyList, pose: Pose, speed: float, on_map: RouteMap) -> list[Conflict]:
    """Who is on the ego's lane ahead now or within :data:`LATER`, if all keep their speed.

    A car with right of way follows its road: straight on where it crosses, along its lane where
    that meets the ego's. Anybody else goes on straight, and is on the lane while its footprint
    overlaps the strip that the ego drives over.
    """
    route = on_map.route
    s, _ = route.project(pose.x, pose.y)
    scene = Scene(
        route, s, pose.x, pose.y, max(speed, 0.0), on_map.stop_line, on_map.exit, bodies
    )  # fmt: skip
    front, rear = s + HALF, s - HALF
    listed, crossed = [], set()
    for other in crossing(scene):
        crossed.add(other.body.id)
        half, course = other.body.width / 2, float(route.pose(other.meets)[2])
        listed.append(Conflict(
            other.body.id, other.meets - half - front, other.meets + half - rear,
            seconds(other.distance, other.speed), seconds(other.past, other.speed),
            other.body.vx * math.cos(course) + other.body.vy * math.sin(course),
        ))  # fmt: skip
    listed += [
        conflict
        for body in bodies
        if body.id not in crossed and (conflict := _across(body, scene)) is not None
    ]
    return [each for each in listed if each.ends > 0.0 and each.comes < LATER]


def _across(body: Body, scene: Scene) -> Conflict | None:
    """The body as it moves straight on towards, on or off the lane; ``None`` if it never is."""
    at, lateral = scene.route.project(body.x, body.y)
    if at <= scene.s:
        return None
    course = float(scene.route.pose(at)[2])
    turned = body.heading - course
    c, sn = abs(math.cos(turned)), abs(math.sin(turned))
    along = (body.length * c + body.width * sn) / 2
    reach = (body.length * sn + body.width * c + CAR_WIDTH) / 2 + _BESIDE
    forward = body.vx * math.cos(course) + body.vy * math.sin(course)
    sideways = body.vy * math.cos(course) - body.vx * math.sin(course)
    outward = sideways if lateral > 0.0 else -sideways
    apart = abs(lateral)
    if outward > _SIDEWAYS:
        comes, leaves = (0.0 if apart < reach else LATER), seconds(reach - apart, outward)
    elif outward < -_SIDEWAYS:
        comes, leaves = seconds(apart - reach, -outward), seconds(apart + reach, -outward)
    else:
        comes, leaves = (0.0 if apart < reach else LATER), LATER
    begins, ends = at - along - scene.s - HALF, at + along - scene.s + HALF
    return Conflict(body.id, begins, ends, comes, leaves, forward)
