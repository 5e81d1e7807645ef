"""Readings of percepts for prompts: numbers and pictures; ``None`` for what a fault put there."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from numbers import Real
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pytest_dura.driving.bodies import BodyList
from pytest_dura.driving.lanes import Route
from pytest_dura.driving.percepts import (
    ACCELERATION,
    ANGLE,
    BODY_SPEED,
    PLACE,
    SIZE,
    SPEED,
    YAW_RATE,
)
from pytest_dura.driving.sensors import Pose, RouteMap, Sign, Waypoint
from pytest_dura.llm.port import Image

Row = tuple[float | None, ...]

_BODY = (
    (-PLACE, PLACE), (-PLACE, PLACE), (-ANGLE, ANGLE), (-BODY_SPEED, BODY_SPEED),
    (-BODY_SPEED, BODY_SPEED), SIZE, SIZE,
)  # fmt: skip
_RETURN = ((0.0, PLACE), (-ANGLE, ANGLE), (-2 * BODY_SPEED, 2 * BODY_SPEED))


class Motion(NamedTuple):
    """Reading of the channel imu; see ``sensors.Imu``."""

    acceleration: float | None
    lateral_acceleration: float | None
    yaw_rate: float | None
    heading: float | None


def number(value: object, low: float, high: float) -> float | None:
    """A real number from ``low`` to ``high``, as a float; ``None`` for anything else."""
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, Real):
        return None
    try:
        real = float(value)
    except OverflowError:  # an int of hundreds of digits
        return None
    return real if low <= real <= high else None


def rounded(value: float | None, decimals: int = 1) -> float | int | None:
    """Round a number for a prompt, which never is -0, and whole without decimals."""
    if value is None or not math.isfinite(value):
        return None
    return round(value, decimals) + 0.0 if decimals else round(value)


def degrees(angle: float | None) -> int | None:
    """Radians in whole degrees, above -180 and up to 180."""
    if angle is None:
        return None
    whole = round(math.degrees(math.remainder(angle, 2 * math.pi)))
    return 180 if whole == -180 else whole


def own_pose(percept: Mapping[str, Any]) -> Pose | None:
    """Pose in the channel localisation, if all of its numbers are possible."""
    value = percept.get("localisation")
    x = number(getattr(value, "x", None), -PLACE, PLACE)
    y = number(getattr(value, "y", None), -PLACE, PLACE)
    heading = number(getattr(value, "heading", None), -ANGLE, ANGLE)
    return None if x is None or y is None or heading is None else Pose(x, y, heading)


def own_speed(percept: Mapping[str, Any]) -> float | None:
    """Speed in the channel odometry, in m/s."""
    return number(getattr(percept.get("odometry"), "speed", None), *SPEED)


def own_motion(percept: Mapping[str, Any]) -> Motion:
    """Motion in the channel imu."""
    value = percept.get("imu")
    limits = (ACCELERATION, ACCELERATION, YAW_RATE, ANGLE)
    return Motion(*(
        number(getattr(value, name, None), -limit, limit)
        for name, limit in zip(Motion._fields, limits, strict=True)
    ))  # fmt: skip


def own_map(percept: Mapping[str, Any]) -> RouteMap | None:
    """The channel map, if there is a route and its places are numbers."""
    value = percept.get("map")
    if not isinstance(value, RouteMap) or not isinstance(value.route, Route):
        return None
    stop_line, exit_, limit = (number(place, -PLACE, PLACE) for place in value[1:4])
    if stop_line is None or exit_ is None or limit is None:
        return None
    waypoints = []
    listed: object = value.waypoints
    for given in listed if isinstance(listed, (tuple, list)) else ():
        if isinstance(given, Waypoint):
            s, x, y = (number(part, -PLACE, PLACE) for part in given[:3])
            heading = number(given.heading, -ANGLE, ANGLE)
            if s is not None and x is not None and y is not None and heading is not None:
                waypoints.append(Waypoint(s, x, y, heading))
    return RouteMap(value.route, stop_line, exit_, limit, tuple(waypoints))


def bodies(percept: Mapping[str, Any]) -> list[tuple[object, Row]] | None:
    """Ids and rows of the channel lidar, each number of a row or ``None``; ``None`` without."""
    value = percept.get("lidar")
    if not isinstance(value, BodyList):
        return None
    rows = _rows(value.data, _BODY)
    if rows is None or not isinstance(value.ids, tuple) or len(value.ids) != len(rows):
        return None
    return list(zip(value.ids, rows, strict=True))


def returns(percept: Mapping[str, Any]) -> list[Row] | None:
    """Rows of the channel radar: range, azimuth, rate, each a number or ``None``."""
    return _rows(percept.get("radar"), _RETURN)


def signs(percept: Mapping[str, Any]) -> list[Sign] | None:
    """Signs in the channel controls, whatever their values are."""
    value = percept.get("controls")
    if not isinstance(value, (tuple, list)) or isinstance(value, Sign):
        return None
    return [sign for sign in value if isinstance(sign, Sign)]


def picture(value: object, largest: int) -> NDArray[np.uint8] | None:
    """A picture in colour, ``(height, width, 3)`` of ``uint8``.

    Args:
        value: Of a channel.
        largest: Pixels of a side, at most.
    """
    if not isinstance(value, np.ndarray) or value.dtype != np.uint8 or value.ndim != 3:
        return None
    height, width, colours = value.shape
    return value if colours == 3 and 0 < height <= largest and 0 < width <= largest else None


def _rows(value: object, limits: tuple[tuple[float, float], ...]) -> list[Row] | None:
    if not isinstance(value, np.ndarray) or value.ndim != 2 or value.dtype.kind not in "fiuO":
        return None
    if value.shape[1] != len(limits):
        return None
    return [
        tuple(number(entry, *limit) for entry, limit in zip(row, limits, strict=True))
        for row in value.tolist()
    ]


_LARGEST_IMAGE = 1024
"""Pixels of a side."""

VIEWS: Mapping[str, str] = {
    "camera_front": "what is ahead, seen through your windscreen",
    "camera_third_person": "your own car, turquoise, and what is ahead, seen from behind and above",
}


def camera_images(
    percept: Mapping[str, Any], names: Sequence[str]
) -> tuple[tuple[Image, ...], dict[str, Any]]:
    """The pictures of some channels, and facts of the block CAMERA.

    A channel that is not there, or that holds no picture, is listed as missing.

    Args:
        percept: Sensor channels by name.
        names: Camera channels, in the order in which their pictures are shown.
    """
    images, pictures = [], []
    for name in names:
        pixels = picture(percept.get(name), _LARGEST_IMAGE)
        if pixels is not None:
            images.append(Image(name, pixels))
        place = len(images) if pixels is not None else 0
        pictures.append({"name": name, "shown": place, "view": VIEWS.get(name, "")})
    return tuple(images), {"pictures": tuple(pictures)}
