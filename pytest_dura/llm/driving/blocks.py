"""What the sensors report, in blocks of facts: the prompt of the driving domain."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from pytest_dura.core.state import GeneratorView, PastDecision
from pytest_dura.driving.bodies import CAR_LENGTH
from pytest_dura.driving.faults.signs import POSTER
from pytest_dura.driving.junction import ARMS
from pytest_dura.driving.plausible import PLACE
from pytest_dura.driving.sensors import TRAFFIC_LIGHT, Pose, RouteMap, Sign
from pytest_dura.llm.driving import readings
from pytest_dura.llm.driving.images import seen
from pytest_dura.llm.driving.past import feedback_facts, history_facts, last_command
from pytest_dura.llm.driving.readings import number, shown
from pytest_dura.llm.driving.surroundings import lidar_facts, nearest, radar_facts
from pytest_dura.llm.prompts.perceived import PerceivedText
from pytest_dura.llm.prompts.prompt import Block, Prompt

BLOCKS = (
    "EGO", "LIDAR", "RADAR", "CAMERA", "IMU", "MAP", "CONTROLS", "GOAL", "HISTORY", "FEEDBACK",
)  # fmt: skip
"""All blocks, in the order in which they are shown."""

SIGN_KINDS = ("give_way", "priority_road", TRAFFIC_LIGHT, POSTER)
"""Kinds that are named as they are; another kind is a text like any other."""

LIGHTS = ("red", "yellow", "green")
"""What a traffic light can show."""

MOST_WAYPOINTS, WAYPOINT_STEP = 4, 2
"""Waypoints that are shown, and of how many of the map each is the first."""

MOST_SIGNS = 6
"""Signs that are shown, the nearest ones."""

_HALF = CAR_LENGTH / 2


def driving_prompt(
    view: GeneratorView, past: Sequence[PastDecision] = (), *, images: Sequence[str] = ()
) -> Prompt:
    """The prompt of a tick, from what the component sees.

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
    """The blocks of a percept: a pure function of it, which no value in a channel can make fail.

    Args:
        percept: Sensor channels by name, after faults.
        past: Decisions to remind of, oldest first.
        images: Camera channels to show.
        now: Simulated seconds.
        last: What was carried out at the tick before.
        feedback: Why the proposal before this one was refused.
    """
    pose, speed = readings.own_pose(percept), readings.own_speed(percept)
    on_map = readings.own_map(percept)
    at = on_map.route.project(pose.x, pose.y) if on_map is not None and pose is not None else None
    found, rows = readings.bodies(percept), readings.returns(percept)
    front = None if at is None else at[0] + _HALF
    to_stop = None if front is None or on_map is None else on_map.stop_line - front
    facts: dict[str, Mapping[str, Any]] = {
        "EGO": {"speed": shown(speed), **last_command(last, speed, to_stop), **_lane(on_map, at)},
        "LIDAR": lidar_facts(found, pose, speed),
        "RADAR": radar_facts(rows, found, pose),
        "IMU": _motion(percept),
        "MAP": _map(on_map, front, pose),
        "CONTROLS": _controls(readings.signs(percept), front),
        "GOAL": _goal(on_map),
    }
    shown_images, facts["CAMERA"] = seen(percept, images)
    facts["HISTORY"] = history_facts(past, now)
    facts["FEEDBACK"] = feedback_facts(feedback)
    left_out = {
        name
        for name, asked in (("CAMERA", images), ("HISTORY", past), ("FEEDBACK", feedback))
        if not asked
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
    arm = on_map.route.destination if cleared else on_map.route.origin
    return {
        "place": place, "to_stop_line": shown(to_stop_line), "arm": ARMS[arm],
        "offset": shown(at[1]),
    }  # fmt: skip


def _motion(percept: Mapping[str, Any]) -> dict[str, Any]:
    motion = readings.own_motion(percept)
    return {
        "acceleration": shown(motion.acceleration),
        # Both are positive to the right, as headings grow that way where y points south.
        "left": _negative(motion.lateral_acceleration, 1),
        "turning": _negative(motion.yaw_rate and math.degrees(motion.yaw_rate), 0),
        # As a compass has it, where 0 is north and 90 is east; headings count from the east.
        "heading": None if motion.heading is None else compass(motion.heading),
    }


def _negative(value: float | None, decimals: int) -> float | int | None:
    return None if value is None else shown(-value, decimals)


def compass(heading: float) -> int:
    """A heading in whole degrees of a compass, from 0 up to 359."""
    return round(math.degrees(heading) + 90.0) % 360


def _map(on_map: RouteMap | None, front: float | None, pose: Pose | None) -> dict[str, Any]:
    facts = _goal(on_map)
    if on_map is None:
        nothing = dict.fromkeys(("origin", "stop_line", "exit", "limit"))
        return {**facts, **nothing, "waypoints": ()}
    return {
        **facts,
        "origin": ARMS[on_map.route.origin],
        "stop_line": None if front is None else shown(on_map.stop_line - front),
        "exit": None if front is None else shown(on_map.exit - front),
        "limit": shown(on_map.speed_limit),
        "waypoints": _ways(on_map, front, pose),
    }


def _ways(
    on_map: RouteMap, front: float | None, pose: Pose | None
) -> tuple[dict[str, float | int | None], ...]:
    """The next waypoints from the front on, ahead and to the left of the ego's middle."""
    if front is None or pose is None:
        return ()
    coming = [one for one in on_map.waypoints if one.s > front][: WAYPOINT_STEP * MOST_WAYPOINTS]
    c, s = math.cos(pose.heading), math.sin(pose.heading)
    # y points south, so that left of the heading (c, s) is (s, -c).
    return tuple(
        {
            "ahead": shown(c * (one.x - pose.x) + s * (one.y - pose.y), 0),
            "left": shown(s * (one.x - pose.x) - c * (one.y - pose.y), 0),
        }
        for one in coming[::WAYPOINT_STEP]
    )


def _goal(on_map: RouteMap | None) -> dict[str, Any]:
    if on_map is None:
        return {"missing": 1, "turn": None, "destination": None}
    return {"missing": 0, "turn": on_map.route.turn, "destination": ARMS[on_map.route.destination]}


def _controls(found: Sequence[Sign] | None, front: float | None) -> dict[str, Any]:
    if found is None:
        return {"missing": 1, "farther": 0, "objects": ()}
    signs = [sign_facts(f"S{count}", sign, front) for count, sign in enumerate(found, start=1)]
    return {"missing": 0, **nearest(signs, MOST_SIGNS)}


def sign_facts(name: str, sign: Sign, front: float | None) -> dict[str, Any]:
    """Facts of one sign.

    Args:
        name: Its id.
        sign: As it was perceived.
        front: Metres of the ego's front along its route.
    """
    at = number(sign.at, -PLACE, PLACE)
    known = isinstance(sign.kind, str) and sign.kind in SIGN_KINDS
    said = isinstance(sign.text, str) and not sign.text
    return {
        "id": name,
        "label": name,
        "kind": sign.kind if known else PerceivedText(sign.kind, 40),
        "distance": None if at is None or front is None else shown(at - front),
        "text": "" if said else PerceivedText(sign.text),
        "state": sign.state if isinstance(sign.state, str) and sign.state in LIGHTS else "",
    }
