"""Traffic on highway-env's road: lanes, lateral control, drivers, pedestrians, and the ego's body.

highway-env measures the distance to every lane, for every car at every step: more than half of
what a step costs. Most lanes are out of the question by their first term alone.

Drivers follow highway-env's Intelligent Driver Model. Added to it here: a leader on their own
route beyond the end of their lane, and gap acceptance at the stop line by right of way; without
these, highway-env's own regulation lets many of them crash (see docs of the scenario's world).
The parameters live on classes of our own, so that no other highway-env user sees them.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from highway_env.road.lane import AbstractLane, CircularLane, StraightLane
from highway_env.road.road import Road, RoadNetwork
from highway_env.utils import not_zero, wrap_to_pi
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.controller import ControlledVehicle
from highway_env.vehicle.objects import Obstacle
from numpy.typing import NDArray

from pytest_dura.driving.bodies import CAR_LENGTH, CYCLIST_LENGTH, PEDESTRIAN_SIZE
from pytest_dura.driving.lanes import Route, conflict, routes_of
from pytest_dura.driving.maneuvers import MAX_BRAKING
from pytest_dura.driving.moving import Actuated, Walking, crossing_length, kerb, placed
from pytest_dura.driving.roads import Arm
from pytest_dura.driving.roads import Road as Geometry
from pytest_dura.driving.scenario import CyclistStart, Part

_SHARPEST_COURSE = math.pi / 4
"""Greatest angle in rad between lane and course that is steered for."""


class LaneKeeping(ControlledVehicle):
    """Steers along a lane as highway-env does, to the last bit."""

    def keep_lane(self) -> float:
        """Go on to the next lane where one ends, and the steering angle in rad that follows it.

        ``follow_road`` and ``steering_control`` in one, which measure the same otherwise.
        """
        lane = self.road.network.get_lane(self.target_lane_index)
        along, offset = lane.local_coordinates(self.position)
        if lane.after_end(self.position, along):
            self.follow_road()
            return self.steering_control(self.target_lane_index)
        return self._steering(lane, along, offset)

    def steering_control(self, target_lane_index: Any) -> float:
        """The steering angle in rad that follows the centre of a lane."""
        lane = self.road.network.get_lane(target_lane_index)
        return self._steering(lane, *lane.local_coordinates(self.position))

    def _steering(self, lane: Any, along: float, offset: float) -> float:
        """Offset to lateral speed, to heading; its error to a rate of turn, and that to an angle.

        See ``highway_env.vehicle.controller.ControlledVehicle.steering_control``. Sine and tangent
        stay numpy's, which may differ from the standard library's in the last bit.
        """
        course = lane.heading_at(along + self.speed * self.TAU_PURSUIT)
        speed = not_zero(self.speed)
        heading = float(np.arcsin(within(-self.KP_LATERAL * offset / speed, 1.0)))
        target = course + within(heading, _SHARPEST_COURSE)
        rate = self.KP_HEADING * wrap_to_pi(target - self.heading)
        slip = np.arcsin(within(self.LENGTH / 2 / speed * rate, 1.0))
        return within(float(np.arctan(2 * np.tan(slip))), self.MAX_STEERING_ANGLE)


def within(value: float, most: float) -> float:
    """The value between ``-most`` and ``most``; NaN stays NaN."""
    if value > most:
        return most
    if value < -most:
        return -most
    return value


MARGIN = 1e-6
"""Metres (and radians) within which two lanes are compared by highway-env itself, and not here.

Rounding is orders of magnitude smaller, so that the lane is the one that highway-env would find.
"""
Index = tuple[str, str, int]
"""A lane: the nodes that it leads from and to, and its number among those that do."""
_TURN = 2 * math.pi


class _Straight(NamedTuple):
    """Figures of a straight lane from which the distance to it is computed."""

    lane: Index
    start: tuple[float, float]
    along: tuple[float, float]
    length: float
    heading: float
    width: float


class _Arc(NamedTuple):
    """Figures of an arc from which the distance is computed; ``sense`` is 1 clockwise, else -1."""

    lane: Index
    centre: tuple[float, float]
    radius: float
    begin: float
    sense: int
    length: float
    width: float


class LaneNetwork(RoadNetwork):
    """The lanes of another network, with a quicker search for the nearest one.

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
        """The lane with the least sum of offset, overshoot and angle, as highway-env finds it.

        Args:
            position: World position in m, shape ``(2,)``.
            heading: In rad; ``None`` leaves the angle out.

        Returns:
            Its nodes and its number.
        """
        if heading is not None:
            x, y = position.tolist()
            nearest = self._nearest(x, y, float(heading))
            if nearest is not None:
                return nearest
        return super().get_closest_lane_index(position, heading)

    def _nearest(self, x: float, y: float, heading: float) -> Index | None:
        """The nearest lane, or ``None`` where rounding could decide between two.

        All terms of a distance are positive: a lane whose first terms are above the best is out.
        """
        nearest, best, second = self._nearest_straight(x, y, heading)
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
                nearest, best, second = index, distance, best
            elif distance < second:
                second = distance
        return nearest if second - best > MARGIN else None

    def _nearest_straight(
        self, x: float, y: float, heading: float
    ) -> tuple[Index | None, float, float]:
        """The nearest straight lane, its distance and that of the next one."""
        nearest = None
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
                nearest, best, second = index, distance, best
            elif distance < second:
                second = distance
        return nearest, best, second


def _wrapped(angle: float) -> float:
    """The angle between -pi and pi."""
    return (angle + math.pi) % _TURN - math.pi


_STOP_MARGIN = 1.0
"""Drivers stop this many metres before the stop line."""
_READY_BRAKING = 4.0
"""m/s2 that a driver is ready to use for a stop line."""
_COMFORT_SPEED = 8.0
_MARGIN = 1.5
"""Seconds between leaving the conflict and the other's arrival that a driver wants."""
_TOUCH = 1e-6
"""Metres beyond half a diagonal within which contact of two bodies is checked."""
_PASSING = 0.3
"""Metres that a driver leaves beside an obstacle; where there is less, it stops before it."""
_STANDS = 6.0
"""Seconds after which a driver who brakes as hard as it can drives on."""
_LOOK_AHEAD = 45.0
"""Metres before the stop line from which others take a driver into account."""


class Driver(LaneKeeping, IDMVehicle):
    """A background driver with a route, who stays on its lanes."""

    DISTANCE_WANTED = 7.0
    COMFORT_ACC_MAX = 4.0
    COMFORT_ACC_MIN = -3.0

    body_id: str
    plan: Route
    s: float
    gives_way = True
    brakes_at: float | None = None
    """s from which on it brakes as hard as it can."""

    def act(self, _action: Any = None) -> None:
        """IDM on the lane (and the next one), then the limits of the route and right of way."""
        if self.crashed:
            return
        if self.brakes_at is not None:
            since = self.road.now - self.brakes_at
            if -1e-9 <= since < _STANDS:
                rate = -min(MAX_BRAKING, self.speed / self.road.dt)
                self.action = {"steering": self.keep_lane(), "acceleration": rate}
                return
        steering = self.keep_lane()
        rate = self._idm(self.lane_index)
        if self.lane_index != self.target_lane_index:
            rate = min(rate, self._idm(self.target_lane_index))
        rate = within(rate, self.ACC_MAX)
        limit = self.road.limit_for(self)
        if limit < rate:
            rate = max(limit, -self.ACC_MAX)
        self.action = {"steering": steering, "acceleration": rate}

    def _idm(self, lane_index: Any) -> float:
        """highway-env's acceleration behind the leader on a lane, in m/s2."""
        leader = self.road.leader(self, lane_index)
        return float(self.acceleration(ego_vehicle=self, front_vehicle=leader))


class Ego(Actuated, LaneKeeping):
    """The vehicle that the component drives: highway-env steers it along its lane."""

    body_id = "EGO"
    plan: Route
    s: float

    def act(self, _action: Any = None) -> None:
        """Steer along the lane; the acceleration is set by :meth:`actuate`.

        It takes the place of highway-env's speed controller, which knows no limit.
        """
        self.action = {"steering": self.keep_lane(), "acceleration": self.executed}


class Pedestrian(Walking, Obstacle):
    """A pedestrian as highway-env knows obstacles."""

    LENGTH = PEDESTRIAN_SIZE
    WIDTH = PEDESTRIAN_SIZE


class Cyclist(Pedestrian):
    """A cyclist, who moves as a pedestrian does, with a size of its own."""

    LENGTH = CYCLIST_LENGTH


class Standing(Obstacle):
    """A static obstacle: it stands where it is, whatever touches it.

    Args:
        road: Where it stands.
        position: Of its centre.
        heading: Along which its length lies.
        size: Length and width in m.
    """

    body_id: str

    def __init__(
        self, road: Road, position: NDArray[np.float64], heading: float, size: tuple[float, float]
    ) -> None:
        self.LENGTH, self.WIDTH = size
        super().__init__(road, position, heading, 0.0)


class JunctionRoad(Road):
    """highway-env's road with right of way at the stop lines.

    ``courtesy`` says whether drivers brake for an ego that stands in the conflict zone on their
    path (``occupied``) or insist on their right of way as though it were not there (``none``).
    """

    now, dt = 0.0, 0.1
    """s: the time, and how long the next step lasts."""
    courtesy = "occupied"
    obstacles: tuple[Standing, ...] = ()
    halted: frozenset[int] = frozenset()
    """Arms whose traffic light is not green."""

    def act(self) -> None:
        """All drivers decide on the same state."""
        for vehicle in self.vehicles:
            vehicle.s = vehicle.plan.project(*vehicle.position.tolist())[0]
        super().act()

    def step(self, dt: float) -> None:
        """Move all vehicles, then mark contacts.

        highway-env flags a contact a step early, from predicted positions, and marks one side only
        where the other is a pedestrian; here both are marked when their boxes overlap.
        """
        for vehicle in self.vehicles:
            vehicle.step(dt)
        bodies = [
            (body, *body.position.tolist(), float(body.diagonal) / 2 + _TOUCH)
            for body in (*self.vehicles, *self.objects, *self.obstacles)
        ]
        for i, (vehicle, x, y, reach) in enumerate(bodies[: len(self.vehicles)]):
            for other, other_x, other_y, other_reach in bodies[i + 1 :]:
                if not math.hypot(other_x - x, other_y - y) > reach + other_reach:
                    vehicle.handle_collisions(other)

    def leader(self, me: Driver, lane_index: Any) -> Any:
        """The nearest car or pedestrian ahead of a driver on a lane and on its path, or ``None``.

        highway-env's test for being on a curved lane takes in cars that wait beside the curve.
        """
        network = self.network
        lane = network.get_lane(lane_index)
        nearest, front = math.inf, None
        s = lane.local_coordinates(me.position)[0]
        for other in (*self.vehicles, *self.objects):
            if other is me or not network.may_hold(lane_index, *other.position.tolist(), 1.0):
                continue
            ahead, beside = lane.local_coordinates(other.position)
            if s <= ahead <= nearest and lane.on_lane(other.position, ahead, beside, margin=1.0):
                nearest, front = ahead, other
        if front is not None:
            along, lateral = me.plan.project(*front.position.tolist())
            if along < me.s or abs(lateral) > (me.WIDTH + front.WIDTH) / 2 + 0.8:
                return None
        return front

    def limit_for(self, me: Driver) -> float:
        """The acceleration that leaders on the route and right of way allow, in m/s2."""
        limit, line = math.inf, me.plan.stop_line
        before_line = me.s + CAR_LENGTH / 2 <= line
        near = before_line and me.s > line - _LOOK_AHEAD and me.gives_way
        stop_distance = line - _STOP_MARGIN - CAR_LENGTH / 2 - me.s
        # A car that can still stop before the line itself is not committed, though past the margin.
        room = max(line - CAR_LENGTH / 2 - me.s, 0.0)
        committed = me.speed**2 / (2 * _READY_BRAKING) > room
        must_stop = near and not committed and me.plan.origin in self.halted
        for other in self.vehicles:
            if other is me:
                continue
            distance = _distance_ahead(me, other)
            if distance is not None:
                limit = min(limit, _follow(me, distance, other.speed))
            elif near and not committed and not must_stop:
                must_stop = self._must_yield(me, other)
        for person in self.objects:
            s, lateral = me.plan.project(*person.position.tolist())
            if 0.0 < s - me.s < _LOOK_AHEAD and abs(lateral) < person.clearance():
                # A pedestrian's centre is nearer to its edge than a car's, which IDM reckons with.
                limit = min(limit, _follow(me, s - me.s + CAR_LENGTH / 2 - 1.0, 0.0))
        for obstacle in self.obstacles:
            distance = _distance_to(me, obstacle)
            if distance is not None:
                limit = min(limit, _follow(me, distance, 0.0))
        if must_stop:
            limit = min(limit, _follow(me, stop_distance + CAR_LENGTH + 2.0, 0.0))
        return limit

    def _must_yield(self, me: Driver, other: Any) -> bool:
        has_priority = me.plan.priority > other.plan.priority
        if isinstance(other, Ego) and self.courtesy == "none" and has_priority:
            return False
        meeting = conflict(me.plan, other.plan)
        if meeting is None:
            return False
        mine_in, mine_out, other_in, other_out = meeting
        line = other.plan.stop_line
        if other.s - CAR_LENGTH / 2 > other_out or other.s < line - _LOOK_AHEAD:
            return False
        inside = other.s + CAR_LENGTH / 2 > line
        if not inside and other.plan.priority <= me.plan.priority:
            return False
        if not inside and (other.speed < 0.5 or other.plan.origin in self.halted):
            return False
        arrive = _time_to(me, mine_in - CAR_LENGTH / 2)
        leave = _time_to(me, mine_out + CAR_LENGTH / 2)
        speed = max(other.speed, 3.0) if inside else max(other.speed, 6.0)
        other_arrives = (other_in - CAR_LENGTH / 2 - other.s) / speed
        other_leaves = (other_out + CAR_LENGTH / 2 - other.s) / speed
        return bool(arrive - _MARGIN < other_leaves and other_arrives < leave + _MARGIN)


def _time_to(me: Driver, s: float) -> float:
    """Seconds until ``s`` if the driver goes now, accelerating at 2 m/s2 to a comfortable speed."""
    distance: float = s - me.s
    if distance <= 0.0:
        return 0.0
    speed: float = max(me.speed, 0.0)
    top, rate = _COMFORT_SPEED, 2.0
    if speed >= top:
        return distance / speed
    ramp = (top * top - speed * speed) / (2 * rate)
    if distance <= ramp:
        return (math.sqrt(speed * speed + 2 * rate * distance) - speed) / rate
    return (top - speed) / rate + (distance - ramp) / top


def _distance_ahead(me: Any, other: Any) -> float | None:
    """Metres between centres if ``other`` is ahead of ``me`` on its route, else ``None``."""
    if other.plan.origin == me.plan.origin:
        same = other.plan is me.plan
        shared = me.plan.length if same else me.plan.stop_line + 8.0
        if other.s > me.s and other.s < shared:
            return float(other.s - me.s)
    if other.plan.destination == me.plan.destination:
        left, other_left = me.plan.length - me.s, other.plan.length - other.s
        behind = me.s > me.plan.stop_line - 5.0
        if other_left < left and other.s > other.plan.exit - 6.0 and behind:
            return float(left - other_left)
    return None


def _distance_to(me: Driver, obstacle: Standing) -> float | None:
    """Metres to an obstacle in the way of ``me``, as between the centres of two cars."""
    s, lateral = me.plan.project(*obstacle.position.tolist())
    if not 0.0 < s - me.s < _LOOK_AHEAD:
        return None
    turned = float(obstacle.heading) - me.plan.heading_at(s)
    along, across = abs(math.cos(turned)), abs(math.sin(turned))
    half_length, half_width = obstacle.LENGTH / 2, obstacle.WIDTH / 2
    beside = me.WIDTH / 2 + half_width * along + half_length * across + _PASSING
    if abs(lateral) >= beside:
        return None
    return s - me.s - half_length * along - half_width * across + CAR_LENGTH / 2


def _follow(me: Driver, distance: float, speed: float) -> float:
    """IDM interaction with a leader at ``distance`` metres between centres, in m/s2."""
    rate = math.sqrt(-me.COMFORT_ACC_MAX * me.COMFORT_ACC_MIN)
    gap = me.DISTANCE_WANTED + me.speed * me.TIME_WANTED
    gap += me.speed * (me.speed - speed) / (2 * rate)
    free = 1.0 - (max(me.speed, 0.0) / me.plan.road.speed_limit) ** me.DELTA
    return float(me.COMFORT_ACC_MAX * (free - (max(gap, 0.0) / max(distance, 0.1)) ** 2))


def standing(road: Road, arm: Arm, part: Part) -> Standing:
    """The body of an obstacle, or of a part of one, on or beside an arm."""
    x, y, heading = placed(arm, part.offset, part.beside)
    body = Standing(road, np.array([x, y]), heading, part.size)
    body.body_id = part.id
    return body


def walker(road: Road, body_id: str, arm: Arm, offset: float, side: str) -> Pedestrian:
    """A pedestrian at the kerb of an arm, about to cross it ``offset`` m out from the stop line.

    ``side`` is where it comes from, seen by a driver on that arm who nears the junction.
    """
    x, y, heading = kerb(arm, offset, side)
    person = Pedestrian(road, np.array([x, y]), heading, 0.0)
    person.body_id = body_id
    person.distance = crossing_length(arm)
    return person


def cyclist(road: Road, arm: Arm, start: CyclistStart) -> Cyclist:
    """A cyclist as far before the kerb of an arm as it starts."""
    x, y, heading = kerb(arm, start.offset, start.side)
    back = start.approach * np.array([math.cos(heading), math.sin(heading)])
    body = Cyclist(road, np.array([x, y]) - back, heading, 0.0)
    body.body_id = start.id
    body.distance = crossing_length(arm) + start.approach
    return body


def lane_network(road: Geometry) -> LaneNetwork:
    """highway-env's lanes of a road; for the built-in four-way junction, its own to the last bit.

    Nodes are ``o0`` (the outer end of arm 0), ``ir0`` (its stop line) and ``il0`` (where it is
    left for the outer end); where a way across is more than one lane, further ones lie between.
    """
    network = RoadNetwork()
    for number in range(len(road.arms)):
        arm, frame = road.arms[number], _rotation(road.arms[number].angle)
        if road.destinations(number):
            start = frame @ np.array([arm.offset, arm.length + arm.stop_line])
            end = frame @ np.array([arm.offset, arm.stop_line])
            lane = _straight(arm, start, end, arm.priority, road.speed_limit)
            network.add_lane(f"o{number}", f"ir{number}", lane)
        ways = [way for way in routes_of(road) if way.origin == number]
        # Right, left and straight on, as highway-env has them.
        for way in sorted(ways, key=lambda way: ("right", "left", "straight").index(way.turn)):
            _add_way(network, way)
        before = (number - 1) % len(road.arms)
        if road.arms[before].lanes != "in":
            _add_exit(network, road, before)
    return LaneNetwork(network)


def _rotation(angle: float) -> NDArray[np.float64]:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def _straight(arm: Arm, start: Any, end: Any, priority: int, limit: float) -> StraightLane:
    return StraightLane(start, end, width=arm.lane_width, priority=priority, speed_limit=limit)


def _add_exit(network: RoadNetwork, road: Geometry, number: int) -> None:
    """Add the lane that leaves on an arm, in the frame of the arm a quarter farther on."""
    arm = road.arms[number]
    frame = _rotation(math.radians((arm.bearing - 90.0) % 360.0))
    outer = frame @ np.array([arm.length + arm.stop_line, arm.offset])
    inner = frame @ np.array([arm.stop_line, arm.offset])
    lane = _straight(arm, inner, outer, arm.priority, road.speed_limit)
    network.add_lane(f"il{number}", f"o{number}", lane)


def _add_way(network: RoadNetwork, way: Route) -> None:
    """Add the lanes from a stop line to where an arm is left: straight, an arc, straight."""
    arm, curve, limit = way.arm, way.curve, way.road.speed_limit
    frame, last = _rotation(arm.angle), f"il{way.destination}"
    at = [f"ir{way.origin}", f"{way.origin}-{way.destination}a", f"{way.origin}-{way.destination}b"]
    begins = np.array([arm.offset, arm.stop_line])
    if not curve.turned:
        end = frame @ np.array([arm.offset, arm.stop_line - curve.length])
        lane = _straight(arm, frame @ begins, end, way.priority, limit)
        network.add_lane(at[0], last, lane)
        return
    node = at[0]
    if curve.lead:
        turns = begins - np.array([0.0, curve.lead])
        lane = _straight(arm, frame @ begins, frame @ turns, way.priority, limit)
        network.add_lane(node, at[1], lane)
        node, begins = at[1], turns
    right = curve.turned > 0.0
    side = curve.radius if right else -curve.radius
    phase = math.pi if right else 0.0
    lane = CircularLane(
        frame @ (begins + np.array([side, 0.0])),
        curve.radius,
        arm.angle + phase,
        arm.angle + (phase + curve.turned),
        clockwise=right,
        width=arm.lane_width,
        priority=way.priority,
        speed_limit=limit,
    )
    network.add_lane(node, at[2] if curve.tail else last, lane)
    if curve.tail:
        x, y, _ = way.pose(np.array([way.exit - curve.tail, way.exit]))
        start, end = np.array([x[0], y[0]]), np.array([x[1], y[1]])
        network.add_lane(at[2], last, _straight(arm, start, end, way.priority, limit))
