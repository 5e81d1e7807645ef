"""Places on the roads of an OpenDRIVE file, as far as the positions of a scenario need them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from pytest_dura.driving.openscenario.document import Element, read_document
from pytest_dura.driving.openscenario.parameters import Parameters
from pytest_dura.driving.openscenario.place import Pose

_NUMBERS = Parameters()
_SLACK = 1e-6


@dataclass(frozen=True)
class RoadNetwork:
    """Roads by their id.

    Args:
        roads: Elements of the file.
    """

    roads: dict[str, Element]

    @classmethod
    def read(cls, file: Path) -> RoadNetwork:
        """Read an OpenDRIVE file.

        Raises:
            ConfigurationError: If it is none.
        """
        root = read_document(file)
        if root.tag != "OpenDRIVE":
            root.refuse("this is no OpenDRIVE file", found=root.tag, expected="OpenDRIVE")
        return cls({road.require("id"): road for road in root.all("road")})

    def at(self, road: str, s: float, t: float) -> Pose | None:
        """Return the pose of the reference line's direction, ``t`` to its left.

        ``None`` for an unknown road, a place off its end, and where it is neither straight nor a
        circle's arc.
        """
        element = self.roads.get(road)
        plan = None if element is None else element.find("planView")
        if element is None or plan is None:
            return None
        if not -_SLACK <= s <= _number(element, "length") + _SLACK:
            return None
        shape = _last_before(plan.all("geometry"), "s", s)
        if shape is None:
            return None
        begin = Pose(_number(shape, "x"), _number(shape, "y"), _number(shape, "hdg"))
        pose = _along(shape, begin, s - _number(shape, "s"))
        return None if pose is None else pose.moved(0.0, t)

    def on_lane(self, road: str, lane: str, s: float, offset: float) -> Pose | None:
        """Return the pose of the lane's traffic, which keeps right, ``offset`` left of its middle.

        ``None`` as for :meth:`at`, and for a lane that is not there.
        """
        element = self.roads.get(road)
        lanes = None if element is None else element.find("lanes")
        section = None if lanes is None else _last_before(lanes.all("laneSection"), "s", s)
        if lanes is None or section is None or not lane.lstrip("-").isdecimal():
            return None
        number = int(lane)
        side = section.find("left" if number > 0 else "right")
        widths = {
            int(each.require("id")): _cubic(each.all("width"), "sOffset", s - _number(section, "s"))
            for each in ([] if side is None else side.all("lane"))
        }
        if number not in widths:
            return None
        inner = sum(width for other, width in widths.items() if abs(other) < abs(number))
        t = math.copysign(inner + widths[number] / 2.0, number)
        t += _cubic(lanes.all("laneOffset"), "s", s) + offset
        pose = self.at(road, s, t)
        return pose if pose is None or number < 0 else pose.moved(0.0, 0.0, math.pi)


def _along(shape: Element, begin: Pose, length: float) -> Pose | None:
    """Move along a straight or an arc; ``None`` for any other shape."""
    arc = shape.find("arc")
    curvature = 0.0 if arc is None else _number(arc, "curvature")
    if curvature != 0.0:
        turned = curvature * length
        return begin.moved(
            math.sin(turned) / curvature, (1.0 - math.cos(turned)) / curvature, turned
        )
    return None if arc is None and shape.find("line") is None else begin.moved(length)


def _number(element: Element, name: str) -> float:
    return _NUMBERS.number(element, name)


def _last_before(elements: list[Element], key: str, s: float) -> Element | None:
    before = [element for element in elements if _number(element, key) <= s + _SLACK]
    return max(before, key=lambda element: _number(element, key), default=None)


def _cubic(elements: list[Element], key: str, s: float) -> float:
    """Evaluate the polynomial that holds at ``s``; 0 without one."""
    element = _last_before(elements, key, s)
    if element is None:
        return 0.0
    ds = s - _number(element, key)
    a, b, c, d = (_number(element, name) for name in "abcd")
    return a + ds * (b + ds * (c + ds * d))
