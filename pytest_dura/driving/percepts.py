"""Percepts as the built-in roles take them: every number within what a sensor can report at all.

A fault may put any finite number into a message: 1e300 m, a size below zero. What a role reckons
from it would overflow, and an episode whose role fails is lost instead of judged. So the roles
read their sensors through this module. A number within its range stays as it is, bit by bit. For
one beyond:

- places, ranges, speeds and accelerations saturate: 10 km are far from everything, and 70 m/s are
  too fast for everything;
- of an angle, the whole turns are left out;
- too small a size is taken to be a car's, and too large a one saturates.

What saturates is no measurement. :func:`implausible_values` lists it, for monitors that must not
call safe what they cannot judge.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.percepts import sealed, shared
from pytest_dura.driving.bodies import (
    CAR_LENGTH,
    CAR_WIDTH,
    HEADING,
    LENGTH,
    VX,
    VY,
    WIDTH,
    Body,
    BodyList,
)
from pytest_dura.driving.lanes import other_roads
from pytest_dura.driving.sensors import RANGE, Imu, Pose

PLACE = 10_000.0
"""m from the junction's centre, either way; the map ends after some 100 m."""
ANGLE = 100.0
"""rad, either way; headings are not wrapped, and no object turns sixteen times."""
SPEED = (-1.0, 70.0)
"""m/s of the wheels; a car rolls backwards at a walking pace at most, and 70 m/s is 252 km/h."""
ACCELERATION = 50.0
"""m/s2, either way; five times what tyres give, and less than a crash."""
YAW_RATE = 10.0
"""rad/s, either way; more than a spinning car has."""
BODY_SPEED = 70.0
"""m/s of an object, along each axis, either way."""
SIZE = (0.1, 30.0)
"""m; from a post to the longest road train."""

Floats = NDArray[np.float64]


class _Columns:
    """The ranges of an array's columns: name, least and greatest value of each."""

    def __init__(self, **ranges: tuple[float, float]) -> None:
        self.names = tuple(ranges)
        self.low, self.high = np.array(list(ranges.values())).T

    def contain(self, data: Floats) -> bool:
        """Whether all numbers are in range."""
        within = (data >= self.low) & (data <= self.high)
        return b"\0" not in within.tobytes()  # for a few rows quicker than all()

    def clipped(self, data: Floats, angle: int) -> Floats:
        """A copy within the ranges; the column of the angle is turned back."""
        clipped: Floats = np.clip(data, self.low, self.high)
        angles = data[:, angle]
        clipped[:, angle] = np.where(np.abs(angles) <= ANGLE, angles, np.fmod(angles, 2 * math.pi))
        return clipped

    def beyond(self, data: Floats) -> dict[int, tuple[str, ...]]:
        """The names of the columns that are out of range, by row, where any is."""
        outside = (data < self.low) | (data > self.high)
        return {
            row: tuple(self.names[column] for column in np.flatnonzero(outside[row]).tolist())
            for row in np.flatnonzero(outside.any(axis=1)).tolist()
        }

    def describe(self, row: Floats, names: tuple[str, ...]) -> str:
        """Text on what a row reports in these columns."""
        numbers = dict(zip(self.names, row.tolist(), strict=True))
        return _listed({name: numbers[name] for name in names})


_BODIES = _Columns(
    x=(-PLACE, PLACE),
    y=(-PLACE, PLACE),
    heading=(-ANGLE, ANGLE),
    vx=(-BODY_SPEED, BODY_SPEED),
    vy=(-BODY_SPEED, BODY_SPEED),
    length=SIZE,
    width=SIZE,
)
_RETURNS = _Columns(
    range=(0.0, PLACE), azimuth=(-ANGLE, ANGLE), rate=(-2 * BODY_SPEED, 2 * BODY_SPEED)
)


def own_pose(percept: Mapping[str, Any]) -> Pose:
    """The pose of the channel localisation."""
    pose: Pose = percept["localisation"]
    x, y, heading = pose
    if _is_place(x, y, heading):
        return pose
    return Pose(_within(x, -PLACE, PLACE), _within(y, -PLACE, PLACE), _angle(heading))


def own_speed(percept: Mapping[str, Any]) -> float:
    """The speed of the channel odometry, in m/s."""
    speed: float = percept["odometry"].speed
    return speed if SPEED[0] <= speed <= SPEED[1] else _within(speed, *SPEED)


def own_motion(percept: Mapping[str, Any]) -> Imu:
    """The motion of the channel imu."""
    imu: Imu = percept["imu"]
    if _is_motion(*imu):
        return imu
    along, across, turning, heading = imu
    return Imu(
        _within(along, -ACCELERATION, ACCELERATION),
        _within(across, -ACCELERATION, ACCELERATION),
        _within(turning, -YAW_RATE, YAW_RATE),
        _angle(heading),
    )


def plausible_objects(percept: Mapping[str, Any]) -> BodyList:
    """The objects of the channel lidar, computed once for a percept."""
    return shared(_plausible_objects, percept)


def _plausible_objects(percept: Mapping[str, Any]) -> BodyList:
    bodies: BodyList = percept["lidar"]
    if _BODIES.contain(bodies.data):
        return bodies
    data = _BODIES.clipped(bodies.data, HEADING)
    for column, usual in ((LENGTH, CAR_LENGTH), (WIDTH, CAR_WIDTH)):
        data[bodies.data[:, column] < SIZE[0], column] = usual
    return BodyList(bodies.ids, data)


def plausible_returns(percept: Mapping[str, Any]) -> Floats:
    """The channel radar, computed once for a percept; see ``sensors.radar_returns``."""
    return shared(_plausible_returns, percept)


def _plausible_returns(percept: Mapping[str, Any]) -> Floats:
    radar: Floats = percept["radar"]
    if _are_returns(radar.tolist()):
        return radar
    return sealed(_RETURNS.clipped(radar, 1))


# In plain arithmetic, since NumPy does not pay for a few rows; the ranges are those of the columns.
def _are_returns(rows: Iterable[Sequence[float]]) -> bool:
    most = 2 * BODY_SPEED
    for distance, azimuth, rate in rows:
        if not (0.0 <= distance <= PLACE and -ANGLE <= azimuth <= ANGLE and -most <= rate <= most):
            return False
    return True


class ImplausibleValue(NamedTuple):
    """A value that no sensor can have measured; ``subject`` is the channel, or an object's id.

    ``far`` is true of an object whose place is so far away that it cannot matter.
    """

    channel: str
    subject: str
    detail: str
    far: bool = False


def out_of_range(percept: Mapping[str, Any]) -> list[ImplausibleValue]:
    """Values beyond the ranges that localisation, odometry, imu, lidar and radar report.

    Without imu or radar, these report nothing.
    """
    values = list(shared(_implausible_in, percept))
    if "imu" in percept and not _is_motion(*(imu := percept["imu"])):
        limits = (ACCELERATION, ACCELERATION, YAW_RATE, ANGLE)
        values.append(_beyond("imu", imu, limits))
    if "radar" in percept and plausible_returns(percept) is not (radar := percept["radar"]):
        row, names = next(iter(_RETURNS.beyond(radar).items()))
        values.append(ImplausibleValue("radar", "radar", _RETURNS.describe(radar[row], names)))
    return values


def implausible_values(percept: Mapping[str, Any]) -> list[ImplausibleValue]:
    """Values that forbid to call a percept safe: those of localisation, odometry and lidar.

    An object whose place is so far away that it cannot be near is not among them.
    """
    return [value for value in shared(_implausible_in, percept) if not value.far]


def all_objects(percepts: Sequence[Mapping[str, Any]]) -> tuple[list[BodyList], list[bool]]:
    """The plausible objects of each percept, and whether it has :func:`implausible_values`.

    All lists are checked at once, which nearly always is enough.
    """
    lists: list[BodyList] = [percept["lidar"] for percept in percepts]
    if not lists or not _BODIES.contain(np.concatenate([bodies.data for bodies in lists])):
        objects = [plausible_objects(percept) for percept in percepts]
        return objects, [bool(implausible_values(percept)) for percept in percepts]
    return lists, [
        not (_is_place(*percept["localisation"]) and _is_speed(percept["odometry"].speed))
        for percept in percepts
    ]


def _is_speed(speed: float) -> bool:
    return SPEED[0] <= speed <= SPEED[1]


def _is_place(x: float, y: float, heading: float) -> bool:
    return -PLACE <= x <= PLACE and -PLACE <= y <= PLACE and -ANGLE <= heading <= ANGLE


def _is_motion(along: float, across: float, turning: float, heading: float) -> bool:
    return (
        abs(along) <= ACCELERATION
        and abs(across) <= ACCELERATION
        and abs(turning) <= YAW_RATE
        and abs(heading) <= ANGLE
    )


def _implausible_in(percept: Mapping[str, Any]) -> tuple[ImplausibleValue, ...]:
    values = []
    pose, speed = percept["localisation"], percept["odometry"].speed
    if not _is_place(*pose):
        values.append(_beyond("localisation", pose, (PLACE, PLACE, ANGLE)))
    if not _is_speed(speed):
        values.append(ImplausibleValue("odometry", "odometry", _listed({"speed": speed})))
    bodies: BodyList = percept["lidar"]
    if plausible_objects(percept) is not bodies:
        for row, names in _BODIES.beyond(bodies.data).items():
            far = "x" in names or "y" in names
            detail = _BODIES.describe(bodies.data[row], names)
            values.append(ImplausibleValue("lidar", bodies.ids[row], detail, far))
    return tuple(values)


def _beyond(channel: str, value: Any, limits: tuple[float, ...]) -> ImplausibleValue:
    numbers = {
        name: number
        for name, number, limit in zip(value._fields, value, limits, strict=True)
        if abs(number) > limit
    }
    return ImplausibleValue(channel, channel, _listed(numbers))


def _listed(numbers: Mapping[str, float]) -> str:
    return "reports " + ", ".join(f"{name} {number:.3g}" for name, number in numbers.items())


def _within(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)


def _angle(angle: float) -> float:
    return angle if abs(angle) <= ANGLE else math.fmod(angle, 2 * math.pi)


DISTANCE_TOLERANCE = 2.5
"""m; farther apart, lidar and radar do not mean the same object."""
RATE_TOLERANCE = 2.5
"""m/s; range rates that differ more contradict each other."""
_ASSUMED_SPEED = 9.0

Mask = NDArray[np.bool_]


def compare_sensors(percept: Mapping[str, Any]) -> tuple[Mask, Mask]:
    """Masks of the lidar objects that radar confirms, and of the radar returns that lidar explains.

    Their shapes are ``(objects,)`` and ``(returns,)``.
    Objects at the edge of the radar's reach count as confirmed.
    """
    bodies = plausible_objects(percept)
    near = _near(bodies.data, _return_places(percept))
    rates = _range_rates(bodies.data, own_pose(percept), own_speed(percept))
    same = near & (np.abs(rates[:, None] - plausible_returns(percept)[:, 2]) < RATE_TOLERANCE)
    far = ~_within_reach(percept, bodies)
    return same.any(axis=1) | far, np.asarray(near.any(axis=0))


def _return_places(percept: Mapping[str, Any]) -> Floats:
    """Places of the radar returns: x and y, shape ``(returns, 2)``."""
    returns, pose = plausible_returns(percept), own_pose(percept)
    bearing = pose.heading - returns[:, 1]
    x = pose.x + returns[:, 0] * np.cos(bearing)
    y = pose.y + returns[:, 0] * np.sin(bearing)
    return np.stack([x, y], axis=1)


def _near(data: Floats, places: Floats) -> Mask:
    """Mask of the pairs that may be the same object, shape ``(objects, returns)``."""
    apart = np.hypot(data[:, None, 0] - places[:, 0], data[:, None, 1] - places[:, 1])
    return np.asarray(apart < DISTANCE_TOLERANCE)


def _within_reach(percept: Mapping[str, Any], bodies: BodyList) -> Mask:
    """Mask of the objects that radar surely sees, which are not at the edge of its reach."""
    pose, data = own_pose(percept), bodies.data
    return np.asarray(np.hypot(data[:, 0] - pose.x, data[:, 1] - pose.y) <= RANGE - 2.0)


def sensors_agree(percept: Mapping[str, Any]) -> bool:
    """Whether lidar and radar report the same objects in the same order, as without an attack.

    Saves the comparison of all pairs; plain arithmetic, since NumPy does not pay for a few rows.
    """
    rows, returns = plausible_objects(percept).numbers, plausible_returns(percept)
    if len(rows) != len(returns):
        return False
    (own_x, own_y, heading), speed = own_pose(percept), own_speed(percept)
    ego_vx, ego_vy = speed * math.cos(heading), speed * math.sin(heading)
    for (x, y, _, vx, vy, _, _), (distance, azimuth, rate) in zip(
        rows, returns.tolist(), strict=True
    ):
        dx, dy, bearing = x - own_x, y - own_y, heading - azimuth
        apart_x = distance * math.cos(bearing) - dx
        apart_y = distance * math.sin(bearing) - dy
        if apart_x * apart_x + apart_y * apart_y >= DISTANCE_TOLERANCE**2:
            return False
        expected = (dx * (vx - ego_vx) + dy * (vy - ego_vy)) / max(math.hypot(dx, dy), 0.1)
        if abs(expected - rate) >= RATE_TOLERANCE:
            return False
    return True


def _range_rates(data: Floats, pose: Any, speed: float) -> Floats:
    dx, dy = data[:, 0] - pose.x, data[:, 1] - pose.y
    vx = data[:, VX] - speed * math.cos(pose.heading)
    vy = data[:, VY] - speed * math.sin(pose.heading)
    rates: Floats = (dx * vx + dy * vy) / np.maximum(np.hypot(dx, dy), 0.1)
    return rates


class CrossCheck:
    """Tracks which objects are real: those of lidar that radar does not contradict, and its own.

    An object of lidar that radar does not confirm for some ticks in a row is not believed, as long
    as radar can be relied on: it confirms at least as many others as it contradicts. A radar that
    sees nothing, or other things than lidar throughout, contradicts no other sensor.

    Args:
        confirm: Ticks in a row from which on a contradicted object is not believed.
    """

    def __init__(self, confirm: int = 3) -> None:
        self.confirm = confirm
        self._contradicted: dict[str, int] = {}

    def reset(self) -> None:
        """Forget the contradicted objects."""
        self._contradicted = {}

    def update(self, percept: Mapping[str, Any]) -> BodyList:
        """The objects of the next percept; call it once per tick."""
        bodies = plausible_objects(percept)
        if sensors_agree(percept):
            self._contradicted = {}
            return bodies
        confirmed, _ = compare_sensors(percept)
        contradicted = [bodies.ids[row] for row in np.flatnonzero(~confirmed).tolist()]
        before = self._contradicted
        self._contradicted = {name: before.get(name, 0) + 1 for name in contradicted}
        if _within_reach(percept, bodies)[confirmed].sum() >= len(contradicted):
            gone = {name for name, ticks in self._contradicted.items() if ticks >= self.confirm}
            bodies = bodies.rows([row for row, name in enumerate(bodies.ids) if name not in gone])
        return _with_returns(percept, bodies)


def with_unexplained_returns(percept: Mapping[str, Any]) -> BodyList:
    """The lidar objects, and a car for each radar return that none of them explains.

    Radar gives no course: a car on a road other than the ego's is taken to drive on its lane at
    9 m/s, one elsewhere to stand. Needs the channel map as well.
    """
    return (
        plausible_objects(percept)
        if sensors_agree(percept)
        else _with_returns(percept, plausible_objects(percept))
    )


def _with_returns(percept: Mapping[str, Any], bodies: BodyList) -> BodyList:
    """These objects, and a car for each radar return that none of them explains."""
    places = _return_places(percept)
    near = _near(bodies.data, places)
    for row in np.flatnonzero(~near.any(axis=0)).tolist():
        x, y = places[row].tolist()
        heading, vx, vy = 0.0, 0.0, 0.0
        for arm in other_roads(percept["map"].route):
            if 0.0 <= arm.beside(x, y) < arm.lane_width:
                vx, vy = (_ASSUMED_SPEED * part for part in arm.inward)
                heading = math.atan2(vy, vx)
                break
        bodies = bodies.with_body(Body(f"R{row}", x, y, heading, vx, vy, CAR_LENGTH, CAR_WIDTH))
    return bodies
