"""Attacks on the list of perceived objects. They touch the percept only, never the road."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import Field

from pytest_dura.driving.bodies import CAR_LENGTH, CAR_WIDTH, Body, BodyList
from pytest_dura.driving.faults.base import ObjectFault, distance
from pytest_dura.faults.model import Moment
from pytest_dura.faults.parts import FaultPart, Finite, NotNegative, Positive, Share
from pytest_dura.faults.spans import Span


class GhostParameters(FaultPart):
    """Where the ghost appears, how large it is, and how it moves."""

    place: Literal["ego", "junction"] = Field(
        "ego",
        description="Where `ahead` is measured from: the ego's front, or the stop line before it.",
    )
    # Farther away a car at the speed limit of 10 m/s stops for it without any haste.
    ahead: Annotated[Positive, Span(2.0, 60.0, mildest=60.0)] = Field(
        14.0,
        description="Metres on the ego's route, from `place` to the ghost's near end, when it"
        " appears.",
    )
    # Two lanes to either side. Of where and how it stands, and of its size, none is milder than
    # another: the simplest is a car on the route.
    lateral: Annotated[Finite, Span(-8.0, 8.0)] = Field(
        0.0, description="Metres beside that place on the route; positive is to the right."
    )
    heading: Annotated[Finite, Span(-3.14, 3.14)] = Field(
        0.0, description="Radians to the right of the route's heading there."
    )
    speed: Annotated[NotNegative, Span(0.0, 10.0)] = Field(
        0.0, description="Along its own heading, straight on, in m/s."
    )
    length: Annotated[Positive, Span(0.5, 12.0, mildest=CAR_LENGTH)] = Field(
        CAR_LENGTH, description="In m."
    )
    width: Annotated[Positive, Span(0.5, 3.0, mildest=CAR_WIDTH)] = Field(
        CAR_WIDTH, description="In m."
    )


class GhostObstacle(ObjectFault):
    """An object that is not there: lidar reports a car on the ego's route, standing by default."""

    type: Literal["ghost-obstacle"]
    parameters: GhostParameters = GhostParameters()

    @classmethod
    def example(cls) -> dict[str, Any]:
        """Two seconds into the episode, for four seconds."""
        return {"activation": {"at": 2.0}, "duration": 4.0}

    def begin(self, value: BodyList, moment: Moment) -> Body:
        """The ghost as it appears."""
        given, channels, rng = self.parameters, moment.channels, moment.rng
        pose, way = channels["localisation"], channels["map"]
        start = way.stop_line
        if given.place == "ego":
            start = way.route.project(pose.x, pose.y)[0] + CAR_LENGTH / 2
        s = start + given.ahead + given.length / 2
        x, y, heading = (float(value) for value in way.route.pose(s))
        # y points south, so that right of the heading (c, s) is (-s, c).
        x, y = x - given.lateral * math.sin(heading), y + given.lateral * math.cos(heading)
        heading += given.heading
        # Adding 0 makes -0 of a standing ghost 0.
        velocity = given.speed * math.cos(heading) + 0.0, given.speed * math.sin(heading) + 0.0
        name = f"V{900 + int(rng.integers(100))}"  # looks like any other id
        return Body(name, x, y, heading, *velocity, given.length, given.width)

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
    lead: Annotated[Positive, Span(0.5, 5.0, mildest=5.0)] = Field(
        2.0, description="The false path meets the ego's route this many seconds ahead of the ego."
    )
    # The longer it takes, the slower the vehicle seems to come.
    duration: Annotated[Positive, Span(0.5, 10.0, mildest=10.0)] = Field(
        4.0, description="Seconds until the false path ends."
    )


class TrajectorySpoof(ObjectFault):
    """A real vehicle's course is replaced by one that cuts the ego off, or by a given one.

    Either position and velocity are false or, with ``spoofs: velocity``, the velocity alone. Radar
    still sees the vehicle where it is.
    """

    type: Literal["trajectory-spoof"]
    parameters: SpoofParameters = SpoofParameters()

    def begin(self, value: BodyList, moment: Moment) -> Any:
        """The victim and its false path; ``None`` while there is no such car within sight."""
        given, pose = self.parameters, moment.channels["localisation"]
        route = moment.channels["map"].route
        cars = [body for body in value if not body.is_pedestrian]
        if given.victim == "oncoming":
            cars = [body for body in cars if _is_oncoming(body, pose)]
        if not cars:
            return None
        victim = min(cars, key=lambda body: distance(body, pose))
        if given.velocity is not None:
            heading = route.heading_at(route.project(victim.x, victim.y)[0])
            (along, right), c, s = given.velocity, math.cos(heading), math.sin(heading)
            return victim, along * c - right * s, along * s + right * c
        s, _ = route.project(pose.x, pose.y)
        meet = s + CAR_LENGTH + max(moment.channels["odometry"].speed, 3.0) * given.lead
        x, y, _ = (float(value) for value in route.pose(meet))
        return victim, (x - victim.x) / given.duration, (y - victim.y) / given.duration

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
