"""Lidar against radar: which objects one of the two does not know."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pytest_dura.driving.bodies import CAR_LENGTH, CAR_WIDTH, VX, VY, Body, BodyList
from pytest_dura.driving.junction import LANE_OFFSET
from pytest_dura.driving.plausible import objects, own_pose, own_speed
from pytest_dura.driving.plausible import returns as radar_returns
from pytest_dura.driving.sensors import RANGE

DISTANCE_TOLERANCE = 2.5
"""m; farther apart, lidar and radar do not mean the same object."""
RATE_TOLERANCE = 2.5
"""m/s; range rates that differ more contradict each other."""
_ASSUMED_SPEED = 9.0

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


def compare(percept: Mapping[str, Any]) -> tuple[Mask, Mask]:
    """Which lidar objects radar confirms, and which radar returns lidar explains.

    Masks of shape ``(objects,)`` and ``(returns,)``.
    Objects at the edge of the radar's reach count as confirmed.
    """
    bodies = objects(percept)
    near = _near(bodies.data, _return_places(percept))
    rates = _range_rates(bodies.data, own_pose(percept), own_speed(percept))
    same = near & (np.abs(rates[:, None] - radar_returns(percept)[:, 2]) < RATE_TOLERANCE)
    far = ~_within_reach(percept, bodies)
    return same.any(axis=1) | far, np.asarray(near.any(axis=0))


def _return_places(percept: Mapping[str, Any]) -> Floats:
    """Where radar sees something: x and y, shape ``(returns, 2)``."""
    returns, pose = radar_returns(percept), own_pose(percept)
    bearing = pose.heading - returns[:, 1]
    x = pose.x + returns[:, 0] * np.cos(bearing)
    y = pose.y + returns[:, 0] * np.sin(bearing)
    return np.stack([x, y], axis=1)


def _near(data: Floats, places: Floats) -> Mask:
    """Which objects may be which returns, shape ``(objects, returns)``."""
    apart = np.hypot(data[:, None, 0] - places[:, 0], data[:, None, 1] - places[:, 1])
    return np.asarray(apart < DISTANCE_TOLERANCE)


def _within_reach(percept: Mapping[str, Any], bodies: BodyList) -> Mask:
    """Which objects radar surely sees, if they are there: not those at the edge of its reach."""
    pose, data = own_pose(percept), bodies.data
    return np.asarray(np.hypot(data[:, 0] - pose.x, data[:, 1] - pose.y) <= RANGE - 2.0)


def agree(percept: Mapping[str, Any]) -> bool:
    """Whether lidar and radar report the same objects in the same order, as without an attack.

    Saves the comparison of all pairs; plain arithmetic, since NumPy does not pay for a few rows.
    """
    rows, returns = objects(percept).numbers, radar_returns(percept)
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
    """The objects to believe in: those of lidar that radar does not contradict, and what it adds.

    An object of lidar that radar does not confirm for some ticks in a row is not believed, as long
    as radar can be relied on: it confirms at least as many others as it contradicts. A radar that
    sees nothing, or other things than lidar throughout, contradicts nobody.

    Args:
        confirm: Ticks in a row from which on a contradicted object is not believed.
    """

    def __init__(self, confirm: int = 3) -> None:
        self.confirm = confirm
        self._contradicted: dict[str, int] = {}

    def reset(self) -> None:
        """Forget what was contradicted."""
        self._contradicted = {}

    def update(self, percept: Mapping[str, Any]) -> BodyList:
        """The objects of the next percept; call it once per tick."""
        bodies = objects(percept)
        if agree(percept):
            self._contradicted = {}
            return bodies
        confirmed, _ = compare(percept)
        contradicted = [bodies.ids[row] for row in np.flatnonzero(~confirmed).tolist()]
        before = self._contradicted
        self._contradicted = {name: before.get(name, 0) + 1 for name in contradicted}
        if _within_reach(percept, bodies)[confirmed].sum() >= len(contradicted):
            gone = {name for name, ticks in self._contradicted.items() if ticks >= self.confirm}
            bodies = bodies.rows([row for row, name in enumerate(bodies.ids) if name not in gone])
        return _with_returns(percept, bodies)


def with_unexplained_returns(percept: Mapping[str, Any]) -> BodyList:
    """The lidar objects, and a car for each radar return that none of them explains.

    Radar gives no course: a car on the crossing road is taken to drive on its lane at 9 m/s, one
    elsewhere to stand.
    """
    return objects(percept) if agree(percept) else _with_returns(percept, objects(percept))


def _with_returns(percept: Mapping[str, Any], bodies: BodyList) -> BodyList:
    """These objects, and a car for each radar return that none of them explains."""
    places = _return_places(percept)
    near = _near(bodies.data, places)
    for row in np.flatnonzero(~near.any(axis=0)).tolist():
        x, y = places[row].tolist()
        on_road = abs(y) < 2 * LANE_OFFSET
        vx = math.copysign(_ASSUMED_SPEED, y) if on_road else 0.0
        heading = 0.0 if vx >= 0 else math.pi
        bodies = bodies.with_body(Body(f"R{row}", x, y, heading, vx, 0.0, CAR_LENGTH, CAR_WIDTH))
    return bodies
