"""Scenarios from logs: what a recorded drive shows before a violation, on a built-in road.

A log has no road. The ego is put on the first arm of one, on its lane; the centre of the junction
is where the ways of the ego and of who crosses it lie on their lanes. What is assumed of a drive
and who is left out is listed.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.driving.bodies import (
    CAR_LENGTH,
    CAR_WIDTH,
    HEADING,
    LENGTH,
    VX,
    VY,
    WIDTH,
    X,
    Y,
)
from pytest_dura.driving.lanes import Route, route_between
from pytest_dura.driving.recorded import Drive
from pytest_dura.driving.roads import FOUR_WAY, Arm, Road, named_road

Floats = NDArray[np.float64]
_STRAIGHT = math.cos(math.pi / 4)
_MOVING = 0.3
"""m/s; who is slower stands."""
_FASTEST = 10.0
"""m/s at which a scenario lets road users start."""
_WALKING = 3.0
"""m/s that people on foot walk at most in a scenario."""
_NEAREST, _FARTHEST = 5.1, 5.0
"""m to the stop line, and to the outer end of the arm, at which an ego may start."""
_SAME, _ALIGNED = 0.1, math.radians(5.0)
"""m and rad by which a car may differ from one of a scenario without a word."""
_CROSSING = 3.0
"""m from the stop line outwards where people on foot cross, as scenarios have it by default."""
_AT_KERB, _FAR = 0.3, 12.0
"""m from the outer edge of a lane inwards and outwards, within which someone on foot starts."""


@dataclass
class _Found:
    """What is made of a drive.

    Args:
        road: Where it takes place.
        step: Seconds from sample to sample.
        vehicles: On their arms.
        pedestrians: Who cross an arm.
        assumed: What the log does not show, one sentence each.
    """

    road: Road
    step: float
    vehicles: list[dict[str, Any]] = field(default_factory=list)
    pedestrians: list[dict[str, Any]] = field(default_factory=list)
    assumed: list[str] = field(default_factory=list)

    def add(self, name: str, track: Floats) -> None:
        """Add a road user with its way from the start on, or say why it is left out."""
        row = track[0]
        body = name.upper() if re.fullmatch(r"(?![RS]\d+$)[A-Za-z]\w{0,15}", name) else ""
        body = body or "LOG_" + re.sub(r"\W", "_", name.upper())[:12]
        if row[LENGTH] < 1.0:
            self._add_pedestrian(body, name, track)
            return
        for arm in self.road.arms:
            distance = arm.along(row[X], row[Y]) - arm.stop_line
            lateral = arm.beside(row[X], row[Y]) - arm.offset
            inward = math.cos(row[HEADING]) * arm.inward[0] + math.sin(row[HEADING]) * arm.inward[1]
            if inward < _STRAIGHT or abs(lateral) > arm.offset or not 3.0 <= distance < arm.length:
                continue
            speed = self.speed(name, row)
            self.note_shape(name, row, float(lateral), math.acos(min(inward, 1.0)))
            turn = _turn(track, arm)
            entry = {"id": body, "arm": arm.name, "distance": round(float(distance), 2)}
            entry |= {"speed": speed} if turn == "straight" else {"speed": speed, "turn": turn}
            self.vehicles.append(entry)
            return
        self.assumed.append(f"{name} is not on a lane that leads to the junction, and is left out.")

    def _add_pedestrian(self, body: str, name: str, track: Floats) -> None:
        """Add someone on foot who is still to cross an arm."""
        speeds = np.hypot(track[:, VX], track[:, VY])
        walks = np.flatnonzero(speeds > _MOVING)  # NaN does not
        row = track[0]
        for arm in self.road.arms if len(walks) else ():
            course = track[walks[0], VX : VY + 1] / speeds[walks[0]]
            across = float(course @ np.array(arm.right))
            offset = arm.along(row[X], row[Y]) - arm.stop_line
            beside = arm.beside(row[X], row[Y])
            edge = abs(beside) - arm.lane_width
            comes = beside * across < 0.0
            if abs(across) < _STRAIGHT or not 1.0 <= offset <= 60.0 or not comes:
                continue
            if not -_AT_KERB <= edge <= _FAR:
                continue
            speed = float(np.median(speeds[walks]))
            if speed > _WALKING:
                self.assumed.append(f"{name} went {speed:.1f} m/s, and walks {_WALKING:g} m/s.")
            wait = walks[0] * self.step + max(edge, 0.0) / speed
            self.pedestrians.append(
                {
                    "id": body,
                    "arm": arm.name,
                    "offset": round(float(offset), 2),
                    "side": "right" if beside > 0.0 else "left",
                    "start": round(float(wait), 2),
                    "speed": round(min(speed, _WALKING), 2),
                }
            )
            return
        self.assumed.append(f"{name} is not about to cross an arm on foot, and is left out.")

    def note_shape(self, name: str, row: Floats, lateral: float, angle: float) -> None:
        """Say what a scenario cannot keep: the size of a car, and its place across the lane."""
        if abs(row[LENGTH] - CAR_LENGTH) > _SAME or abs(row[WIDTH] - CAR_WIDTH) > _SAME:
            self.assumed.append(
                f"{name} was {row[LENGTH]:.1f} m long and {row[WIDTH]:.1f} m wide, and is a car of "
                f"{CAR_LENGTH:g} m by {CAR_WIDTH:g} m."
            )
        if abs(lateral) > _SAME or angle > _ALIGNED:
            side = "right" if lateral > 0.0 else "left"
            self.assumed.append(
                f"{name} was {abs(lateral):.1f} m to the {side} of the middle of its lane, turned "
                f"by {math.degrees(angle):.0f} degrees, and begins in the middle along the lane."
            )

    def speed(self, name: str, row: Floats) -> float:
        """Return the speed at which a scenario can let it begin."""
        speed = math.hypot(row[VX], row[VY])
        if speed > _FASTEST:
            self.assumed.append(f"{name} drove {speed:.1f} m/s, and begins at {_FASTEST:g} m/s.")
        return round(min(speed, _FASTEST), 2)


def scenario_of(
    drive: Drive, violated: int, *, before: float = 4.0, road: str = FOUR_WAY.name
) -> tuple[dict[str, Any], list[str]]:
    """Make a scenario that begins some seconds before a violation.

    Args:
        drive: The recorded drive.
        violated: Tick of the violation.
        before: Seconds before it at which the scenario begins.
        road: A built-in road.

    Returns:
        The keys of a scenario file, and what was assumed.

    Raises:
        ConfigurationError: If the ego is not on the road before the junction then.
    """
    geometry = named_road(road)
    start = max(violated - round(before / drive.step), 0)
    found = _Found(geometry, drive.step)
    local = _on_road(drive, start, violated, found)
    ego = local[start, 0]
    own = geometry.arms[0]
    distance = own.along(ego[X], ego[Y]) - own.stop_line
    if not _NEAREST < distance <= own.length - _FARTHEST:
        raise ConfigurationError(
            "the ego is not on its arm when the scenario begins",
            found=f"{distance:.1f} m before the stop line, {before:g} s before the violation",
            expected=f"from {_NEAREST:g} to {own.length - _FARTHEST:g} m",
            remedy="begin earlier or later, `--before SECONDS`",
        )
    for place, name in enumerate(drive.ids[1:], 1):
        track = local[:, place]
        if not np.isfinite(track[start, :5]).all():
            if np.isfinite(track[start : violated + 1, X]).any():
                found.assumed.append(f"{name} came into sight later, and is left out.")
            continue
        found.add(name, track[start:])
    turn = _turn(local[start:, 0], own)
    beside = own.beside(ego[X], ego[Y]) - own.offset
    found.note_shape("The ego", ego, float(beside), 0.0)
    found.assumed.append(
        "From then on the others are simulated: they keep to the road and yield by its signs."
    )
    world: dict[str, Any] = {} if road == FOUR_WAY.name else {"road": road}
    speed = found.speed("The ego", ego)
    world["ego"] = {"distance": round(float(distance), 2), "speed": speed, "turn": turn}
    world |= {"vehicles": found.vehicles} if found.vehicles else {}
    world |= {"pedestrians": found.pedestrians} if found.pedestrians else {}
    return {"simulator": "driving", "duration": 30.0, "world": world}, found.assumed


def on_road(drive: Drive, road: str = FOUR_WAY.name) -> tuple[Floats, Route, list[str]]:
    """Place a whole drive on a built-in road: its rows there, the ego's route, what was assumed."""
    geometry = named_road(road)
    found = _Found(geometry, drive.step)
    rows = _on_road(drive, 0, len(drive.ego) - 1, found)
    turn = _turn(rows[:, 0], geometry.arms[0])
    ways = [route_between(geometry, 0, each) for each in geometry.destinations(0)]
    return rows, next((way for way in ways if way.turn == turn), ways[0]), found.assumed


def _on_road(drive: Drive, start: int, violated: int, found: _Found) -> Floats:
    """Turn and move the drive so that the ego is on the lane of the road's first arm."""
    own = found.road.arms[0]
    rows: Floats = drive.data.copy()
    heading = float(rows[start, 0, HEADING])
    inward = math.atan2(own.inward[1], own.inward[0])
    turn = inward - heading
    c, s = math.cos(turn), math.sin(turn)
    for a, b in ((X, Y), (VX, VY)):
        rows[..., a], rows[..., b] = (
            c * rows[..., a] - s * rows[..., b],
            s * rows[..., a] + c * rows[..., b],
        )
    rows[..., HEADING] += turn
    right = own.right
    beside = own.offset - own.beside(rows[start, 0, X], rows[start, 0, Y])
    centre = drive.options.junction
    if centre is not None:
        x, y = centre[0], centre[1] * drive.flip
        x, y = c * x - s * y, s * x + c * y
        beside = -own.beside(x, y)
        found.assumed.append("The junction is where the mapping says.")
    shifts = {}
    for place, name in enumerate(drive.ids[1:], 1):
        lane = _crosses(rows[start, place], own)
        if lane is not None:
            # Who crosses keeps to the right of the middle: that says where the middle is.
            due = own.along(*(lane * own.offset))
            shifts[name] = float(due - own.along(*rows[start, place, :2]))
    if centre is not None:
        along = -own.along(x, y)
    elif shifts:
        along = float(np.median(list(shifts.values())))
        found.assumed.append(f"The junction is where {', '.join(shifts)} cross the ego's way.")
    elif walkers := _on_foot(rows[start:], drive.ids, own):
        name, at = walkers[0]
        along = own.stop_line + _CROSSING - at
        found.assumed.append(
            f"The junction is where {name} crosses {_CROSSING:g} m before the ego's stop line."
        )
    else:
        along = -own.along(*rows[violated, 0, :2])
        found.assumed.append(
            "Nothing crosses the ego's way: the junction is where the violation happened."
        )
    where = f"the arm {own.name} of the built-in one {found.road.name}"
    found.assumed.insert(0, f"The log has no road: the ego is on {where}.")
    rows[..., X] += beside * right[0] + along * own.outward[0]
    rows[..., Y] += beside * right[1] + along * own.outward[1]
    return rows


def _on_foot(rows: Floats, ids: list[str], own: Arm) -> list[tuple[str, float]]:
    """Who crosses the ego's way on foot, and where along its arm, the nearest to the ego first."""
    found = []
    for place, name in enumerate(ids[1:], 1):
        track = rows[:, place]
        speeds = np.hypot(track[:, VX], track[:, VY])
        walks = np.flatnonzero(speeds > _MOVING)
        if not track[0, LENGTH] < 1.0 or not len(walks):
            continue
        course = track[walks[0], VX : VY + 1] / speeds[walks[0]]
        if abs(float(course @ np.array(own.right))) > _STRAIGHT:
            found.append((name, own.along(*track[walks[0], :2])))
    here = own.along(*rows[0, 0, :2])
    return sorted(found, key=lambda each: abs(each[1] - here))


def _crosses(row: Floats, own: Arm) -> Floats | None:
    """The side to the right of a car that crosses the ego's way, or is about to."""
    if not np.isfinite(row[:5]).all() or row[LENGTH] < 1.0:
        return None
    if math.hypot(row[VX], row[VY]) < _MOVING:
        return None
    course = np.array([math.cos(row[HEADING]), math.sin(row[HEADING])])
    if abs(float(course @ np.array(own.right))) < math.cos(math.radians(15.0)):
        return None
    return np.array([-course[1], course[0]])  # y points south


def _turn(track: Floats, arm: Arm) -> str:
    """Where a car goes, by its last heading."""
    known = track[np.isfinite(track[:, HEADING])]
    inward = math.atan2(arm.inward[1], arm.inward[0])
    turned = (float(known[-1, HEADING]) - inward + math.pi) % (2.0 * math.pi) - math.pi
    if abs(turned) < math.pi / 4:
        return "straight"
    return "right" if turned > 0.0 else "left"
