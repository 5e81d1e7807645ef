"""CarlaSimulator: a junction of driving in CARLA, with its physics and its traffic manager.

CARLA moves the cars; what is sensed, signals and measures are driving's own. CARLA's axes are those
of driving, moved to the junction's centre.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from pytest_dura.adapters.boxes import BoxBody, refuse_rules_of_drivers, touching
from pytest_dura.adapters.carla.maps import library
from pytest_dura.adapters.carla.world import (
    CONNECTIONS,
    CarlaError,
    Connection,
    Sensor,
)
from pytest_dura.core.seeding import derive_seed
from pytest_dura.core.state import Tick
from pytest_dura.driving import camera
from pytest_dura.driving.bodies import PEDESTRIAN_SIZE
from pytest_dura.driving.highway import JunctionSimulator
from pytest_dura.driving.lanes import Route
from pytest_dura.driving.moving import Actuated, Walking, crossing_length, kerb
from pytest_dura.driving.scenario import CyclistStart, DrivingWorld, PedestrianStart
from pytest_dura.driving.sensors import EgoState

_DROP = 0.3
"""m above the road at which a car is placed, so that it does not stand in it."""
_STANDING = 0.02
"""m/s; a car on its springs that moves less stands."""
_WAYS = 5.0
"""m from one place to the next of those that the traffic manager is given."""
_WALKER = "walker.pedestrian.0001"
_WALKER_HEIGHT = 1.0
"""m from the ground to the middle of a pedestrian."""


class Pedals:
    """Throttle, brake and steering, from an acceleration and a route.

    The pedals are fed forward, and corrected by the speed that is missing. The wheel has the bend
    of the route, corrected by place and course of the car beside it.
    """

    throttle, brake = 5.0, 10.0
    """m/s2 of the full pedal, from which the correction starts."""
    gain = 3.0
    """1/s, of the correction."""
    most = 3.0
    """m/s2 of it at most."""
    wheelbase, locked = 2.9, math.radians(70.0)
    """m, and the angle of a wheel that is turned all the way."""
    back, ahead = 4.0, 0.1
    """m in which it comes back to its route, and s by which it looks at the bend before."""

    def __init__(self) -> None:
        self._expected: float | None = None
        self._missing = 0.0

    def press(self, speed: float, acceleration: float, dt: float) -> tuple[float, float]:
        """Return throttle and brake, from 0 to 1."""
        if self._expected is not None:
            missing = self._missing + self.gain * (self._expected - speed)
            self._missing = min(max(missing, -self.most), self.most)
        self._expected = max(speed + acceleration * dt, 0.0)
        if self._expected <= _STANDING:
            self._missing = 0.0
            return 0.0, 1.0
        force = acceleration + self._missing
        return min(max(force / self.throttle, 0.0), 1.0), min(max(-force / self.brake, 0.0), 1.0)

    def steer(self, car: CarlaCar) -> float:
        """Return the wheel, from -1 on the left to 1."""
        plan, at = car.plan, car.s + self.ahead * car.speed
        aside = plan.project(*car.position.tolist())[1]
        turned = math.sin(car.course - plan.heading_at(car.s))
        bend = plan.heading_at(at + 0.5) - plan.heading_at(at - 0.5)
        bend -= aside / self.back**2 + 2.0 * turned / self.back
        return min(max(math.atan(self.wheelbase * bend) / self.locked, -1.0), 1.0)


class CarlaCar(BoxBody):
    """A car whose place is that of an actor; the traffic manager drives it on its route."""

    def __init__(self, body_id: str, plan: Route, s: float, speed: float) -> None:
        self.plan, self.number, self.s = plan, plan.number, s
        self.actor: Any = None
        self.course = plan.heading_at(s)
        super().__init__(body_id, *plan.point(s), self.course, speed)

    def take(self, state: Any, x: float, y: float) -> None:
        """Take place and speed from an actor's state; ``x`` and ``y`` are those of the centre."""
        place, velocity = state.get_transform(), state.get_velocity()
        turned = math.radians(place.rotation.yaw) - self.heading
        heading = self.heading + math.remainder(turned, 2 * math.pi)
        self.stand_at(place.location.x - x, place.location.y - y, heading)
        speed = float(self.direction @ (velocity.x, velocity.y))
        self.speed = speed if abs(speed) > _STANDING else 0.0
        self.course = math.atan2(velocity.y, velocity.x) if self.speed else heading
        self.s = self.plan.project(*self.position.tolist())[0]


class CarlaEgo(Actuated, CarlaCar):
    """The car that the component drives; driving's actuator says which acceleration it gets."""


class CarlaWalker(Walking, BoxBody):
    """A pedestrian of driving, who is put where it walks."""

    LENGTH = WIDTH = PEDESTRIAN_SIZE
    actor: Any = None


class CarlaRoad:
    """The road as driving's simulator knows one, kept in step with CARLA.

    Args:
        held: The connection, with the road loaded.
        world: What the scenario says.
        x: Of the centre, on CARLA's map.
        y: See ``x``.
        timeout: Seconds that a sensor may take.
    """

    def __init__(
        self, held: Connection, world: DrivingWorld, x: float, y: float, timeout: float
    ) -> None:
        self.held, self.courtesy, self._x, self._y = held, world.courtesy, x, y
        self.vehicles: list[CarlaCar] = []
        self.objects: list[CarlaWalker] = []
        self.obstacles: tuple[Any, ...] = ()
        self.halted: frozenset[int] = frozenset()
        self.bumper: Sensor | None = None
        self.camera: Sensor | None = None
        self.pedals, self._timeout = Pedals(), timeout
        self._known: dict[int, CarlaCar | CarlaWalker] = {}

    def act(self) -> None:
        """Leave decisions to the traffic manager."""

    def start(self) -> None:
        """Make the frame of time 0, in which nothing moves; then let it move."""
        self._put_pedestrians()
        self._take_step()
        for car in self.vehicles:
            self.set_off(car)

    def step(self, dt: float) -> None:
        """Hand over what is commanded, let CARLA take a step, take over where things are."""
        ego = next(car for car in self.vehicles if isinstance(car, CarlaEgo))
        throttle, brake = self.pedals.press(ego.speed, ego.executed, dt)
        control = library().VehicleControl(
            throttle=throttle, steer=self.pedals.steer(ego), brake=brake
        )
        with self.held.asking("command the ego"):
            ego.actor.apply_control(control)
        self._put_pedestrians()
        bodies: list[CarlaCar | CarlaWalker] = [*self.vehicles, *self.objects]
        there = {body.actor.id: body for body in bodies}
        for number in self._known.keys() - there.keys():
            self.held.remove(self._known[number].actor)
        self._known = there
        snapshot = self._take_step()
        for car in self.vehicles:
            state = snapshot.find(car.actor.id)
            if state is None:
                raise CarlaError(f"{car.body_id} is no longer in CARLA's world")
            car.take(state, self._x, self._y)
        self._mark_contacts()

    def set_off(self, car: CarlaCar) -> None:
        """Let a car move at its speed; the traffic manager drives it, if it is not the ego."""
        held, ego = self.held, self.vehicles[0]
        with held.asking(f"set {car.body_id} off"):
            car.actor.set_simulate_physics(True)
            car.actor.set_target_velocity(library().Vector3D(*car.velocity.tolist(), 0.0))
            if car is ego:
                return
            car.actor.set_autopilot(True, held.traffic_port)
            held.traffic.auto_lane_change(car.actor, False)
            held.traffic.set_desired_speed(car.actor, 3.6 * car.plan.road.speed_limit)
            ways = np.arange(car.s + _WAYS, car.plan.length, _WAYS)
            path = [self._location(*car.plan.point(way)) for way in ways.tolist()]
            held.traffic.set_path(car.actor, path)
            if self.courtesy == "none" and car.plan.priority > ego.plan.priority:
                held.traffic.collision_detection(car.actor, ego.actor, False)

    def transform(self, body: BoxBody, height: float) -> Any:
        """Place of a body on CARLA's map."""
        place = self._location(*body.position.tolist())
        place.z = self.held.ground(place) + height
        return library().Transform(place, library().Rotation(yaw=math.degrees(body.heading)))

    def picture(self) -> NDArray[np.uint8]:
        """The front camera's frame of this tick, in RGB."""
        image = self._image
        pixels = np.frombuffer(image.raw_data, np.uint8).reshape(image.height, image.width, 4)
        seen: NDArray[np.uint8] = pixels[:, :, 2::-1].copy()
        return seen

    def _location(self, x: float, y: float) -> Any:
        return library().Location(x=x + self._x, y=y + self._y)

    def _put_pedestrians(self) -> None:
        for walker in self.objects:
            place = self.transform(walker, _WALKER_HEIGHT)
            if walker.actor is None:
                walker.actor = self.held.spawn(_WALKER, place)
            with self.held.asking("move a pedestrian"):
                walker.actor.set_transform(place)

    def _take_step(self) -> Any:
        snapshot = self.held.tick()
        if self.camera is not None:
            self._image = self.camera.at(snapshot.frame, self._timeout)
        return snapshot

    def _mark_contacts(self) -> None:
        """Mark who touches: by our boxes, and for the ego by CARLA's sensor, too."""
        for pair in touching(self.vehicles, self.objects):
            for body in pair:
                body.crashed = True
        for event in () if self.bumper is None else self.bumper.so_far():
            ego, known = self.vehicles[0], self._known.get(event.other_actor.id)
            x, y = ego.position + ego.LENGTH / 2.0 * ego.direction
            # A wall or a pole is a body of its own, where the ego's front is.
            other = known or BoxBody(event.other_actor.type_id, x, y, ego.heading, 0.0)
            if known is None:
                self.obstacles = (*self.obstacles, other)
            other.crashed = ego.crashed = True


class CarlaSimulator(JunctionSimulator):
    """The junction in CARLA; ``driving.carla`` among the simulators. No server was run with it.

    One process, pytest's own, runs its episodes; each begins without the actors of the one before.
    The server builds the scenario's road, or has it in a town. A server that is lost in an episode
    is found, or started, for the next one.

    Args:
        host: Of the server.
        port: Of the server.
        traffic_port: Of the traffic manager, which is opened here.
        server: Command line of a program of the project that starts it where nothing answers.
        town: A map of CARLA, such as ``Town01``.
        junction: Which junction of the town, see ``python -m pytest_dura.adapters.carla road``.
        vehicle: Blueprint of the ego.
        other_vehicle: Blueprint of the other cars.
        front_camera: Whether the channel ``camera_front`` is CARLA's; frames are rendered then.
        timeout: Seconds of wall-clock time that the server may take to answer.
    """

    instances = "one"
    deterministic: ClassVar[bool] = False
    repeatable: ClassVar[bool] = False
    tolerances: ClassVar[Mapping[str, float]] = {"speed": 0.1}
    lacks: ClassVar[Mapping[str, str]] = {
        "obstacles": "the traffic manager's drivers would not see them",
        "cyclists": "they are not placed",
        "controls.signals": "its traffic lights are those of the town",
    }

    def __init__(
        self,
        *,
        host: str = "127.0.0.1",
        port: int = 2000,
        traffic_port: int = 8000,
        server: str = "",
        town: str = "",
        junction: int = 0,
        vehicle: str = "vehicle.lincoln.mkz_2020",
        other_vehicle: str = "vehicle.lincoln.mkz_2020",
        front_camera: bool = False,
        timeout: float = 20.0,
    ) -> None:
        library()
        super().__init__()
        self.key = host, port, traffic_port, server, timeout
        """Of the connection that its episodes share."""
        self._town, self._junction, self._timeout = town, junction, timeout
        self._blueprints, self._has_camera = (vehicle, other_vehicle), front_camera

    @classmethod
    def check_scenario(cls, world: Mapping[str, Any]) -> dict[str, Any]:
        """The world with all defaults filled in.

        Raises:
            pydantic.ValidationError: If the world is none of driving's.
            ConfigurationError: As for :class:`JunctionSimulator`, and for vehicles with rules.
        """
        checked = super().check_scenario(world)
        refuse_rules_of_drivers(checked["vehicles"], "the traffic manager's")
        return checked

    @classmethod
    def close_process(cls) -> None:
        """Leave the servers, and end those that were started here."""
        CONNECTIONS.close()

    @classmethod
    def open_process(cls) -> None:
        """Check that the library is there; a server is found at the first reset.

        Raises:
            ConfigurationError: If it is not installed.
        """
        library()

    def reset(self, scenario: Mapping[str, Any], seed: int) -> Tick:
        """Build the road where it is not there, and what the scenario puts on it at time 0."""
        tick = super().reset(scenario, seed)
        self._road.start()
        return tick

    def close(self) -> None:
        """Take the actors of the episode out; the server stays for the next one."""
        if self._road is not None:
            self._road.held.end()
        super().close()

    def _make_road(self, world: DrivingWorld, seed: int) -> CarlaRoad:
        if self._road is not None:
            self._road.held.end()
        held = CONNECTIONS.take(*self.key)
        place = held.load(world.geometry, self._town, self._junction)
        held.begin(self.time_step, derive_seed(seed, "carla") % 2**31, rendering=self._has_camera)
        return CarlaRoad(held, world, place.x, place.y, self._timeout)

    def _place(
        self, body_id: str, plan: Route, s: float, speed: float, exponent: float | None = None
    ) -> CarlaCar:
        road, carla, is_ego = self._road, library(), exponent is None
        car: CarlaCar = (CarlaEgo if is_ego else CarlaCar)(body_id, plan, s, speed)
        car.actor = road.held.spawn(self._blueprints[not is_ego], road.transform(car, _DROP))
        extent = car.actor.bounding_box.extent
        car.LENGTH, car.WIDTH = 2.0 * extent.x, 2.0 * extent.y
        road.vehicles.append(car)
        if is_ego:
            bumper = road.held.spawn("sensor.other.collision", carla.Transform(), car.actor)
            road.bumper = Sensor(bumper)
            road.camera = self._mount(camera.FRONT, car.actor) if self._has_camera else None
        if self._index:
            road.set_off(car)
        else:
            with road.held.asking(f"hold {body_id}"):
                car.actor.set_simulate_physics(False)
        return car

    def _picture(self, view: str, state: EgoState) -> NDArray[np.uint8]:
        if view == "front" and self._has_camera:
            seen: NDArray[np.uint8] = self._road.picture()
            return seen
        return super()._picture(view, state)

    def _mount(self, mount: camera.Mount, ego: Any) -> Sensor:
        carla = library()
        place = carla.Transform(
            carla.Location(x=mount.ahead, z=mount.height), carla.Rotation(pitch=-mount.pitch)
        )
        size, view = str(mount.size), str(mount.field_of_view)
        held: Connection = self._road.held
        return Sensor(
            held.spawn(
                "sensor.camera.rgb", place, ego, image_size_x=size, image_size_y=size, fov=view
            )
        )

    def _make_walker(self, person: PedestrianStart | CyclistStart) -> CarlaWalker:
        road = self._route.road
        arm = road.arms[road.arm(person.arm)]
        x, y, heading = kerb(arm, person.offset, person.side)
        walker = CarlaWalker(person.id, x, y, heading, 0.0)
        walker.distance = crossing_length(arm)
        return walker
