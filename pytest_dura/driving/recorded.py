"""Recorded drives: signals of the domain from the poses of a log, once these are no mirror image.

Columns ``ego.x``, ``ego.y`` and those of other objects, ``V1.x`` and so on, are metres; ``heading``
is in rad, ``vx``, ``vy`` and ``speed`` in m/s. An object is there from its first to its last
sample. Within the package x points east and y south: poses with y to the left are turned over.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError

from pytest_dura.core.errors import ConfigurationError, list_names
from pytest_dura.core.simulator import Line, Scene, Tracks
from pytest_dura.driving.bodies import (
    CAR_LENGTH,
    CAR_WIDTH,
    LENGTH,
    VX,
    VY,
    WIDTH,
    BodyList,
    X,
    Y,
    proximity,
)
from pytest_dura.driving.criticality import Encounters, criticality
from pytest_dura.driving.scenario import Positive, _Model
from pytest_dura.driving.traffic_rules import LEADER_CAP, SAME_DIRECTION

Floats = NDArray[np.float64]
EGO = "ego"
"""Name of the ego's columns; in scenes and messages it is EGO."""
_KEYS = ("x", "y", "heading", "vx", "vy", "speed")
_MOVING = 1.0
"""m/s; the course of what is slower is not clear."""
_ENOUGH = 20
"""Moving samples from which on a heading is compared with a course."""
_SLIP, _WRONG = math.radians(10.0), math.radians(30.0)
"""Mean angle between headings and courses that turning and noise explain, and that none does."""
_BETTER = 3.0
"""Times by which another reading of the axes has to fit better."""
_CLEAR = 1.0
"""m between the courses of two that meet each other, below which neither side is clear."""
_BESIDE = 6.0
"""m between the courses of two that meet each other on one road."""
_NEAR = 15.0
"""m within which two that meet each other are looked at."""


class Body(_Model):
    """Size of an object of a log."""

    length: Positive = Field(CAR_LENGTH, description="In m.")
    width: Positive = Field(CAR_WIDTH, description="In m.")
    reverses: bool = Field(False, description="Whether it drives backwards all the time.")


class DriveOptions(_Model):
    """What a mapping says of a recorded drive."""

    axes: Literal["right-handed", "left-handed"] = Field(
        "right-handed",
        description="Right-handed with y to the left of x and counter-clockwise headings, as in "
        "ROS; left-handed with y to the right, as in CARLA, Unreal and the traces of simulations.",
    )
    traffic: Literal["right", "left", "either"] = Field(
        "right", description="The side that traffic keeps; either: sides are not compared."
    )
    junction: list[float] | None = Field(
        None,
        min_length=2,
        max_length=2,
        description="x and y of the centre of the junction in the log, in m, for scenarios from it "
        "and roles that see it; default: it is inferred from who crosses.",
    )
    objects: dict[str, Body] = Field({}, description="Sizes by object; default: a car's.")


def options_of(given: Mapping[str, Any]) -> DriveOptions:
    """Read what a mapping says of a drive.

    Raises:
        ConfigurationError: For what does not fit.
    """
    try:
        return DriveOptions.model_validate(dict(given))
    except ValidationError as error:
        first = error.errors()[0]
        raise ConfigurationError(
            "the world of this log does not fit",
            key="world.driving." + ".".join(map(str, first["loc"])),
            found=first.get("input"),
            expected=first["msg"],
            remedy="see docs/logs.md",
        ) from None


class Drive:
    """Poses of a log, in the package's axes.

    Args:
        columns: Columns of the log.
        step: Seconds from sample to sample.
        options: What the mapping says.
    """

    def __init__(self, columns: Mapping[str, Floats], step: float, options: DriveOptions) -> None:
        self.step, self.options = step, options
        ids = [name[:-2] for name in columns if name.endswith(".x") and f"{name[:-1]}y" in columns]
        if EGO not in ids or not set(options.objects) <= set(ids):
            lacking = next((name for name in options.objects if name not in ids), EGO)
            raise ConfigurationError(
                f"the log has no poses of {lacking!r}",
                key="signals",
                found=f"poses of {list_names(ids)}" if ids else "no poses",
                expected=f"signals `{lacking}.x` and `{lacking}.y`, and those of the objects",
                remedy="bind them in the mapping",
            )
        self.ids = [EGO, *sorted(name for name in ids if name != EGO)]
        self.sizes = [options.objects.get(name, Body()) for name in self.ids]
        given = [
            _track(columns, name, step, reverses=size.reverses)
            for name, size in zip(self.ids, self.sizes, strict=True)
        ]
        backwards = [
            columns.get(f"{name}.speed", np.zeros(len(pose))) < (math.inf if size.reverses else 0.0)
            for name, size, (pose, _) in zip(self.ids, self.sizes, given, strict=True)
        ]
        self._backwards = np.stack(backwards, axis=1)
        self.flip = -1.0 if options.axes == "right-handed" else 1.0
        self.raw: Floats = np.stack([pose for pose, _ in given], axis=1)
        self.unknown = np.logical_or.reduce([unknown for _, unknown in given])
        rows = self.raw * np.array([1.0, self.flip, self.flip, 1.0, self.flip])
        self.ego = np.nan_to_num(rows[:, 0])
        there = np.isfinite(rows).all(axis=2)
        sizes = np.array([(size.length, size.width) for size in self.sizes])
        data = np.concatenate([rows, np.broadcast_to(sizes, (len(rows), *sizes.shape))], axis=2)
        self.bodies = []
        for tick, present in enumerate(there):
            chosen = np.flatnonzero(present[1:]) + 1
            names = tuple(self.ids[place] for place in chosen)
            self.bodies.append(BodyList(names, data[tick, chosen]))
        self.data, self._there = data, there
        size = self.sizes[0].length, self.sizes[0].width
        self.encounters = Encounters(self.ego, self.bodies, step, size)

    def signals(self) -> dict[str, Floats]:
        """The signals of the domain that follow from poses."""
        size = self.sizes[0].length, self.sizes[0].width
        gap, ttc = proximity(self.ego, self.bodies, size)
        heading, vx, vy = self.ego[:, 2], self.ego[:, 3], self.ego[:, 4]
        speed = np.cos(heading) * vx + np.sin(heading) * vy
        leader_gap, leader_speed = self._leaders(size)
        return {
            "gap": gap,
            "ttc": ttc,
            "collided": (gap <= 0.0).astype(float),
            "leader_gap": leader_gap,
            "speed": speed,
            "acceleration": np.gradient(speed, self.step) if len(speed) > 1 else 0.0 * speed,
            **criticality(self.encounters, leader_gap, leader_speed),
        }

    def _leaders(self, size: tuple[float, float]) -> tuple[Floats, Floats]:
        """Gap to, and speed of, who is ahead in the arc that the ego drives on, at each tick."""
        ticks, heading = len(self.ego), self.ego[:, 2]
        c, s = np.cos(heading)[:, None], np.sin(heading)[:, None]
        speed = self.ego[:, 3] * c[:, 0] + self.ego[:, 4] * s[:, 0]
        turn = np.gradient(np.unwrap(heading), self.step) if ticks > 1 else 0.0 * heading
        moving = np.abs(speed) > _MOVING
        bend = np.where(moving, turn / np.where(moving, speed, 1.0), 0.0)[:, None]
        others = self.data[:, 1:]
        if not others.shape[1]:
            return np.full(ticks, LEADER_CAP), np.zeros(ticks)
        dx, dy = others[..., X] - self.ego[:, :1], others[..., Y] - self.ego[:, 1:2]
        ahead, aside = c * dx + s * dy, c * dy - s * dx
        sharp = np.abs(bend) > 1e-6
        safe = np.where(sharp, bend, 1.0)
        along = np.where(sharp, np.arctan2(safe * ahead, 1.0 - safe * aside) / safe, ahead)
        reach = np.hypot(safe * ahead, 1.0 - safe * aside)
        lateral = np.where(sharp, (1.0 - reach) / safe, aside)
        path = heading[:, None] + bend * along
        turned = others[..., 2] - path
        cosine, sine = np.cos(turned), np.abs(np.sin(turned))
        half_length, half_width = others[..., LENGTH] / 2, others[..., WIDTH] / 2
        across = size[1] / 2 + half_width * np.abs(cosine) + half_length * sine
        distance = along - size[0] / 2 - half_length * np.abs(cosine) - half_width * sine
        leads = (along > 0.0) & (np.abs(lateral) < across) & (cosine > SAME_DIRECTION)
        leads &= half_length > 0.5
        distance = np.where(leads, np.maximum(distance, 0.0), LEADER_CAP)
        nearest = np.argmin(distance, axis=1)
        rows = np.arange(ticks)
        gap = np.minimum(distance[rows, nearest], LEADER_CAP)
        who, course = others[rows, nearest], path[rows, nearest]
        forward = who[:, VX] * np.cos(course) + who[:, VY] * np.sin(course)
        return gap, np.where(gap < LEADER_CAP, forward, 0.0)

    def refuse_mirror(self) -> None:
        """Refuse headings that do not go with the motion, and traffic on the wrong side.

        Raises:
            ConfigurationError: It names what is mirrored, and how that was seen.
        """
        for problem, found, remedy in (*self._headings(), *self._sides()):
            raise ConfigurationError(
                f"the world of this log is not as declared: {problem}",
                key="world.driving",
                found=found,
                expected=f"{self.options.axes} axes, and traffic on the {self.options.traffic}",
                remedy=remedy,
            )

    def _headings(self) -> list[tuple[str, str, str]]:
        """Compare headings and velocities with the way from sample to sample."""
        if len(self.raw) < 3:
            return []
        way = np.gradient(self.raw[:, :, :2], self.step, axis=0)
        moving = np.isfinite(self.raw).all(axis=2) & (np.hypot(way[..., 0], way[..., 1]) > _MOVING)
        if moving.sum() < _ENOUGH:
            return []
        course = np.arctan2(way[..., 1], way[..., 0])
        drift = np.arctan2(self.raw[..., 4], self.raw[..., 3])[moving]
        ahead = (course + math.pi * self._backwards)[moving]
        course = course[moving]
        heading = self.raw[..., 2][moving]
        readings = {
            "headings point against the motion": (
                heading + math.pi,
                (
                    "turn them by pi (`offset: 3.14159`), or, of who did drive backwards, say "
                    "`objects: {ego: {reverses: true}}`"
                ),
            ),
            "headings turn the other way, as in left-handed axes (CARLA, Unreal)": (
                -heading, "turn them over (`scale: -1`), or say `axes` if y is turned over as well",
            ),
            "headings are those of a compass": (
                math.pi / 2 - heading, "bind pi/2 less the heading (`scale: -1, offset: 1.5708`)",
            ),
            "headings are in degrees": (np.radians(heading), "say `recorded_in: deg`"),
        }  # fmt: skip
        found = _against("headings", heading, ahead, readings)
        readings = {
            "velocities point against the motion": (drift + math.pi, "turn them over"),
            "velocities are mirrored, as in left-handed axes (CARLA, Unreal)": (
                -drift, "turn `vy` over (`scale: -1`)",
            ),
        }  # fmt: skip
        return found + _against("velocities", drift, course, readings)

    def _sides(self) -> list[tuple[str, str, str]]:
        """See on which side of the ego oncoming traffic passes."""
        if self.options.traffic == "either":
            return []
        left = {True: 0, False: 0}
        mine = self.ego
        c, s = np.cos(mine[:, 2]), np.sin(mine[:, 2])
        moving = c * mine[:, 3] + s * mine[:, 4] > _MOVING
        for place in range(1, len(self.ids)):
            other = self.data[:, place]
            dx, dy = other[:, X] - mine[:, 0], other[:, Y] - mine[:, 1]
            aside = c * dy - s * dx  # to the right, with y to the south
            oncoming = moving & (other[:, VX] * c + other[:, VY] * s < -_MOVING)
            oncoming &= np.cos(other[:, 2] - mine[:, 2]) < -0.9
            oncoming &= (np.hypot(dx, dy) < _NEAR) & (np.abs(aside) < _BESIDE)
            offset = float(np.median(aside[oncoming])) if oncoming.any() else 0.0
            if abs(offset) >= _CLEAR:
                left[offset < 0.0] += 1
        proper, wrong = left[self.options.traffic == "right"], left[self.options.traffic != "right"]
        if wrong <= proper:
            return []
        other_side = "right" if self.options.traffic == "right" else "left"
        axes = "left-handed" if self.options.axes == "right-handed" else "right-handed"
        return [(
            "oncoming traffic passes on the wrong side",
            f"{wrong} of {wrong + proper} that came towards the ego passed on its {other_side}",
            (f"say `axes: {axes}` if y is turned over (CARLA and Unreal are left-handed), "
            "`traffic` if it keeps to the other side, "
             "`traffic: either` if the ego did drive on the wrong side"),
        )]  # fmt: skip

    def scene(self) -> Scene:
        """The drive from above, with the ways of all."""
        poses = np.full((len(self.ego), len(self.ids), 6), np.nan, np.float32)
        poses[..., :3] = self.data[..., :3]
        poses[..., 3] = np.hypot(self.data[..., VX], self.data[..., VY])
        poses[..., 4:] = self.data[..., LENGTH : WIDTH + 1]
        poses[~self._there] = np.nan
        tracks = Tracks(("EGO", *self.ids[1:]), poses)
        ways = [self.data[self._there[:, place], place, :2] for place in range(len(self.ids))]
        lines = tuple(Line("route", way[:: max(len(way) // 200, 1)].astype(np.float32))
                      for way in ways[:1])  # fmt: skip
        return Scene(lines, tracks, tracks, "EGO")


def _track(
    columns: Mapping[str, Floats], name: str, step: float, *, reverses: bool
) -> tuple[Floats, NDArray[Any]]:
    """Pose and velocity of an object, NaN where it is not there, and where it is not known."""
    unknown_keys = [
        key for key in columns if key.startswith(f"{name}.") and key[len(name) + 1 :] not in _KEYS
    ]
    if unknown_keys:
        raise ConfigurationError(
            "the pose of an object has no such part",
            key=f"signals.{unknown_keys[0]}",
            found=unknown_keys[0],
            expected=f"one of {list_names([f'{name}.{key}' for key in _KEYS])}",
            remedy="rename the signal",
        )
    given = {key: columns[f"{name}.{key}"] for key in _KEYS if f"{name}.{key}" in columns}
    known = np.logical_and.reduce([np.isfinite(column) for column in given.values()])
    count = len(known)
    inside = np.zeros(count, dtype=bool)
    if known.any():
        first, last = int(np.argmax(known)), count - int(np.argmax(known[::-1]))
        inside[first:last] = True
    if name == EGO:
        inside[:] = True
    ticks = np.arange(count)[known]
    way = np.full((count, 2), 0.0)
    if len(ticks) > 1:
        for place, key in enumerate(("x", "y")):
            way[known, place] = np.gradient(given[key][known], ticks * step)
    speed = given.get("speed")
    course = _course(way, known) + (math.pi if reverses else 0.0)
    heading = given.get("heading", course)
    if "vx" in given and "vy" in given:
        vx, vy = given["vx"], given["vy"]
    elif speed is not None:
        vx, vy = speed * np.cos(heading), speed * np.sin(heading)
    else:
        vx, vy = way.T
    pose = np.stack([given["x"], given["y"], heading, vx, vy], axis=1)
    pose[~known] = np.nan
    return pose, inside & ~known


def _course(way: Floats, known: NDArray[Any]) -> Floats:
    """Headings from the motion: who stands keeps the last one, and first has the next one."""
    moving = known & (np.hypot(way[:, 0], way[:, 1]) > _MOVING / 2)
    if not moving.any():
        return np.zeros(len(way))
    at = np.maximum.accumulate(np.where(moving, np.arange(len(way)), -1))
    at = np.where(at < 0, int(np.argmax(moving)), at)
    course: Floats = np.arctan2(way[at, 1], way[at, 0])
    return course


def _against(
    what: str, given: Floats, course: Floats, readings: Mapping[str, tuple[Floats, str]]
) -> list[tuple[str, str, str]]:
    """Say how directions differ from the course, if many do."""
    angle = _angle(given, course)
    if angle <= _SLIP:
        return []
    found = f"on average {math.degrees(angle):.0f} degrees from the way that was driven"
    for problem, (other, remedy) in readings.items():
        if _angle(other, course) <= angle / _BETTER:
            return [(problem, found, remedy)]
    if angle <= _WRONG:
        return []
    return [(f"{what} do not go with the motion", found, "check what is bound, and its unit")]


def _angle(a: Floats, b: Floats) -> float:
    """Mean angle between directions."""
    return float(np.mean(np.abs((a - b + math.pi) % (2 * math.pi) - math.pi)))
