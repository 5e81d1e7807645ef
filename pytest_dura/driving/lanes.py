"""highway-env's road network, which finds the lane nearest to a car an order of magnitude quicker.

highway-env measures the distance to every lane, for every car at every step: more than half of
what a step costs. Most lanes are out of the question by their first term alone.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from highway_env.road.lane import AbstractLane, CircularLane, StraightLane
from highway_env.road.road import RoadNetwork
from numpy.typing import NDArray

MARGIN = 1e-6
"""Metres (and radians) within which two lanes are not told apart here, but by highway-env itself.

Rounding is orders of magnitude smaller, so that what is found is what highway-env would find.
"""
Index = tuple[str, str, int]
"""A lane: the nodes that it leads from and to, and its number among those that do."""
_TURN = 2 * math.pi


class _Straight(NamedTuple):
    """What the distance to a straight lane is made of."""

    lane: Index
    start: tuple[float, float]
    along: tuple[float, float]
    length: float
    heading: float
    width: float


class _Arc(NamedTuple):
    """What the distance to an arc is made of; ``sense`` is 1 clockwise and -1 otherwise."""

    lane: Index
    centre: tuple[float, float]
    radius: float
    begin: float
    sense: int
    length: float
    width: float


class LaneNetwork(RoadNetwork):
    """The lanes of another network, and what is quicker to tell of them than to ask them.

    Args:
        network: Whose graph it shares. It must not change any more.

    Raises:
        TypeError: For a lane that is neither straight nor an arc.
    """

    def __init__(self, network: RoadNetwork) -> None:
        super().__init__()
        self.graph = network.graph
        self._straights: dict[Index, _Straight] = {}
        self._arcs: dict[Index, _Arc] = {}
        for index, lane in network.lanes_dict().items():
            length, width = float(lane.length), float(lane.width)
            if type(lane) is StraightLane:
                start, along = lane.start.tolist(), lane.direction.tolist()
                course = float(lane.heading)
                self._straights[index] = _Straight(index, start, along, length, course, width)
            elif type(lane) is CircularLane:
                centre, phase = lane.center.tolist(), float(lane.start_phase)
                radius, sense = float(lane.radius), int(lane.direction)
                self._arcs[index] = _Arc(index, centre, radius, phase, sense, length, width)
            else:
                raise TypeError(f"lane {index} is a {type(lane).__name__}, not straight nor an arc")

    def may_hold(self, index: Index, x: float, y: float, margin: float) -> bool:
        """Whether ``on_lane`` of that lane may hold there; where this is false, it does not.

        Args:
            index: Which lane.
            x: World position in m.
            y: World position in m.
            margin: Metres beside the lane, as for ``on_lane``.
        """
        straight = self._straights.get(index)
        if straight is None:
            (x0, y0), arc = self._arcs[index].centre, self._arcs[index]
            beside = abs(arc.radius - math.hypot(x - x0, y - y0))
            return beside <= arc.width / 2 + margin + MARGIN
        dx, dy = x - straight.start[0], y - straight.start[1]
        ux, uy = straight.along
        if abs(dy * ux - dx * uy) > straight.width / 2 + margin + MARGIN:
            return False
        over = AbstractLane.VEHICLE_LENGTH + MARGIN
        return bool(-over <= dx * ux + dy * uy <= straight.length + over)

    def get_closest_lane_index(
        self, position: NDArray[np.float64], heading: float | None = None
    ) -> Any:
        """As highway-env has it: the lane with the least sum of offset, overshoot and angle.

        Args:
            position: World position in m, shape ``(2,)``.
            heading: In rad; ``None`` leaves the angle out.

        Returns:
            Its nodes and its number.
        """
        if heading is not None:
            x, y = position.tolist()
            found = self._nearest(x, y, float(heading))
            if found is not None:
                return found
        return super().get_closest_lane_index(position, heading)

    def _nearest(self, x: float, y: float, heading: float) -> Index | None:
        """The nearest lane, or ``None`` where rounding could decide between two.

        All terms of a distance are positive: a lane whose first terms are above the best is out.
        """
        found, best, second = self._nearest_straight(x, y, heading)
        for index, (x0, y0), radius, begin, sense, length, _ in self._arcs.values():
            dx, dy = x - x0, y - y0
            distance = abs(radius - math.hypot(dx, dy))
            if distance > best + MARGIN:
                continue
            turned = _wrapped(math.atan2(dy, dx) - begin)
            if abs(turned) > math.pi - MARGIN:
                return None  # opposite to its beginning, where the way along it jumps
            s = sense * turned * radius
            distance += s - length if s > length else -s if s < 0.0 else 0.0
            distance += abs(_wrapped(heading - (begin + turned + sense * math.pi / 2)))
            if distance < best:
                found, best, second = index, distance, best
            elif distance < second:
                second = distance
        return found if second - best > MARGIN else None

    def _nearest_straight(
        self, x: float, y: float, heading: float
    ) -> tuple[Index | None, float, float]:
        """The nearest straight lane, its distance and that of the next one."""
        found = None
        best = second = math.inf
        for index, (x0, y0), (ux, uy), length, course, _ in self._straights.values():
            dx, dy = x - x0, y - y0
            distance = abs(dy * ux - dx * uy)
            if distance > best + MARGIN:
                continue
            s = dx * ux + dy * uy
            distance += s - length if s > length else -s if s < 0.0 else 0.0
            if distance > best + MARGIN:
                continue
            distance += abs(_wrapped(heading - course))
            if distance < best:
                found, best, second = index, distance, best
            elif distance < second:
                second = distance
        return found, best, second


def _wrapped(angle: float) -> float:
    """The angle between -pi and pi."""
    return (angle + math.pi) % _TURN - math.pi
