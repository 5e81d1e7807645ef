"""An arm with two joints that carries parts, and a person who walks up and reaches in, from above.

x points to the right, y downwards, angles turn clockwise from x, as in the report's player. The
arm's base is at the origin.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from pytest_dura import ActionError, Episode, Line, Measure, Percept, Scene, Simulator, Tick, Tracks

UPPER, FORE, HALF_WIDTH = 0.65, 0.55, 0.08  # m; lengths of the links, and half their width
TOP_RATE, BRAKING = 1.5, 5.0  # rad/s of a joint, and rad/s2 either way
SUBSTEPS, CLOSE = 5, 0.6  # of a tick, looked at from so many m on: tool and hand move 0.4 m in one
PLACES = np.array([[-1.5, 0.7], [1.3, -0.7]])  # rad; joints where a part is taken, and put down
NEAR_PLACE = 0.03  # rad
BODY, HAND = 0.25, 0.06  # m; radii of the person's trunk and hand
START = 4.2  # m from the base, where the person comes from
SCANNERS = {"left": (-0.5, 0.4), "right": (0.5, -0.4)}  # m; where they stand
REACH = 9.0  # m; of a scanner
HARMLESS = 0.25  # m/s; reduced speed (ISO 10218-1), above which a contact is an accident here
MASS = 5.0  # kg; half of what moves, and the tool: effective mass of the arm (ISO/TS 15066, A.3.4)
PARTS = {"trunk": (40.0, 25e3), "hand": (0.6, 75e3)}  # kg and N/m; as they are hit (table A.3)


class Joints(NamedTuple):
    """Rates of both joints in rad/s: the action."""

    shoulder: float
    elbow: float


class Encoders(NamedTuple):
    """Angles of both joints in rad, and their rates in rad/s."""

    shoulder: float
    elbow: float
    shoulder_rate: float
    elbow_rate: float


class Scan(NamedTuple):
    """Distance in m and direction in rad of a person's legs, seen from the scanner."""

    range: float
    bearing: float

    def place(self, scanner: str) -> np.ndarray:
        """Where a scanner of this name puts the person, in m."""
        away = self.range * np.array([math.cos(self.bearing), math.sin(self.bearing)])
        return np.array(SCANNERS[scanner]) + away


Person = tuple[np.ndarray, np.ndarray, float]


class World(BaseModel):
    """The way of the person: up to the arm, a reach into its space, and back."""

    model_config = ConfigDict(extra="forbid")
    delay: float = Field(4.0, ge=0, description="When the person sets out, in s.")
    speed: float = Field(1.6, gt=0, le=2.5, description="Of walking, in m/s; 1.6: ISO 13855.")
    bearing: float = Field(0.0, ge=-3.2, le=3.2, description="Where the person stands, in rad.")
    aside: float = Field(0.0, ge=-1, le=1, description="Comes from beside that, in rad.")
    stand: float = Field(1.3, ge=0.9, le=4.5, description="Where, in m from the arm's base.")
    stay: float = Field(4.0, ge=0, description="Time there, in s.")
    reach: float = Field(0.6, ge=0, le=0.8, description="Of a hand from the trunk's edge, in m.")
    hand: float = Field(2.0, gt=0, le=2.5, description="Of its reach, in m/s; 2.0: ISO 13855.")
    payload: float = Field(0.0, ge=0, le=20, description="What the arm carries, in kg.")
    face: float = Field(2.0, gt=0, description="Area by which arm or part touches, in cm2.")

    def person(self, time: float) -> Person:
        """Trunk and hand in m, and the speed of the faster one in m/s."""
        ends = [(START, self.bearing + self.aside), (self.stand, self.bearing)]
        begin, end = (r * np.array([math.cos(a), math.sin(a)]) for r, a in ends)
        way = float(np.hypot(*(end - begin)))
        there = self.delay + way / self.speed
        walked = min(max(time - self.delay, 0.0) * self.speed, way)
        walked -= min(max(time - there - self.stay, 0.0) * self.speed, way)
        trunk = begin + (end - begin) * walked / way
        stretch = min(max(time - there, 0.0) * self.hand, self.reach)
        stretch -= min(max(time - there - self.stay, 0.0) * self.hand, stretch)
        hand = trunk - (BODY - HAND + stretch) * trunk / np.hypot(*trunk)
        speed = self.speed if 0.0 < walked < way else 0.0
        return trunk, hand, self.hand if 0.0 < stretch < self.reach else speed


def links(shoulder: float, elbow: float) -> np.ndarray:
    """Base, elbow and tool of the arm in m, shape ``(3, 2)``."""
    bend = UPPER * np.array([math.cos(shoulder), math.sin(shoulder)])
    fore = FORE * np.array([math.cos(shoulder + elbow), math.sin(shoulder + elbow)])
    return np.array([np.zeros(2), bend, bend + fore])


def arm_speed(elbow: float, rates: Sequence[float]) -> float:
    """Speed in m/s of the tool or of the elbow, whichever is faster."""
    ends = UPPER * rates[0], FORE * (rates[0] + rates[1])
    tool = math.sqrt(max(ends[0] ** 2 + ends[1] ** 2 + 2 * ends[0] * ends[1] * math.cos(elbow), 0))
    return max(abs(ends[0]), tool)


def distance(joints: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Distance in m of each point from the arm's surface; below 0 within it."""
    starts, ways = joints[:-1, None], np.diff(joints, axis=0)[:, None]
    share = ((points - starts) * ways).sum(-1) / (ways**2).sum(-1)
    nearest = starts + np.clip(share, 0.0, 1.0)[..., None] * ways
    gaps: np.ndarray = np.linalg.norm(points - nearest, axis=-1).min(axis=0) - HALF_WIDTH
    return gaps


def struck(episode: Episode) -> bool:
    """Whether the arm hit the person faster than is harmless."""
    return bool(((episode.signal("gap") <= 0) & (episode.signal("arm_speed") > HARMLESS)).any())


def least_separation(episode: Episode) -> float:
    """Least separation while the arm moved, in m."""
    moving = episode.signal("arm_speed") > 0.05
    return float(episode.signal("separation")[moving].min(initial=START))


class Cell(Simulator):
    """The arm, the person and two laser scanners at the height of legs, which see no hand."""

    lacks = {"payload": "its joints brake alike at any load"}  # noqa: RUF012
    measures = (
        Measure("struck", "struck", "runs in which the arm struck the person", struck, "share", "",
                ("gap", "arm_speed"), "grave"),
        Measure("parts", "parts", "parts that were moved",
                lambda run: float(run.signal("parts")[-1]), "mean"),
        Measure("least_separation", "separation", "least separation while the arm moved",
                least_separation, "mean", "m"),
    )  # fmt: skip

    @classmethod
    def check_scenario(cls, world: Mapping[str, Any]) -> dict[str, Any]:
        """Return the scenario's `world` with its defaults."""
        return World.model_validate(dict(world)).model_dump()

    def reset(self, scenario: Mapping[str, Any], seed: int) -> Tick:
        """Begin at rest, where the first part is."""
        self._world = World.model_validate(scenario["world"])
        self._angles, self._rates = PLACES[0].copy(), np.zeros(2)
        self._index = self._visits = 0
        return self._tick(self._begin())

    def step(self, action: Joints) -> Tick:
        """Move for a time step, and count the places that were reached."""
        person = self._move(action)
        if np.abs(self._angles - PLACES[(self._visits + 1) % 2]).max() < NEAR_PLACE:
            self._visits += 1
        self._index += 1
        return self._tick(person)

    def _begin(self) -> Person:
        return self._look(self._world.person(0.0))

    def _move(self, action: Joints) -> Person:
        """Let each joint follow as fast as its brake and motor can, whatever it carries."""
        dt = self.time_step / SUBSTEPS
        for part in range(1, SUBSTEPS + 1):
            change = np.clip(np.array(action) - self._rates, -BRAKING * dt, BRAKING * dt)
            self._angles += (self._rates + change / 2) * dt
            self._rates += change
            if part == SUBSTEPS or self._near < CLOSE:
                now = (self._index + part / SUBSTEPS) * self.time_step
                person = self._look(self._world.person(now))
            if self._near <= 0.0:
                break  # within a tick what was touched might be left again
        return person

    def check_action(self, action: Any) -> Joints:
        """Return the rates within what the joints can do."""
        if not isinstance(action, (tuple, list)) or len(action) != len(Joints._fields):
            raise ActionError(f"the arm takes two rates, (shoulder, elbow), and no {action!r}")
        super().check_action(tuple(action))
        return Joints(*(min(TOP_RATE, max(-TOP_RATE, float(rate))) for rate in action))

    def fallback_action(self) -> Joints:
        """Stop."""
        return Joints(0.0, 0.0)

    def signals(self, ticks: Sequence[Tick]) -> dict[str, Any]:
        """See the domain for what they mean."""
        names = ("gap", "separation", "arm_speed", "contact_force", "contact_pressure", "parts")
        return {name: np.array([tick.truth[name] for tick in ticks]) for name in names}

    def percept_signals(self, percepts: Sequence[Percept]) -> dict[str, Any]:
        """Return how far the person is from the arm's base for each scanner."""
        return {
            name: np.array([np.hypot(*percept[name].place(name)) for percept in percepts])
            for name in SCANNERS
        }

    def scene(self, ticks: Sequence[Tick], percepts: Sequence[Percept]) -> Scene:
        """Return the cell from above; the percept is where the scanners put the person."""
        true, seen = np.full((2, len(ticks), 5, 6), np.nan, np.float32)
        for row, (tick, percept) in enumerate(zip(ticks, percepts, strict=True)):
            for poses, angles in ((true, tick.truth["angles"]), (seen, percept["joints"][:2])):
                poses[row, 0] = 0.0, 0.0, 0.0, 0.0, 0.3, 0.3
                joints = links(*angles)
                for place, (x, y) in enumerate(np.diff(joints, axis=0)):
                    middle = joints[place] + (x / 2, y / 2)
                    poses[row, 1 + place] = *middle, math.atan2(y, x), 0.0, math.hypot(x, y), 0.16
            x, y = tick.truth["trunk"]
            motion = math.atan2(-y, -x), tick.truth["person_speed"]
            true[row, 3] = x, y, *motion, 2 * BODY, 2 * BODY
            true[row, 4] = *tick.truth["hand"], *motion, 2 * HAND, 2 * HAND
            for place, name in enumerate(SCANNERS, 3):
                seen[row, place] = *percept[name].place(name), *true[row, 3, 2:]
        right = np.hypot(*(seen[:, 4, :2] - true[:, 3, :2]).T) < 0.05
        seen[right, 4] = np.nan  # it is drawn where it is wrong
        ids = ("base", "upper arm", "forearm", "person")
        box = 0.1 * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)])
        places = ((box + links(*angles)[-1]).astype(np.float32) for angles in PLACES)
        lines = tuple(Line("stop_line", place) for place in places)
        truth, percept = Tracks((*ids, "hand"), true), Tracks((*ids, "by the right scanner"), seen)
        return Scene(lines, truth, percept, ego="base")

    def _look(self, person: Person) -> Person:
        """Measure the gap of the arm to trunk, hand and what joins them."""
        points = np.array([person[0], *np.linspace(*person[:2], 6)])
        gaps = distance(links(*self._angles), points) - [BODY, *[HAND] * 6]
        self._near = max(0.0, float(gaps.min()))
        self._part = "trunk" if gaps.argmin() == 0 else "hand"
        return person

    def _touch(self) -> tuple[float, float]:
        """Speed of the arm in m/s, and by it the force in N of a contact (ISO/TS 15066, A.3.4)."""
        speed, (mass, stiffness) = arm_speed(self._angles[1], self._rates), PARTS[self._part]
        force = speed * math.sqrt(stiffness / (1.0 / MASS + 1.0 / mass))
        return speed, force if self._near <= 0.0 else 0.0

    def _tick(self, person: Person) -> Tick:
        (trunk, hand, walking), gap = person, self._near
        angles, rates = tuple(self._angles.tolist()), tuple(self._rates.tolist())
        (speed, force), braking = self._touch(), max(map(abs, rates)) / BRAKING
        truth = {
            "angles": angles, "trunk": tuple(trunk.tolist()), "hand": tuple(hand.tolist()),
            "person_speed": walking, "gap": gap, "parts": float((self._visits + 1) // 2),
            "separation": gap - walking * braking - speed * braking / 2, "arm_speed": speed,
            "contact_force": force, "contact_pressure": force / self._world.face,
        }  # fmt: skip
        channels: dict[str, Any] = {"joints": Encoders(*angles, *rates)}
        for name, place in SCANNERS.items():
            x, y = trunk - np.array(place)
            channels[name] = Scan(min(math.hypot(x, y), REACH), math.atan2(y, x))
        accident = gap <= 0.0 and speed > HARMLESS
        blow = f"it struck the person at {speed:.1f} m/s" if accident else None
        return Tick(self._index, self._index * self.time_step, truth, channels, critical=blow)
