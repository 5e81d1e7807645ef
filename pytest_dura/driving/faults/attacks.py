"""Attacks on the list of perceived objects. They touch the percept only, never the road."""

from __future__ import annotations

import math
from typing import Any, ClassVar, Literal

from pydantic import Field

from pytest_dura.driving.bodies import CAR_LENGTH, CAR_WIDTH, Body, BodyList
from pytest_dura.faults.model import Fault, Kind, Moment
from pytest_dura.faults.parts import FaultPart, Positive, Share


class GhostParameters(FaultPart):
    """Where the ghost stands and how large it is."""

    ahead: Positive = Field(
        14.0, description="Metres ahead of the ego's front on its route, when it appears."
    )
    length: Positive = Field(CAR_LENGTH, description="In m.")
    width: Positive = Field(CAR_WIDTH, description="In m.")


class ObjectFault(Fault):
    """Base of the faults that tamper with a list of objects, which only lidar reports."""

    acts_on: ClassVar[Kind] = "objects"
    default_target: ClassVar[str | None] = "lidar"


class GhostObstacle(ObjectFault):
    """An object that is not there: lidar reports a standing car on the ego's route."""

    type: Literal["ghost-obstacle"]
    parameters: GhostParameters = GhostParameters()

    @classmethod
    def example(cls) -> dict[str, Any]:
        """Two seconds into the episode, for four seconds."""
        return {"activation": {"at": 2.0}, "duration": 4.0}

    def begin(self, value: BodyList, moment: Moment) -> Body:
        """The ghost, fixed to the ground from now on."""
        channels, rng = moment.channels, moment.rng
        pose, route = channels["localisation"], channels["map"].route
        s, _ = route.project(pose.x, pose.y)
        distance = CAR_LENGTH / 2 + self.parameters.ahead + self.parameters.length / 2
        x, y, heading = (float(value) for value in route.pose(s + distance))
        name = f"V{900 + int(rng.integers(100))}"  # looks like any other id
        size = (self.parameters.length, self.parameters.width)
        return Body(name, x, y, heading, 0.0, 0.0, *size)

    def apply(self, memory: Body, value: BodyList, moment: Moment) -> BodyList:
        """The objects with the ghost among them."""
        return value.with_body(memory)


class SpoofParameters(FaultPart):
    """How the spoofed vehicle seems to move."""

    magnitude: Share = Field(
        1.0, description="0 leaves the vehicle where it is, 1 puts it wholly on the false path."
    )
    lead: Positive = Field(
        2.0, description="The false path meets the ego's route this many seconds ahead of the ego."
    )
    duration: Positive = Field(4.0, description="Seconds until the false path meets the route.")


class TrajectorySpoof(ObjectFault):
    """A real vehicle's position and velocity are replaced by a course that cuts the ego off.

    Radar still sees the vehicle where it is.
    """

    type: Literal["trajectory-spoof"]
    parameters: SpoofParameters = SpoofParameters()

    @classmethod
    def example(cls) -> dict[str, Any]:
        """Two seconds into the episode, for five seconds."""
        return {"activation": {"at": 2.0}, "duration": 5.0}

    def begin(self, value: BodyList, moment: Moment) -> Any:
        """The victim, the nearest car within sight, and its false path; ``None`` without a car."""
        pose, odometry = moment.channels["localisation"], moment.channels["odometry"]
        route = moment.channels["map"].route
        cars = [body for body in value if not body.is_pedestrian]
        if not cars:
            return None
        victim = min(cars, key=lambda b: (math.hypot(b.x - pose.x, b.y - pose.y), b.id))
        s, _ = route.project(pose.x, pose.y)
        meet = s + CAR_LENGTH + max(odometry.speed, 3.0) * self.parameters.lead
        x, y, _ = (float(value) for value in route.pose(meet))
        vx = (x - victim.x) / self.parameters.duration
        vy = (y - victim.y) / self.parameters.duration
        return victim, vx, vy

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
        x, y = start.x + vx * time, start.y + vy * time
        false = (x, y, real.heading + turn, vx * moving, vy * moving)
        x, y, heading, vx, vy = (r + share * (f - r) for r, f in zip(real[1:6], false, strict=True))
        return value.with_body(Body(real.id, x, y, heading, vx, vy, real.length, real.width))
