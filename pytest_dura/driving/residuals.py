"""Residuals: by how much the ego's sensors contradict each other and a model of its motion.

Each is the difference of two accounts of the same quantity, and near 0 while all sensors are well.
The model is a kinematic bicycle with its centre midway between the axles: in a turn the centre
slides sideways, by the yaw rate times the distance to the rear axle. Where the model leaves room,
such as for the speed within a tick, only what is beyond that room counts.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from pytest_dura.driving.bodies import CAR_LENGTH, VX, VY
from pytest_dura.driving.junction import Route
from pytest_dura.driving.maneuvers import (
    Command,
    Maneuver,
    acceleration_for,
)
from pytest_dura.driving.scene import HALF
from pytest_dura.driving.sensors import Imu, Pose

ACTUATOR_SLEW = 40.0
"""m/s3; so fast does the ego's acceleration follow what is asked for."""
LETS_OFF = 1.5
"""m/s; below this speed the brake may be let off, to come to a stop without a jerk."""
TO_REAR = CAR_LENGTH / 2
"""m from the centre to the rear axle."""
MOVES = 0.5
"""m/s or m/s2; what moves or accelerates by more is not measured at exactly the same value twice.
"""

EGO = ("odometry.speed", "localisation.along", "localisation.across", "localisation.heading")
"""The names of :func:`ego_residuals`."""


Row = list[float]


class Snapshot(NamedTuple):
    """What the sensors say at one tick; the objects by id."""

    imu: Imu
    speed: float
    pose: Pose
    objects: Mapping[str, Row]
    radar: list[Row]
    route: Route
    stop_line: float

    @classmethod
    def of(cls, percept: Mapping[str, Any]) -> Snapshot:
        """From all channels that are numbers."""
        bodies, route_map = percept["lidar"], percept["map"]
        return cls(
            percept["imu"],
            percept["odometry"].speed,
            percept["localisation"],
            dict(zip(bodies.ids, bodies.data.tolist(), strict=True)),
            percept["radar"].tolist(),
            route_map.route,
            route_map.stop_line,
        )


def residuals(
    before: Snapshot, now: Snapshot, command: Command | None, dt: float
) -> Iterator[tuple[str, str, float]]:
    """Name, subject and value of each residual of a tick, where the subject is a channel or an id.

    Args:
        before: The tick before.
        now: This tick.
        command: What was commanded at the tick before; ``None`` if nothing was.
        dt: Seconds per tick.
    """
    for name, value in zip(EGO, ego_residuals(before, now, dt), strict=True):
        yield name, name.partition(".")[0], value
    if command is not None:
        yield "command", "command", command_residual(command, before, now, dt)
    for body, (x, y) in object_residuals(before, now, dt).items():
        yield "lidar.x", body, x
        yield "lidar.y", body, y
    for channel, stays in frozen(before, now).items():
        yield f"frozen.{channel}", channel, float(stays)


def ego_residuals(before: Snapshot, now: Snapshot, dt: float) -> tuple[float, float, float, float]:
    """Sensors against each other, from one tick to the next; infinite where they make no sense.

    Returns:
        ``odometry.speed``: gain of speed against the imu's acceleration, in m/s2;
        ``localisation.along`` and ``localisation.across``: displacement against odometry and
        model, ahead and to the right, in m/s;
        ``localisation.heading``: turn against the imu's yaw rate, in rad/s.
    """
    start, end, yaw_rate = before.pose, now.pose, now.imu.yaw_rate
    turned = end.heading - start.heading
    if not math.isfinite(turned):
        return math.inf, math.inf, math.inf, math.inf
    c, s = math.cos(start.heading), math.sin(start.heading)
    vx, vy = (end.x - start.x) / dt, (end.y - start.y) / dt
    slide = yaw_rate * TO_REAR
    slow, fast = sorted((_ahead(before.speed, slide), _ahead(now.speed, slide)))
    return (
        (now.speed - before.speed) / dt - now.imu.acceleration,
        beyond(vx * c + vy * s, slow, fast),
        vy * c - vx * s - slide,
        math.remainder(turned, 2 * math.pi) / dt - yaw_rate,
    )


def command_residual(command: Command, before: Snapshot, now: Snapshot, dt: float) -> float:
    """The imu's acceleration against the one that was commanded a tick before, in m/s2.

    The actuator follows with a bounded slew rate, and below ``LETS_OFF`` may let the brake off.
    """
    to_line = 0.0
    if command.acceleration is None and command.maneuver in (Maneuver.WAIT, Maneuver.YIELD):
        s, _ = before.route.project(before.pose.x, before.pose.y)
        to_line = before.stop_line - s - HALF
    asked = acceleration_for(command, before.speed, to_line)
    last, reach = before.imu.acceleration, ACTUATOR_SLEW * dt
    least = max(last - reach, min(last + reach, asked))
    most = max(least, 0.0) if before.speed < LETS_OFF else least
    return beyond(now.imu.acceleration, least, most)


def object_residuals(before: Snapshot, now: Snapshot, dt: float) -> dict[str, tuple[float, float]]:
    """How far each object is from where its velocity led to expect it, in x and y, in m/s, by id.

    Objects that were not there a tick before have none.
    """
    found = {}
    for name, row in now.objects.items():
        old = before.objects.get(name)
        if old is not None:
            found[name] = (row[0] - old[0]) / dt - old[VX], (row[1] - old[1]) / dt - old[VY]
    return found


def frozen(before: Snapshot, now: Snapshot) -> dict[str, bool]:
    """Which channels show exactly the values of a tick before, although others say they change.

    A speed that stays while the imu accelerates, a position that stays while the wheels turn, an
    object that stays while it moves, a range that stays while it has a rate.
    """
    rolls = abs(now.speed) > MOVES
    return {
        "odometry": now.speed == before.speed and abs(now.imu.acceleration) > MOVES,
        "localisation": rolls and now.pose[:2] == before.pose[:2],
        "lidar": any(
            abs(row[VX]) + abs(row[VY]) > MOVES and row[:2] == before.objects.get(name, ())[:2]
            for name, row in now.objects.items()
        ),
        "radar": any(
            abs(row[2]) > MOVES and row[0] == old[0]
            for old, row in zip(before.radar, now.radar, strict=False)
        ),
    }


def beyond(value: float, low: float, high: float) -> float:
    """By how much a value is above or below a range; 0 within it."""
    if low <= value <= high:
        return 0.0
    return value - high if value > high else value - low


def _ahead(speed: float, slide: float) -> float:
    """The part of a speed that goes ahead; the speed itself where no such part is possible."""
    rest = speed * speed - slide * slide
    return math.copysign(math.sqrt(rest), speed) if rest > 0.0 else speed
