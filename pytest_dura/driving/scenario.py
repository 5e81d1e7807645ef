"""World of a driving scenario: vehicles, pedestrians, obstacles and lights, given or drawn."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import (
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    SerializerFunctionWrapHandler,
    Tag,
    ValidationInfo,
    field_validator,
    model_serializer,
    model_validator,
)

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.seeding import stream
from pytest_dura.domains import Unit
from pytest_dura.driving.lanes import Route, route_between
from pytest_dura.driving.roads import BUILT_IN, FOUR_WAY, Arm, Lanes, Road, Turn, named_road

ArmName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,15}$")]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]

_EARLIEST = -9.0
"""Seconds; no car is on the road for longer when an episode begins."""
_Distance = Annotated[float, Field(ge=3, allow_inf_nan=False)]
_Entry = Annotated[float, Field(ge=_EARLIEST, allow_inf_nan=False)]


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


def _refuse_both(who: str, way: Any) -> None:
    if way.to is not None and "turn" in way.model_fields_set:
        raise ValueError(f"{who} has both a `turn` and an arm to go `to`; give one of the two")


def _without_defaults(data: dict[str, Any], keys: Iterable[str]) -> dict[str, Any]:
    """The data without these keys where they are none, and without a turn that ``to`` replaces."""
    if data.get("to") is not None:
        del data["turn"]
    return {key: value for key, value in data.items() if key not in keys or value is not None}


class ArmData(_Model):
    """An arm of a road, with a lane in each direction or in one; traffic keeps to the right."""

    name: ArmName = Field(description="Its name in the scenario.")
    bearing: Annotated[float, Field(ge=0, lt=360)] = Field(
        description="Where it leads, seen from the centre: degrees of a compass, north 0, east 90."
    )
    priority: Annotated[int, Field(ge=1, le=9)] = Field(
        1, description="Right of way: the greater goes first; a left turn counts as one less."
    )
    length: Annotated[float, Field(ge=60, le=400), Unit("m")] = Field(
        100.0, description="From its outer end to the stop line, in m."
    )
    stop_line: Annotated[float, Field(ge=4, le=60), Unit("m")] = Field(
        11.0, description="From the centre to the stop line, in m."
    )
    lane_width: Annotated[float, Field(ge=2.6, le=6), Unit("m")] = Field(
        4.0, description="Of each lane, in m."
    )
    lanes: Lanes = Field(
        "both", description="Lanes towards the junction (in), away from it (out), or both."
    )


class RoadData(_Model):
    """A road that a scenario describes: one junction."""

    arms: Annotated[tuple[ArmData, ...], Field(strict=False, max_length=8)] = Field(
        description="At least two; the ego comes from the first one, unless it says otherwise."
    )
    speed_limit: Annotated[float, Field(ge=3, le=20), Unit("m/s")] = Field(
        10.0, description="In m/s."
    )

    @field_validator("arms")
    @classmethod
    def _at_least_two(cls, arms: tuple[ArmData, ...]) -> tuple[ArmData, ...]:
        # Not by `min_length`, which counts an arm with an error of its own as missing.
        if len(arms) < 2:
            raise ValueError(f"a road has at least two arms, and this one has {len(arms)}")
        return arms

    def road(self) -> Road:
        """The road that it describes."""
        arms = tuple(Arm(**arm.model_dump()) for arm in self.arms)
        return Road("custom", arms, self.speed_limit)


def _kind_of_road(value: object) -> str:
    return "<data>" if isinstance(value, (Mapping, RoadData)) else "<name>"


class EgoStart(_Model):
    """Where the ego comes from and goes to."""

    distance: Annotated[float, Field(gt=5, allow_inf_nan=False), Unit("m")] = Field(
        50.0,
        description="From its centre to the stop line, in m; at most its arm's length less 5 m.",
    )
    speed: Annotated[float, Field(ge=0, le=10), Unit("m/s")] = Field(
        8.0, description="At the start, in m/s."
    )
    turn: Turn = Field("straight", description="Where it goes.")
    arm: ArmName | None = Field(
        None, description="Where it comes from; by default the road's first arm, the south."
    )
    to: ArmName | None = Field(None, description="Instead of a turn: the arm on which it leaves.")

    @model_validator(mode="after")
    def _turn_or_to(self) -> EgoStart:
        _refuse_both("the ego", self)
        return self

    @model_serializer(mode="wrap")
    def _plain(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Without what older worlds do not have where it is at its default: digests stay equal."""
        return _without_defaults(handler(self), ("arm", "to"))


class Turns(_Model):
    """Weights of the turns that drivers take."""

    left: NotNegative = 0.15
    straight: Positive = 0.7
    right: NotNegative = 0.15


class Traffic(_Model):
    """Random traffic: arrivals at the outer end of each arm."""

    headway: Annotated[Positive, Unit("s")] = Field(
        22.0, description="Mean time between two arrivals on one arm, in s (exponential, shifted)."
    )
    minimum_headway: Annotated[Positive, Unit("s")] = Field(
        2.5,
        description="Least time between two arrivals, in s; less than the mean.",
        validate_default=True,
    )
    arms: tuple[ArmName, ...] | None = Field(
        None, strict=False, description="Arms with traffic; by default all but the ego's."
    )
    speed: Annotated[float, Field(gt=0, le=10), Unit("m/s")] = Field(
        8.0, description="Mean speed, in m/s."
    )
    speed_deviation: Annotated[float, Field(ge=0, le=2), Unit("m/s")] = Field(
        0.7, description="In m/s."
    )
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
    arm: ArmName = Field(description="Where it comes from.")
    turn: Turn = Field("straight", description="Where it goes.")
    to: ArmName | None = Field(None, description="Instead of a turn: the arm on which it leaves.")
    distance: Annotated[_Distance | None, Unit("m")] = Field(
        None,
        description="From its centre to its stop line at the start, in m; at most its arm's length "
        "less 1 m.",
    )
    enters: Annotated[_Entry | None, Unit("s")] = Field(
        None,
        description="Instead of the distance: when it enters the road at the outer end of its arm, "
        "once there is room, in s. Before 0, it has driven on at its speed until the start.",
    )
    speed: Annotated[float, Field(ge=0, le=10), Unit("m/s")] = Field(
        8.0, description="At the start, or when it enters, in m/s."
    )
    exponent: Annotated[float, Field(ge=1, le=10)] = Field(
        4.0, description="Of the free acceleration in the Intelligent Driver Model."
    )
    gives_way: bool = Field(
        True,
        description="Whether it stops for who has the right of way and for traffic lights; a car "
        "that does not still follows the car ahead.",
    )
    brakes_at: Annotated[NotNegative | None, Unit("s")] = Field(
        None,
        description="When it brakes as hard as a dry road allows, 8 m/s2, in s; it then stands, "
        "and drives on 6 s after it began.",
    )

    @model_validator(mode="after")
    def _somewhere(self) -> ExplicitVehicle:
        if self.distance is None and not (self.gives_way and self.brakes_at is None):
            raise ValueError(
                f"the vehicle {self.id} needs a `distance`, to brake or to give no way"
            )
        if (self.distance is None) == (self.enters is None):
            raise ValueError(
                f"the vehicle {self.id} needs one of `distance`, at the start, and `enters`"
            )
        _refuse_both(f"the vehicle {self.id}", self)
        return self

    def route(self, road: Road) -> Route:
        """Its route on a road."""
        origin = road.arm(self.arm)
        return route_between(road, origin, _destination(road, origin, self.turn, self.to))

    @model_serializer(mode="wrap")
    def _plain(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Without what older worlds do not have where it is at its default: digests stay equal."""
        data = _without_defaults(handler(self), ("distance", "enters", "to", "brakes_at"))
        if self.gives_way:
            del data["gives_way"]
        if self.exponent == ExplicitVehicle.model_fields["exponent"].default:
            del data["exponent"]
        return data


class PedestrianStart(_Model):
    """A pedestrian who crosses an arm from kerb to kerb."""

    id: Annotated[str, Field(pattern=r"^[A-Z][A-Z0-9_]{0,15}$")] = "P1"
    arm: ArmName = Field("south", description="The arm that is crossed.")
    offset: Annotated[float, Field(ge=1, le=60), Unit("m")] = Field(
        3.0, description="From the stop line outwards, in m."
    )
    side: Literal["left", "right"] = Field(
        "right", description="Where it comes from, seen by a driver who nears the junction."
    )
    start: Annotated[NotNegative, Unit("s")] = Field(
        2.0, description="When it steps off the kerb, in s."
    )
    speed: Annotated[float, Field(gt=0, le=3), Unit("m/s")] = Field(1.3, description="In m/s.")


class CyclistStart(_Model):
    """A cyclist who crosses an arm without looking, on a machine of 1.8 m by 0.6 m."""

    id: Annotated[str, Field(pattern=r"^[A-Z][A-Z0-9_]{0,15}$")] = Field(
        description="Its name in records; as for vehicles."
    )
    arm: ArmName = Field("south", description="The arm that is crossed.")
    offset: Annotated[float, Field(ge=1, le=60), Unit("m")] = Field(
        3.0, description="From the stop line outwards, in m."
    )
    side: Literal["left", "right"] = Field(
        "right", description="Where it comes from, seen by a driver who nears the junction."
    )
    approach: Annotated[float, Field(ge=0, le=40), Unit("m")] = Field(
        0.0, description="How far from the kerb it starts, in m."
    )
    start: Annotated[NotNegative, Unit("s")] = Field(0.0, description="When it starts, in s.")
    speed: Annotated[float, Field(gt=0, le=8), Unit("m/s")] = Field(4.5, description="In m/s.")


_LONGEST_PART = 20.0
"""m; what is longer is reported in parts."""


class Part(NamedTuple):
    """A body that an obstacle consists of: its place as the obstacle's, length and width in m."""

    id: str
    kind: str
    offset: float
    beside: float
    size: tuple[float, float]


class StaticObstacle(_Model):
    """Something that stands on or beside an arm, and that lidar and radar see like any object."""

    id: Annotated[str, Field(pattern=r"^[A-Z][A-Z0-9_]{0,15}$")] = Field(
        description="Its name in records; as for vehicles."
    )
    kind: Literal["parked_car", "parked_van", "hedge", "cones", "island"] = Field(
        description="A car of 4.5 by 1.8 m, a van of 6 by 2 m, a hedge of 60 by 1.6 m, a row of "
        "cones of 3 by 0.4 m, or a kerb island of 6 by 1 m; its length lies along the arm. A hedge "
        "is reported as three bodies of 20 m."
    )
    arm: ArmName = "south"
    offset: Annotated[NotNegative, Unit("m")] = Field(
        description="From the stop line outwards to its centre, in m; at most the arm's length "
        "less 1 m."
    )
    beside: Annotated[float, Field(ge=-15, le=15), Unit("m")] = Field(
        description="From the middle of the road to its centre, in m; positive to the right of a "
        "driver who nears the junction. The lane towards it is 4 m wide."
    )

    @property
    def size(self) -> tuple[float, float]:
        """Length and width in m."""
        return {
            "parked_car": (4.5, 1.8), "parked_van": (6.0, 2.0), "hedge": (60.0, 1.6),
            "cones": (3.0, 0.4), "island": (6.0, 1.0),
        }[self.kind]  # fmt: skip

    def parts(self) -> list[Part]:
        """The bodies of which it consists, from the junction outwards; the first has its id.

        Planners and monitors cover a body by three discs. Those of a hedge of 60 m in one piece
        reach 9 m beside it, so that who drives along it would be predicted to meet it; those of
        20 m reach 2.6 m.
        """
        length, width = self.size
        number = max(round(length / _LONGEST_PART), 1)
        each = length / number
        first = self.offset - (length - each) / 2.0
        names = [self.id, *(f"{self.id}.{part}" for part in range(2, number + 1))]
        return [
            Part(name, self.kind, first + each * row, self.beside, (each, width))
            for row, name in enumerate(names)
        ]


class Phase(_Model):
    """What a traffic light shows for some time."""

    state: Literal["red", "yellow", "green"]
    lasts: Annotated[Positive, Unit("s")] = Field(description="In s.")


class TrafficLight(_Model):
    """A light at the stop lines of some arms, whose phases follow each other again and again.

    Drivers stop at red and yellow, where they can. Between those who may go, the signs decide, and
    so they do for requirements on the right of way.
    """

    arms: tuple[ArmName, ...] = Field(strict=False, min_length=1)
    phases: tuple[Phase, ...] = Field(strict=False, min_length=1)
    offset: Annotated[NotNegative, Unit("s")] = Field(
        0.0, description="How far into its phases it begins, in s."
    )

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

    road: Annotated[
        Annotated[str, Tag("<name>")] | Annotated[RoadData, Tag("<data>")],
        Discriminator(_kind_of_road),
    ] = Field(
        FOUR_WAY.name,
        description=f"A built-in road ({', '.join(BUILT_IN)}), or the data of another.",
    )
    ego: EgoStart = EgoStart()
    traffic: Traffic | None = Field(None, description="Random traffic; left out, there is none.")
    vehicles: tuple[ExplicitVehicle, ...] = Field((), strict=False)
    pedestrians: tuple[PedestrianStart, ...] = Field((), strict=False)
    cyclists: tuple[CyclistStart, ...] = Field((), strict=False)
    occlusion: bool = Field(
        False,
        description="Whether cars, vans and hedges hide from lidar and radar what is behind them; "
        "by default the sensors see everybody within their reach.",
    )
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
        if self.road == FOUR_WAY.name:
            del data["road"]
        if self.traffic is not None and self.traffic.arms is None:
            data["traffic"]["arms"] = self._other_arms()
        if not self.obstacles:
            del data["obstacles"]
        if not self.cyclists:
            del data["cyclists"]
        if not self.occlusion:
            del data["occlusion"]
        if not self.controls.signals:
            del data["controls"]
        return data

    @property
    def geometry(self) -> Road:
        """The road.

        Raises:
            ConfigurationError: If there is none of this name.
        """
        return named_road(self.road) if isinstance(self.road, str) else self.road.road()

    @property
    def ego_route(self) -> Route:
        """The ego's route.

        Raises:
            ConfigurationError: If it leaves the road.
        """
        road, ego = self.geometry, self.ego
        origin = 0 if ego.arm is None else road.arm(ego.arm, "world.ego.arm")
        way = _destination(road, origin, ego.turn, ego.to, "world.ego")
        return route_between(road, origin, way)

    def _other_arms(self) -> list[str]:
        """The arms that others may come from, and the ego does not."""
        own = self.ego.arm or self.geometry.names[0]
        return [name for name in self.geometry.entries if name != own]


def _destination(road: Road, origin: int, turn: str, to: str | None, key: str | None = None) -> int:
    """The number of the arm on which a road user leaves; ``key`` is who, in the scenario."""
    if to is None:
        return road.destination(origin, turn, key and f"{key}.turn")
    number = road.arm(to, key and f"{key}.to")
    ways = road.destinations(origin)
    if number in ways:
        return number
    name = road.names[origin]
    raise ConfigurationError(
        f"no route leads from the arm {name} to the arm {to} of the road {road.name}",
        key=key and f"{key}.to",
        found=to,
        expected="one of " + ", ".join(road.names[way] for way in ways)
        if ways
        else "another `arm`: no traffic can come from this one",
        remedy="name another arm",
    )


def check_road(world: DrivingWorld) -> None:
    """Refuse a road that cannot be, and what of the world is not on it.

    Raises:
        ConfigurationError: With the key, the value and what could stand there.
    """
    road = world.geometry
    road.check()
    ego = world.ego_route
    _check_distance("world.ego.distance", world.ego.distance, ego.stop_line - 5.0, ego.arm.name)
    for index, vehicle in enumerate(world.vehicles):
        key = f"world.vehicles.{index}"
        origin = road.arm(vehicle.arm, f"{key}.arm")
        _destination(road, origin, vehicle.turn, vehicle.to, key)
        if vehicle.distance is not None:
            most = road.arms[origin].length - 1.0
            _check_distance(f"{key}.distance", vehicle.distance, most, vehicle.arm)
    crowds: dict[str, Sequence[PedestrianStart | CyclistStart | StaticObstacle]] = {
        "pedestrians": world.pedestrians,
        "cyclists": world.cyclists,
        "obstacles": world.obstacles,
    }
    for kind, things in crowds.items():
        for index, thing in enumerate(things):
            key = f"world.{kind}.{index}"
            arm = road.arms[road.arm(thing.arm, f"{key}.arm")]
            _check_distance(f"{key}.offset", thing.offset, arm.length - 1.0, arm.name)
    for number, light in enumerate(world.controls.signals):
        for name in light.arms:
            road.arm(name, f"world.controls.signals.{number}.arms")
    if world.traffic is not None:
        for name in world.traffic.arms or ():
            road.arm(name, "world.traffic.arms")
            if name not in road.entries:
                raise ConfigurationError(
                    f"no traffic can come from the arm {name} of the road {road.name}",
                    key="world.traffic.arms",
                    found=name,
                    expected="some of " + ", ".join(road.entries),
                    remedy="leave it out",
                )


def _check_distance(key: str, distance: float, most: float, arm: str) -> None:
    if distance > most:
        raise ConfigurationError(
            f"that far out, the arm {arm} has ended",
            key=key,
            found=distance,
            expected=f"at most {most:g} m",
            remedy="bring it nearer to the stop line, or make the arm longer",
        )


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


def drawn_arrivals(
    traffic: Traffic | None, seed: int, duration: float, road: Road = FOUR_WAY
) -> list[Arrival]:
    """All arrivals of random traffic in an episode, in order of time.

    Drawn beforehand, one stream per arm: what the ego does cannot change the traffic's demand.
    Several ways that are the same turn share its weight, and the other turns that of a missing one.
    """
    if traffic is None:
        return []
    drawn = []
    for arm in road.entries[1:] if traffic.arms is None else traffic.arms:
        origin = road.arm(arm)
        ways = road.destinations(origin)
        turns = [road.turn(origin, way) for way in ways]
        weights = np.array([getattr(traffic.turns, turn) / turns.count(turn) for turn in turns])
        if not weights.any():
            continue  # no car takes any of the turns that there are
        rng = stream(seed, f"traffic:{arm}")
        # Cars that entered up to nine seconds ago are on the arm when the episode begins.
        time = _EARLIEST + rng.exponential(traffic.headway)
        while time < duration:
            way = ways[int(rng.choice(len(ways), p=weights / weights.sum()))]
            speed = float(rng.normal(traffic.speed, traffic.speed_deviation))
            exponent = float(rng.uniform(3.5, 4.5))
            plan = route_between(road, origin, way)
            drawn.append(Arrival(time, "", plan, float(np.clip(speed, 4.0, 10.0)), exponent))
            mean = traffic.headway - traffic.minimum_headway
            time += traffic.minimum_headway + rng.exponential(mean)
    return [arrival._replace(body_id=f"V{i}") for i, arrival in enumerate(in_order(drawn), 1)]


def given_arrivals(vehicles: Iterable[ExplicitVehicle], road: Road = FOUR_WAY) -> list[Arrival]:
    """The arrivals of those vehicles that enter the road."""
    return [
        Arrival(
            vehicle.enters,
            vehicle.id,
            vehicle.route(road),
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
    ego, road = world.ego_route, world.geometry
    taken = defaultdict(list, {ego.origin: [ego.stop_line - world.ego.distance]})
    for vehicle in world.vehicles:
        if vehicle.distance is not None:
            origin = road.arm(vehicle.arm)
            taken[origin].append(road.arms[origin].length - vehicle.distance)
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
        road = model.geometry
        traffic = model.model_dump()["traffic"]
        drawn = drawn_arrivals(Traffic.model_validate(traffic), seed, duration, road)
        absent = without_room(model, [*given_arrivals(model.vehicles, road), *drawn])
        cars = [_vehicle(arrival) for arrival in drawn if arrival.body_id not in absent]
        model = model.model_copy(update={"traffic": None, "vehicles": (*model.vehicles, *cars)})
    return model.model_dump(mode="json")


def _vehicle(car: Arrival) -> ExplicitVehicle:
    return ExplicitVehicle.model_validate(
        {
            "id": car.body_id,
            "arm": car.plan.arm.name,
            **_way(car.plan),
            "enters": car.time,
            "speed": car.speed,
            "exponent": car.exponent,
        }
    )


def _way(plan: Route) -> dict[str, str]:
    """A route as a vehicle's ``turn``, or its ``to`` where a turn does not say which arm."""
    road, ways = plan.road, plan.road.destinations(plan.origin)
    if sum(road.turn(plan.origin, way) == plan.turn for way in ways) > 1:
        return {"to": plan.leaves.name}
    return {"turn": plan.turn}
