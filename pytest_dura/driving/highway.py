"""JunctionSimulator: one junction, whatever drives the other cars; on highway-env here.

HighwaySimulator steps highway-env's road directly: no observation table, no rewards, no spawning
that the scenario did not ask for, and none of highway-env's class-level settings is touched.
"""

from __future__ import annotations

import copy
import math
import re
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.percepts import Percept
from pytest_dura.core.seeding import stream
from pytest_dura.core.simulator import POSE, Line, Scene, Simulator, Tracks
from pytest_dura.core.state import Tick
from pytest_dura.driving import camera, explanations, outlines, signals
from pytest_dura.driving.bodies import (
    CAR_LENGTH,
    CAR_WIDTH,
    COLUMNS,
    CYCLIST_LENGTH,
    NO_BODIES,
    VX,
    VY,
    BodyList,
    box_gap,
    boxes_overlap,
)
from pytest_dura.driving.criticality import near_miss_events
from pytest_dura.driving.lanes import Route
from pytest_dura.driving.maneuvers import Command, Maneuver, acceleration_for
from pytest_dura.driving.measures import MEASURES
from pytest_dura.driving.moving import placed
from pytest_dura.driving.percepts import own_pose, own_speed, plausible_objects
from pytest_dura.driving.roads import Road
from pytest_dura.driving.scenario import (
    CyclistStart,
    DrivingWorld,
    PedestrianStart,
    check_road,
    drawn_arrivals,
    given_arrivals,
    has_room,
    in_order,
    without_room,
)
from pytest_dura.driving.sensors import (
    CHANNEL_ALIASES,
    EgoState,
    channels,
    route_map,
    signs,
)
from pytest_dura.driving.signals import HINDSIGHT
from pytest_dura.driving.traffic_rules import NOT_A_CAR

STANDING = 0.5
"""m/s; slower counts as standing."""


@dataclass(frozen=True)
class Contact:
    """The ego's first contact. All contacts are collisions; ``code`` tells them apart.

    ``code`` is 1 where the ego ran into the other, 2 where the other ran into the ego, and 3 where
    it did so while the ego stood. Who ran into whom is decided by whose speed along the line
    between the two centres was greater. ``side`` is the ego's.
    """

    partner: str
    side: str
    speed: float
    partner_speed: float
    in_conflict_zone: bool
    code: int

    def describe(self) -> str:
        """One line for events and messages."""
        how = {1: "ran into", 2: "was struck by", 3: "was struck while standing by"}[self.code]
        zone = "inside" if self.in_conflict_zone else "outside"
        return (
            f"the ego ({self.speed:.1f} m/s) {how} {self.partner} ({self.partner_speed:.1f} m/s), "
            f"contact on its {self.side}, {zone} the conflict zone"
        )


def _attribute_contact(ego: Any, before: EgoState, road: Any, route: Route) -> Contact:
    """The contact that has just crashed the ego; ``before`` is its state one step earlier."""
    box = np.array([[*ego.position, ego.heading, ego.LENGTH, ego.WIDTH]])
    bodies = (*road.vehicles, *road.objects, *road.obstacles)
    crashed = [b for b in bodies if b is not ego and b.crashed]
    partner = min(crashed, key=lambda b: (_gap(box, b), b.body_id))
    offset = partner.position - ego.position
    distance = max(float(np.linalg.norm(offset)), 1e-6)
    line = offset / distance
    towards = before.speed * float(ego.direction @ line)
    approach = -float(partner.velocity @ line)
    standing = abs(before.speed) < STANDING
    code = 1 if towards >= approach and not standing else 3 if standing else 2
    angle = math.atan2(
        ego.direction[0] * offset[1] - ego.direction[1] * offset[0], float(ego.direction @ offset)
    )
    half = CAR_LENGTH / 2
    inside = before.s + half > route.stop_line and before.s - half < route.exit
    return Contact(partner.body_id, _side(angle), before.speed, float(partner.speed), inside, code)


def _gap(box: Any, body: Any) -> float:
    other = np.array([[*body.position, body.heading, body.LENGTH, body.WIDTH]])
    return float(box_gap(box, other)[0])


def _side(angle: float) -> str:
    """Side of an angle from straight ahead; y is south, so positive is to the right."""
    if abs(angle) < math.pi / 4:
        return "front"
    if abs(angle) > 3 * math.pi / 4:
        return "rear"
    return "right" if angle > 0 else "left"


EGO = "EGO"

Row = tuple[float, float, float, float]


def _junction_scene(ticks: Sequence[Tick], percepts: Sequence[Percept], route: Route) -> Scene:
    """The junction with all its bodies, one pose per tick.

    Percepts are shown as the roles read them, see ``pytest_dura.driving.percepts``.
    """
    egos = [tick.truth["ego"] for tick in ticks]
    truth = _tracks(
        [(ego.x, ego.y, ego.heading, ego.speed) for ego in egos],
        [tick.truth["bodies"] for tick in ticks],
    )
    perceived = [(*own_pose(percept), own_speed(percept)) for percept in percepts]
    percept = _tracks(perceived, [plausible_objects(percept) for percept in percepts])
    planned = Line("route", route.grid[::4, 1:3].astype(np.float32))
    return Scene((*outlines.lines(route.road), planned), truth, percept, EGO)


def _tracks(egos: Sequence[Row], bodies: Sequence[BodyList]) -> Tracks:
    """Bodies by id. Of several with one id in one tick, as faults may bring them, each is shown."""
    columns = {EGO: 0}
    # The ids seldom change: many ticks at once are a fraction of the work.
    runs = [(ids, list(run)) for ids, run in groupby(bodies, key=lambda body: body.ids)]
    columns_of_runs = [
        [columns.setdefault(id_, len(columns)) for id_ in _distinct(ids)] for ids, _ in runs
    ]
    poses = np.full((len(bodies), len(columns), len(POSE)), np.nan, np.float32)
    poses[:, 0, :4] = egos
    poses[:, 0, 4:] = CAR_LENGTH, CAR_WIDTH
    first = 0
    for (ids, run), own_columns in zip(runs, columns_of_runs, strict=True):
        if ids:
            data = np.array([body_list.data for body_list in run])
            speed = np.hypot(data[:, :, VX], data[:, :, VY])
            rows = [data[:, :, :VX], speed[:, :, None], data[:, :, VY + 1 :]]
            poses[first : first + len(run), own_columns] = np.concatenate(rows, axis=2)
        first += len(run)
    return Tracks(tuple(columns), poses)


def _distinct(ids: tuple[str, ...]) -> tuple[str, ...]:
    """The ids, with a number behind one that comes again, or that is the ego's."""
    names: list[str] = []
    for id_ in ids:
        name, number = id_, 2
        while name in names or name == EGO:
            name, number = f"{id_} ({number})", number + 1
        names.append(name)
    return tuple(names)


_GOAL_DISTANCE = 25.0
"""Metres behind the junction at which the task is done, as in highway-env's ``has_arrived``."""
WRECK_TIME = 3.0
"""Seconds after which background cars that crashed into each other are cleared away."""
_REMOVED_AT = 80.0


class JunctionSimulator(Simulator):
    """Ego, traffic and pedestrians on the road that the scenario's ``world`` says.

    Actions are what :meth:`Command.of` accepts. See ``DrivingWorld`` for the world, and
    ``signals.NAMES`` for the signals. A subclass makes the road, with the drivers on it.
    """

    channel_aliases = CHANNEL_ALIASES

    def __init__(self) -> None:
        self._road: Any = None
        self._state: Any = None

    @classmethod
    def check_scenario(cls, world: Mapping[str, Any]) -> dict[str, Any]:
        """The world with all defaults filled in.

        Raises:
            pydantic.ValidationError: If the world is none of ours.
            ConfigurationError: If a route leaves the road, two bodies have one id, one has an id of
                random traffic, one that entered before the start has no room, or an obstacle stands
                where a car starts.
        """
        model = DrivingWorld.model_validate(dict(world))
        check_road(model)
        ids = ["EGO", *(v.id for v in model.vehicles), *(p.id for p in model.pedestrians)]
        ids += [cyclist.id for cyclist in model.cyclists]
        ids += [obstacle.id for obstacle in model.obstacles]
        twice = sorted({i for i in ids if ids.count(i) > 1})
        if twice:
            raise ConfigurationError(
                "two bodies of a scenario have the same id",
                key="world.vehicles",
                found=twice[0],
                expected="ids that are unique, and not EGO",
            )
        letters = "RS" if model.traffic is None else "RSV"
        reserved = next((i for i in ids if re.fullmatch(f"[{letters}][0-9]+", i)), None)
        if reserved is not None:
            raise ConfigurationError(
                "random traffic, radar returns and signs have ids of this form",
                key="world.vehicles",
                found=reserved,
                expected="an id that is not R or S, nor V beside random traffic, with a number",
            )
        absent = without_room(model, given_arrivals(model.vehicles, model.geometry))
        if absent:
            raise ConfigurationError(
                "a car that entered the road before the start has no room there",
                key="world.vehicles",
                found=absent[0],
                expected="14 m between the cars of an arm",
                remedy="let it enter earlier or later",
            )
        _check_obstacles(model)
        return model.model_dump(mode="json")

    def reset(self, scenario: Mapping[str, Any], seed: int) -> Tick:
        """Build the road and what the scenario puts on it at time 0."""
        world = DrivingWorld.model_validate(self.check_scenario(scenario.get("world", {})))
        geometry = world.geometry
        road = self._make_road(world, seed)
        self._road, self._index, self._dt = road, 0, self.time_step
        self._route = world.ego_route
        self._map, self._signs = route_map(self._route), signs(self._route)
        self._lights = {
            geometry.arm(a): signal for signal in world.controls.signals for a in signal.arms
        }
        self._light_states: dict[int, str] = {}
        self._contact: Contact | None = None
        self._background_crashes = 0
        self._wrecks: dict[str, float] = {}
        start = self._route.stop_line - world.ego.distance
        self._ego = self._place(EGO, self._route, start, world.ego.speed)
        for vehicle in world.vehicles:
            if vehicle.distance is not None:
                plan = vehicle.route(geometry)
                s = plan.stop_line - vehicle.distance
                driver = self._place(vehicle.id, plan, s, vehicle.speed, vehicle.exponent)
                driver.gives_way, driver.brakes_at = vehicle.gives_way, vehicle.brakes_at
        crossing: list[PedestrianStart | CyclistStart] = [*world.pedestrians, *world.cyclists]
        for person in crossing:
            body = self._make_walker(person)
            body.walking, body.start = person.speed, person.start
            road.objects.append(body)
        self._occlusion = world.occlusion
        self._kinds = {
            part.id: part.kind for obstacle in world.obstacles for part in obstacle.parts()
        }
        self._obstacle_rows = tuple(
            (
                *obstacle.position.tolist(),
                float(obstacle.heading),
                0.0,
                0.0,
                obstacle.LENGTH,
                obstacle.WIDTH,
            )
            for obstacle in road.obstacles
        )
        self._switch_lights()
        drawn = drawn_arrivals(world.traffic, seed, scenario.get("duration", 60.0), geometry)
        self._arrivals = in_order([*given_arrivals(world.vehicles, geometry), *drawn])
        self._admit(initially=True)
        self._state = self._observe_ego(0.0, self._ego.heading)
        _check_pose(self._state, self._route)
        return self._tick(())

    def step(self, action: Any) -> Tick:
        """Carry out a command for one time step."""
        before: EgoState = self._state
        self.drive(self._acceleration(action))
        events = self._collisions(before)
        self._clear()
        self._admit()
        self._state = self._observe_ego((self._ego.speed - before.speed) / self._dt, before.heading)
        return self._tick(events)

    def actuation(self, action: Command) -> Command:
        """The command with the acceleration that carries its maneuver out."""
        return Command(action.maneuver, self._acceleration(action))

    def _acceleration(self, action: Command) -> float:
        to_line = self._route.stop_line - self._state.front
        return acceleration_for(action, self._state.speed, to_line, self._map.speed_limit)

    def drive(self, acceleration: float) -> None:
        """Step the road alone: the ego at an acceleration in m/s2, the others as they decide.

        Nothing is sensed; the benchmarks measure it as bare stepping.
        """
        dt, time = self._dt, self._index * self._dt
        self._ego.actuate(acceleration, dt)
        for person in self._road.objects:
            person.walk(time, dt, self._road.vehicles)
        self._road.now, self._road.dt = time, dt
        self._road.act()
        self._road.step(dt)
        self._index += 1
        if self._lights:
            self._switch_lights()

    def _switch_lights(self) -> None:
        """Set the lights to their state now, which drivers heed at the next step."""
        now = self._index * self._dt
        self._light_states = {arm: light.state_at(now) for arm, light in self._lights.items()}
        halted = {arm for arm, state in self._light_states.items() if state != "green"}
        self._road.halted = frozenset(halted)
        if self._lights:
            self._signs = signs(self._route, self._light_states.get(self._route.origin, ""))

    def signals(self, ticks: Sequence[Tick]) -> dict[str, NDArray[np.float64]]:
        """The ground-truth signals; see ``pytest_dura.driving.signals``."""
        return signals.truth_signals(ticks, self._route, self._dt)

    def found_events(self, ticks: Sequence[Tick]) -> Sequence[tuple[int, str, str, str]]:
        """The near misses: which object, when and how near."""
        return near_miss_events(signals.encounters(ticks, self._dt))

    def percept_signals(self, percepts: Sequence[Percept]) -> dict[str, NDArray[np.float64]]:
        """The signals ``signals.PERCEPT_NAMES`` of each percept."""
        return signals.percept_signals(percepts)

    def account_measures(
        self,
        ticks: Sequence[Tick],
        percepts: Sequence[Percept],
        accounts: Sequence[Mapping[str, Any]],
    ) -> dict[str, NDArray[np.float64]]:
        """The measures ``explanations.MEANINGS`` of the component's accounts."""
        return explanations.account_measures(ticks, percepts, accounts, self._dt)

    measure_kinds = explanations.KINDS
    hindsight = HINDSIGHT
    measures = MEASURES

    def account_signals(
        self,
        ticks: Sequence[Tick],
        percepts: Sequence[Percept],
        accounts: Sequence[Mapping[str, Any]],
    ) -> dict[str, NDArray[np.float64]]:
        """The age of the decisions; see ``explanations.SIGNALS``."""
        return {"age": explanations.ages(ticks, accounts)}

    def scene(self, ticks: Sequence[Tick], percepts: Sequence[Percept]) -> Scene:
        """The junction from above."""
        return _junction_scene(ticks, percepts, self._route)

    def check_action(self, action: Any) -> Command:
        """A command; see :meth:`Command.of`."""
        return Command.of(action)

    def fallback_action(self) -> Command:
        """Keeping the speed, which is what the car does without a command."""
        return Command(Maneuver.PROCEED, 0.0)

    def describe_action(self, action: Command) -> str:
        """The maneuver's name, and the acceleration where it is asked for."""
        if action.acceleration is None:
            return action.maneuver.value
        return f"{action.maneuver.value} at {action.acceleration:.6g} m/s2"

    def render(self) -> NDArray[np.uint8]:
        """The third-person view."""
        return camera.third_person(self._state, self._solids(), self._route.road)

    def close(self) -> None:
        """Forget the road."""
        self._road = self._state = None

    @abstractmethod
    def _make_road(self, world: DrivingWorld, seed: int) -> Any:
        """Make the road without cars and pedestrians, with the obstacles of the world.

        It has ``vehicles``, ``objects`` (pedestrians), ``obstacles``, ``halted``, and ``act`` and
        ``step``, which move the cars and mark those that touch as ``crashed``.
        """

    @abstractmethod
    def _place(
        self, body_id: str, plan: Route, s: float, speed: float, exponent: float | None = None
    ) -> Any:
        """Put a car on the road, at ``s`` of its route: a driver, or without exponent the ego."""

    @abstractmethod
    def _make_walker(self, person: PedestrianStart | CyclistStart) -> Any:
        """Make a pedestrian at its kerb, or a cyclist before it.

        See :class:`~pytest_dura.driving.moving.Walking`.
        """

    def _admit(self, initially: bool = False) -> None:
        """Place the cars whose time has come and that have room; others wait outside, in order."""
        if not self._arrivals or self._arrivals[0][0] > self._index * self._dt:
            return
        now, waiting = self._index * self._dt, []
        for arrival in self._arrivals:
            time, body_id, plan, speed, exponent = arrival
            if time > now:
                waiting.append(arrival)
                continue
            s = arrival.start if initially else 0.0
            taken = [v.s for v in self._road.vehicles if v.plan.origin == plan.origin]
            if has_room(s, taken):
                self._place(body_id, plan, s, speed, exponent)
            elif not initially:
                waiting.append(arrival)
        self._arrivals = waiting

    def _clear(self) -> None:
        """Remove cars that have left, and wrecks after ``WRECK_TIME``."""
        now = self._index * self._dt
        gone = {i for i, since in self._wrecks.items() if now - since >= WRECK_TIME - 1e-9}
        self._road.vehicles = [
            v
            for v in self._road.vehicles
            if v is self._ego or (v.s < v.plan.exit + _REMOVED_AT and v.body_id not in gone)
        ]
        if gone:
            self._road.objects = [p for p in self._road.objects if p.body_id not in gone]

    def _collisions(self, before: EgoState) -> tuple[tuple[str, str, str], ...]:
        """Events of new crashes; a crash of background cars among themselves is not the ego's."""
        events: list[tuple[str, str, str]] = []
        ego = self._ego
        if ego.crashed and self._contact is None:
            self._contact = _attribute_contact(ego, before, self._road, self._route)
            events.append(("collision", self._contact.partner, self._contact.describe()))
        fresh = [
            body
            for body in (*self._road.vehicles, *self._road.objects, *self._road.obstacles)
            if body.crashed and body is not ego and body.body_id not in self._wrecks
        ]
        if fresh:
            now = self._index * self._dt
            self._wrecks.update({body.body_id: now for body in fresh})
            partner = self._contact.partner if self._contact else None
            others = [body.body_id for body in fresh if body.body_id != partner]
            if others:
                self._background_crashes += 1
                events.append(("background_crash", "+".join(others), "not a collision of the ego"))
        return tuple(events)

    def _observe_ego(self, acceleration: float, heading_before: float) -> EgoState:
        ego = self._ego
        x, y = ego.position.tolist()
        s, lateral = self._route.project(x, y)
        heading = float(ego.heading)
        return EgoState(
            x, y, heading, float(ego.speed), float(acceleration), ego.commanded,
            (heading - heading_before) / self._dt, s, lateral,
        )  # fmt: skip

    def _bodies(self) -> BodyList:
        road, ego, rows, ids = self._road, self._ego, [], []
        for body in (*road.vehicles, *road.objects):
            if body is ego:
                continue
            x, y = body.position.tolist()
            heading, speed = float(body.heading), float(body.speed)
            course = heading
            if (
                body.LENGTH > CYCLIST_LENGTH
            ):  # a car's course differs from its heading by the slip angle
                course += math.atan(0.5 * math.tan(body.action["steering"]))
            ids.append(body.body_id)
            rows.append((x, y, heading, speed * math.cos(course), speed * math.sin(course),
                         body.LENGTH, body.WIDTH))  # fmt: skip
        if self._kinds:
            ids += self._kinds
            rows += self._obstacle_rows
        if not ids:
            return NO_BODIES
        return BodyList(tuple(ids), np.array(rows).reshape(-1, COLUMNS), tuple(rows))

    def _routes(self) -> tuple[int, ...]:
        """The number of each body's route, in the order of the bodies."""
        ego, road = self._ego, self._road
        cars = [vehicle.number for vehicle in road.vehicles if vehicle is not ego]
        return (*cars, *[NOT_A_CAR] * (len(road.objects) + len(road.obstacles)))

    def _solids(self) -> list[camera.Solid]:
        """Solids on the ground now, for the cameras: the ground truth, and never a percept."""
        people = {person.body_id for person in self._road.objects}
        solids = [
            camera.Solid(
                "pedestrian" if body.id in people else self._kinds.get(body.id, "car"),
                body.x, body.y, body.heading, body.length, body.width,
            )
            for body in self._bodies()
        ]  # fmt: skip
        road = self._route.road
        for name in road.entries:
            number = road.arm(name)
            kind = road.sign(number)
            if kind:
                solids.append(camera.sign_beside(road.arms[number], kind))
        for number, state in self._light_states.items():
            solids.append(camera.light_beside(road.arms[number], state))
        return solids

    def _tick(self, events: tuple[tuple[str, str, str], ...]) -> Tick:
        state, bodies = self._state, self._bodies()
        contact = self._contact
        truth = {
            "ego": state,
            "bodies": bodies,
            "routes": self._routes(),
            "contact": contact.code if contact else 0,
            "background_crashes": self._background_crashes,
        }
        return Tick(
            index=self._index,
            time=self._index * self._dt,
            truth=truth,
            channels=channels(
                state,
                bodies,
                self._map,
                self._signs,
                self._camera(self._index, state),
                occlusion=self._occlusion,
            ),
            goal=state.s > self._route.exit + _GOAL_DISTANCE,
            critical=contact.describe() if contact else None,
            events=events,
        )

    def _camera(self, index: int, state: EgoState) -> Any:
        def frame(view: str) -> NDArray[np.uint8]:
            if self._state is not state:
                raise ConfigurationError(
                    "a camera frame can be read only during its tick",
                    key=f"camera_{view}",
                    found=f"the frame of tick {index}, read at tick {self._index} or after a reset",
                    remedy="read the channel when the role runs, and keep the array",
                )
            return self._picture(view, state)

        return frame

    def _picture(self, view: str, state: EgoState) -> NDArray[np.uint8]:
        """What the camera of a view sees now."""
        draw = camera.front if view == "front" else camera.third_person
        return draw(state, self._solids(), self._route.road)


class HighwaySimulator(JunctionSimulator):
    """The junction on highway-env: its lanes and its drivers, with right of way added to them."""

    imports = ("pytest_dura.driving.traffic",)

    def snapshot(self) -> object:
        """A deep copy of road, vehicles and bookkeeping; the road network is shared."""
        return copy.deepcopy(vars(self), _shared(self._road))

    def restore(self, snapshot: Any) -> None:
        """Return to a snapshot."""
        self.__dict__.update(copy.deepcopy(snapshot, _shared(snapshot["_road"])))

    def _make_road(self, world: DrivingWorld, seed: int) -> Any:
        from pytest_dura.driving import traffic

        geometry = world.geometry
        road = traffic.JunctionRoad(_network(geometry), np_random=stream(seed, "highway_env"))
        road.courtesy = world.courtesy
        road.obstacles = tuple(
            traffic.standing(road, geometry.arms[geometry.arm(obstacle.arm)], part)
            for obstacle in world.obstacles
            for part in obstacle.parts()
        )
        return road

    def _place(
        self, body_id: str, plan: Route, s: float, speed: float, exponent: float | None = None
    ) -> Any:
        from pytest_dura.driving.traffic import Driver, Ego

        x, y, heading = (float(value) for value in plan.pose(s))
        kind = Ego if exponent is None else Driver
        vehicle = kind(self._road, [x, y], heading=heading, speed=speed)
        vehicle.body_id, vehicle.plan, vehicle.s, vehicle.number = body_id, plan, s, plan.number
        vehicle.target_speed = self._map.speed_limit
        vehicle.plan_route_to(f"o{plan.destination}")
        if exponent is not None:
            vehicle.enable_lane_change = False
            vehicle.DELTA = exponent
        self._road.vehicles.append(vehicle)
        return vehicle

    def _make_walker(self, person: PedestrianStart | CyclistStart) -> Any:
        from pytest_dura.driving.traffic import cyclist, walker

        road = self._route.road
        arm = road.arms[road.arm(person.arm)]
        if isinstance(person, CyclistStart):
            return cyclist(self._road, arm, person)
        return walker(self._road, person.id, arm, person.offset, person.side)


def _check_obstacles(world: DrivingWorld) -> None:
    """Refuse an obstacle where a car stands at the start."""
    if not world.obstacles:
        return
    road = world.geometry
    starts = {"EGO": (world.ego_route, world.ego.distance)}
    starts |= {
        car.id: (car.route(road), car.distance)
        for car in world.vehicles
        if car.distance is not None
    }
    for index, obstacle in enumerate(world.obstacles):
        arm = road.arms[road.arm(obstacle.arm)]
        x, y, heading = placed(arm, obstacle.offset, obstacle.beside)
        box = np.array([[x, y, heading, *obstacle.size]])
        for name, (plan, distance) in starts.items():
            at = [float(value) for value in plan.pose(plan.stop_line - distance)]
            if boxes_overlap(box, np.array([[*at, CAR_LENGTH, CAR_WIDTH]]))[0]:
                raise ConfigurationError(
                    f"an obstacle stands where the car {name} starts",
                    key=f"world.obstacles.{index}",
                    found=obstacle.id,
                    expected="obstacles that touch no road user at the start",
                    remedy="change its `offset` or `beside`, or the car's `distance`",
                )


_ON_ROUTE = 0.5
"""m beside its route, or rad off its heading, up to which a pose is on it."""


def _check_pose(ego: EgoState, route: Route) -> None:
    """Refuse an ego that is not on its route, by what the built network made of its pose.

    Raises:
        ConfigurationError: With the distance to the route.
    """
    turned = math.remainder(ego.heading - route.heading_at(ego.s), 2.0 * math.pi)
    on_route = 0.0 <= ego.s <= route.length
    if not on_route or abs(ego.lateral) > _ON_ROUTE or abs(turned) > _ON_ROUTE:
        raise ConfigurationError(
            f"the ego does not start on its route {route}",
            key="world.ego",
            found=f"{ego.lateral:.1f} m beside it, {math.degrees(turned):.0f} degrees off",
            expected=f"a pose on it, from 0 to {route.length:.0f} m",
            remedy="correct `distance`, or the road",
        )


def _shared(road: Any) -> dict[int, Any]:
    """The network of a road, which copies share, as a memo of ``deepcopy``."""
    return {} if road is None else {id(road.network): road.network}


@cache
def _network(road: Road) -> Any:
    """highway-env's lanes of a road, built once and shared: nothing changes it."""
    from pytest_dura.driving.traffic import lane_network

    return lane_network(road)
