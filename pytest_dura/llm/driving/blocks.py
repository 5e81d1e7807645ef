"""Blocks of the prompt of the driving domain: what the sensors report, as facts.

LIDAR holds the nearest objects relative to the ego, CONFLICTS who is on its lane and when, RADAR
returns that lidar does not explain, HISTORY earlier decisions, and FEEDBACK the reasons of refused
ones.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from pytest_dura.core.errors import ActionError
from pytest_dura.core.state import GeneratorView, PastDecision
from pytest_dura.driving.bodies import CAR_LENGTH, kind_by_size
from pytest_dura.driving.channel_faults import POSTER
from pytest_dura.driving.conflicts import conflicts, launched, seconds
from pytest_dura.driving.maneuvers import (
    MAX_BRAKING,
    Command,
    Maneuver,
    acceleration_for,
    braking_distance,
)
from pytest_dura.driving.percepts import DISTANCE_TOLERANCE, PLACE, RATE_TOLERANCE
from pytest_dura.driving.sensors import RANGE, TRAFFIC_LIGHT, Pose, RouteMap, Sign
from pytest_dura.llm.driving import readings
from pytest_dura.llm.driving.conflicts import (
    MOST_CONFLICTS,
    complete,
    conflict_facts,
    times_to_collision,
)
from pytest_dura.llm.driving.readings import Row, camera_images, degrees, number, rounded
from pytest_dura.llm.prompts import Block, PerceivedText, Prompt

MOST = 12
"""Objects that a block shows: half of them the nearest, the others those that will be nearest."""
SOON = 4.0
"""s; what is 40 m away and quick is a danger before what stands at the roadside."""

_PLAIN = re.compile(r"[A-Z]{1,2}[0-9]{1,5}", re.ASCII)
_ID = re.compile(r"[A-Z][A-Z0-9_]{0,15}", re.ASCII)
_PARTS = re.compile(r"([A-Z_]*)([0-9]*)(.*)")
_OCTANTS = (
    "ahead", "ahead-left", "left", "behind-left", "behind", "behind-right", "right", "ahead-right",
)  # fmt: skip


def shown_id(value: object) -> str:
    """Make the id that an object has in the prompt, and by which it can be cited.

    An id as a scenario may give it stays. Anything else, which only a fault can have put there,
    has a name made of its digest, the same at every tick.
    """
    if isinstance(value, str) and _ID.fullmatch(value):
        return value
    text = value if isinstance(value, str) else type(value).__name__
    return "X" + hashlib.sha256(text.encode(errors="backslashreplace")).hexdigest()[:6].upper()


def label(name: str) -> str | PerceivedText:
    """Label of an id: a plain one as it is, such as ``V3``; any other as a text of the scene."""
    return name if _PLAIN.fullmatch(name) else PerceivedText(name)


def _lidar_facts(
    bodies: Sequence[tuple[object, Row]] | None,
    rows: Sequence[Row] | None,
    pose: Pose | None,
    speed: float | None,
) -> dict[str, Any]:
    """Facts of the block LIDAR.

    Args:
        bodies: Ids and rows of the objects; see ``readings.bodies``.
        rows: Of the radar.
        pose: Of the ego.
        speed: Of the ego, in m/s.
    """
    if bodies is None:
        return {"missing": 1, "farther": 0, "objects": ()}
    times: Mapping[str, float] = {}
    if pose is not None and speed is not None:
        times = times_to_collision(complete([row for _, row in bodies]), pose, speed)
    objects = []
    for place, (name, row) in enumerate(bodies):
        listed = _object(name, row, pose, speed)
        objects.append({
            **listed, "ttc": rounded(times.get(str(place))),
            "radar": _radar_agrees(row, listed["distance"], listed["closing"], rows, pose),
        })  # fmt: skip
    return {"missing": 0, **nearest(objects)}


def _radar_agrees(
    body: Row,
    distance: float | None,
    closing: float | None,
    rows: Sequence[Row] | None,
    pose: Pose | None,
) -> str | None:
    """Whether radar sees a lidar object: ``yes``, ``no``, ``other speed``, ``too far`` to be sure.

    As ``percepts.compare_sensors`` compares the two.
    """
    if rows is None or pose is None or distance is None:
        return None
    places = [(_place(row, pose), row[2]) for row in rows]
    rates = [
        rate
        for place, rate in places
        if place is not None
        and body[0] is not None
        and body[1] is not None
        and math.hypot(place[0] - body[0], place[1] - body[1]) < DISTANCE_TOLERANCE
    ]
    if not rates:
        return "no" if distance <= RANGE - 2.0 else "too far"
    known = [rate for rate in rates if rate is not None]
    if closing is None or not known:
        return "yes"
    return "yes" if any(abs(rate + closing) < RATE_TOLERANCE for rate in known) else "other speed"


def _radar_facts(
    rows: Sequence[Row] | None, bodies: Sequence[tuple[object, Row]] | None, pose: Pose | None
) -> dict[str, Any]:
    """Facts of the block RADAR: returns that no lidar object explains.

    Each is ``R`` and the number of its row, as the built-in planners name it.
    """
    if rows is None:
        return {"missing": 1, "farther": 0, "objects": ()}
    objects = []
    for index, row in enumerate(rows):
        distance, azimuth, rate = row
        place = None if pose is None else _place(row, pose)
        if place is None or not any(
            x is not None
            and y is not None
            and math.hypot(x - place[0], y - place[1]) < DISTANCE_TOLERANCE
            for _, (x, y, *_) in bodies or ()
        ):
            objects.append({
                "id": f"R{index}", "label": f"R{index}", "distance": rounded(distance),
                "bearing": degrees(azimuth), "rate": rounded(rate),
            })  # fmt: skip
    return {"missing": 0, **nearest(objects)}


def _conflict_facts(
    bodies: Sequence[tuple[object, Row]] | None,
    pose: Pose | None,
    speed: float | None,
    on_map: RouteMap | None,
) -> dict[str, Any]:
    """Facts of the block CONFLICTS; see :func:`pytest_dura.driving.conflicts.conflicts`."""
    if bodies is None or pose is None or speed is None or on_map is None:
        return {"missing": 1, "farther": 0, "objects": ()}
    listed = conflicts(complete([row for _, row in bodies]), pose, speed, on_map)
    listed.sort(key=lambda each: (each.comes, each.begins, int(each.body)))
    objects = []
    for each in listed[:MOST_CONFLICTS]:
        name = shown_id(bodies[int(each.body)][0])
        facts = conflict_facts(each, name, speed, on_map.speed_limit)
        objects.append({**facts, "label": label(name)})
    return {
        "missing": 0,
        "farther": len(listed) - len(objects),
        "objects": tuple(sorted(objects, key=by_id)),
    }


def nearest(objects: Sequence[Mapping[str, Any]], most: int = MOST) -> dict[str, Any]:
    """Select at most so many objects, sorted by id; returns how many others there are, too.

    Half of them are the nearest, the others those that will be nearest in :data:`SOON`: a crowd at
    the roadside must not hide a car that is about to hit the ego.
    """

    def far(listed: Mapping[str, Any], after: float = 0.0) -> tuple[float, Any]:
        distance, rate = listed["distance"], listed.get("rate")
        closing = (listed.get("closing") if rate is None else -rate) or 0.0
        if distance is None:
            return math.inf, by_id(listed)
        return abs(distance) - after * max(closing, 0.0), by_id(listed)

    near = sorted(objects, key=far)
    half = (most + 1) // 2
    soon = sorted(near[half:], key=lambda listed: far(listed, SOON))
    kept = [*near[:half], *soon[: most - half]]
    return {"farther": len(objects) - len(kept), "objects": tuple(sorted(kept, key=by_id))}


def by_id(listed: Mapping[str, Any]) -> tuple[str, int, str]:
    """Sort key of objects: V2 before V10."""
    parts = _PARTS.match(listed["id"])
    assert parts is not None
    return parts[1], int(parts[2] or -1), listed["id"]


def direction(angle: float | None) -> str | None:
    """Direction of an angle to the left of ahead, in words."""
    return None if angle is None else _OCTANTS[round(angle / (math.pi / 4)) % 8]


def course(turned: float | None) -> str | None:
    """Course of an object that is turned by this angle to the left against the ego, in words."""
    if turned is None:
        return None
    words = ("same way", "to the left", "oncoming", "to the right")
    return words[round(turned / (math.pi / 2)) % 4]


def _object(name: object, row: Row, pose: Pose | None, speed: float | None) -> dict[str, Any]:
    x, y, heading, vx, vy, length, width = row
    distance = angle = closing = ahead = left = turned = None
    if pose is not None and heading is not None:
        turned = pose.heading - heading
    if pose is not None and x is not None and y is not None:
        ahead, left = _from_ego(x, y, pose)
        dx, dy = x - pose.x, y - pose.y
        distance, angle = math.hypot(dx, dy), math.atan2(left, ahead)
        if vx is not None and vy is not None and speed is not None:
            c, s = math.cos(pose.heading), math.sin(pose.heading)
            approach = dx * (speed * c - vx) + dy * (speed * s - vy)
            closing = approach / max(distance, 0.1)
    moving = None if vx is None or vy is None else math.hypot(vx, vy)
    shown = shown_id(name)
    return {
        "id": shown, "label": label(shown), "kind": kind_by_size(length, width),
        "distance": rounded(distance),
        "direction": direction(angle), "ahead": rounded(ahead), "left": rounded(left),
        "speed": rounded(moving), "closing": rounded(closing), "course": course(turned),
        "length": rounded(length), "width": rounded(width),
    }  # fmt: skip


def _from_ego(x: float, y: float, pose: Pose) -> tuple[float, float]:
    """Metres ahead and to the left of the ego's middle."""
    dx, dy, c, s = x - pose.x, y - pose.y, math.cos(pose.heading), math.sin(pose.heading)
    # y points south, so that left of the heading (c, s) is (s, -c).
    return c * dx + s * dy, s * dx - c * dy


def _place(row: Row, pose: Pose) -> tuple[float, float] | None:
    """Place of a radar return, x and y."""
    distance, azimuth, _ = row
    if distance is None or azimuth is None:
        return None
    bearing = pose.heading - azimuth
    return pose.x + distance * math.cos(bearing), pose.y + distance * math.sin(bearing)


EXPLANATION, REASON = 120, 160
"""Characters shown of an explanation, and of a reason."""
MOST_DECISIONS, MOST_REASONS = 5, 4
_LONG_AGO = 1e6


def _history_facts(past: Sequence[PastDecision], now: float) -> dict[str, Any]:
    """Facts of the block HISTORY, oldest first.

    An explanation may repeat the text of a sign, and is shown as a text of the scene.

    Args:
        past: The decisions to show; only the latest few are.
        now: Simulated seconds.
    """
    decisions = [
        {
            "ago": rounded(number(now - decision.time, -_LONG_AGO, _LONG_AGO)),
            "proposed": maneuver(decision.proposed),
            "executed": maneuver(decision.executed),
            "source": decision.source
            if decision.source in ("proposal", "recovery", "fallback")
            else None,
            "explanation": PerceivedText(decision.explanation, EXPLANATION)
            if decision.explanation
            else "",
        }
        for decision in past[-MOST_DECISIONS:]
    ]
    return {"decisions": tuple(decisions)}


def _last_command(
    last: PastDecision | None,
    speed: float | None,
    to_stop_line: float | None,
    on_map: RouteMap | None,
) -> dict[str, Any]:
    """The maneuver carried out last, and the acceleration in m/s2 that it asks for now."""
    command = _command(last.executed) if last is not None else None
    if command is None:
        return {"last": None if last is not None else "none yet", "acceleration": None}
    acceleration = command.acceleration
    if speed is not None and to_stop_line is not None and on_map is not None:
        acceleration = acceleration_for(command, speed, to_stop_line, on_map.speed_limit)
    return {"last": command.maneuver.value, "acceleration": rounded(acceleration)}


def maneuver(action: object) -> str | None:
    """The name of an action's maneuver; ``None`` if there is none."""
    command = _command(action)
    return None if command is None else command.maneuver.value


def _command(action: object) -> Command | None:
    if action is None:
        return None
    try:
        return Command.of(action)
    except (ActionError, TypeError):  # of another simulator, or a component's nonsense
        return None


BLOCKS = (
    "EGO", "LIDAR", "CONFLICTS", "RADAR", "CAMERA", "IMU", "MAP", "CONTROLS", "GOAL", "HISTORY",
    "FEEDBACK",
)  # fmt: skip
"""All blocks, in the order in which they are shown."""

_SIGN_KINDS = ("give_way", "priority_road", TRAFFIC_LIGHT, POSTER)
"""Kinds that are named as they are; another kind is a text like any other."""

_LIGHTS = ("red", "yellow", "green")
"""What a traffic light can show."""

MOST_WAYPOINTS, WAYPOINT_STEP = 4, 2
"""Waypoints that are shown, and of how many of the map each is the first."""

MOST_SIGNS = 6
"""Signs that are shown, the nearest ones."""

_HALF = CAR_LENGTH / 2


def driving_prompt(
    view: GeneratorView, past: Sequence[PastDecision] = (), *, images: Sequence[str] = ()
) -> Prompt:
    """Make the prompt of a tick, from what the component sees.

    Args:
        view: Percept, time, feedback of the monitors, and the past for the last command.
        past: Decisions to remind of, oldest first.
        images: Camera channels to show.
    """
    last = view.past[-1] if view.past else None
    return percept_prompt(
        view.percept, past, images=images, now=view.time, last=last, feedback=view.feedback
    )


def percept_prompt(
    percept: Mapping[str, Any],
    past: Sequence[PastDecision] = (),
    *,
    images: Sequence[str] = (),
    now: float = 0.0,
    last: PastDecision | None = None,
    feedback: Sequence[str] = (),
) -> Prompt:
    """Make the blocks of a percept: a pure function, which no value in a channel makes fail.

    Args:
        percept: Sensor channels by name, after faults.
        past: Decisions to remind of, oldest first.
        images: Camera channels to show.
        now: Simulated seconds.
        last: Decision of the tick before.
        feedback: Reasons for which the proposal before this one was refused.
    """
    pose, speed = readings.own_pose(percept), readings.own_speed(percept)
    on_map = readings.own_map(percept)
    at = on_map.route.project(pose.x, pose.y) if on_map is not None and pose is not None else None
    bodies, rows = readings.bodies(percept), readings.returns(percept)
    front = None if at is None else at[0] + _HALF
    to_stop = None if front is None or on_map is None else on_map.stop_line - front
    facts: dict[str, Mapping[str, Any]] = {
        "EGO": {
            "speed": rounded(speed),
            "stops_in": None if speed is None else rounded(braking_distance(speed, MAX_BRAKING)),
            **_last_command(last, speed, to_stop, on_map),
            **_lane(on_map, at),
            **_times(on_map, to_stop, speed),
        },
        "LIDAR": _lidar_facts(bodies, rows, pose, speed),
        "CONFLICTS": _conflict_facts(bodies, pose, speed, on_map),
        "RADAR": _radar_facts(rows, bodies, pose),
        "IMU": _motion(percept),
        "MAP": _map(on_map, front, pose),
        "CONTROLS": _controls(readings.signs(percept), front),
        "GOAL": _goal(on_map),
    }
    shown_images, facts["CAMERA"] = camera_images(percept, images)
    facts["HISTORY"] = _history_facts(past, now)
    reasons = tuple(PerceivedText(reason, REASON) for reason in feedback[:MOST_REASONS])
    facts["FEEDBACK"] = {"reasons": reasons, "more": max(len(feedback) - MOST_REASONS, 0)}
    left_out = {
        name
        for name, content in (("CAMERA", images), ("HISTORY", past), ("FEEDBACK", feedback))
        if not content
    }
    blocks = tuple(Block(name, facts[name]) for name in BLOCKS if name not in left_out)
    return Prompt(blocks, shown_images)


def _lane(on_map: RouteMap | None, at: tuple[float, float] | None) -> dict[str, Any]:
    """Where the ego is on its route, and how far right of the middle of its lane."""
    if on_map is None or at is None:
        return {"place": None, "to_stop_line": None, "arm": None, "offset": None}
    to_stop_line = on_map.stop_line - at[0] - _HALF
    cleared = at[0] - _HALF > on_map.exit
    place = "approach" if to_stop_line >= 0.0 else "cleared" if cleared else "junction"
    arm = on_map.route.leaves if cleared else on_map.route.arm
    return {
        "place": place, "to_stop_line": rounded(to_stop_line), "arm": arm.name,
        "offset": rounded(at[1]),
    }  # fmt: skip


def _times(
    on_map: RouteMap | None, to_stop_line: float | None, speed: float | None
) -> dict[str, Any]:
    """When the ego is at the stop line and clear of the junction, and what giving way asks for."""
    if on_map is None or to_stop_line is None or speed is None:
        return dict.fromkeys(("line_in", "clear_in", "wait", "yield"))
    limit = on_map.speed_limit
    to_exit = on_map.exit - on_map.stop_line + to_stop_line + CAR_LENGTH
    return {
        "line_in": rounded(seconds(to_stop_line, speed)),
        "clear_in": rounded(launched(to_exit, speed, limit)),
        **{
            each.value: rounded(acceleration_for(Command(each), speed, to_stop_line, limit))
            for each in (Maneuver.WAIT, Maneuver.YIELD)
        },
    }


def _motion(percept: Mapping[str, Any]) -> dict[str, Any]:
    motion = readings.own_motion(percept)
    return {
        "acceleration": rounded(motion.acceleration),
        # Both are positive to the right, as headings grow that way where y points south.
        "left": _negative(motion.lateral_acceleration, 1),
        "turning": _negative(motion.yaw_rate and math.degrees(motion.yaw_rate), 0),
        # As a compass has it, where 0 is north and 90 is east; headings count from the east.
        "heading": None if motion.heading is None else compass(motion.heading),
    }


def _negative(value: float | None, decimals: int) -> float | int | None:
    return None if value is None else rounded(-value, decimals)


def compass(heading: float) -> int:
    """A heading in whole degrees of a compass, from 0 up to 359."""
    return round(math.degrees(heading) + 90.0) % 360


def _map(on_map: RouteMap | None, front: float | None, pose: Pose | None) -> dict[str, Any]:
    facts = _goal(on_map)
    if on_map is None:
        nothing = dict.fromkeys(("origin", "stop_line", "exit", "limit"))
        return {**facts, **nothing, "waypoints": ()}
    waypoints = []  # the next ones from the front on
    if front is not None and pose is not None:
        coming = [waypoint for waypoint in on_map.waypoints if waypoint.s > front]
        for point in coming[: WAYPOINT_STEP * MOST_WAYPOINTS : WAYPOINT_STEP]:
            ahead, left = _from_ego(point.x, point.y, pose)
            waypoints.append({"ahead": rounded(ahead, 0), "left": rounded(left, 0)})
    return {
        **facts,
        "origin": on_map.route.arm.name,
        "stop_line": None if front is None else rounded(on_map.stop_line - front),
        "exit": None if front is None else rounded(on_map.exit - front),
        "limit": rounded(on_map.speed_limit),
        "waypoints": tuple(waypoints),
    }


def _goal(on_map: RouteMap | None) -> dict[str, Any]:
    if on_map is None:
        return {"missing": 1, "turn": None, "destination": None}
    return {"missing": 0, "turn": on_map.route.turn, "destination": on_map.route.leaves.name}


def _controls(signs: Sequence[Sign] | None, front: float | None) -> dict[str, Any]:
    if signs is None:
        return {"missing": 1, "farther": 0, "objects": ()}
    facts = [sign_facts(f"S{number}", sign, front) for number, sign in enumerate(signs, start=1)]
    return {"missing": 0, **nearest(facts, MOST_SIGNS)}


def sign_facts(name: str, sign: Sign, front: float | None) -> dict[str, Any]:
    """Facts of one sign.

    Args:
        name: Its id.
        sign: As it was perceived.
        front: Metres of the ego's front along its route.
    """
    at = number(sign.at, -PLACE, PLACE)
    known = isinstance(sign.kind, str) and sign.kind in _SIGN_KINDS
    blank = isinstance(sign.text, str) and not sign.text
    return {
        "id": name,
        "label": name,
        "kind": sign.kind if known else PerceivedText(sign.kind, 40),
        "distance": None if at is None or front is None else rounded(at - front),
        "text": "" if blank else PerceivedText(sign.text),
        "state": sign.state if isinstance(sign.state, str) and sign.state in _LIGHTS else "",
    }
