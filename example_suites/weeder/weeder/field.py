"""A robot that hoes weeds out of a row of cabbage, from above: x along the rows, y to the right.

The robot straddles a row; its wheels run between the rows, its hoe cuts in the row.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict
from pydantic import Field as Key

from pytest_dura import ActionError, Line, Measure, Percept, Scene, Simulator, Tick, Tracks, stream

ROWS, BETWEEN = (-0.75, 0.0, 0.75), 0.5  # m; where the rows are, and from plant to plant
PLANTS = 14  # in a row
SOWN = 1.0 + BETWEEN * np.arange(PLANTS)  # m; where the sowing machine put them, as its map says
END = float(SOWN[-1]) + 0.5  # m
WHEELS, TYRE, STEM, CABBAGE = 0.375, 0.05, 0.05, 0.1  # m
LENGTH, ANIMAL = 0.8, 0.2  # m; of the robot, and the radius of an animal
TOP_SPEED, TOP_TURN, BRAKING = 0.4, 0.6, 1.0  # m/s, rad/s, m/s2
HOEING = 10.0  # 1/s; the hoe is down or up after 0.1 s
SIGHT = (0.15, 0.9)  # m ahead of the hoe that the camera sees
WARM = 5.0  # m that the thermal camera sees
SUBSTEPS = 4  # of a tick


class Command(NamedTuple):
    """Speed in m/s, turn in rad/s clockwise, and the hoe: 0 up, 1 down. The action."""

    speed: float
    turn: float
    hoe: float


class Camera(NamedTuple):
    """Row to the right in m, its direction in rad, the next plant ahead in m, and its likeness.

    ``crop`` is 1 for what looks like a cabbage and 0 for what looks like a weed.
    """

    offset: float
    heading: float
    distance: float
    crop: float


class Gnss(NamedTuple):
    """Place in m."""

    x: float
    y: float


class Thermal(NamedTuple):
    """Distance in m and direction in rad of the nearest warm body."""

    range: float
    bearing: float


class Odometry(NamedTuple):
    """Speed in m/s, as the wheels turn."""

    speed: float


class Animal(BaseModel):
    """A fawn that lies in the row, or a hare that runs across."""

    model_config = ConfigDict(extra="forbid")
    x: float = Key(4.0, description="In m.")
    y: float = Key(0.0, description="At first, in m.")
    start: float = Key(15.0, ge=0, description="When it gets up, in s.")
    speed: float = Key(1.5, ge=-3, le=3, description="Then, to the right, in m/s.")


class World(BaseModel):
    """The ground, what the camera confuses, and an animal."""

    model_config = ConfigDict(extra="forbid")
    slip: float = Key(0.1, ge=0, lt=1, description="Greatest share of the speed lost at a tick.")
    slope: float = Key(0.0, ge=-0.3, le=0.3, description="Slides to the right, share of speed.")
    weeds: float = Key(0.6, ge=0, le=1, description="Chance of a weed between two plants.")
    confusion: float = Key(0.0, ge=0, le=1, description="Chance to take one for the other, a tick.")
    animal: Animal | None = None


class Field(Simulator):
    """The robot in the middle one of three rows."""

    measures = (
        Measure("crops_lost", "lost", "cabbages that were hoed or run over",
                lambda run: float(run.signal("crops_lost")[-1]), "mean"),
        Measure("weeds_missed", "missed", "weeds that it went by",
                lambda run: float(run.signal("weeds_missed")[-1]), "mean"),
        Measure("ran_over", "animal", "runs in which it ran into an animal", lambda run: bool(
            ((run.signal("animal_gap") <= 0) & (run.signal("speed") > 0.05)).any()
        ), "share", severity="grave"),
    )  # fmt: skip

    @classmethod
    def check_scenario(cls, world: Mapping[str, Any]) -> dict[str, Any]:
        """Return the scenario's `world` with its defaults."""
        return World.model_validate(dict(world)).model_dump()

    def reset(self, scenario: Mapping[str, Any], seed: int) -> Tick:
        """Draw where plants and weeds grow, and begin before the first of them."""
        self._world = World.model_validate(scenario["world"])
        draw = stream(seed, "plants")
        places = [(x, row) for row in ROWS for x in SOWN]
        self._crops = np.array(places) + draw.uniform(-0.02, 0.02, (len(places), 2))
        grown = SOWN[:-1][draw.random(PLANTS - 1) < self._world.weeds]
        self._weeds = np.column_stack([grown + draw.uniform(0.22, 0.28, len(grown)), 0.0 * grown])
        self._slips, self._eyes = stream(seed, "slip"), stream(seed, "camera")
        self._lost, self._cut = np.zeros(len(places), bool), np.zeros(len(grown), bool)
        self._x = self._y = self._heading = self._speed = self._hoe = self._rolled = 0.0
        self._index = 0
        return self._tick()

    def step(self, action: Command) -> Tick:
        """Drive and hoe for a time step; the ground holds the wheels more or less well."""
        dt = self.time_step / SUBSTEPS
        held = 1.0 - self._slips.uniform(0.0, self._world.slip)
        for _ in range(SUBSTEPS):
            change = action.speed - self._rolled
            self._rolled += min(max(change, -BRAKING * dt), BRAKING * dt)
            self._speed = held * self._rolled
            self._heading += action.turn * held * dt * min(1.0, self._rolled / 0.1)
            self._x += self._speed * math.cos(self._heading) * dt
            slide = math.sin(self._heading) + self._world.slope
            self._y += self._speed * slide * dt
            self._hoe += min(max(action.hoe - self._hoe, -HOEING * dt), HOEING * dt)
            if self._hoe > 0.5:
                self._lost |= self._under_hoe(self._crops)
                self._cut |= self._under_hoe(self._weeds)
            beside = np.abs(np.abs(self._crops[:, 1] - self._y) - WHEELS)
            near = np.abs(self._crops[:, 0] - self._x) < CABBAGE
            self._lost |= near & (beside < STEM + TYRE)
        self._index += 1
        return self._tick()

    def check_action(self, action: Any) -> Command:
        """Return what wheels and hoe can do of it."""
        if not isinstance(action, (tuple, list)) or len(action) != len(Command._fields):
            raise ActionError(f"the robot takes (speed, turn, hoe), and no {action!r}")
        super().check_action(tuple(action))
        ends = ((0.0, TOP_SPEED), (-TOP_TURN, TOP_TURN), (0.0, 1.0))
        parts = zip(action, ends, strict=True)
        return Command(*(min(high, max(low, float(part))) for part, (low, high) in parts))

    def fallback_action(self) -> Command:
        """Lift the hoe and stop."""
        return Command(0.0, 0.0, 0.0)

    def signals(self, ticks: Sequence[Tick]) -> dict[str, Any]:
        """See the domain for what they mean."""
        names = ("crops_lost", "weeds_cut", "weeds_missed", "animal_gap", "offset", "speed", "x")
        return {name: np.array([tick.truth[name] for tick in ticks]) for name in names}

    def percept_signals(self, percepts: Sequence[Percept]) -> dict[str, Any]:
        """Return the offset by camera and by satellites."""
        return {
            "offset": np.array([-percept["camera"].offset for percept in percepts]),
            "gnss_offset": np.array([percept["gnss"].y for percept in percepts]),
        }

    def scene(self, ticks: Sequence[Tick], percepts: Sequence[Percept]) -> Scene:
        """Return the field from above: weeds have three corners, a lost cabbage has a name."""
        ids = ("robot", "animal", *(f"lost cabbage {each}" for each in range(len(self._crops))))
        poses = np.full((2, len(ticks), len(ids), 6), np.nan, np.float32)
        for row, (tick, percept) in enumerate(zip(ticks, percepts, strict=True)):
            (x, y, heading), warm = tick.truth["robot"], percept["thermal"]
            for place in np.flatnonzero(tick.truth["lost"]):
                poses[:, row, 2 + place] = *self._crops[place], 0, 0, 0.1, 0.1
            poses[:, row, 0] = x, y, heading, tick.truth["speed"], LENGTH, 2 * WHEELS
            poses[1, row, 0, :2] = percept["gnss"]
            if tick.truth["animal"]:
                poses[0, row, 1] = *tick.truth["animal"], 0, 0, 2 * ANIMAL, 2 * ANIMAL
            if warm.range < WARM:
                way = warm.range * np.exp(1j * (heading + warm.bearing))
                poses[1, row, 1] = x + way.real, y + way.imag, 0, 0, 2 * ANIMAL, 2 * ANIMAL
        lines = []
        for plants, radius, corners in ((self._crops, CABBAGE, 12), (self._weeds, STEM, 3)):
            turns = np.linspace(0.0, math.tau, corners + 1)
            outline = radius * np.column_stack([np.cos(turns), np.sin(turns)])
            lines += [Line("edge", (outline + place).astype(np.float32)) for place in plants]
        truth, percept = (Tracks(ids, each) for each in poses)
        return Scene(tuple(lines), truth, percept, ego="robot")

    def _under_hoe(self, plants: np.ndarray) -> np.ndarray:
        along, beside = np.abs(plants - (self._x, self._y)).T
        return (along < STEM) & (beside < CABBAGE)

    def _tick(self) -> Tick:
        time, x, y = self._index * self.time_step, self._x, self._y
        animal = self._world.animal
        warm, gap, place = Thermal(WARM, 0.0), 2 * WARM, None
        if animal is not None:
            place = animal.x, animal.y + animal.speed * max(0.0, time - animal.start)
            away = math.hypot(place[0] - x, place[1] - y)
            bearing = math.atan2(place[1] - y, place[0] - x) - self._heading
            gap = max(0.0, away - ANIMAL - LENGTH / 2)
            if away < WARM:
                warm = Thermal(away, bearing)
        missed = ~self._cut & (self._weeds[:, 0] < x - STEM)
        truth = {
            "robot": (x, y, self._heading), "animal": place, "x": x, "offset": y,
            "speed": self._speed, "animal_gap": min(gap, 2 * WARM),
            "lost": tuple(self._lost.tolist()),
            "crops_lost": float(self._lost.sum()), "weeds_cut": float(self._cut.sum()),
            "weeds_missed": float(missed.sum()),
        }  # fmt: skip
        channels = {"camera": self._camera(), "gnss": Gnss(x, y), "thermal": warm,
                    "odometry": Odometry(self._rolled)}  # fmt: skip
        blow = "it ran into an animal" if gap <= 0.0 and self._speed > 0.01 else None
        return Tick(self._index, time, truth, channels, goal=x >= END, critical=blow)

    def _camera(self) -> Camera:
        """What the camera makes of the next plant; it confuses it for a tick, not for good."""
        row = np.concatenate([self._crops[abs(self._crops[:, 1]) < 0.3], self._weeds])
        ahead = row[:, 0] - self._x
        left = np.where(ahead > SIGHT[0], ahead, np.inf)
        place, confused = int(left.argmin()), self._eyes.random() < self._world.confusion
        crop = left[place] < SIGHT[1] and (place < PLANTS) != confused
        return Camera(-self._y, -self._heading, min(left[place], SIGHT[1]), float(crop))
