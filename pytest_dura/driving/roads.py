"""Roads as data: arms around a centre, and what follows from their numbers.

A road is one junction. Its arms leave the centre at any bearing and have one lane in each
direction, or in one of them; traffic keeps to the right. Whatever the domain needs to know of the
geometry, it reads from a :class:`Road`, which the channel ``map`` carries within the route.

Metres and radians; x east, y south. A bearing is a compass's, in degrees: north 0, east 90.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from itertools import pairwise
from typing import Literal

from pytest_dura.core.errors import ConfigurationError, did_you_mean

Turn = Literal["left", "straight", "right"]
Lanes = Literal["both", "in", "out"]
Vector = tuple[float, float]

STRAIGHT_ON = 45.0
"""Degrees; who turns by no more goes straight on."""
SHARPEST = 150.0
"""Degrees; no route turns by more. Two arms are hence at least 30 degrees apart."""
LEAST_RADIUS = 5.0
"""m; the lane of a sharper turn is more than a car can follow."""
_ROUNDING = 1e-9


@dataclass(frozen=True)
class Arm:
    """An arm of a junction.

    Args:
        name: Its name in scenarios, records and messages.
        bearing: Where it leads, seen from the centre, in degrees of a compass.
        priority: Right of way; the greater goes first. A left turn counts as one less.
        length: Of the lanes, from their outer end to the stop line, in m.
        stop_line: From the centre to the stop line, in m.
        lane_width: Of each lane, in m.
        lanes: Whether traffic may come from it, leave on it, or both.
    """

    name: str
    bearing: float
    priority: int = 1
    length: float = 100.0
    stop_line: float = 11.0
    lane_width: float = 4.0
    lanes: Lanes = "both"

    @property
    def offset(self) -> float:
        """Metres from the middle of the road to the middle of a lane."""
        return self.lane_width / 2.0

    @property
    def end(self) -> float:
        """Metres from the centre to its outer end."""
        return self.stop_line + self.length

    @cached_property
    def angle(self) -> float:
        """Radians by which the southern arm is turned, clockwise, to lie where this one lies."""
        return math.radians((self.bearing - 180.0) % 360.0)

    @cached_property
    def outward(self) -> Vector:
        """The unit vector from the centre along it."""
        return unit(self.bearing)

    @cached_property
    def inward(self) -> Vector:
        """The unit vector along which its traffic nears the centre."""
        return unit(self.bearing + 180.0)

    @cached_property
    def right(self) -> Vector:
        """The unit vector to the right of a driver who nears the junction."""
        return unit(self.bearing + 270.0)

    def along(self, x: float, y: float) -> float:
        """Metres from the centre, measured along it; negative on the other side."""
        return x * self.outward[0] + y * self.outward[1]

    def beside(self, x: float, y: float) -> float:
        """Metres right of its middle, for a driver who nears the junction."""
        return x * self.right[0] + y * self.right[1]

    def place(self, along: float, beside: float) -> Vector:
        """The x and y of a point ``along`` metres from the centre and ``beside`` its middle."""
        c, sn = math.cos(self.angle), math.sin(self.angle)
        return c * beside - sn * along, sn * beside + c * along


def unit(bearing: float) -> Vector:
    """The unit vector of a bearing in degrees; exact for the four main ones."""
    angle = math.radians(bearing)
    x, y = math.sin(angle), -math.cos(angle)
    return _snapped(x), _snapped(y)


def _snapped(value: float) -> float:
    nearest = float(round(value))
    return nearest + 0.0 if abs(value - nearest) < 1e-12 else value


@dataclass(frozen=True)
class Curve:
    """The way across the junction: straight on for ``lead``, an arc, straight on for ``tail``.

    Args:
        turned: Radians of the arc, positive to the right; 0 for a straight way.
        radius: Of the arc, in m; 0 for a straight way.
        lead: Metres from the stop line to the arc.
        tail: Metres from the arc to where the arm begins on which it leaves.
        length: Metres of arc; of a straight way, all of it.
    """

    turned: float
    radius: float
    lead: float
    tail: float
    length: float


@dataclass(frozen=True)
class Road:
    """One junction.

    Args:
        name: Of a built-in road; ``custom`` for one that a scenario describes.
        arms: At least two; the ego comes from the first one unless its scenario says otherwise.
        speed_limit: In m/s, on all of it.
    """

    name: str
    arms: tuple[Arm, ...]
    speed_limit: float = 10.0

    def __reduce__(self) -> tuple[type[Road], tuple[str, tuple[Arm, ...], float]]:
        """Copies are made of its data alone, without what was computed from it."""
        return Road, (self.name, self.arms, self.speed_limit)

    def arm(self, name: str, key: str | None = None) -> int:
        """The number of the arm of this name.

        Raises:
            ConfigurationError: If there is none; ``key`` is where the scenario names it.
        """
        names = self.names
        if name in names:
            return names.index(name)
        raise ConfigurationError(
            f"the road {self.name} has no arm {name!r}",
            key=key,
            found=name,
            expected="one of " + ", ".join(names),
            remedy=did_you_mean(name, names) or "name an arm of the road, or give it this one",
        )

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the arms."""
        return tuple(arm.name for arm in self.arms)

    def turned(self, origin: int, destination: int) -> float:
        """Degrees by which a route turns, positive to the right."""
        bearing = self.arms[destination].bearing - (self.arms[origin].bearing + 180.0)
        return (bearing + 180.0) % 360.0 - 180.0

    def turn(self, origin: int, destination: int) -> Turn:
        """What a driver calls the way from one arm to another."""
        turned = self.turned(origin, destination)
        if abs(turned) <= STRAIGHT_ON:
            return "straight"
        return "right" if turned > 0.0 else "left"

    def destinations(self, origin: int) -> tuple[int, ...]:
        """The arms on which traffic from an arm may leave, from the left to the right."""
        if self.arms[origin].lanes == "out":
            return ()
        others = [
            number for number, arm in enumerate(self.arms) if number != origin and arm.lanes != "in"
        ]
        return tuple(sorted(others, key=lambda number: self.turned(origin, number)))

    def destination(self, origin: int, turn: str, key: str | None = None) -> int:
        """The arm to which a turn leads.

        Raises:
            ConfigurationError: If none does, or more than one; ``key`` is where the scenario
                says the turn.
        """
        ways = self.destinations(origin)
        fitting = [number for number in ways if self.turn(origin, number) == turn]
        if len(fitting) == 1:
            return fitting[0]
        name = self.arms[origin].name
        if not ways:
            raise ConfigurationError(
                f"no traffic can come from the arm {name} of the road {self.name}",
                key=key and key.replace(".turn", ".arm"),
                found=name,
                expected="one of " + ", ".join(self.entries),
                remedy="name another arm, or give this one a lane towards the junction",
            )
        possible = ", ".join(f"{self.turn(origin, n)} (to {self.arms[n].name})" for n in ways)
        leads = "leads to several arms" if fitting else "leaves the road"
        raise ConfigurationError(
            f"on the road {self.name}, {turn} from the arm {name} {leads}",
            key=key,
            found=turn,
            expected="one of " + possible,
            remedy="give another turn, or name the arm with `to`",
        )

    @cached_property
    def entries(self) -> tuple[str, ...]:
        """Names of the arms from which traffic can come."""
        return tuple(arm.name for n, arm in enumerate(self.arms) if self.destinations(n))

    def priority(self, origin: int, destination: int) -> int:
        """Right of way of a route: the greater goes first."""
        return self.arms[origin].priority - (self.turn(origin, destination) == "left")

    def sign(self, origin: int) -> str:
        """The sign beside an arm: ``give_way``, ``priority_road``, or empty where all are equal."""
        own = self.arms[origin].priority
        others = [self.arms[self.arm(name)].priority for name in self.entries]
        if own < max(others, default=own):
            return "give_way"
        return "priority_road" if own > min(others, default=own) else ""

    @property
    def crosswise(self) -> bool:
        """Whether it is the plain crossing of an east-west road over a north-south road."""
        bearings = tuple(arm.bearing for arm in self.arms)
        priorities = [arm.priority for arm in self.arms]
        return (
            self.names == ("south", "west", "north", "east")
            and bearings == (180.0, 270.0, 0.0, 90.0)
            and priorities[0] == priorities[2] < priorities[1] == priorities[3]
        )

    def inside(self, x: float, y: float) -> bool:
        """Whether a point is on the inner side of all stop lines."""
        return all(arm.along(x, y) <= arm.stop_line for arm in self.arms)

    def before_ends(self, x: float, y: float, margin: float) -> bool:
        """Whether a point is at least ``margin`` metres before the outer ends of all arms."""
        return all(arm.along(x, y) < arm.end - margin for arm in self.arms)

    @cache  # noqa: B019 - roads are few, and as good as constants
    def curve(self, origin: int, destination: int) -> Curve:
        """The way from the stop line of one arm to where another arm begins.

        Raises:
            ConfigurationError: If no single turn of a car leads from the one to the other.
        """
        start, end = self.arms[origin], self.arms[destination]
        degrees = self.turned(origin, destination)
        if abs(degrees) < _ROUNDING and abs(start.offset - end.offset) < _ROUNDING:
            return Curve(0.0, 0.0, 0.0, 0.0, start.stop_line + end.stop_line)
        # In the frame of the origin: driving up (towards -y) on x = offset.
        ex, ey = unit(degrees)
        end_x = end.stop_line * ex - end.offset * ey
        end_y = end.stop_line * ey + end.offset * ex
        after = (end_x - start.offset) / ex if ex else -1.0
        before = start.stop_line - (end_y - after * ey)
        tangent = min(before, after)
        turned = math.radians(degrees)
        # Nanometres are rounding, and a quarter has exactly the radius that its tangents have.
        radius = round(tangent / math.tan(abs(turned) / 2.0), 9) if tangent > 0.0 else 0.0
        if abs(degrees) > SHARPEST or radius < LEAST_RADIUS:
            raise ConfigurationError(
                f"no car can turn from the arm {start.name} to the arm {end.name}",
                key=f"world.road.arms.{origin}",
                found=f"a turn of {degrees:.0f} degrees with a radius of {radius:.1f} m",
                expected=f"at most {SHARPEST:g} degrees, and at least {LEAST_RADIUS:g} m",
                remedy="move the stop lines outwards, give both arms lanes of one width, or let "
                "one of them have lanes in one direction",
            )
        lead, tail = before - tangent, after - tangent
        lead, tail = (0.0 if rest < _ROUNDING else rest for rest in (lead, tail))
        return Curve(turned, radius, lead, tail, radius * abs(turned))

    @lru_cache(maxsize=256)  # noqa: B019 - each world that may be drawn asks, most on one road
    def check(self) -> None:
        """Refuse a geometry that cannot be.

        Raises:
            ConfigurationError: With the arm's number in ``key``, as in ``world.road.arms.1``.
        """
        if len(set(self.names)) < len(self.names):
            twice = next(name for name in self.names if self.names.count(name) > 1)
            raise ConfigurationError(
                "two arms have the same name",
                key="world.road.arms",
                found=twice,
                expected="names that are unique",
            )
        if not self.entries:
            raise ConfigurationError(
                "no route leads across the road",
                key="world.road.arms",
                found=", ".join(f"{arm.name}: {arm.lanes}" for arm in self.arms),
                expected="an arm with a lane towards the junction, and another with one away",
                remedy="correct `lanes` of an arm",
            )
        for a, b in self.neighbours():
            self._check_neighbours(a, b)
            self._check_neighbours(b, a)
        for origin in range(len(self.arms)):
            for destination in self.destinations(origin):
                self.curve(origin, destination)

    def neighbours(self) -> list[tuple[int, int]]:
        """Numbers of the arms that follow each other, counter-clockwise."""
        order = sorted(range(len(self.arms)), key=lambda number: -self.arms[number].bearing % 360)
        return list(pairwise([*order, order[0]]))

    def _check_neighbours(self, number: int, other: int) -> None:
        arm, beside = self.arms[number], self.arms[other]
        apart = math.radians(abs((beside.bearing - arm.bearing + 180.0) % 360.0 - 180.0))
        least = math.radians(180.0 - SHARPEST)
        if apart < least - _ROUNDING:
            raise ConfigurationError(
                f"the arms {arm.name} and {beside.name} are too near each other",
                key=f"world.road.arms.{number}.bearing",
                found=f"{math.degrees(apart):.0f} degrees",
                expected=f"at least {math.degrees(least):.0f} degrees",
            )
        if apart > math.pi - 0.1:
            return
        # Where the edges of the two meet, measured along this arm.
        meet = (beside.lane_width + arm.lane_width * math.cos(apart)) / math.sin(apart)
        if arm.stop_line < meet:
            raise ConfigurationError(
                f"the stop line of the arm {arm.name} lies on the arm {beside.name}",
                key=f"world.road.arms.{number}.stop_line",
                found=arm.stop_line,
                expected=f"at least {math.ceil(meet * 10.0) / 10.0:g} m",
                remedy="move it outwards",
            )


FOUR_WAY = Road(
    "four_way",
    (
        Arm("south", 180.0, priority=1),
        Arm("west", 270.0, priority=3),
        Arm("north", 0.0, priority=1),
        Arm("east", 90.0, priority=3),
    ),
)
"""The junction of highway-env: the east-west road has priority."""

BUILT_IN: Mapping[str, Road] = {
    road.name: road
    for road in (
        FOUR_WAY,
        Road(
            "four_way_wide",
            tuple(
                Arm(arm.name, arm.bearing, arm.priority, 120.0, 17.0, 5.0) for arm in FOUR_WAY.arms
            ),
        ),
        Road(
            "t_junction",
            (
                Arm("south", 180.0, priority=1),
                Arm("west", 270.0, priority=3),
                Arm("east", 90.0, priority=3),
            ),
        ),
        Road(
            "merge",
            (
                Arm("ramp", 235.0, priority=1, stop_line=26.0, lanes="in"),
                Arm("west", 270.0, priority=3, stop_line=26.0, lanes="in"),
                Arm("east", 90.0, priority=3, stop_line=26.0, lanes="out"),
            ),
        ),
    )
}
"""The built-in roads by name."""


def named_road(name: str) -> Road:
    """A built-in road.

    Raises:
        ConfigurationError: If there is none of this name.
    """
    if name in BUILT_IN:
        return BUILT_IN[name]
    raise ConfigurationError(
        f"there is no road {name!r}",
        key="world.road",
        found=name,
        expected="one of " + ", ".join(BUILT_IN) + ", or a mapping with `arms`",
        remedy=did_you_mean(name, BUILT_IN) or "name a built-in road, or describe one",
    )
