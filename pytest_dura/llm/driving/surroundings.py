"""The blocks LIDAR and RADAR: the nearest objects, relative to the ego."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from pytest_dura.driving.radar import DISTANCE_TOLERANCE
from pytest_dura.driving.sensors import Pose
from pytest_dura.llm.driving.readings import Row, degrees, shown
from pytest_dura.llm.prompts.perceived import PerceivedText

MOST = 12
"""Objects that a block shows: half of them the nearest ones, the others those that will be."""
SOON = 4.0
"""s; what is 40 m away and quick is a danger before what stands at the roadside."""

NARROWEST_CAR = 1.3
"""m; a bicycle is 0.7 m wide, the narrowest cars 1.4 m."""

_PLAIN = re.compile(r"[A-Z]{1,2}[0-9]{1,5}", re.ASCII)
_ID = re.compile(r"[A-Z][A-Z0-9_]{0,15}", re.ASCII)
_PARTS = re.compile(r"([A-Z_]*)([0-9]*)(.*)")
_OCTANTS = (
    "ahead", "ahead-left", "left", "behind-left", "behind", "behind-right", "right", "ahead-right",
)  # fmt: skip


def shown_id(found: object) -> str:
    """The id by which an object stands in the prompt, and can be cited.

    An id as a scenario may give it stays. Anything else, which only a fault can have put there,
    has a name made of its digest, the same at every tick.
    """
    if isinstance(found, str) and _ID.fullmatch(found):
        return found
    text = found if isinstance(found, str) else type(found).__name__
    return "X" + hashlib.sha256(text.encode(errors="backslashreplace")).hexdigest()[:6].upper()


def label(name: str) -> str | PerceivedText:
    """An id in words: as it is if it says nothing, such as ``V3``; else as a text of the scene."""
    return name if _PLAIN.fullmatch(name) else PerceivedText(name)


def lidar_facts(
    found: Sequence[tuple[object, Row]] | None, pose: Pose | None, speed: float | None
) -> dict[str, Any]:
    """Facts of the block LIDAR.

    Args:
        found: Ids and rows of the objects; see ``readings.bodies``.
        pose: Of the ego.
        speed: Of the ego, in m/s.
    """
    if found is None:
        return {"missing": 1, "farther": 0, "objects": ()}
    objects = [_object(name, row, pose, speed) for name, row in found]
    return {"missing": 0, **nearest(objects)}


def radar_facts(
    rows: Sequence[Row] | None, found: Sequence[tuple[object, Row]] | None, pose: Pose | None
) -> dict[str, Any]:
    """Facts of the block RADAR.

    A return has the id of the lidar object at its place; one that none explains is ``R`` and the
    number of its row, as the built-in planners name it.
    """
    if rows is None:
        return {"missing": 1, "farther": 0, "objects": ()}
    objects = []
    for index, row in enumerate(rows):
        distance, azimuth, rate = row
        name = _at(row, found or (), pose) or f"R{index}"
        objects.append({
            "id": name, "label": label(name), "distance": shown(distance),
            "bearing": degrees(azimuth), "rate": shown(rate),
        })  # fmt: skip
    return {"missing": 0, **nearest(objects)}


def nearest(objects: Sequence[Mapping[str, Any]], most: int = MOST) -> dict[str, Any]:
    """So many objects at most, sorted by id, and how many others there are.

    Half of them are the nearest. Of the others come those that will be nearest in :data:`SOON`, so
    that a crowd at the roadside hides nobody who is about to hit the ego.
    """

    def far(one: Mapping[str, Any], after: float = 0.0) -> tuple[float, Any]:
        distance, rate = one["distance"], one.get("rate")
        closing = (one.get("closing") if rate is None else -rate) or 0.0
        if distance is None:
            return math.inf, by_id(one)
        return abs(distance) - after * max(closing, 0.0), by_id(one)

    near = sorted(objects, key=far)
    half = (most + 1) // 2
    soon = sorted(near[half:], key=lambda one: far(one, SOON))
    kept = [*near[:half], *soon[: most - half]]
    return {"farther": len(objects) - len(kept), "objects": tuple(sorted(kept, key=by_id))}


def by_id(one: Mapping[str, Any]) -> tuple[str, int, str]:
    """What ids are sorted by: V2 before V10."""
    parts = _PARTS.match(one["id"])
    assert parts is not None
    return parts[1], int(parts[2] or -1), one["id"]


def direction(angle: float | None) -> str | None:
    """Where an angle to the left of ahead points, in words."""
    return None if angle is None else _OCTANTS[round(angle / (math.pi / 4)) % 8]


def course(turned: float | None) -> str | None:
    """Where an object goes that is turned so far to the left against the ego, in words."""
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
        dx, dy, c, s = x - pose.x, y - pose.y, math.cos(pose.heading), math.sin(pose.heading)
        # y points south, so that left of the heading (c, s) is (s, -c).
        ahead, left = c * dx + s * dy, s * dx - c * dy
        distance, angle = math.hypot(dx, dy), math.atan2(left, ahead)
        if vx is not None and vy is not None and speed is not None:
            approach = dx * (speed * c - vx) + dy * (speed * s - vy)
            closing = approach / max(distance, 0.1)
    moving = None if vx is None or vy is None else math.hypot(vx, vy)
    made = shown_id(name)
    return {
        "id": made, "label": label(made), "kind": kind(length, width), "distance": shown(distance),
        "bearing": degrees(angle), "direction": direction(angle), "ahead": shown(ahead),
        "left": shown(left), "speed": shown(moving), "closing": shown(closing),
        "heading": degrees(turned), "course": course(turned),
        "length": shown(length), "width": shown(width),
    }  # fmt: skip


def kind(length: float | None, width: float | None) -> str | None:
    """What has this size: sensors report sizes, not classes.

    What is longer than a pedestrian and narrower than a car is an obstacle, such as a row of cones
    or a kerb island.
    """
    if length is None:
        return None
    if length < 1.0:
        return "pedestrian"
    return "obstacle" if width is not None and width < NARROWEST_CAR else "car"


def _at(row: Row, found: Sequence[tuple[object, Row]], pose: Pose | None) -> str | None:
    """Id of the lidar object nearest to a radar return, if it is near."""
    distance, azimuth, _ = row
    if pose is None or distance is None or azimuth is None:
        return None
    x = pose.x + distance * math.cos(pose.heading - azimuth)
    y = pose.y + distance * math.sin(pose.heading - azimuth)
    apart = [
        (math.hypot(at_x - x, at_y - y), index)
        for index, (_, (at_x, at_y, *_)) in enumerate(found)
        if at_x is not None and at_y is not None
    ]
    least, index = min(apart, default=(math.inf, 0))
    return shown_id(found[index][0]) if least < DISTANCE_TOLERANCE else None
