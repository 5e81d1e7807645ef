"""Junctions of CARLA's maps as roads of driving; its axes are the same: y south, clockwise."""

from __future__ import annotations

import math
from functools import cache
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from pytest_dura.adapters.carla.opendrive import GIVE_WAY, STOP
from pytest_dura.adapters.libraries import client_library
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.driving.roads import Arm, Road

_LOOK = 40.0
"""m before the stop line in which a sign is looked for."""
_LONGEST, _STEP = 400.0, 1.0
"""m of an arm that are looked at, and from look to look."""
_BENT = math.radians(2.0)
"""Angle by which a lane may bend within an arm, and two lanes of one arm may differ."""
_ASIDE = 0.5
"""m by which an arm may pass the centre."""
_POINTS = ("north", "north_east", "east", "south_east", "south", "south_west", "west", "north_west")


@cache
def library() -> Any:
    """Return the client library.

    Raises:
        ConfigurationError: If it is not installed.
    """
    versions = ", for Python 3.10 to 3.12"
    return client_library(
        lambda: import_module("carla"), "carla", "CARLA", "carla", versions=versions
    )


class Place(NamedTuple):
    """A junction of a map: its road, and where the road's centre is on the map, in m."""

    road: Road
    x: float
    y: float


class _End(NamedTuple):
    """Where a lane meets a junction: place, bearing outwards in rad, waypoint."""

    x: float
    y: float
    outward: float
    point: Any


def junctions_of(world_map: Any) -> dict[int, Any]:
    """Junctions of a map, by id."""
    points = [point for pair in world_map.get_topology() for point in pair]
    return {point.junction_id: point.get_junction() for point in points if point.is_junction}


def place_of(world_map: Any, junction: int, speed_limit: float = 10.0) -> Place:
    """Read a junction of a map as a road.

    Args:
        world_map: A ``carla.Map``.
        junction: Id of the junction, see :func:`junctions_of`.
        speed_limit: In m/s, which CARLA's maps have as signs at some places.

    Raises:
        ConfigurationError: If there is none, or it is none of driving's roads: arms with one lane
            in each direction, or in one, that meet in one point.
    """
    found = junctions_of(world_map)
    if junction not in found:
        raise _unfit(world_map, junction, "there is none", ", ".join(map(str, sorted(found))))
    lanes = found[junction].get_waypoints(library().LaneType.Driving)
    exits = _distinct([_end(end, inward=False) for _, end in lanes])
    sides: list[tuple[_End | None, _End | None]] = []
    for entry in _distinct([_end(begin, inward=True) for begin, _ in lanes]):
        beside = [each for each in exits if _angle(each.outward - entry.outward) < _BENT]
        sides.append((entry, min(beside, key=lambda other: _apart(entry, other), default=None)))
    paired = {id(way_out) for _, way_out in sides}
    sides += [(None, each) for each in exits if id(each) not in paired]
    middles = [_middle(*side) for side in sides]
    for number, (_, _, outward) in enumerate(middles):
        if any(_angle(outward - other) < _BENT for _, _, other in middles[:number]):
            raise _unfit(world_map, junction, "an arm has several lanes in one direction")
    x, y = _centre(middles)
    arms = [_arm(x, y, *side, middle) for side, middle in zip(sides, middles, strict=True)]
    off = max(abs(a.beside(m[0] - x, m[1] - y)) for a, m in zip(arms, middles, strict=True))
    if off > _ASIDE:
        raise _unfit(world_map, junction, f"an arm passes the centre at {off:.1f} m")
    if len({arm.name for arm in arms}) < len(arms):
        arms = [Arm(**{**vars(arm), "name": f"arm_{n}"}) for n, arm in enumerate(arms)]
    arms.sort(key=lambda arm: (arm.bearing - 180.0) % 360.0)
    road = Road("custom", tuple(arms), speed_limit)
    road.check()
    return Place(road, x, y)


def difference(road: Road, other: Road) -> str:
    """Say where two roads differ: by more than a decimetre or a degree, or by a sign."""
    for number, arm in enumerate(road.arms):
        there = next((a for a in other.arms if abs(_angle_of(a, arm)) < 1.0), None)
        if there is None:
            return f"no arm at {arm.bearing:g} degrees for {arm.name}"
        for key in ("stop_line", "lane_width", "lanes", "length"):
            ours, theirs = getattr(arm, key), getattr(there, key)
            is_equal = ours == theirs if key == "lanes" else abs(ours - theirs) < 0.1
            if not is_equal and not (key == "length" and ours < theirs + 2.0 * _STEP):
                return f"{key} of {arm.name} is {theirs} there, and {ours} in the scenario"
        sign, own = other.sign(other.arms.index(there)), road.sign(number)
        if sign != own:
            there_is, ours_is = sign or "none", own or "none"
            return f"the sign of {arm.name} is {there_is} there, and {ours_is} in the scenario"
    return "" if len(road.arms) == len(other.arms) else f"it has {len(other.arms)} arms"


def _angle_of(arm: Arm, other: Arm) -> float:
    return math.remainder(arm.bearing - other.bearing, 360.0)


def _end(point: Any, *, inward: bool) -> _End:
    place = point.transform.location
    outward = math.radians(point.transform.rotation.yaw) + (math.pi if inward else 0.0)
    return _End(place.x, place.y, outward, point)


def _distinct(ends: list[_End]) -> list[_End]:
    kept: list[_End] = []
    for end in ends:
        if not any(_apart(end, each) < 0.5 and _angle(end.outward - each.outward) < _BENT
                   for each in kept):  # fmt: skip
            kept.append(end)
    return kept


def _middle(entry: _End | None, way_out: _End | None) -> tuple[float, float, float]:
    """Point in the middle of an arm where it meets the junction, and bearing outwards in rad."""
    if entry is not None and way_out is not None:
        return (entry.x + way_out.x) / 2, (entry.y + way_out.y) / 2, way_out.outward
    end = entry or way_out
    assert end is not None
    half = end.point.lane_width / 2 * (-1.0 if entry is None else 1.0)
    # For who looks outwards the lane towards the junction is on the left.
    return end.x - half * math.sin(end.outward), end.y + half * math.cos(end.outward), end.outward


def _centre(middles: list[tuple[float, float, float]]) -> tuple[float, float]:
    """Point nearest to the lines of all arms."""
    normals = np.array([[-math.sin(angle), math.cos(angle)] for _, _, angle in middles])
    offsets = (normals * [middle[:2] for middle in middles]).sum(axis=1)
    x, y = np.linalg.lstsq(normals, offsets, rcond=None)[0]
    return float(x), float(y)


def _arm(
    x: float, y: float, entry: _End | None, way_out: _End | None, middle: tuple[float, float, float]
) -> Arm:
    """Make an arm, seen from the centre."""
    end = entry or way_out
    assert end is not None
    outward = middle[2]
    bearing = round(math.degrees(outward) + 90.0, 1) % 360.0
    signs, lengths = [], []
    if entry is not None:
        lengths.append(_straight(entry, "previous"))
        before = (entry.point.previous(_LOOK) or [entry.point])[0]
        for kind in (GIVE_WAY, STOP):
            signs += before.get_landmarks_of_type(_LOOK + 1.0, kind)
    if way_out is not None:
        lengths.append(_straight(way_out, "next"))
    return Arm(
        _POINTS[round(bearing / 45.0) % 8],
        bearing,
        priority=1 if signs else 3,
        length=min(lengths),
        stop_line=round(
            (middle[0] - x) * math.cos(outward) + (middle[1] - y) * math.sin(outward), 2
        ),
        lane_width=round(end.point.lane_width, 2),
        lanes="in" if way_out is None else "out" if entry is None else "both",
    )


def _straight(end: _End, way: str) -> float:
    """Metres from the end, ``next`` or ``previous`` to it, until the lane bends or ends."""
    farthest, points = 0.0, getattr(end.point, way)(_STEP)
    while points and not points[0].is_junction and farthest < _LONGEST:
        place, yaw = points[0].transform.location, points[0].transform.rotation.yaw
        if abs(math.remainder(math.radians(yaw) - end.outward, math.pi)) > _BENT:
            break
        farthest = math.hypot(place.x - end.x, place.y - end.y)
        points = getattr(points[0], way)(_STEP)
    return float(round(farthest))


def _angle(difference: float) -> float:
    return abs(math.remainder(difference, 2 * math.pi))


def _apart(a: _End, b: _End) -> float:
    return math.hypot(a.x - b.x, a.y - b.y)


def _unfit(
    world_map: Any, junction: int, problem: str, expected: str = "one lane in each direction"
) -> ConfigurationError:
    return ConfigurationError(
        f"the junction {junction} of {world_map.name} is no road of driving: {problem}",
        key="junction",
        found=junction,
        expected=expected,
        remedy="name another junction, or leave `town` out: CARLA then builds the scenario's road",
    )
