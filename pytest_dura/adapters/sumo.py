"""SumoSimulator: the four-way junction of driving, with SUMO's drivers, in this process by libsumo.

The network is the junction's own geometry, so that a route of driving and one of SUMO are the same
line: ``benchmarks/sumo_network.py`` makes the files beside this module. SUMO decides how fast the
other cars drive and who goes first; the ego has the speed that its actuator gives it. Contacts are
those of driving's boxes: SUMO's own collisions are off, since it sees none of a pedestrian who is
put somewhere (``moveToXY``), and knows a car by its front bumper alone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from pytest_dura.adapters.boxes import BoxBody, refuse_rules_of_drivers, touching
from pytest_dura.adapters.libraries import client_library
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.seeding import derive_seed
from pytest_dura.driving.bodies import CAR_LENGTH, PEDESTRIAN_SIZE
from pytest_dura.driving.highway import EGO, JunctionSimulator
from pytest_dura.driving.lanes import Route
from pytest_dura.driving.moving import Actuated, Walking, crossing_length, kerb
from pytest_dura.driving.scenario import CyclistStart, DrivingWorld, PedestrianStart

NETWORK, TYPES = "four_way.net.xml", "four_way.add.xml"
"""The network, and the types of drivers and the routes on it; both lie beside this module."""
EXPONENTS = (1.0, 10.0)
"""Least and greatest exponent of a driver's free acceleration; there is a type for each tenth."""
_HALF = CAR_LENGTH / 2
_MODELLED = frozenset({"ego", "traffic", "vehicles", "pedestrians", "courtesy"})
"""Keys of a world that say something here."""
_OPTIONS = (
    "--xml-validation", "never",
    "--xml-validation.net", "never",
    "--no-step-log", "true",
    "--no-warnings", "true",
    "--duration-log.disable", "true",
    "--collision.action", "none",
    "--time-to-teleport", "-1",
    "--insertion-checks", "none",
)  # fmt: skip
_NO_CHECKS = 0
"""SUMO's speed mode in which a car drives just as fast as it is commanded."""
_AS_PLACED = 2
"""SUMO's way to move a person to exactly this place, on a road or not."""


def route_name(plan: Route) -> str:
    """Name of a route in :data:`TYPES`, such as ``south_straight``."""
    return f"{plan.arm.name}_{plan.turn}"


def type_name(exponent: float) -> str:
    """Name of the type of drivers whose exponent is the nearest tenth."""
    return f"driver_{round(10 * exponent)}"


@cache
def _library() -> Any:
    return client_library(lambda: import_module("libsumo"), "libsumo", "SUMO", "sumo")


class SumoCar(BoxBody):
    """A car whose centre is on its route.

    Args:
        body_id: Its id here and in SUMO.
        plan: Its route.
        s: Metres of its centre along the route.
        speed: In m/s.
        kind: Its type in SUMO.
    """

    def __init__(self, body_id: str, plan: Route, s: float, speed: float, kind: str) -> None:
        self.plan, self.number, self.kind = plan, plan.number, kind
        self.origin: float | None = None
        """``s`` at which SUMO took it over; ``None`` before."""
        super().__init__(body_id, 0.0, 0.0, 0.0, speed)
        self.drive_to(s, speed)

    def drive_to(self, s: float, speed: float) -> None:
        """Be at ``s`` with this speed."""
        self.s, self.speed = s, speed
        self.stand_at(*self.plan.point(s), self.plan.heading_at(s))


class SumoEgo(Actuated, SumoCar):
    """The car that the component drives, at the speed that its actuator comes to."""


class SumoWalker(Walking, BoxBody):
    """A pedestrian of driving; SUMO's drivers see it as a person of theirs."""

    LENGTH = WIDTH = PEDESTRIAN_SIZE


class SumoRoad:
    """The road as driving's simulator knows one, kept in step with SUMO.

    Args:
        courtesy: As the world says it.
        sumo: The library, with the network loaded.
    """

    def __init__(self, courtesy: str, sumo: Any) -> None:
        self.courtesy, self._sumo = courtesy, sumo
        self.vehicles: list[SumoCar] = []
        self.objects: list[SumoWalker] = []
        self.obstacles: tuple[Any, ...] = ()
        self.halted: frozenset[int] = frozenset()
        self._inside: set[str] = set()
        self._people: set[str] = set()

    def act(self) -> None:
        """Leave decisions to SUMO, whose drivers decide as they move."""

    def step(self, dt: float) -> None:
        """Hand over what is new, let SUMO take a step, take over where cars are, mark contacts."""
        for car in self.vehicles:
            if isinstance(car, SumoEgo):
                self._drive_ego(car, dt)
            elif car.origin is None:
                self._add(car, car.speed, dt)
        self._remove_cleared()
        for person in self.objects:
            self._move(person)
        self._sumo.simulationStep()
        vehicle = self._sumo.vehicle
        for car in self.vehicles:
            assert car.origin is not None
            covered = vehicle.getDistance(car.body_id)
            car.drive_to(car.origin + covered, vehicle.getSpeed(car.body_id))
        self._mark_contacts()

    def _drive_ego(self, ego: SumoEgo, dt: float) -> None:
        speed = max(ego.speed + ego.executed * dt, 0.0)
        if ego.origin is None:
            self._add(ego, speed, dt)
            self._sumo.vehicle.setSpeedMode(ego.body_id, _NO_CHECKS)
        self._sumo.vehicle.setSpeed(ego.body_id, speed)

    def _add(self, car: SumoCar, speed: float, dt: float) -> None:
        """Add a car, which SUMO puts on its road at the end of the step: a step further on."""
        car.origin = car.s + speed * dt
        vehicle = self._sumo.vehicle
        front = car.origin + _HALF
        vehicle.add(
            car.body_id,
            route_name(car.plan),
            typeID=car.kind,
            departPos=repr(front),
            departSpeed=repr(speed),
        )
        if self.courtesy == "none" and self._goes_before_ego(car):
            # As if the ego were not there until it is on the driver's own lane.
            vehicle.setParameter(car.body_id, "junctionModel.ignoreTypes", EGO)
        self._inside.add(car.body_id)

    def _goes_before_ego(self, car: SumoCar) -> bool:
        ego = next(each for each in self.vehicles if isinstance(each, SumoEgo))
        return car.plan.priority > ego.plan.priority

    def _remove_cleared(self) -> None:
        for name in sorted(self._inside - {car.body_id for car in self.vehicles}):
            self._sumo.vehicle.remove(name)
            self._inside.discard(name)
        for name in sorted(self._people - {person.body_id for person in self.objects}):
            self._sumo.person.removeStages(name)
            self._people.discard(name)

    def _move(self, walker: SumoWalker) -> None:
        """Put a person where the pedestrian is; SUMO's y points north."""
        person, name = self._sumo.person, walker.body_id
        if name not in self._people:
            # It needs a road to stand on and a way to go; `moveToXY` overrules both.
            person.add(name, "south_in", 50.0)
            person.appendWaitingStage(name, 1e6)
            self._people.add(name)
        x, y = walker.position.tolist()
        person.moveToXY(name, "", x, -y, math.degrees(walker.heading) + 90.0, _AS_PLACED)

    def _mark_contacts(self) -> None:
        """Mark both of two bodies whose boxes overlap, one of them a car; wrecks stand still."""
        for pair in touching(self.vehicles, self.objects):
            for body in pair:
                self._wreck(body)

    def _wreck(self, body: BoxBody) -> None:
        if not body.crashed and isinstance(body, SumoCar):
            self._sumo.vehicle.setSpeedMode(body.body_id, _NO_CHECKS)
            self._sumo.vehicle.setSpeed(body.body_id, 0.0)
        body.crashed = True


class SumoSimulator(JunctionSimulator):
    """The junction with SUMO's drivers; ``driving.sumo`` among the simulators.

    Signals, channels, measures and the pedestrians' way are driving's own. The cars are on rails:
    their centre is on the lane's middle, and no slip angle turns them.
    """

    instances = "one per process"
    lacks = {  # noqa: RUF012 - declared as a class variable by the base
        "obstacles": "SUMO's drivers would not see them",
        "controls.signals": "its network has signs alone",
        "road": "its network is that of the four-way junction",
    }

    @classmethod
    def check_scenario(cls, world: Mapping[str, Any]) -> dict[str, Any]:
        """The world with all defaults filled in.

        Raises:
            pydantic.ValidationError: If the world is none of driving's.
            ConfigurationError: If it needs another road than the four-way junction, as for
                :class:`JunctionSimulator`, and if libsumo is not installed.
        """
        _library()
        checked = super().check_scenario(world)
        unknown = sorted(checked.keys() - _MODELLED - {key.partition(".")[0] for key in cls.lacks})
        if unknown:
            raise ConfigurationError(
                f"SUMO has no network for a world with {unknown[0]!r}",
                key=f"world.{unknown[0]}",
                found=checked[unknown[0]],
                expected="the four-way junction without more than " + ", ".join(sorted(_MODELLED)),
                remedy="run the scenario in the simulator `driving`",
            )
        refuse_rules_of_drivers(checked["vehicles"], "SUMO's")
        return checked

    def close(self) -> None:
        """End the simulation, unless another one of this process has replaced it."""
        if self._road is not None and self._road is _running[0]:
            _library().close()
            _running[0] = None
        super().close()

    def drive(self, acceleration: float) -> None:
        """Step the road; see the base.

        Raises:
            RuntimeError: If another simulation of this process has replaced this one.
        """
        if self._road is not _running[0]:
            raise RuntimeError("another simulation has replaced this one: SUMO runs one a process")
        super().drive(acceleration)

    def _make_road(self, world: DrivingWorld, seed: int) -> SumoRoad:
        sumo, here = _library(), Path(__file__).parent
        options = [
            "--net-file", str(here / NETWORK),
            "--additional-files", str(here / TYPES),
            "--step-length", repr(self.time_step),
            "--seed", str(derive_seed(seed, "sumo") % 2**31),
            *_OPTIONS,
        ]  # fmt: skip
        if _running[0] is None:
            sumo.start(["sumo", *options])
        else:
            sumo.load(options)
        road = _running[0] = SumoRoad(world.courtesy, sumo)
        return road

    def _place(
        self, body_id: str, plan: Route, s: float, speed: float, exponent: float | None = None
    ) -> SumoCar:
        if exponent is None:
            car: SumoCar = SumoEgo(body_id, plan, s, speed, EGO)
        else:
            car = SumoCar(body_id, plan, s, speed, type_name(exponent))
        self._road.vehicles.append(car)
        return car

    def _make_walker(self, person: PedestrianStart | CyclistStart) -> SumoWalker:
        road = self._route.road
        arm = road.arms[road.arm(person.arm)]
        x, y, heading = kerb(arm, person.offset, person.side)
        walker = SumoWalker(person.id, x, y, heading, 0.0)
        walker.distance = crossing_length(arm)
        return walker


_running: list[SumoRoad | None] = [None]
"""The road of the simulation that runs in this process: libsumo holds one."""
