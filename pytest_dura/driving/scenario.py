"""World of a driving scenario: vehicles, pedestrians, obstacles and lights, given or drawn."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    ValidationInfo,
    field_validator,
    model_serializer,
    model_validator,
)

from pytest_dura.core.seeding import stream
from pytest_dura.driving.junction import ARM_LENGTH, ARMS, TURNS, Route, route

Arm = Literal["south", "west", "north", "east"]
Turn = Literal["left", "straight", "right"]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]

_EARLIEST = -9.0
"""Seconds; nobody is on the road for longer when an episode begins."""


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class EgoStart(_Model):
    """The ego comes from the south, on the minor road, and gives way."""

    distance: Annotated[float, Field(gt=5, le=95)] = Field(
        50.0, description="From its centre to the stop line, in m."
    )
    speed: Annotated[float, Field(ge=0, le=10)] = Field(8.0, description="At the start, in m/s.")
    turn: Turn = Field("straight", description="Where it goes.")


class Turns(_Model):
    """Weights of the turns that drivers take."""

    left: NotNegative = 0.15
    straight: Positive = 0.7
    right: NotNegative = 0.15


class Traffic(_Model):
    """Random traffic: arrivals at the outer end of each arm."""

    headway: Positive = Field(
        22.0, description="Mean time between two arrivals on one arm, in s (exponential, shifted)."
    )
    minimum_headway: Positive = Field(
        2.5,
        description="Least time between two arrivals, in s; less than the mean.",
        validate_default=True,
    )
    arms: tuple[Arm, ...] = Field(
        ("west", "north", "east"), strict=False, description="Arms with traffic."
    )
    speed: Annotated[float, Field(gt=0, le=10)] = Field(8.0, description="Mean speed, in m/s.")
    speed_deviation: Annotated[float, Field(ge=0, le=2)] = Field(0.7, description="In m/s.")
    turns: Turns = Turns()

    @field_validator("minimum_headway")
    @classmethod
    def _below_the_mean(cls, minimum: float, info: ValidationInfo) -> float:
        mean = info.data.get("headway", math.inf)
        if minimum >= mean:
            raise ValueError(
                f"the least time between two arrivals, {minimum:g} s, is not below their mean,"
                f" {mean:g} s"
            )
        return minimum


class ExplicitVehicle(_Model):
    """One vehicle where the scenario wants it: on its arm at the start, or entering it."""

    id: Annotated[str, Field(pattern=r"^[A-Z][A-Z0-9_]{0,15}$")] = Field(
        description="Its name in records; not EGO, nor R or S with a number, nor V with a number "
        "beside random traffic."
    )
    arm: Arm = Field(description="Where it comes from.")
    turn: Turn = Field("straight", description="Where it goes.")
    distance: Annotated[float, Field(ge=3, le=99)] | None = Field(
        None, description="From its centre to its stop line at the start, in m."
    )
    enters: Annotated[float, Field(ge=_EARLIEST, allow_inf_nan=False)] | None = Field(
        None,
        description="Instead of the distance: when it enters the road at the outer end of its arm, "
        "once there is room, in s. Before 0, it has driven on at its speed until the start.",
    )
    speed: Annotated[float, Field(ge=0, le=10)] = Field(
        8.0, description="At the start, or when it enters, in m/s."
    )
    exponent: Annotated[float, Field(ge=1, le=10)] = Field(
        4.0, description="Of the free acceleration in the Intelligent Driver Model."
    )

    @model_validator(mode="after")
    def _somewhere(self) -> ExplicitVehicle:
        if (self.distance is None) == (self.enters is None):
            raise ValueError(
                f"the vehicle {self.id} needs one of `distance`, at the start, and `enters`"
            )
        return self

    @model_serializer(mode="wrap")
    def _plain(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Without what older worlds do not have where it is at its default: digests stay equal."""
        data: dict[str, Any] = handler(self)
        for key in ("distance", "enters"):
            if data[key] is None:
                del data[key]
        if self.exponent == ExplicitVehicle.model_fields["exponent"].default:
            del data["exponent"]
        return data


class PedestrianStart(_Model):
    """A pedestrian who crosses an arm from kerb to kerb."""

    id: Annotated[str, Field(pattern=r"^[A-Z][A-Z0-9_]{0,15}$")] = "P1"
    arm: Arm = Field("south", description="The arm that is crossed.")
    offset: Annotated[float, Field(ge=1, le=60)] = Field(
        3.0, description="From the stop line outwards, in m."
    )
    side: Literal["left", "right"] = Field(
        "right", description="Where it comes from, seen by a driver who nears the junction."
    )
    start: NotNegative = Field(2.0, description="When it steps off the kerb, in s.")
    speed: Annotated[float, Field(gt=0, le=3)] = Field(1.3, description="In m/s.")


class StaticObstacle(_Model):
    """Something that stands on or beside an arm, and that lidar and radar see like any object."""

    id: Annotated[str, Field(pattern=r"^[A-Z][A-Z0-9_]{0,15}$")] = Field(
        description="Its name in records; as for vehicles."
    )
    kind: Literal["parked_car", "cones", "island"] = Field(
        description="A car of 4.5 by 1.8 m, a row of cones of 3 by 0.4 m, or a kerb island of 6 by "
        "1 m; its length lies along the arm."
    )
    arm: Arm = "south"
    offset: Annotated[float, Field(ge=0, le=99)] = Field(
        description="From the stop line outwards to its centre, in m."
    )
    beside: Annotated[float, Field(ge=-15, le=15)] = Field(
        description="From the middle of the road to its centre, in m; positive to the right of a "
        "driver who nears the junction. The lane towards it is 4 m wide."
    )

    @property
    def size(self) -> tuple[float, float]:
        """Length and width in m."""
        return {"parked_car": (4.5, 1.8), "cones": (3.0, 0.4), "island": (6.0, 1.0)}[self.kind]


class Phase(_Model):
    """What a traffic light shows for some time."""

    state: Literal["red", "yellow", "green"]
    lasts: Positive = Field(description="In s.")


class TrafficLight(_Model):
    """A light at the stop lines of some arms, whose phases follow each other again and again.

    Drivers stop at red and yellow, where they can. Between those who may go, the signs decide, and
    so they do for requirements on the right of way.
    """

    arms: tuple[Arm, ...] = Field(strict=False, min_length=1)
    phases: tuple[Phase, ...] = Field(strict=False, min_length=1)
    offset: NotNegative = Field(0.0, description="How far into its phases it begins, in s.")

    def state_at(self, time: float) -> str:
        """The state ``time`` s after the start."""
        remaining = math.fmod(time + self.offset + 1e-9, sum(phase.lasts for phase in self.phases))
        for phase in self.phases:
            remaining -= phase.lasts
            if remaining < 0.0:
                return phase.state
        return self.phases[-1].state


class Controls(_Model):
    """What regulates the junction beside its signs."""

    signals: tuple[TrafficLight, ...] = Field((), strict=False)

    @model_validator(mode="after")
    def _at_most_one_for_an_arm(self) -> Controls:
        arms = [arm for light in self.signals for arm in light.arms]
        twice = sorted({arm for arm in arms if arms.count(arm) > 1})
        if twice:
            raise ValueError(f"the arm {twice[0]} has two traffic lights")
        return self


class DrivingWorld(_Model):
    """What a driving scenario may say under ``world``."""

    ego: EgoStart = EgoStart()
    traffic: Traffic | None = Field(None, description="Random traffic; left out, there is none.")
    vehicles: tuple[ExplicitVehicle, ...] = Field((), strict=False)
    pedestrians: tuple[PedestrianStart, ...] = Field((), strict=False)
    courtesy: Literal["none", "occupied"] = Field(
        "occupied",
        description="Whether drivers with the right of way brake for an ego that is inside the "
        "junction on their path (occupied), or behave as if it were not there until it is on "
        "their own lane (none).",
    )
    obstacles: tuple[StaticObstacle, ...] = Field((), strict=False)
    controls: Controls = Field(Controls(), description="Traffic lights; by default signs alone.")

    @model_serializer(mode="wrap")
    def _plain(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Without what older worlds do not have where there is none of it."""
        data: dict[str, Any] = handler(self)
        if not self.obstacles:
            del data["obstacles"]
        if not self.controls.signals:
            del data["controls"]
        return data


_ENTRY_SPACE = 14.0


class Arrival(NamedTuple):
    """A car that enters the road.

    Args:
        time: Seconds; negative for one that has been on the road for that long at the start.
        body_id: Its id.
        plan: Its route.
        speed: In m/s, when it enters.
        exponent: Of the free acceleration in the Intelligent Driver Model.
    """

    time: float
    body_id: str
    plan: Route
    speed: float
    exponent: float

    @property
    def start(self) -> float:
        """Metres along its route when the episode begins."""
        return max(0.0, -self.time * self.speed)


def has_room(s: float, taken: Iterable[float]) -> bool:
    """Whether a car can be put at ``s``, with others of its arm at these places."""
    return not any(abs(other - s) < _ENTRY_SPACE for other in taken)


def drawn_arrivals(traffic: Traffic | None, seed: int, duration: float) -> list[Arrival]:
    """All arrivals of random traffic in an episode, in order of time.

    Drawn beforehand, one stream per arm: what the ego does cannot change the traffic's demand.
    """
    if traffic is None:
        return []
    drawn = []
    weights = np.array([traffic.turns.left, traffic.turns.straight, traffic.turns.right])
    for arm in traffic.arms:
        rng = stream(seed, f"traffic:{arm}")
        # Cars that entered up to nine seconds ago are on the arm when the episode begins.
        time = _EARLIEST + rng.exponential(traffic.headway)
        while time < duration:
            turn = TURNS[int(rng.choice(3, p=weights / weights.sum()))]
            speed = float(rng.normal(traffic.speed, traffic.speed_deviation))
            exponent = float(rng.uniform(3.5, 4.5))
            plan = route(ARMS.index(arm), turn)
            drawn.append(Arrival(time, "", plan, float(np.clip(speed, 4.0, 10.0)), exponent))
            mean = traffic.headway - traffic.minimum_headway
            time += traffic.minimum_headway + rng.exponential(mean)
    return [arrival._replace(body_id=f"V{i}") for i, arrival in enumerate(in_order(drawn), 1)]


def given_arrivals(vehicles: Iterable[ExplicitVehicle]) -> list[Arrival]:
    """The arrivals of those vehicles that enter the road."""
    return [
        Arrival(
            vehicle.enters,
            vehicle.id,
            route(ARMS.index(vehicle.arm), vehicle.turn),
            vehicle.speed,
            vehicle.exponent,
        )
        for vehicle in vehicles
        if vehicle.enters is not None
    ]


def in_order(arrivals: Iterable[Arrival]) -> list[Arrival]:
    """The arrivals by time, and by arm for those that enter together."""
    return sorted(arrivals, key=lambda arrival: (arrival.time, arrival.plan.origin))


def without_room(world: DrivingWorld, arrivals: Iterable[Arrival]) -> list[str]:
    """Ids of arrivals that should be on the road at the start, at places that others take."""
    taken = defaultdict(list, {0: [ARM_LENGTH - world.ego.distance]})
    for vehicle in world.vehicles:
        if vehicle.distance is not None:
            taken[ARMS.index(vehicle.arm)].append(ARM_LENGTH - vehicle.distance)
    absent = []
    for arrival in in_order(arrivals):
        if arrival.time > 0.0:
            break
        if has_room(arrival.start, taken[arrival.plan.origin]):
            taken[arrival.plan.origin].append(arrival.start)
        else:
            absent.append(arrival.body_id)
    return absent


def concrete_world(world: Mapping[str, Any], duration: float, seed: int) -> dict[str, Any]:
    """The world with the cars that a seed draws among its vehicles, and no random traffic.

    Its episodes are the same to the last bit, with the same ids. Cars that find no room on the road
    at the start never come, and are not among them.

    Args:
        world: As in a scenario file.
        duration: Of the episode, in s.
        seed: Of the episode.

    Returns:
        The world with defaults filled in.
    """
    model = DrivingWorld.model_validate(dict(world))
    if model.traffic is not None:
        drawn = drawn_arrivals(model.traffic, seed, duration)
        absent = without_room(model, [*given_arrivals(model.vehicles), *drawn])
        cars = [_vehicle(arrival) for arrival in drawn if arrival.body_id not in absent]
        model = model.model_copy(update={"traffic": None, "vehicles": (*model.vehicles, *cars)})
    return model.model_dump(mode="json")


def _vehicle(car: Arrival) -> ExplicitVehicle:
    return ExplicitVehicle.model_validate(
        {
            "id": car.body_id,
            "arm": ARMS[car.plan.origin],
            "turn": car.plan.turn,
            "enters": car.time,
            "speed": car.speed,
            "exponent": car.exponent,
        }
    )
