"""Percepts as the built-in roles take them: every number within what a sensor can report at all.

A fault may put any finite number into a message: 1e300 m, a size below zero. What a role reckons
from it would overflow, and an episode whose role fails is lost instead of judged. So the roles
read their sensors through here. A number within its range stays as it is, bit by bit. One beyond:

- places, ranges, speeds and accelerations saturate: 10 km are far from everything, and 70 m/s are
  too fast for everything;
- of an angle, the whole turns are left out;
- too small a size is taken to be a car's, and too large a one saturates.

What saturates is no measurement. :func:`doubtful` says which, for monitors that must not call safe
what they cannot judge.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.percepts import shared
from pytest_dura.driving.bodies import CAR_LENGTH, CAR_WIDTH, HEADING, LENGTH, WIDTH, BodyList
from pytest_dura.driving.sensors import Imu, Pose

PLACE = 10_000.0
"""m from the junction's centre, either way; the map ends after some 100 m."""
ANGLE = 100.0
"""rad, either way; headings are not wrapped, and nobody turns sixteen times."""
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
        self._last: tuple[Any, bool] = None, False

    def hold(self, data: Floats) -> bool:
        """Whether all numbers are within; several roles ask in turn, so that an answer is kept."""
        last, answer = self._last
        if last is not data:
            within = (data >= self.low) & (data <= self.high)
            answer = b"\0" not in within.tobytes()  # for a few rows quicker than all()
            # Who may still write into it could change the answer.
            self._last = (None if data.flags.writeable else data), answer
        return answer

    def clipped(self, data: Floats, angle: int) -> Floats:
        """A copy within the ranges; the column of the angle is turned back."""
        found: Floats = np.clip(data, self.low, self.high)
        angles = data[:, angle]
        found[:, angle] = np.where(np.abs(angles) <= ANGLE, angles, np.fmod(angles, 2 * math.pi))
        return found

    def beyond(self, data: Floats) -> dict[int, tuple[str, ...]]:
        """The names of the columns that are out of range, by row, where any is."""
        outside = (data < self.low) | (data > self.high)
        return {
            row: tuple(self.names[column] for column in np.flatnonzero(outside[row]).tolist())
            for row in np.flatnonzero(outside.any(axis=1)).tolist()
        }

    def told(self, row: Floats, names: tuple[str, ...]) -> str:
        """What a row reports in these columns."""
        numbers = dict(zip(self.names, row.tolist(), strict=True))
        return _told({name: numbers[name] for name in names})


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
    """Of the channel localisation."""
    pose: Pose = percept["localisation"]
    x, y, heading = pose
    if _is_place(x, y, heading):
        return pose
    return Pose(_within(x, -PLACE, PLACE), _within(y, -PLACE, PLACE), _angle(heading))


def own_speed(percept: Mapping[str, Any]) -> float:
    """Of the channel odometry, in m/s."""
    speed: float = percept["odometry"].speed
    return speed if SPEED[0] <= speed <= SPEED[1] else _within(speed, *SPEED)


def own_motion(percept: Mapping[str, Any]) -> Imu:
    """Of the channel imu."""
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


def objects(percept: Mapping[str, Any]) -> BodyList:
    """Of the channel lidar."""
    bodies: BodyList = percept["lidar"]
    if _BODIES.hold(bodies.data):
        return bodies
    data = _BODIES.clipped(bodies.data, HEADING)
    for column, usual in ((LENGTH, CAR_LENGTH), (WIDTH, CAR_WIDTH)):
        data[bodies.data[:, column] < SIZE[0], column] = usual
    return BodyList(bodies.ids, data)


def returns(percept: Mapping[str, Any]) -> Floats:
    """Of the channel radar; see ``sensors.radar_returns``."""
    found: Floats = percept["radar"]
    return found if _RETURNS.hold(found) else _RETURNS.clipped(found, 1)


class Absurd(NamedTuple):
    """Something that no sensor can have measured; ``subject`` is the channel, or an object's id.

    ``far`` is true of an object whose place is so far away that it cannot matter.
    """

    channel: str
    subject: str
    detail: str
    far: bool = False


def out_of_range(percept: Mapping[str, Any]) -> list[Absurd]:
    """What the channels localisation, odometry, imu, lidar and radar report beyond the ranges.

    Without imu or radar, these report nothing.
    """
    found = list(shared(_judged_by, percept))
    if "imu" in percept and not _is_motion(*(imu := percept["imu"])):
        limits = (ACCELERATION, ACCELERATION, YAW_RATE, ANGLE)
        found.append(_beyond("imu", imu, limits))
    if "radar" in percept and not _RETURNS.hold(seen := percept["radar"]):
        row, names = next(iter(_RETURNS.beyond(seen).items()))
        found.append(Absurd("radar", "radar", _RETURNS.told(seen[row], names)))
    return found


def doubtful(percept: Mapping[str, Any]) -> list[Absurd]:
    """What forbids to call a percept safe: as above, but of localisation, odometry and lidar alone.

    Objects are no matter of doubt whose place is so far away that they cannot be near.
    """
    return [one for one in shared(_judged_by, percept) if not one.far]


def all_objects(percepts: Sequence[Mapping[str, Any]]) -> tuple[list[BodyList], list[bool]]:
    """Of each percept its :func:`objects`, and whether anything in it is :func:`doubtful`.

    All lists are looked through at once, which nearly always is enough.
    """
    lists: list[BodyList] = [percept["lidar"] for percept in percepts]
    if not lists or not _BODIES.hold(np.concatenate([one.data for one in lists])):
        found = [objects(percept) for percept in percepts]
        return found, [bool(doubtful(percept)) for percept in percepts]
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


def _judged_by(percept: Mapping[str, Any]) -> tuple[Absurd, ...]:
    found = []
    pose, speed = percept["localisation"], percept["odometry"].speed
    if not _is_place(*pose):
        found.append(_beyond("localisation", pose, (PLACE, PLACE, ANGLE)))
    if not _is_speed(speed):
        found.append(Absurd("odometry", "odometry", _told({"speed": speed})))
    bodies: BodyList = percept["lidar"]
    if not _BODIES.hold(bodies.data):
        for row, names in _BODIES.beyond(bodies.data).items():
            far = "x" in names or "y" in names
            told = _BODIES.told(bodies.data[row], names)
            found.append(Absurd("lidar", bodies.ids[row], told, far))
    return tuple(found)


def _beyond(channel: str, value: Any, limits: tuple[float, ...]) -> Absurd:
    told = {
        name: number
        for name, number, limit in zip(value._fields, value, limits, strict=True)
        if abs(number) > limit
    }
    return Absurd(channel, channel, _told(told))


def _told(numbers: Mapping[str, float]) -> str:
    return "reports " + ", ".join(f"{name} {number:.3g}" for name, number in numbers.items())


def _within(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)


def _angle(angle: float) -> float:
    return angle if abs(angle) <= ANGLE else math.fmod(angle, 2 * math.pi)
