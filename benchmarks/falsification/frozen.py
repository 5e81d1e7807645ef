"""Frozen systems: made before the portfolio's turns were chosen anew, and reported beside them.

Their bounds were set so that uniform points or CMA-ES take some tens to some thousands of
simulations; no result of the portfolio was looked at for that.
"""

from __future__ import annotations

import numpy as np

from falsification.development import STEP, held, inputs, rolled
from falsification.systems import Floats, Signals, System


def pendulum(points: Floats) -> Signals:
    """A damped pendulum with a weak motor, 30 s, 30 pieces of torque: angle and rate."""
    torque = 0.6 * (2.0 * held(points, 30, 300) - 1.0)

    def change(state: Floats, push: Floats) -> Floats:
        return np.stack([state[1], push - np.sin(state[0]) - 0.15 * state[1]])

    return rolled(np.zeros((2, len(points))), [torque], change, ("angle", "rate"))


def rooms(points: Floats) -> Signals:
    """Two rooms, a heater with hysteresis in one, weather and a window; 240 minutes, 24 pieces."""
    weather, window = (held(part, 24, 240) for part in (points[:, :24], points[:, 24:]))
    count = len(points)
    first, second, on = np.full(count, 19.0), np.full(count, 18.0), np.zeros(count, bool)
    seen = []
    for outside, opened in zip(20.0 * weather - 5.0, window, strict=True):
        on = np.where(first < 18.5, True, np.where(first > 20.5, False, on))
        loss = 0.004 + 0.03 * opened
        first = first + 0.12 * on - 0.03 * (first - second) - 0.004 * (first - outside)
        second = second + 0.03 * (first - second) - loss * (second - outside)
        seen.append(np.stack([first, second, on]))
    return dict(zip(("first", "second", "on"), np.stack(seen, axis=-1), strict=True))


def lane(points: Floats) -> Signals:
    """A car that keeps its lane by delayed steering, on a bending road in wind; 40 s, 20 pieces."""
    bend, wind = (2.0 * held(part, 20, 400) - 1.0 for part in (points[:, :20], points[:, 20:]))
    count = len(points)
    offset, heading, steering = np.zeros(count), np.zeros(count), np.zeros(count)
    seen = []
    for curve, gust in zip(bend, wind, strict=True):
        wanted = np.clip(-0.25 * offset - 1.2 * heading, -0.35, 0.35)
        steering = steering + STEP * 2.0 * (wanted - steering)
        heading = heading + STEP * (1.5 * steering - 0.25 * curve)
        offset = offset + STEP * (12.0 * heading + 0.8 * gust)
        seen.append(np.stack([offset, steering]))
    return dict(zip(("offset", "steering"), np.stack(seen, axis=-1), strict=True))


def server(points: Floats) -> Signals:
    """A queue whose servers grow after a delay above 30 jobs, and shrink below 5; 20 pieces."""
    arrivals = 6.0 * held(points, 20, 400)
    count = len(points)
    queue, size, waited, cost = (np.zeros(count) for _ in range(4))
    size += 1.0
    seen = []
    for jobs in arrivals:
        waited = np.where(queue > 30.0, waited + STEP, 0.0)
        grow = (waited > 2.0) & (size < 3.0)
        size = np.where(grow, size + 1.0, np.where((queue < 5.0) & (size > 1.0), size - 1.0, size))
        waited = np.where(grow, 0.0, waited)
        queue = np.maximum(queue + STEP * (jobs - 1.8 * size), 0.0)
        cost = cost + STEP * size
        seen.append(np.stack([queue, size]))
    return dict(zip(("queue", "size"), np.stack(seen, axis=-1), strict=True))


def charger(points: Floats) -> Signals:
    """A battery that trips when warm and charged; a gentle current does not do it; 24 pieces."""
    current = held(points, 24, 480)
    count = len(points)
    charge, heat, tripped = np.zeros(count), np.zeros(count), np.zeros(count)
    seen = []
    for now in current:
        flow = np.where(tripped > 0.0, 0.0, now)
        tripped = np.where((heat > 0.5) & (charge > 0.2), 8.0, np.maximum(tripped - STEP, 0.0))
        heat = heat + STEP * (flow**2 - 0.35 * heat)
        charge = np.clip(charge + STEP * (0.06 * flow - 0.01 * charge), 0.0, 2.0)
        seen.append(np.stack([charge, heat, tripped]))
    return dict(zip(("charge", "heat", "tripped"), np.stack(seen, axis=-1), strict=True))


def convoy(points: Floats) -> Signals:
    """Five masses on springs and dampers behind a driven one; 40 s, 20 pieces: distances."""
    force = 2.0 * held(points, 20, 400) - 1.0

    def change(state: Floats, push: Floats) -> Floats:
        x, v = state[:6], state[6:]
        pull = 0.8 * (x[:-1] - x[1:]) + 0.5 * (v[:-1] - v[1:])
        pulled = np.vstack([pull[1:], np.zeros_like(pull[:1])])
        return np.vstack([v, 1.5 * push[None] - 0.3 * v[:1], pull - pulled])

    names = tuple(f"x{i}" for i in range(12))
    seen = rolled(np.zeros((12, len(points))), [force], change, names)
    return {f"d{i}": seen[f"x{i - 1}"] - seen[f"x{i}"] for i in range(1, 6)}


SYSTEMS = {
    "pendulum": System(
        inputs("torque", pieces=30),
        pendulum,
        STEP,
        {"swing": "always (angle <= 11)", "still": "always[10:30] (angle <= 3.2 or rate >= -1.6)"},
    ),
    "rooms": System(
        inputs("weather", "window", pieces=24),
        rooms,
        1.0,
        {
            "cold": "always[60:239] (second >= 4.9)",
            "idle": "not (eventually[60:120] (always[0:35] (on <= 0.5)))",
        },
    ),
    "lane": System(
        inputs("bend", "wind", pieces=20),
        lane,
        STEP,
        {
            "left": "always (offset <= 58)",
            "settled": "always[0:30] ((offset >= 24) implies (eventually[0:6] (offset <= 0.5)))",
        },
    ),
    "server": System(
        inputs("arrivals", pieces=20),
        server,
        STEP,
        {
            "backlog": "always (queue <= 45)",
            "even": "not (always[10:39] (queue >= 9.5 and queue <= 27))",
        },
    ),
    "charger": System(
        inputs("current", pieces=24),
        charger,
        STEP,
        {"full": "always (charge <= 0.55)", "gentle": "always (charge <= 0.5 or heat >= 0.42)"},
    ),
    "convoy": System(
        inputs("force", pieces=20),
        convoy,
        STEP,
        {
            "all apart": (
                "always (d1 < 11) and always (d2 < 9) and always (d3 < 7) and always (d4 < 5)"
                " and always (d5 > -5.6)"
            )
        },
    ),
}
