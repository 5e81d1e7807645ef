"""Roads of driving as OpenDRIVE, of which CARLA builds a world.

Arms and ways across are roads there; numbers of junction and ways follow those of the arms. Axes of
OpenDRIVE: y north, angles counter-clockwise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from pytest_dura.driving.lanes import Route, routes_of
from pytest_dura.driving.roads import Road

GIVE_WAY, STOP = "205", "206"
"""Types of these signs."""
_JUNCTION = 1000
_HEADER = '<header revMajor="1" revMinor="4" name="{}" version="1" date="" north="0" south="0" \
east="0" west="0"><geoReference>+proj=tmerc +lat_0=0 +lon_0=0</geoReference></header>'
_SIGN = '<signal id="{}" s="{!r}" t="{!r}" name="give way" dynamic="no" orientation="+" \
zOffset="2" country="" type="{}" subtype="-1" value="-1" height="0.8" width="0.8">\
<validity fromLane="-1" toLane="-1"/></signal>'
_SIGN_BEFORE = 1.0
"""m from a sign to the stop line."""


def opendrive_of(road: Road) -> str:
    """Write a road; lanes, stop lines, ways across and signs are those of driving."""
    ways = routes_of(road)
    parts = [_HEADER.format(road.name)]
    parts += [_arm(road, number) for number in range(len(road.arms))]
    parts += [_way(plan) for plan in ways]
    connections = "".join(
        f'<connection id="{plan.number}" incomingRoad="{plan.origin}" '
        f'connectingRoad="{_id(plan)}" contactPoint="start"><laneLink from="-1" to="-1"/>'
        "</connection>"
        for plan in ways
    )
    parts.append(f'<junction name="{road.name}" id="{_JUNCTION}">{connections}</junction>')
    return '<?xml version="1.0"?>\n<OpenDRIVE>\n' + "\n".join(parts) + "\n</OpenDRIVE>\n"


def _id(plan: Route) -> int:
    return len(plan.road.arms) + plan.number


def _arm(road: Road, number: int) -> str:
    """Write an arm inwards along its middle, so that who nears the junction is on the right."""
    arm = road.arms[number]
    link = f'<successor elementType="junction" elementId="{_JUNCTION}"/>'
    geometry = _geometry(arm.place(arm.end, 0.0), arm.angle - math.pi / 2, [(arm.length, 0.0)])
    sides = {1: arm.lanes != "in", -1: arm.lanes != "out"}
    width = f'<width sOffset="0" a="{arm.lane_width!r}" b="0" c="0" d="0"/>'
    lanes = _lanes({side: width for side, is_there in sides.items() if is_there})
    sign = ""
    if road.sign(number) == "give_way":
        beside = -arm.lane_width - 1.0
        sign = _SIGN.format(number, arm.length - _SIGN_BEFORE, beside, GIVE_WAY)
    parts = f"<link>{link}</link>{geometry}<lanes>{lanes}</lanes><signals>{sign}</signals>"
    return _road(number, arm.length, junction=-1, limit=road.speed_limit, parts=parts)


def _way(plan: Route) -> str:
    """Write the way across along the middle of its only lane."""
    link = "".join(
        f'<{side} elementType="road" elementId="{arm}" contactPoint="end"/>'
        for side, arm in (("predecessor", plan.origin), ("successor", plan.destination))
    )
    curve, arm = plan.curve, plan.arm
    bend = curve.turned / curve.length if curve.turned else 0.0
    lines = [(curve.lead, 0.0), (curve.length, bend), (curve.tail, 0.0)]
    begin = arm.place(arm.stop_line, arm.offset)
    geometry = _geometry(begin, arm.angle - math.pi / 2, lines)
    wide, wider = arm.lane_width, (plan.leaves.lane_width - arm.lane_width) / plan.inside
    lane = f'<link><predecessor id="-1"/><successor id="1"/></link><width sOffset="0" \
a="{wide!r}" b="{wider!r}" c="0" d="0"/>'
    offset = f'<laneOffset s="0" a="{wide / 2!r}" b="{wider / 2!r}" c="0" d="0"/>'
    parts = f"<link>{link}</link>{geometry}<lanes>{offset}{_lanes({-1: lane})}</lanes>"
    limit = plan.road.speed_limit
    return _road(_id(plan), plan.inside, junction=_JUNCTION, limit=limit, parts=parts)


def _road(number: int, length: float, *, junction: int, limit: float, parts: str) -> str:
    return (
        f'<road name="" length="{length!r}" id="{number}" junction="{junction}">'
        f'<type s="0" type="town"><speed max="{limit * 3.6!r}" unit="km/h"/></type>{parts}</road>'
    )


def _lanes(sides: dict[int, str]) -> str:
    groups = []
    for side, name in ((1, "left"), (0, "center"), (-1, "right")):
        if side in sides or not side:
            kind = "driving" if side else "none"
            lane = f'<lane id="{side}" type="{kind}" level="false">{sides.get(side, "")}</lane>'
            groups.append(f"<{name}>{lane}</{name}>")
    return f'<laneSection s="0">{"".join(groups)}</laneSection>'


def _geometry(
    begin: tuple[float, float], heading: float, lines: Sequence[tuple[float, float]]
) -> str:
    """Write straight lines and arcs, each by its length and curvature."""
    (x, y), s, written = begin, 0.0, ""
    for length, bend in lines:
        if length <= 0.0:
            continue
        shape = f'<arc curvature="{-bend!r}"/>' if bend else "<line/>"
        written += (
            f'<geometry s="{s!r}" x="{x!r}" y="{-y!r}" hdg="{-heading!r}" length="{length!r}">'
            f"{shape}</geometry>"
        )
        after = heading + bend * length
        if bend:
            x += (math.sin(after) - math.sin(heading)) / bend
            y -= (math.cos(after) - math.cos(heading)) / bend
        else:
            x, y = x + length * math.cos(heading), y + length * math.sin(heading)
        s, heading = s + length, after
    return f"<planView>{written}</planView>"
