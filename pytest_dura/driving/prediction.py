"""Short predictions of the ego on its route and of the others, and how near they come.

Cars are covered by three discs, pedestrians by one, which makes a separation of two arrays of
points. Vectorised over candidate accelerations, times, objects and discs.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pytest_dura.driving.bodies import HEADING, LENGTH, VX, VY, WIDTH, BodyList
from pytest_dura.driving.junction import Route

Floats = NDArray[np.float64]

_OFFSETS = np.array([-1.0, 0.0, 1.0]) / 3.0
"""Centres of the three discs, as shares of a body's length."""
EGO_RADIUS = float(np.hypot(5.0 / 6.0, 1.0))
"""A disc of this radius covers a third of a car of 5 m by 2 m."""


def advance(speed: float, acceleration: Floats, times: Floats, top: float) -> Floats:
    """Metres driven after each time at constant acceleration, not reversing nor above ``top``.

    Shape ``(accelerations, times)``.
    """
    a = acceleration[:, None]
    rate = np.where(np.abs(a) < 1e-9, 1e-9, a)
    limit = np.where(a < 0, 0.0, max(top, speed))
    ramp = np.minimum(np.maximum((limit - speed) / rate, 0.0), times)
    return speed * ramp + 0.5 * a * ramp**2 + np.where(a < 0, 0.0, limit) * (times - ramp)


def moving(bodies: BodyList, times: Floats, yaw_rates: Floats | None = None) -> Floats:
    """Centres of the bodies' discs at each time, shape ``(times, bodies, 3, 2)``.

    Constant speed, and constant yaw rate where ``yaw_rates`` (rad/s, one per body) is given.
    """
    data = bodies.data
    turned = np.zeros((len(times), len(data))) if yaw_rates is None else np.outer(times, yaw_rates)
    half = turned / 2.0
    c, s = np.cos(half), np.sin(half)
    # A chord of the circle: for small angles its length is that of the arc.
    dx = times[:, None] * (c * data[:, VX] - s * data[:, VY])
    dy = times[:, None] * (s * data[:, VX] + c * data[:, VY])
    heading = data[:, HEADING] + turned
    reach = data[:, LENGTH, None] * _OFFSETS
    points = np.empty((len(times), len(data), 3, 2))
    points[..., 0] = (data[:, 0] + dx)[..., None] + np.cos(heading)[..., None] * reach
    points[..., 1] = (data[:, 1] + dy)[..., None] + np.sin(heading)[..., None] * reach
    return points


def radii(bodies: BodyList) -> Floats:
    """Radius of each body's discs, shape ``(bodies,)``."""
    data = bodies.data
    return np.hypot(data[:, LENGTH] / 6.0, data[:, WIDTH] / 2.0)


def ego_discs(route: Route, s: Floats, lateral: float = 0.0) -> Floats:
    """Centres of the ego's discs at positions along its route, shape ``(*s.shape, 3, 2)``."""
    x, y, heading = route.pose(s)
    c, sn = np.cos(heading), np.sin(heading)
    reach = 5.0 * _OFFSETS
    points = np.empty((*s.shape, 3, 2))
    points[..., 0] = (x - lateral * sn)[..., None] + c[..., None] * reach
    points[..., 1] = (y + lateral * c)[..., None] + sn[..., None] * reach
    return points


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
    return np.sqrt(squared) - (EGO_RADIUS + other_radii)


def near(bodies: BodyList, x: float, y: float, speed: float, horizon: float) -> BodyList:
    """The bodies that could be reached within the horizon at all."""
    if not len(bodies):
        return bodies
    data = bodies.data
    reach = 8.0 + horizon * (speed + np.hypot(data[:, VX], data[:, VY]))
    mask = (data[:, 0] - x) ** 2 + (data[:, 1] - y) ** 2 < reach * reach
    return bodies.only(mask)
