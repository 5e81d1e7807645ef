"""Faults of and attacks on the list of perceived objects, and the bases of driving's faults.

They touch the percept only, never the road, and radar still sees every object where it is. Where
the ego is, they take from the channel ``localisation``, with the faults that are declared earlier.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from pytest_dura.driving.bodies import (
    CAR_LENGTH,
    CAR_WIDTH,
    LENGTH,
    PEDESTRIAN_SIZE,
    WIDTH,
    Body,
    BodyList,
)
from pytest_dura.driving.sensors import RANGE
from pytest_dura.faults.model import FaultEffect, Kind, Moment
from pytest_dura.faults.parts import FaultPart, Finite, NotNegative, Positive, Share, Span

Ids = Annotated[tuple[str, ...], Field(strict=False)]
"""Ids of objects; a list in a scenario file."""


class Selection(FaultPart):
    """Which objects a fault is about; by default all that are reported."""

    ids: Ids | None = Field(None, description="Ids of the objects; null for all.")
    nearest: Annotated[int, Field(ge=1)] | None = Field(
        None, description="Only so many of them: those nearest to the ego at each tick."
    )

    def rows(self, bodies: BodyList, pose: Any) -> list[int]:
        """Rows of the selected objects, in the order of the list."""
        rows = [row for row, name in enumerate(bodies.ids) if self.ids is None or name in self.ids]
        if self.nearest is None:
            return rows
        return sorted(sorted(rows, key=lambda row: distance(bodies[row], pose))[: self.nearest])


def distance(body: Body, pose: Any) -> tuple[float, str]:
    """Metres from a pose to a body's centre, and its id, which decides between equal ones."""
    return math.hypot(body.x - pose.x, body.y - pose.y), body.id


class ObjectFault(FaultEffect):
    """Base of the faults that tamper with a list of objects, which only lidar reports."""

    acts_on: ClassVar[Kind] = "objects"
    default_target: ClassVar[str | None] = "lidar"
    lasting: ClassVar[float | str] = 5.0


class PoseFault(FaultEffect):
    """Base of the faults that tamper with a pose, which only ``localisation`` reports."""

    acts_on: ClassVar[Kind] = "pose"
    default_target: ClassVar[str | None] = "localisation"
    lasting: ClassVar[float | str] = 5.0


class MissParameters(Selection):
    """How often an object is missed, and which ones are."""

    probability: Annotated[Share, Span(0.0, 1.0)] = Field(
        0.3, description="Of a miss, for each object and tick."
    )


class ObjectMiss(ObjectFault):
    """Objects are not reported, each at each tick with the same probability (false negatives)."""

    parameters: MissParameters = MissParameters()

    @property
    def hits_by_chance(self) -> bool:
        """Whether draws decide: not where nothing or everything is missed."""
        return 0.0 < self.parameters.probability < 1.0

    def apply(self, memory: Any, value: BodyList, moment: Moment) -> BodyList:
        """The objects that are not missed, in their order."""
        drawn = moment.rng.random(len(value))
        chosen = self.parameters.rows(value, moment.channels["localisation"])
        missed = {row for row in chosen if drawn[row] < self.parameters.probability}
        return value.rows([row for row in range(len(value)) if row not in missed])


class PositionNoiseParameters(Selection):
    """How far positions scatter, and whose do."""

    # From then on an object is anywhere on the road but where it is.
    sigma: Annotated[NotNegative, Span(0.0, 5.0, unit="m")] = Field(
        0.5, description="Standard deviation of the normal error of x and of y, in m."
    )


class PositionNoise(ObjectFault):
    """Reported positions scatter around the real ones, independently at each tick.

    Headings, velocities and sizes are reported as they are.
    """

    parameters: PositionNoiseParameters = PositionNoiseParameters()

    def apply(self, memory: Any, value: BodyList, moment: Moment) -> BodyList:
        """The objects at scattered places."""
        drawn = moment.rng.standard_normal((len(value), 2))
        rows = self.parameters.rows(value, moment.channels["localisation"])
        if not rows or self.parameters.sigma == 0.0:
            return value
        data = value.data.copy()
        data[rows, :2] += self.parameters.sigma * drawn[rows]
        return BodyList(value.ids, data)


class RangeCutParameters(FaultPart):
    """How far the sensor still reaches."""

    reach: Annotated[NotNegative, Span(0.0, RANGE, neutral=RANGE)] = Field(
        25.0, description="Metres from the ego's centre to an object's, beyond which there is none."
    )


class RangeCut(ObjectFault):
    """Nothing beyond some distance is reported, as in fog. From 80 m on, it cuts nothing."""

    parameters: RangeCutParameters = RangeCutParameters()

    def apply(self, memory: Any, value: BodyList, moment: Moment) -> BodyList:
        """The objects within reach, in their order."""
        pose, reach = moment.channels["localisation"], self.parameters.reach
        near = [row for row, body in enumerate(value) if distance(body, pose)[0] <= reach]
        return value.rows(near)


class ClassChangeParameters(Selection):
    """Whose class is mistaken, and for which."""

    becomes: Literal["other", "car", "pedestrian"] = Field(
        "other", description="The class that is reported; `other`: each of the two for the other."
    )
    probability: Annotated[Share, Span(0.0, 1.0)] = Field(
        1.0, description="That an object is mistaken; drawn when it first comes into sight."
    )


class ClassChange(ObjectFault):
    """Cars are reported with a pedestrian's size, pedestrians with a car's, about their centres.

    Sensors report sizes, not classes. A mistaken object stays so until the fault ends.
    """

    parameters: ClassChangeParameters = ClassChangeParameters()

    @property
    def hits_by_chance(self) -> bool:
        """Whether draws decide: not where none or all are mistaken."""
        return 0.0 < self.parameters.probability < 1.0

    def begin(self, value: BodyList, moment: Moment) -> dict[str, bool]:
        """Whether an object is mistaken, by id; filled as objects come into sight."""
        return {}

    def apply(self, memory: dict[str, bool], value: BodyList, moment: Moment) -> BodyList:
        """The objects with the sizes of the class that they are taken for."""
        for name in value.ids:
            if name not in memory:
                memory[name] = bool(moment.rng.random() < self.parameters.probability)
        sizes = {}
        for row in self.parameters.rows(value, moment.channels["localisation"]):
            body = value[row]
            walks = self.parameters.becomes == "pedestrian"
            if self.parameters.becomes == "other":
                walks = not body.is_pedestrian
            if memory[body.id] and walks != body.is_pedestrian:
                sizes[row] = (PEDESTRIAN_SIZE,) * 2 if walks else (CAR_LENGTH, CAR_WIDTH)
        if not sizes:
            return value
        data = value.data.copy()
        data[list(sizes), LENGTH : WIDTH + 1] = np.array(list(sizes.values()))
        return BodyList(value.ids, data)


class IdSwitchParameters(FaultPart):
    """Which two objects the tracker mistakes for each other."""

    ids: Ids | None = Field(
        None, description="Two ids; null for the object nearest to the ego and its own neighbour."
    )

    @model_validator(mode="after")
    def _two(self) -> IdSwitchParameters:
        if self.ids is not None and (len(self.ids) != 2 or self.ids[0] == self.ids[1]):
            raise ValueError("an id switch is between two different objects")
        return self


class IdSwitch(ObjectFault):
    """Two objects carry each other's id. Everything else is reported as it is, in its order.

    A tracker that follows objects by their ids sees both leap. It waits until there are two.
    """

    parameters: IdSwitchParameters = IdSwitchParameters()

    def begin(self, value: BodyList, moment: Moment) -> dict[str, str] | None:
        """The id that is reported in an id's place; ``None`` while there are not two objects."""
        ids = self.parameters.ids
        if ids is not None:
            return dict(zip(ids, reversed(ids), strict=True)) if set(ids) <= {*value.ids} else None
        if len(value) < 2:
            return None
        pose = moment.channels["localisation"]
        first = min(value, key=lambda body: distance(body, pose))
        others = [body for body in value if body.id != first.id]
        second = min(others, key=lambda body: distance(body, first))
        return {first.id: second.id, second.id: first.id}

    def apply(self, memory: dict[str, str], value: BodyList, moment: Moment) -> BodyList:
        """The objects with the two ids exchanged; one that is alone in sight has the other's."""
        return BodyList(tuple(memory.get(name, name) for name in value.ids), value.data)


class MovedParameters(FaultPart):
    """By how much an object is misplaced, along which direction, and which one."""

    dx: Annotated[Finite, Span(-20.0, 20.0, unit="m")] = Field(
        0.0, description="Metres along the direction; negative is backward."
    )
    # Two lanes and a half to either side.
    dy: Annotated[Finite, Span(-10.0, 10.0, unit="m")] = Field(
        0.0, description="Metres across it; positive is to the right."
    )
    frame: Literal["route", "object"] = Field(
        "route",
        description="The direction: of the ego's route beside the object when it begins, or the"
        " object's own heading at each tick.",
    )
    id: str | None = Field(None, description="Id of the object; null for the nearest one.")


class MovedObstacle(ObjectFault):
    """A real object is reported a fixed offset away from where it is; it moves as it does.

    It waits until the object is in sight.
    """

    parameters: MovedParameters = MovedParameters()

    # Farther along the ego's route, which lets it seem farther away than it is.
    typical: ClassVar[Mapping[str, Any]] = {"dx": 5.0}

    def begin(self, value: BodyList, moment: Moment) -> tuple[str, float] | None:
        """The victim's id and the route's heading beside it; ``None`` while it is not in sight."""
        pose, route = moment.channels["localisation"], moment.channels["map"].route
        victim_id = self.parameters.id
        bodies = [body for body in value if victim_id in (None, body.id)]
        if not bodies:
            return None
        victim = min(bodies, key=lambda body: distance(body, pose))
        return victim.id, route.heading_at(route.project(victim.x, victim.y)[0])

    def apply(self, memory: tuple[str, float], value: BodyList, moment: Moment) -> BodyList:
        """The objects with the victim out of its place."""
        name, heading = memory
        body, parameters = value.get(name), self.parameters
        if body is None or parameters.dx == parameters.dy == 0.0:
            return value
        if parameters.frame == "object":
            heading = body.heading
        c, s = math.cos(heading), math.sin(heading)
        # y points south, so that right of the heading (c, s) is (-s, c).
        moved = body._replace(
            x=body.x + parameters.dx * c - parameters.dy * s,
            y=body.y + parameters.dx * s + parameters.dy * c,
        )
        return value.with_body(moved)


class GhostParameters(FaultPart):
    """Where the ghost appears, how large it is, and how it moves."""

    place: Literal["ego", "junction"] = Field(
        "ego",
        description="Where `ahead` is measured from: the ego's front, or the stop line before it.",
    )
    # Farther away a car at the speed limit of 10 m/s stops for it without any haste.
    ahead: Annotated[Positive, Span(2.0, 60.0, neutral=60.0, unit="m")] = Field(
        14.0,
        description="Metres on the ego's route, from `place` to the ghost's near end, when it"
        " appears.",
    )
    # Two lanes to either side. Of where and how it stands, and of its size, none is milder than
    # another: the simplest is a car on the route.
    lateral: Annotated[Finite, Span(-8.0, 8.0, unit="m")] = Field(
        0.0, description="Metres beside that place on the route; positive is to the right."
    )
    heading: Annotated[Finite, Span(-3.14, 3.14, unit="rad")] = Field(
        0.0, description="Radians to the right of the route's heading there."
    )
    speed: Annotated[NotNegative, Span(0.0, 10.0, unit="m/s")] = Field(
        0.0, description="Along its own heading, straight on, in m/s."
    )
    length: Annotated[Positive, Span(0.5, 12.0, neutral=CAR_LENGTH, unit="m")] = Field(
        CAR_LENGTH, description="In m."
    )
    width: Annotated[Positive, Span(0.5, 3.0, neutral=CAR_WIDTH, unit="m")] = Field(
        CAR_WIDTH, description="In m."
    )


class GhostObstacle(ObjectFault):
    """An object that is not there: lidar reports a car on the ego's route, standing by default."""

    parameters: GhostParameters = GhostParameters()

    lasting: ClassVar[float | str] = 4.0

    def begin(self, value: BodyList, moment: Moment) -> Body:
        """The ghost as it appears."""
        parameters, channels, rng = self.parameters, moment.channels, moment.rng
        pose, way = channels["localisation"], channels["map"]
        start = way.stop_line
        if parameters.place == "ego":
            start = way.route.project(pose.x, pose.y)[0] + CAR_LENGTH / 2
        s = start + parameters.ahead + parameters.length / 2
        x, y, heading = (float(value) for value in way.route.pose(s))
        # y points south, so that right of the heading (c, s) is (-s, c).
        x, y = (
            x - parameters.lateral * math.sin(heading),
            y + parameters.lateral * math.cos(heading),
        )
        heading += parameters.heading
        # Adding 0 makes -0 of a standing ghost 0.
        velocity = (
            parameters.speed * math.cos(heading) + 0.0,
            parameters.speed * math.sin(heading) + 0.0,
        )
        name = f"V{900 + int(rng.integers(100))}"  # looks like any other id
        return Body(name, x, y, heading, *velocity, parameters.length, parameters.width)

    def apply(self, memory: Body, value: BodyList, moment: Moment) -> BodyList:
        """The objects with the ghost among them."""
        x, y = memory.x + memory.vx * moment.elapsed, memory.y + memory.vy * moment.elapsed
        return value.with_body(memory._replace(x=x, y=y))


class SpoofParameters(FaultPart):
    """Which vehicle is spoofed, and how it seems to move."""

    victim: Literal["nearest", "oncoming"] = Field(
        "nearest",
        description="The nearest car, or the nearest one that comes towards the ego: that lies"
        " ahead and heads within 45 degrees of the opposite direction. Without one it waits.",
    )
    magnitude: Annotated[Share, Span(0.0, 1.0)] = Field(
        1.0, description="0 leaves the vehicle where it is, 1 puts it wholly on the false path."
    )
    spoofs: Literal["path", "velocity"] = Field(
        "path",
        description="`path`: position, heading and velocity; `velocity`: the velocity alone.",
    )
    velocity: Annotated[tuple[Finite, Finite], Field(strict=False)] | None = Field(
        None,
        description="The false velocity in m/s, along the ego's route beside the vehicle and to"
        " the right of it; null: the one that leads it to where `lead` says.",
    )
    lead: Annotated[Positive, Span(0.5, 5.0, neutral=5.0, unit="s")] = Field(
        2.0, description="The false path meets the ego's route this many seconds ahead of the ego."
    )
    # The longer it takes, the slower the vehicle seems to come.
    duration: Annotated[Positive, Span(0.5, 10.0, neutral=10.0, unit="s")] = Field(
        4.0, description="Seconds until the false path ends."
    )


class TrajectorySpoof(ObjectFault):
    """A real vehicle's course is replaced by one that cuts the ego off, or by a given one.

    Either position and velocity are false or, with ``spoofs: velocity``, the velocity alone. Radar
    still sees the vehicle where it is.
    """

    parameters: SpoofParameters = SpoofParameters()

    def begin(self, value: BodyList, moment: Moment) -> Any:
        """The victim and its false path; ``None`` while there is no such car within sight."""
        parameters, pose = self.parameters, moment.channels["localisation"]
        route = moment.channels["map"].route
        cars = [body for body in value if not body.is_pedestrian]
        if parameters.victim == "oncoming":
            cars = [body for body in cars if _is_oncoming(body, pose)]
        if not cars:
            return None
        victim = min(cars, key=lambda body: distance(body, pose))
        if parameters.velocity is not None:
            heading = route.heading_at(route.project(victim.x, victim.y)[0])
            (along, right), c, s = parameters.velocity, math.cos(heading), math.sin(heading)
            return victim, along * c - right * s, along * s + right * c
        s, _ = route.project(pose.x, pose.y)
        meet = s + CAR_LENGTH + max(moment.channels["odometry"].speed, 3.0) * parameters.lead
        x, y, _ = (float(value) for value in route.pose(meet))
        return victim, (x - victim.x) / parameters.duration, (y - victim.y) / parameters.duration

    def apply(self, memory: Any, value: BodyList, moment: Moment) -> BodyList:
        """The objects with the victim on its false path, where it stops at the end."""
        start, vx, vy = memory
        elapsed, real = moment.elapsed, value.get(start.id)
        share = self.parameters.magnitude
        if real is None or share == 0.0:
            return value
        time = min(elapsed, self.parameters.duration)
        moving = 1.0 if elapsed < self.parameters.duration else 0.0
        # The shorter way round: halfway between 179 and -179 degrees lies 180.
        turn = math.remainder(math.atan2(vy, vx) - real.heading, 2 * math.pi)
        place = start.x + vx * time, start.y + vy * time, real.heading + turn
        if self.parameters.spoofs == "velocity":
            place = real.x, real.y, real.heading
        false = (*place, vx * moving, vy * moving)
        x, y, heading, vx, vy = (r + share * (f - r) for r, f in zip(real[1:6], false, strict=True))
        return value.with_body(Body(real.id, x, y, heading, vx, vy, real.length, real.width))


def _is_oncoming(body: Body, pose: Any) -> bool:
    """Whether a body lies ahead of a pose and heads within 45 degrees of the opposite direction."""
    ahead = (body.x - pose.x) * math.cos(pose.heading) + (body.y - pose.y) * math.sin(pose.heading)
    return ahead > 0.0 and math.cos(body.heading - pose.heading) < -math.sqrt(0.5)
