"""Short predictions of the ego on its route and of the others, and how near they come.

Cars are covered by three discs, pedestrians by one, which makes a separation of two arrays of
points. Vectorised over candidate accelerations, times, objects and discs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pytest_dura.driving.bodies import HEADING, LENGTH, NO_BODIES, VX, VY, WIDTH, BodyList
from pytest_dura.driving.lanes import Route
from pytest_dura.driving.scene import Scene

Floats = NDArray[np.float64]

DISC_OFFSETS: Floats = np.array([-1.0, 0.0, 1.0]) / 3.0
"""Centres of the three discs, as shares of a body's length."""
EGO_OFFSETS: Floats = 5.0 * DISC_OFFSETS
"""Metres along the route from the ego's centre to those of its discs."""
EGO_RADIUS = float(np.hypot(5.0 / 6.0, 1.0))
"""A disc of this radius covers a third of a car of 5 m by 2 m."""


def advance(
    speed: float, accelerations: Sequence[float], times: Sequence[float], top: float
) -> Floats:
    """Metres driven after each time at constant acceleration, not reversing nor above ``top``.

    Shape ``(accelerations, times)``. Plain arithmetic: the arrays are too small for NumPy to pay.
    """
    return np.array([driven(speed, a, times, top) for a in accelerations])


def driven(speed: float, a: float, times: Sequence[float], top: float) -> list[float]:
    """Metres driven after each time, for one acceleration, as plain numbers."""
    limit = 0.0 if a < 0.0 else max(top, speed)
    ramp_end = (limit - speed) / a if a else 0.0
    cruise = speed if a == 0.0 else limit
    row = []
    for time in times:
        ramp = min(ramp_end, time)
        row.append(speed * ramp + 0.5 * a * ramp * ramp + cruise * (time - ramp))
    return row


def moving(bodies: BodyList, times: Floats, yaw_rates: Floats | None = None) -> Floats:
    """Centres of the bodies' discs at each time, shape ``(times, bodies, 3, 2)``.

    Constant speed, and constant yaw rate where ``yaw_rates`` (rad/s, one per body) is given.
    """
    data = bodies.data
    reach = data[:, LENGTH, None] * DISC_OFFSETS
    if yaw_rates is None:
        along = np.empty((len(data), 1, 2))
        np.cos(data[:, HEADING], out=along[:, 0, 0])
        np.sin(data[:, HEADING], out=along[:, 0, 1])
        discs = data[:, None, :2] + along * reach[..., None]
        motion = times[:, None, None, None] * data[:, None, VX : VY + 1]
        straight: Floats = discs + motion
        return straight
    points = np.empty((len(times), len(data), 3, 2))
    turned = times[:, None] * yaw_rates
    half = turned / 2.0
    c, s = np.cos(half), np.sin(half)
    # A chord of the circle: for small angles its length is that of the arc.
    dx = times[:, None] * (c * data[:, VX] - s * data[:, VY])
    dy = times[:, None] * (s * data[:, VX] + c * data[:, VY])
    heading = data[:, HEADING] + turned
    points[..., 0] = (data[:, 0] + dx)[..., None] + np.cos(heading)[..., None] * reach
    points[..., 1] = (data[:, 1] + dy)[..., None] + np.sin(heading)[..., None] * reach
    return points


def radii(bodies: BodyList) -> Floats:
    """Radius of each body's discs, shape ``(bodies,)``."""
    data = bodies.data
    return np.hypot(data[:, LENGTH] / 6.0, data[:, WIDTH] / 2.0)


def ego_discs(route: Route, s: Floats) -> Floats:
    """Centres of the ego's discs at positions along its route, shape ``(*s.shape, 3, 2)``.

    All three lie on the route, as the wheels of a car that follows it do.
    """
    return route.points(s[..., None] + EGO_OFFSETS)


def separations(ego: Floats, others: Floats, other_radii: Floats) -> Floats:
    """Least distance between the ego's discs and each body's, negative on overlap.

    Args:
        ego: Shape ``(candidates, times, 3, 2)``.
        others: Shape ``(times, bodies, 3, 2)``.
        other_radii: Shape ``(bodies,)``.

    Returns:
        Shape ``(candidates, times, bodies)``.
    """
    delta_x = ego[:, :, None, :, None, 0] - others[None, :, :, None, :, 0]
    delta_y = ego[:, :, None, :, None, 1] - others[None, :, :, None, :, 1]
    squared = (delta_x * delta_x + delta_y * delta_y).min(axis=(-2, -1))
    apart: Floats = np.sqrt(squared) - (EGO_RADIUS + other_radii)
    return apart


def near(bodies: BodyList, x: float, y: float, speed: float, horizon: float) -> list[int]:
    """Rows of the bodies that could be reached within the horizon at all."""
    rows = []
    for row, (bx, by, _, vx, vy, _, _) in enumerate(bodies.numbers):
        reach = 8.0 + horizon * (speed + abs(vx) + abs(vy))
        if (bx - x) ** 2 + (by - y) ** 2 < reach * reach:
            rows.append(row)
    return rows


class Predictor:
    """Predicts how near an ego that keeps an acceleration comes to what it perceives.

    Bodies keep their speed, and the yaw rate that two successive percepts show.

    Args:
        horizon: Seconds.
        step: Seconds between two predicted instants.
        now: Whether the present is the first of them.
    """

    def __init__(self, horizon: float, step: float, *, now: bool = False) -> None:
        self.horizon = horizon
        self.times: Floats = np.arange(0.0 if now else 1.0, round(horizon / step) + 1.0) * step
        self.steps: list[float] = self.times.tolist()
        self.reset()

    def reset(self) -> None:
        """Forget what was perceived."""
        self._index: int | None = None
        self._headings: dict[str, float] = {}
        self._before: dict[str, float] = {}

    def observe(self, index: int, bodies: BodyList) -> None:
        """The bodies perceived at a tick; a second call within the tick changes nothing."""
        if index != self._index:
            self._index, self._before = index, self._headings
            self._headings = {
                i: row[HEADING] for i, row in zip(bodies.ids, bodies.numbers, strict=True)
            }

    def separations(
        self, scene: Scene, accelerations: Sequence[float], dt: float
    ) -> tuple[Floats, BodyList]:
        """Distances in m, shape ``(accelerations, times, bodies)``, and which bodies these are.

        Bodies out of reach are left out.
        """
        bodies = self._within_reach(scene, scene.speed)
        if not bodies.ids:
            return np.empty((len(accelerations), len(self.times), 0)), NO_BODIES
        driven = advance(scene.speed, accelerations, self.steps, scene.limit)
        return self._apart(scene, driven, bodies, dt), bodies

    def along(self, scene: Scene, driven: Floats, dt: float) -> tuple[Floats, BodyList]:
        """The separations of an ego that has driven so many metres at each time.

        Args:
            scene: Where it begins.
            driven: Shape ``(candidates, times)``, not decreasing over time.
            dt: Seconds per tick.
        """
        bodies = self._within_reach(scene, float(driven[:, -1].max()) / self.horizon)
        return self._apart(scene, driven, bodies, dt), bodies

    def _within_reach(self, scene: Scene, speed: float) -> BodyList:
        bodies = scene.bodies
        return bodies.rows(near(bodies, scene.x, scene.y, speed, self.horizon))

    def _apart(self, scene: Scene, driven: Floats, bodies: BodyList, dt: float) -> Floats:
        ego = ego_discs(scene.route, scene.s + driven)
        rates = self.rates(bodies.ids, dt)
        others = moving(bodies, self.times, None if rates is None else np.array(rates))
        return separations(ego, others, radii(bodies))

    def rates(self, ids: Sequence[str], dt: float) -> list[float] | None:
        """Yaw rates of these bodies in rad/s; ``None`` if none of them turns."""
        rates, headings, before = [], self._headings, self._before
        for body_id in ids:
            heading = headings[body_id]
            turned = heading - before.get(body_id, heading)
            turned = (turned + math.pi) % (2.0 * math.pi) - math.pi
            rates.append(max(-1.0, min(1.0, turned / dt)))
        return rates if any(rates) else None
