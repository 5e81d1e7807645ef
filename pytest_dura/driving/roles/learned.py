"""Learned residual monitors: an isolation forest and a one-class SVM over driving features.

The residuals of ``pytest_dura.driving.roles.residuals``, their means over the last second, and what
changes in the list of objects, which no residual sees: what appears or vanishes within reach, what
changes its size, and what radar does not confirm. All are near 0 while all sensors are well,
however the ego drives, so that a detector that learned on a few planners need not know the others.

Both learned on fault-free episodes, with sensor noise of stated size; see ``docs/detectors.md``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pytest_dura.core.anomaly_monitor import AnomalyMonitor, FeatureSource, Floats
from pytest_dura.core.state import RoleView
from pytest_dura.driving.bodies import LENGTH, VX, VY, WIDTH
from pytest_dura.driving.maneuvers import Command
from pytest_dura.driving.roles.residuals import (
    EGO,
    Snapshot,
    command_residual,
    ego_residuals,
    object_residuals,
)
from pytest_dura.driving.sensors import RANGE, Pose

NOISE = {
    "odometry": 0.05,  # m/s
    "imu acceleration": 0.1,  # m/s2
    "imu yaw rate": 0.005,  # rad/s
    "localisation position": 0.05,  # m, each of x and y
    "localisation heading": 0.002,  # rad
    "lidar position": 0.03,  # m, each of x and y
    "lidar velocity": 0.1,  # m/s, each of x and y
}
"""Standard deviations of the sensor noise that thresholds are set for; the simulator has none.
Independent at each tick. Radar has none."""

_MEMORY = 1.0
"""s; time constant of the means."""
CAP = 100.0
"""Greatest value of a feature, in its unit: greater ones are as implausible as this one."""
_UNCONFIRMED = 10.0
"""m; farther apart, lidar and radar do not mean the same object, however far."""
_ROAD_END = 85.0
"""m from the centre; farther out, bodies come and go at the ends of the arms."""
_SAME = 1.0
"""m; no two objects have centres so close."""
_EDGE = RANGE - 2.0
"""m from the ego; farther out, one of lidar and radar may not see what the other does."""

_RESIDUALS = {**dict.fromkeys(EGO, 0.1), "localisation.heading": 0.01, "command": 0.1}
_OBJECTS = {
    "lidar.displacement": 0.1,
    "lidar.newcomer": 0.5,
    "lidar.vanished": 0.5,
    "lidar.size": 0.1,
    "radar.unconfirmed": 0.1,
    "radar.unexplained": 0.1,
    "radar.rate": 0.1,
}


class Observation(NamedTuple):
    """Values of the sensors at a tick, the command before it, and seconds per tick."""

    snapshot: Snapshot
    command: Command | None
    dt: float


class DrivingFeatures(FeatureSource):
    """The features of the driving domain.

    ``odometry.speed`` (m/s2), ``localisation.along``, ``.across`` (m/s), ``.heading`` (rad/s) and
    ``command`` (m/s2), see ``pytest_dura.driving.roles.residuals``;
    ``<name>.mean`` of each, exponentially weighted over a second;
    ``lidar.displacement``: m/s by which an object is off where its velocity led to expect it;
    ``lidar.newcomer``, ``lidar.vanished``: m within reach at which an object came or went;
    ``lidar.size``: m by which an object's length and width changed;
    ``radar.unconfirmed``: m from a lidar object to the nearest radar return, at most 10;
    ``radar.unexplained``: m from a radar return to the nearest lidar object, at most 10;
    ``radar.rate``: m/s between the range rates of the two. Of all objects the greatest counts.
    """

    names = (*_RESIDUALS, *(f"{name}.mean" for name in _RESIDUALS), *_OBJECTS)
    resolutions = (*_RESIDUALS.values(), *_RESIDUALS.values(), *_OBJECTS.values())
    noise = NOISE

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget what was seen."""
        self._before: Snapshot | None = None
        self._means = [0.0] * len(_RESIDUALS)

    def observe(self, view: RoleView) -> Observation:
        """The channels that are numbers, and the command."""
        return Observation(Snapshot.of(view.percept), view.command, view.dt)

    def disturbed(self, sample: Observation, random: np.random.Generator) -> Observation:
        """The observation by sensors with the noise of :data:`NOISE`."""
        return sample._replace(snapshot=noisy(sample.snapshot, random))

    def update(self, sample: Observation) -> Floats | None:
        """The features of a tick; ``None`` at the first one, where there is nothing to compare."""
        now, command, dt = sample
        before, self._before = self._before, now
        if before is None:
            return None
        command_error = 0.0 if command is None else command_residual(command, before, now, dt)
        own = [_capped(value) for value in (*ego_residuals(before, now, dt), command_error)]
        share = 1.0 - math.exp(-dt / _MEMORY)
        self._means = [
            mean + share * (value - mean) for mean, value in zip(self._means, own, strict=True)
        ]
        moved = object_residuals(before, now, dt).values()
        listed = (
            max((math.hypot(x, y) for x, y in moved), default=0.0),
            _deepest(before.objects, now.objects, now.pose),
            _deepest(now.objects, before.objects, before.pose),
            _resized(before, now),
            *_against_radar(now),
        )
        return np.array([*own, *self._means, *map(_capped, listed)])


def noisy(snapshot: Snapshot, random: np.random.Generator) -> Snapshot:
    """The snapshot of sensors with the noise of :data:`NOISE`."""
    speed, acceleration, yaw_rate, x, y, heading = random.standard_normal(6).tolist()
    imu, pose = snapshot.imu, snapshot.pose
    errors = random.standard_normal((len(snapshot.objects), 4))
    errors *= [NOISE["lidar position"]] * 2 + [NOISE["lidar velocity"]] * 2
    objects = {}
    for (name, row), (ex, ey, evx, evy) in zip(
        snapshot.objects.items(), errors.tolist(), strict=True
    ):
        objects[name] = [row[0] + ex, row[1] + ey, row[2], row[3] + evx, row[4] + evy, *row[5:]]
    return snapshot._replace(
        speed=snapshot.speed + NOISE["odometry"] * speed,
        imu=imu._replace(
            acceleration=imu.acceleration + NOISE["imu acceleration"] * acceleration,
            yaw_rate=imu.yaw_rate + NOISE["imu yaw rate"] * yaw_rate,
        ),
        pose=pose._replace(
            x=pose.x + NOISE["localisation position"] * x,
            y=pose.y + NOISE["localisation position"] * y,
            heading=pose.heading + NOISE["localisation heading"] * heading,
        ),
        objects=objects,
    )


def _capped(value: float) -> float:
    """Within plus or minus ``CAP``; ``CAP`` for what is no number."""
    return max(-CAP, min(CAP, value)) if value == value else CAP  # noqa: PLR0124 - NaN is not itself


def _deepest(
    before: Mapping[str, list[float]], now: Mapping[str, list[float]], pose: Pose
) -> float:
    """Greatest depth within reach of an object that only ``now`` has, in m; at least 0."""
    deepest = 0.0
    if now.keys() <= before.keys():  # as at most ticks
        return deepest
    for name, (x, y, *_) in now.items():
        if name not in before:
            within = RANGE - math.hypot(x - pose.x, y - pose.y)
            deepest = max(deepest, min(within, _ROAD_END - max(abs(x), abs(y))))
    return deepest


def _resized(before: Snapshot, now: Snapshot) -> float:
    """The greatest change of an object's length and width together, in m."""
    greatest = 0.0
    for name, row in now.objects.items():
        old = before.objects.get(name)
        if old is not None:
            change = abs(row[LENGTH] - old[LENGTH]) + abs(row[WIDTH] - old[WIDTH])
            greatest = max(greatest, change)
    return greatest


def _against_radar(now: Snapshot) -> tuple[float, float, float]:
    """``radar.unconfirmed``, ``radar.unexplained`` and ``radar.rate`` of a tick."""
    if not (now.objects or now.radar):
        return 0.0, 0.0, 0.0
    own_x, own_y, heading = now.pose
    if not math.isfinite(heading):
        return _UNCONFIRMED, _UNCONFIRMED, 0.0
    vx, vy = now.speed * math.cos(heading), now.speed * math.sin(heading)
    places = _places(now)
    nearest = [_UNCONFIRMED] * len(places)
    unconfirmed = worst_rate = 0.0
    for number, row in enumerate(now.objects.values()):
        at, apart = _match(row[0], row[1], places, number, nearest)
        dx, dy = row[0] - own_x, row[1] - own_y
        distance = math.hypot(dx, dy)
        if apart < _UNCONFIRMED:
            expected = (dx * (row[VX] - vx) + dy * (row[VY] - vy)) / max(distance, 0.1)
            worst_rate = max(worst_rate, abs(expected - now.radar[at][2]))
        if not distance > _EDGE:  # there, one of them may not see it any more
            unconfirmed = max(unconfirmed, apart)
    lone = [apart for apart, row in zip(nearest, now.radar, strict=True) if not row[0] > _EDGE]
    return unconfirmed, max(lone, default=0.0), worst_rate


def _places(now: Snapshot) -> list[tuple[float, float]]:
    """Places of the radar returns: x and y in m."""
    own_x, own_y, heading = now.pose
    places = []
    for distance, azimuth, _ in now.radar:
        bearing = heading - azimuth if math.isfinite(azimuth) else heading
        places.append((own_x + distance * math.cos(bearing), own_y + distance * math.sin(bearing)))
    return places


def _match(
    x: float, y: float, places: list[tuple[float, float]], number: int, nearest: list[float]
) -> tuple[int, float]:
    """The return nearest to an object, and how far it is, in m; ``_UNCONFIRMED`` for none nearer.

    ``nearest`` keeps how near any object is to each return. Without an attack, objects and returns
    have the same order, which saves the search.
    """
    if number < len(places):
        apart = math.hypot(places[number][0] - x, places[number][1] - y)
        if apart < _SAME:
            nearest[number] = min(nearest[number], apart)
            return number, apart
    at, least = number, _UNCONFIRMED
    for other, (px, py) in enumerate(places):
        apart = math.hypot(px - x, py - y)
        nearest[other] = min(nearest[other], apart)
        if apart < least:
            at, least = other, apart
    return at, least


_MODELS = Path(__file__).parents[1] / "models"


class IsolationForestMonitor(AnomalyMonitor):
    """Alarms where few random splits of the features isolate a tick from those of training.

    See :class:`pytest_dura.core.anomaly_monitor.AnomalyMonitor` for parameters and alerts, and
    :class:`pytest_dura.driving.roles.learned.DrivingFeatures` for the features.
    """

    name = "residual_monitor"
    kind = "isolation_forest"
    shipped = _MODELS / "isolation_forest.json"

    @classmethod
    def source(cls) -> DrivingFeatures:
        """The features of the driving domain."""
        return DrivingFeatures()


class OneClassSvmMonitor(AnomalyMonitor):
    """Alarms where a tick's features are beyond the border that encloses those of training.

    See :class:`pytest_dura.core.anomaly_monitor.AnomalyMonitor` for parameters and alerts, and
    :class:`pytest_dura.driving.roles.learned.DrivingFeatures` for the features.
    """

    name = "residual_monitor"
    kind = "one_class_svm"
    shipped = _MODELS / "one_class_svm.json"

    @classmethod
    def source(cls) -> DrivingFeatures:
        """The features of the driving domain."""
        return DrivingFeatures()
