"""A scenario of OpenSCENARIO as a world at our junction, for given values of its parameters."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from pytest_dura.driving.junction import ARM_LENGTH, ARMS, SPEED_LIMIT
from pytest_dura.driving.openscenario.document import Element
from pytest_dura.driving.openscenario.parameters import Parameters
from pytest_dura.driving.openscenario.place import LANE_WIDTH, Frame, Pose, Spot, turn_between
from pytest_dura.driving.openscenario.roads import RoadNetwork

Remark = Callable[[Element, str], None]

_EGO = re.compile(r"ego([_ ]?(vehicle|car))?|hero", re.IGNORECASE)
_OBSTACLES = {"trafficIsland": "island", "obstacle": "cones", "barrier": "cones"}
_ASIDE, _TURNED = 0.25, 0.1
"""m and rad by which a place may be off without a remark."""
_TIME = ("ConditionGroup", "Condition", "ByValueCondition", "SimulationTimeCondition")
_KERB = LANE_WIDTH + 1.0
"""m from the road's middle to where our pedestrians begin and end."""


@dataclass
class Entity:
    """An entity of the file.

    Args:
        element: Its ScenarioObject.
        name: Its name.
        kind: ``Vehicle``, ``Pedestrian``, ``MiscObject`` or ``""`` for anything else.
        body: The element of that kind.
        ahead: Metres from its reference point, for vehicles the rear axle, to its middle.
        pose: Of its reference point at the start.
        placed: The element that says so.
        speed: In m/s.
        route_end: Where its route ends.
    """

    element: Element
    name: str
    kind: str
    body: Element | None
    ahead: float = 0.0
    pose: Pose | None = None
    placed: Element | None = None
    speed: float | None = None
    moving: Element | None = None
    route_end: Pose | None = None
    routed: Element | None = None

    @property
    def middle(self) -> Pose:
        """Pose of its middle."""
        assert self.pose is not None
        return self.pose.moved(self.ahead)


@dataclass
class World:
    """What of a file is a scenario of ours.

    Args:
        data: The world.
        duration: Seconds, if the file says so.
        ids: Our id of each entity.
    """

    data: dict[str, Any]
    duration: float | None
    ids: dict[str, str] = field(default_factory=dict)


def world_of(
    root: Element,
    parameters: Parameters,
    *,
    frame: Frame,
    network: RoadNetwork | None,
    remark: Remark,
) -> World:
    """Map a scenario.

    Args:
        root: The outermost element of the file.
        parameters: Values of its parameters.
        frame: Where our junction lies in it; ``south`` is found here.
        network: Its roads, if they are known.
        remark: Takes elements that are used, but not just as they are.

    Raises:
        ConfigurationError: For a file without an ego that has a place on one of the arms.
    """
    return _Mapping(root, parameters, frame, network, remark).world()


class _Mapping:
    def __init__(
        self,
        root: Element,
        parameters: Parameters,
        frame: Frame,
        network: RoadNetwork | None,
        remark: Remark,
    ) -> None:
        self.root, self.parameters, self.frame, self.remark = root, parameters, frame, remark
        self.network = network
        self.entities: dict[str, Entity] = {}
        self.ids: dict[str, str] = {}

    def world(self) -> World:
        self._read_entities()
        storyboard = self.root.find("Storyboard")
        if storyboard is None:
            self.root.refuse("the file has no Storyboard", expected="a scenario")
        self._read_init(storyboard)
        ego = self._ego()
        if ego.pose is None:
            ego.element.refuse(
                f"{ego.name!r} has no place that can be mapped",
                key="Storyboard.Init",
                expected="a TeleportAction to a place in the world, or on a road that can be read",
                remedy="put the road network where LogicFile says, or export places in the world",
            )
        spot = self.frame.spot(ego.middle)
        self.frame = replace(self.frame, south=spot.arm)
        data: dict[str, Any] = {"ego": self._ego_start(ego), "traffic": None}
        for key in ("vehicles", "pedestrians", "obstacles"):
            data[key] = []
        for entity in self.entities.values():
            if entity is not ego:
                self._add(entity, storyboard, data)
        return World({key: data[key] for key in data if data[key]}, self._duration(storyboard),
                     self.ids)  # fmt: skip

    def _read_entities(self) -> None:
        entities = self.root.find("Entities")
        for element in entities.all("ScenarioObject") if entities else []:
            name = element.require("name")
            kind = next((k for k in ("Vehicle", "Pedestrian", "MiscObject") if element.find(k)), "")
            body = element.find(kind) if kind else None
            entity = Entity(element, name, kind, body)
            if body is not None:
                body.get("name")
                centre = body.find("BoundingBox", "Center")
                if centre is not None:
                    entity.ahead = self.parameters.number(centre, "x")
                    centre.get("z")
                    if self.parameters.number(centre, "y", 0.0) != 0.0:
                        self.remark(centre, "y is left out: its middle is on its axis")
            elif (reference := element.find("CatalogReference")) is not None:
                entity.kind = self._kind_of_catalogue(reference)
            if name in self.entities:
                element.refuse(f"two entities are called {name!r}", key="Entities")
            self.entities[name] = entity

    def _kind_of_catalogue(self, reference: Element) -> str:
        """Tell the kind of an entity of a catalogue, which is not read, by the catalogue's name."""
        catalogue = (reference.get("catalogName") or "").lower()
        kind = "Pedestrian" if "pedestrian" in catalogue else "Vehicle"
        kind = "" if "misc" in catalogue else kind
        read = f"a {kind.lower()} whose middle is its reference point" if kind else "nothing"
        self.remark(reference, f"catalogues are not read: {read}, by the name of the catalogue")
        return kind

    def _read_init(self, storyboard: Element) -> None:
        actions = storyboard.find("Init", "Actions")
        waiting = [
            (self._entity(private), action)
            for private in (actions.all("Private") if actions else [])
            for action in private.all("PrivateAction")
        ]
        # A relative position or speed may refer to an entity that comes later in the file.
        before = len(waiting) + 1
        while before > len(waiting):
            before = len(waiting)
            waiting = [pair for pair in waiting if not self._take(*pair)]

    def _entity(self, private: Element) -> Entity:
        name = self.parameters.text(private, "entityRef")
        if name not in self.entities:
            private.refuse(
                f"there is no entity {name!r}",
                key="entityRef",
                expected=", ".join(self.entities) or "an entity",
            )
        return self.entities[name]

    def _take(self, entity: Entity, action: Element) -> bool:
        """Take an init action; whether that is done."""
        if (position := action.find("TeleportAction", "Position")) is not None:
            entity.pose, entity.placed = self._pose(position), position
            return entity.pose is not None
        if (speed := action.find("LongitudinalAction", "SpeedAction")) is not None:
            entity.speed, entity.moving = self._speed(speed), speed
            return entity.speed is not None
        for path in (
            ("AssignRouteAction", "Route"),
            ("AcquirePositionAction", "Position"),
            ("FollowTrajectoryAction", "Trajectory", "Shape", "Polyline"),
            ("FollowTrajectoryAction", "TrajectoryRef", "Trajectory", "Shape", "Polyline"),
        ):
            if (routed := action.find("RoutingAction", *path)) is not None:
                entity.routed, end = routed, self._last_position(routed)
                entity.route_end = None if end is None else self._pose(end)
                return entity.route_end is not None
        return True

    @staticmethod
    def _last_position(routed: Element) -> Element | None:
        points = [*routed.all("Waypoint"), *routed.all("Vertex")]
        for point in points:
            point.get("routeStrategy")
        positions = [place for point in points if (place := point.find("Position")) is not None]
        if routed.tag == "Position":
            return routed
        return positions[-1] if positions else None

    def _pose(self, position: Element) -> Pose | None:
        given = position.kind("Position")
        if given is None:
            position.refuse("a position says where", key="Position", expected="a WorldPosition")
        number = self.parameters.number
        if given.tag == "WorldPosition":
            for name in ("z", "p", "r"):
                if given.attributes.get(name) is not None and number(given, name) != 0.0:
                    self.remark(given, f"{name} is left out: the road is flat")
            return Pose(number(given, "x"), number(given, "y"), number(given, "h", 0.0))
        if given.tag in ("LanePosition", "RoadPosition"):
            return self._road_pose(given)
        if given.tag not in ("RelativeWorldPosition", "RelativeObjectPosition"):
            return None
        other = self.entities.get(self.parameters.text(given, "entityRef"))
        if other is None or other.pose is None:
            given.used = False
            return None
        dx, dy = number(given, "dx", 0.0), number(given, "dy", 0.0)
        if number(given, "dz", 0.0) != 0.0:
            self.remark(given, "dz is left out: the road is flat")
        if given.tag == "RelativeObjectPosition":
            return self._oriented(given, other.pose.moved(dx, dy))
        return self._oriented(given, Pose(other.pose.x + dx, other.pose.y + dy, other.pose.heading))

    def _road_pose(self, given: Element) -> Pose | None:
        """Find a place on the road network, where that is read."""
        if self.network is None:
            return None
        text, number = self.parameters.text, self.parameters.number
        s = number(given, "s")
        if given.tag == "RoadPosition":
            pose = self.network.at(text(given, "roadId"), s, number(given, "t"))
        else:
            lane, offset = text(given, "laneId"), number(given, "offset", 0.0)
            pose = self.network.on_lane(text(given, "roadId"), lane, s, offset)
        if pose is None:
            self.remark(given, "there is no such place on a straight or an arc of the road network")
            return None
        return self._oriented(given, pose)

    def _oriented(self, given: Element, pose: Pose) -> Pose:
        orientation = given.find("Orientation")
        if orientation is None:
            return pose
        turn = self.parameters.number(orientation, "h", 0.0)
        absolute = orientation.get("type") == "absolute"
        return replace(pose, heading=turn if absolute else pose.heading + turn)

    def _speed(self, action: Element) -> float | None:
        dynamics = action.find("SpeedActionDynamics")
        if dynamics is not None:
            shape, length = dynamics.get("dynamicsShape"), dynamics.attributes.get("value", "0")
            dynamics.get("dynamicsDimension")
            dynamics.get("value")
            if shape != "step":
                self.remark(
                    dynamics, f"the speed holds from the start on, not after {shape} of {length}"
                )
        if (target := action.find("SpeedActionTarget", "AbsoluteTargetSpeed")) is not None:
            return self.parameters.number(target, "value")
        target = action.find("SpeedActionTarget", "RelativeTargetSpeed")
        if target is None:
            return None
        other = self.entities.get(self.parameters.text(target, "entityRef"))
        if other is None or other.speed is None:
            target.used = False
            return None
        value = self.parameters.number(target, "value")
        target.get("continuous")
        factor = target.get("speedTargetValueType") == "factor"
        return other.speed * value if factor else other.speed + value

    def _ego(self) -> Entity:
        vehicles = [each for each in self.entities.values() if each.kind == "Vehicle"]
        if not vehicles:
            self.root.refuse("the file has no vehicle", key="Entities", expected="an ego")
        named = [each for each in vehicles if _EGO.fullmatch(each.name)]
        if not named:
            self.remark(vehicles[0].element, "no entity is called ego: the first vehicle is it")
        return (named or vehicles)[0]

    def _ego_start(self, ego: Entity) -> dict[str, Any]:
        spot = self.frame.spot(ego.middle)
        assert ego.placed is not None
        if not spot.on_lane or abs(spot.turned) > math.pi / 4:
            ego.placed.refuse(
                f"{ego.name!r} is on no lane towards our junction",
                key="Position",
                found=_off(spot),
                expected="the right lane of an arm, 4 m wide, towards the centre",
                remedy="say where the junction lies: --set junction=X,Y or X,Y,HEADING",
            )
        self._check_category(ego)
        self._say_off(ego, spot)
        return {
            "distance": self._within(ego.placed, spot.out, 5.1, 95.0, "m before its stop line"),
            "speed": self._speed_of(ego),
            "turn": self._turn(ego, spot),
        }

    def _add(self, entity: Entity, storyboard: Element, data: dict[str, Any]) -> None:
        if entity.pose is None or entity.placed is None:
            self.remark(entity.element, "left out: it has no place that can be mapped")
            return
        spot = self.frame.spot(entity.middle)
        if spot.out < 0.0:
            self.remark(
                entity.placed, f"{entity.name!r} is left out: it begins inside the junction"
            )
        elif entity.kind == "Pedestrian":
            self._add_pedestrian(entity, storyboard, spot, data)
        elif entity.kind == "MiscObject" or (entity.kind == "Vehicle" and not spot.on_lane):
            self._add_obstacle(entity, spot, data)
        elif entity.kind == "Vehicle":
            self._add_vehicle(entity, spot, data)
        else:
            self.remark(entity.element, "left out: neither vehicle, pedestrian nor obstacle")

    def _add_vehicle(self, entity: Entity, spot: Spot, data: dict[str, Any]) -> None:
        assert entity.placed is not None
        if abs(spot.turned) > math.pi / 4:
            self.remark(entity.placed, f"{entity.name!r} is left out: {_off(spot)}")
            return
        self._check_category(entity)
        self._say_off(entity, spot)
        vehicle: dict[str, Any] = {"id": self._id(entity), "arm": ARMS[spot.arm]}
        vehicle["turn"], vehicle["speed"] = self._turn(entity, spot), self._speed_of(entity)
        if spot.out > ARM_LENGTH - 1.0:
            if not vehicle["speed"]:
                self.remark(entity.placed, f"{entity.name!r} is left out: it stands off our arms")
                return
            vehicle["enters"] = _rounded((spot.out - ARM_LENGTH) / vehicle["speed"])
        else:
            vehicle["distance"] = self._within(
                entity.placed, spot.out, 3.0, 99.0, "m before its stop line"
            )
        data["vehicles"].append(vehicle)

    def _add_pedestrian(
        self, entity: Entity, storyboard: Element, spot: Spot, data: dict[str, Any]
    ) -> None:
        assert entity.placed is not None
        start, speed = 0.0, entity.speed or 0.0
        if not speed:
            start, speed = self._set_off(entity, storyboard) or (0.0, 0.0)
        if not speed:
            self.remark(entity.placed, f"{entity.name!r} is left out: it never walks")
            return
        side = "right" if spot.beside > 0.0 else "left"
        across = spot.turned - (math.pi / 2 if side == "right" else -math.pi / 2)
        if abs((across + math.pi) % (2 * math.pi) - math.pi) > math.pi / 4:
            self.remark(entity.placed, f"{entity.name!r} crosses the arm at a right angle here")
        lead = (abs(spot.beside) - _KERB) / speed
        if start + lead < 0.0:
            self.remark(entity.placed, f"{entity.name!r} begins at the kerb, {_KERB:g} m aside")
        data["pedestrians"].append({
            "id": self._id(entity), "arm": ARMS[spot.arm], "side": side,
            "offset": self._within(entity.placed, spot.out, 1.0, 60.0, "m from the stop line"),
            "start": _rounded(max(0.0, start + lead)),
            "speed": self._within(entity.placed, speed, 0.1, 3.0, "m/s"),
        })  # fmt: skip

    def _set_off(self, entity: Entity, storyboard: Element) -> tuple[float, float] | None:
        """Find time and speed of the only event that lets an entity walk off at a time."""
        for story in storyboard.children:
            for group in [g for act in story.children for g in act.children]:
                actors = [e.attributes.get("entityRef") for a in group.children for e in a.children]
                events = [
                    event
                    for maneuver in group.children
                    for event in maneuver.children
                    if event.tag == "Event"
                ]
                if group.tag != "ManeuverGroup" or entity.name not in actors or len(events) != 1:
                    continue
                action = ("Action", "PrivateAction", "LongitudinalAction", "SpeedAction")
                speed = events[0].find(*action, "SpeedActionTarget", "AbsoluteTargetSpeed")
                time = events[0].find("StartTrigger", *_TIME)
                if speed is None or time is None:
                    continue
                for element in (story, *story.children, group, *group.children):
                    element.used = element.used or _holds(element, events[0])
                moving = events[0].find(*action)
                assert moving is not None
                walking = self._speed(moving)
                assert walking is not None
                return self._time(events[0], ("StartTrigger", *_TIME)), walking
        return None

    def _add_obstacle(self, entity: Entity, spot: Spot, data: dict[str, Any]) -> None:
        assert entity.placed is not None
        kind = "parked_car"
        if entity.kind == "Vehicle" and (entity.speed or abs(spot.beside) > 15.0 or spot.out > 99):
            self.remark(entity.placed, f"{entity.name!r} is left out: {_off(spot)}")
            return
        if entity.kind == "MiscObject":
            assert entity.body is not None
            category = entity.body.get("miscObjectCategory") or "none"
            if category not in _OBSTACLES or abs(spot.beside) > 15.0 or spot.out > 99.0:
                self.remark(entity.element, f"left out: {category} {_off(spot)}")
                return
            kind = _OBSTACLES[category]
        self.remark(entity.element, f"stands as {kind}, of that one's size, along the arm")
        data["obstacles"].append({
            "id": self._id(entity), "kind": kind, "arm": ARMS[spot.arm],
            "offset": _rounded(spot.out), "beside": _rounded(spot.beside),
        })  # fmt: skip

    def _check_category(self, entity: Entity) -> None:
        if entity.body is None:
            return
        category = entity.body.get("vehicleCategory")
        if category != "car":
            self.remark(entity.body, f"a {category} is a car here, 5 m long and 2 m wide")

    def _say_off(self, entity: Entity, spot: Spot) -> None:
        assert entity.placed is not None
        if abs(spot.aside) > _ASIDE:
            self.remark(
                entity.placed,
                f"{entity.name!r} begins in the middle of its lane, which is "
                f"{abs(spot.aside):.2f} m to its {'left' if spot.aside > 0 else 'right'}",
            )
        if abs(spot.turned) > _TURNED:
            self.remark(
                entity.placed,
                f"{entity.name!r} begins along its lane, from which it was turned by "
                f"{spot.turned:.2f} rad",
            )

    def _turn(self, entity: Entity, spot: Spot) -> str:
        if entity.route_end is None:
            self.remark(entity.element, f"{entity.name!r} has no route: it goes straight on")
            return "straight"
        turn = turn_between(spot.arm, self.frame.spot(entity.route_end))
        if turn is None:
            assert entity.routed is not None
            self.remark(entity.routed, "the route ends on no other arm: it goes straight on")
        return turn or "straight"

    def _speed_of(self, entity: Entity) -> float:
        if entity.speed is None or entity.moving is None:
            self.remark(entity.element, f"{entity.name!r} has no speed: it begins at 0 m/s")
            return 0.0
        return self._within(entity.moving, entity.speed, 0.0, SPEED_LIMIT, "m/s")

    def _within(self, where: Element, value: float, low: float, high: float, unit: str) -> float:
        if low <= value <= high:
            return _rounded(value)
        near = min(max(value, low), high)
        self.remark(
            where,
            f"{value:g} {unit} is outside of what there is, {low:g} to {high:g}: it is {near:g}",
        )
        return near

    def _duration(self, storyboard: Element) -> float | None:
        time = storyboard.find("StopTrigger", *_TIME)
        return None if time is None else self._time(storyboard, ("StopTrigger", *_TIME))

    def _time(self, element: Element, path: tuple[str, ...]) -> float:
        """Return when the condition on the simulated time at a path holds, with its delay."""
        condition, time = element.find(*path[:-2]), element.find(*path)
        assert condition is not None
        assert time is not None
        if (time.get("rule") or "").startswith("less"):
            time.refuse(
                "this condition holds before a time, not from then on",
                key="SimulationTimeCondition.rule",
                found=time.attributes["rule"],
                expected="greaterThan, greaterOrEqual or equalTo",
            )
        delay = self.parameters.number(condition, "delay", 0.0)
        return self.parameters.number(time, "value") + delay

    def _id(self, entity: Entity) -> str:
        name = re.sub(r"[^A-Z0-9_]", "_", entity.name.upper())
        if not re.match(r"[A-Z]", name) or re.fullmatch(r"[RSV][0-9]+|EGO", name):
            name = f"X_{name}"
        name, number = name[:16], 2
        while name in self.ids.values():
            name, number = f"{name[:12]}_{number}", number + 1
        if name != entity.name.upper():
            self.remark(entity.element, f"is called {name} here")
        self.ids[entity.name] = name
        return name


def _holds(element: Element, inner: Element) -> bool:
    return element is inner or any(_holds(child, inner) for child in element.children)


def _off(spot: Spot) -> str:
    return (
        f"{spot.out:.1f} m from the stop line, {spot.beside:.1f} m right of the road's middle, "
        f"turned by {spot.turned:.2f} rad from the way to the junction"
    )


def _rounded(value: float) -> float:
    return round(value, 4) + 0.0
