"""The world of the robot: its kinematics, what its sensors report, and what is true.

x points to the right, y downwards, angles turn clockwise from x, as in the report's player.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from pytest_dura import (
    ActionError,
    Episode,
    Line,
    Measure,
    Percept,
    Scene,
    Simulator,
    Tick,
    Tracks,
    sealed,
    stream,
)

RADIUS = 0.25
"""m; of the robot's round body."""
TRACK = 0.4
"""m between its wheels."""
TOP_SPEED = 1.0
"""m/s of a wheel, either way."""
LAG = 0.15
"""s; time constant of the wheels' speed."""
RAYS = 72
REACH = 5.0
"""m; what is farther away, the lidar reports as this far."""
NEAR_GOAL = 0.3
"""m from the goal at which the robot has arrived."""
ANGLES = np.linspace(-math.pi, math.pi, RAYS, endpoint=False)
"""rad; directions of the rays from the robot's front, clockwise."""


class Wheels(NamedTuple):
    """Speeds of the left and the right wheel in m/s: the action."""

    left: float
    right: float


class Odometry(NamedTuple):
    """Speed ahead in m/s and yaw rate in rad/s, as the wheels turn."""

    speed: float
    yaw_rate: float


class Imu(NamedTuple):
    """Acceleration ahead in m/s2 and yaw rate in rad/s, as the body moves."""

    acceleration: float
    yaw_rate: float


class Goal(NamedTuple):
    """Distance in m and bearing in rad of the goal's beacon, seen from the robot."""

    distance: float
    bearing: float


class Part(BaseModel):
    """Base of the parts of a world."""

    model_config = ConfigDict(extra="forbid")


class Post(Part):
    """A round obstacle."""

    x: float = Field(description="In m.")
    y: float = Field(description="In m.")
    radius: float = Field(0.1, gt=0, le=2, description="In m.")


class Rows(Part):
    """Rows of plants along x, symmetric to the middle of the place."""

    count: int = Field(2, ge=1, le=10, description="How many rows.")
    spacing: float = Field(1.4, gt=0, description="Between two rows, in m.")
    plants: int = Field(14, ge=1, le=100, description="Plants in each row, 0.5 m apart.")


class World(Part):
    """A walled place, the robot's task in it, and how well its wheels hold."""

    length: float = Field(10.0, gt=1, description="Along x, in m.")
    width: float = Field(6.0, gt=1, description="Along y, in m.")
    x: float = Field(1.0, description="Where the robot begins, in m.")
    y: float = Field(3.0, description="Where the robot begins, in m.")
    heading: float = Field(0.0, description="Of the robot at first, in rad.")
    goal_x: float = Field(9.0, description="In m.")
    goal_y: float = Field(3.0, description="In m.")
    posts: list[Post] = []
    rows: Rows | None = None
    slip: float = Field(
        0.0, ge=0, lt=1, description="Greatest share of a wheel's speed that is lost at a tick."
    )

    def discs(self) -> np.ndarray:
        """Posts and plants, shape ``(n, 3)``: x, y and radius in m."""
        discs = [(post.x, post.y, post.radius) for post in self.posts]
        if self.rows is not None:
            first = self.width / 2 - self.rows.spacing * (self.rows.count - 1) / 2
            discs += [
                (2.0 + 0.5 * plant, first + self.rows.spacing * row, 0.08)
                for row in range(self.rows.count)
                for plant in range(self.rows.plants)
            ]
        return np.array(discs).reshape(-1, 3)


def arrival_time(episode: Episode) -> float | None:
    """Seconds until it arrived."""
    arrived = np.flatnonzero(episode.signal("arrived") > 0.5)
    return float(episode.time[arrived[0]]) if len(arrived) else None


def hit(episode: Episode) -> bool:
    """Whether it touched anything."""
    return episode.ever("contact")


def least_gap(episode: Episode) -> float:
    """Least distance to anything, in m."""
    return float(episode.signal("gap").min())


class RobotWorld(Simulator):
    """A round robot with differential drive among posts, plants and walls."""

    measures = (
        Measure(
            "hit", "hit", "runs in which it touched anything", hit, "share",
            signals=("contact",), severity="grave", signal="contact", event="contact",
        ),
        Measure(
            "arrival_time", "arrival", "time until it arrived, over the runs that did",
            arrival_time, "mean", unit="s", signals=("arrived",),
        ),
        Measure(
            "least_gap", "gap", "least distance to anything", least_gap, "mean", unit="m",
            signals=("gap",),
        ),
    )  # fmt: skip

    @staticmethod
    def check_scenario(world: Mapping[str, Any]) -> dict[str, Any]:
        """Return the world with its defaults."""
        return World.model_validate(dict(world)).model_dump()

    def reset(self, scenario: Mapping[str, Any], seed: int) -> Tick:
        """Begin at rest."""
        self._world = World.model_validate(scenario["world"])
        self._discs = self._world.discs()
        self._slips = stream(seed, "slip")
        self._x, self._y, self._heading = self._world.x, self._world.y, self._world.heading
        self._wheels, self._index = Wheels(0.0, 0.0), 0
        self._speed = self._turning = self._acceleration = 0.0
        self._begin()
        return self._tick()

    def step(self, action: Any) -> Tick:
        """Drive for a time step."""
        self._move(action)
        self._index += 1
        return self._tick()

    def _begin(self) -> None:
        """Build what another physics needs."""

    def _move(self, action: Wheels) -> None:
        """Let the wheels follow with a lag, and the body lose what slips."""
        dt = self.time_step
        share = 1.0 - math.exp(-dt / LAG)
        self._wheels = Wheels(
            *(now + share * (to - now) for now, to in zip(self._wheels, action, strict=True))
        )
        held = 1.0 - self._slips.uniform(0.0, self._world.slip, 2)
        left, right = (np.array(self._wheels) * held).tolist()
        before, self._speed = self._speed, (left + right) / 2
        self._acceleration = (self._speed - before) / dt
        self._turning = (left - right) / TRACK
        middle = self._heading + self._turning * dt / 2
        self._x += self._speed * math.cos(middle) * dt
        self._y += self._speed * math.sin(middle) * dt
        self._heading = math.remainder(self._heading + self._turning * dt, math.tau)

    def check_action(self, action: Any) -> Wheels:
        """Return the speeds of both wheels, within what these can do."""
        if not isinstance(action, (tuple, list)) or len(action) != len(Wheels._fields):
            raise ActionError(f"the robot takes two speeds, (left, right), and no {action!r}")
        super().check_action(tuple(action))
        return Wheels(*(min(TOP_SPEED, max(-TOP_SPEED, float(speed))) for speed in action))

    def fallback_action(self) -> Wheels:
        """Stop."""
        return Wheels(0.0, 0.0)

    def signals(self, ticks: Sequence[Tick]) -> dict[str, Any]:
        """See the domain for what they mean."""
        truth = {key: np.array([tick.truth[key] for tick in ticks]) for key in ticks[0].truth}
        return {
            "gap": truth["gap"],
            "contact": (truth["gap"] <= 0.0).astype(float),
            "speed": truth["speed"],
            "goal_distance": truth["goal_distance"],
            "arrived": np.maximum.accumulate((truth["goal_distance"] < NEAR_GOAL).astype(float)),
            "slipping": np.abs(truth["wheel_speed"] - truth["speed"]),
        }

    def percept_signals(self, percepts: Sequence[Percept]) -> dict[str, Any]:
        """Return the speed by odometry, and the nearest range of the lidar less the body."""
        return {
            "speed": np.array([percept["odometry"].speed for percept in percepts]),
            "gap": np.array([max(0.0, percept["lidar"].min() - RADIUS) for percept in percepts]),
        }

    def scene(self, ticks: Sequence[Tick], percepts: Sequence[Percept]) -> Scene:
        """Return the place from above; the percept is where the beacon puts the robot."""
        world, discs = self._world, self._discs
        corners = [(0, 0), (world.length, 0), (world.length, world.width), (0, world.width), (0, 0)]
        ids = ("robot", *(f"post {place}" for place in range(len(discs))))
        poses = np.zeros((len(ticks), len(ids), 6), np.float32)
        for row, tick in enumerate(ticks):
            poses[row, 0, :4] = [tick.truth[key] for key in ("x", "y", "heading", "speed")]
        poses[:, 0, 4:] = 2 * RADIUS
        poses[:, 1:, :2], poses[:, 1:, 4:] = discs[:, :2], 2 * discs[:, 2:]
        seen = poses.copy()
        for row, percept in enumerate(percepts):
            distance, bearing = percept["goal"]
            angle = poses[row, 0, 2] + bearing
            seen[row, 0, 0] = world.goal_x - distance * math.cos(angle)
            seen[row, 0, 1] = world.goal_y - distance * math.sin(angle)
        lines = (
            Line("edge", np.array(corners, np.float32)),
            Line("route", np.array([(world.x, world.y), (world.goal_x, world.goal_y)], np.float32)),
        )
        return Scene(lines, Tracks(ids, poses), Tracks(ids, seen), ego="robot")

    def _tick(self) -> Tick:
        world = self._world
        away_x, away_y = world.goal_x - self._x, world.goal_y - self._y
        distance = math.hypot(away_x, away_y)
        bearing = math.remainder(math.atan2(away_y, away_x) - self._heading, math.tau)
        gap = self._gap()
        wheels = self._wheels
        rolled = (wheels.left + wheels.right) / 2
        return Tick(
            index=self._index,
            time=self._index * self.time_step,
            truth={
                "x": self._x, "y": self._y, "heading": self._heading, "speed": self._speed,
                "wheel_speed": rolled, "gap": gap, "goal_distance": distance,
            },
            channels={
                "lidar": self._ranges(),
                "odometry": Odometry(rolled, (wheels.left - wheels.right) / TRACK),
                "imu": Imu(self._acceleration, self._turning),
                "goal": Goal(distance, bearing),
            },
            goal=distance < NEAR_GOAL,
            critical="it ran into something" if gap <= 0.0 else None,
        )  # fmt: skip

    def _gap(self) -> float:
        world, (x, y, radius) = self._world, self._discs.T
        gaps = np.hypot(x - self._x, y - self._y) - radius
        walls = (self._x, world.length - self._x, self._y, world.width - self._y)
        return max(0.0, min(*walls, gaps.min(initial=REACH)) - RADIUS)

    def _ranges(self) -> np.ndarray:
        """Range of each ray from the robot's middle in m: the first wall or disc that it meets."""
        angles = ANGLES + self._heading
        cos, sin = np.cos(angles), np.sin(angles)
        ranges = np.full(RAYS, REACH)
        ends = ((self._x, self._world.length, cos), (self._y, self._world.width, sin))
        for at, far, along in ends:
            wall = np.where(along > 0, far - at, at)
            ranges = np.minimum(ranges, wall / np.maximum(np.abs(along), 1e-9))
        for x, y, radius in self._discs:
            dx, dy = x - self._x, y - self._y
            ahead, beside = dx * cos + dy * sin, dy * cos - dx * sin
            inside = radius * radius - beside * beside
            meets = (inside > 0) & (ahead > 0)
            hit_at = ahead - np.sqrt(np.maximum(inside, 0.0))
            ranges = np.where(meets, np.minimum(ranges, hit_at), ranges)
        return sealed(np.maximum(ranges, 0.0))
