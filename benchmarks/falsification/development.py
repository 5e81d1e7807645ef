"""Development systems: small ones, of several kinds, on which the portfolio was chosen."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from falsification.systems import Floats, Signals, System
from pytest_dura.search import Group, Layout

STEP = 0.1


def held(points: Floats, pieces: int, samples: int) -> Floats:
    """Inputs in [0, 1] sample by sample, shape ``(samples, k)``, from pieces of equal length."""
    found: Floats = points[:, np.arange(samples) * pieces // samples].T
    return found


def rolled(
    state: Floats, inputs: list[Floats], change: Callable[..., Floats], names: tuple[str, ...]
) -> Signals:
    """Explicit Euler steps of 0.1 s; the state has shape ``(len(names), k)``."""
    seen = [state]
    for now in zip(*inputs, strict=True):
        state = state + STEP * change(state, *now)
        seen.append(state)
    found = np.stack(seen, axis=-1)
    return dict(zip(names, found, strict=True))


def cart(points: Floats) -> Signals:
    """A cart with a motor and drag: position and speed, 20 s, 20 pieces of force."""
    force = 2.0 * held(points, 20, 200) - 1.0

    def change(state: Floats, push: Floats) -> Floats:
        return np.stack([state[1], push - 0.2 * state[1]])

    return rolled(np.zeros((2, len(points))), [force], change, ("x", "v"))


def spring(points: Floats) -> Signals:
    """A mass on a spring, hardly damped, period 6.3 s: 60 s, 30 pieces of force."""
    force = 2.0 * held(points, 30, 600) - 1.0

    def change(state: Floats, push: Floats) -> Floats:
        return np.stack([state[1], push - state[0] - 0.1 * state[1]])

    # The speed that comes after is used for the position, which keeps the energy.
    seen, now = [], np.zeros((2, len(points)))
    for push in force:
        speed = now[1] + STEP * change(now, push)[1]
        now = np.stack([now[0] + STEP * speed, speed])
        seen.append(now)
    x, v = np.stack(seen, axis=-1)
    return {"x": x, "v": v}


def gearbox(points: Floats) -> Signals:
    """A car with throttle, brake and three gears that change with hysteresis; 40 s, 16 pieces."""
    throttle, brake = held(points[:, :16], 16, 400), held(points[:, 16:], 16, 400)
    count = len(points)
    speed, engine, gear = np.zeros(count), np.full(count, 10.0), np.ones(count)
    seen = []
    for push, pull in zip(throttle, brake, strict=True):
        ratio = np.choose(gear.astype(int) - 1, [4.0, 2.2, 1.2])
        speed = np.maximum(speed + STEP * (2.0 * ratio * push - 8.0 * pull - 0.05 * speed), 0.0)
        engine = engine + STEP * 2.0 * (10.0 + ratio * speed + 15.0 * push - engine)
        gear = np.where((engine > 70.0) & (gear < 3), gear + 1, gear)
        gear = np.where((engine < 28.0) & (gear > 1), gear - 1, gear)
        seen.append(np.stack([speed, engine, gear]))
    return dict(zip(("speed", "engine", "gear"), np.stack(seen, axis=-1), strict=True))


def tanks(points: Floats) -> Signals:
    """Two tanks in a row; a float opens the drain at 0.8 and closes it at 0.3; 100 s, 20 pieces."""
    pump, valve = held(points[:, :20], 20, 1000)[::5], held(points[:, 20:], 20, 1000)[::5]
    first, second = np.zeros(len(points)), np.zeros(len(points))
    drain = np.zeros(len(points), bool)
    seen = []
    for fill, opened in zip(pump, valve, strict=True):
        through = 0.12 * opened * np.sqrt(first)
        first = np.clip(first + 0.5 * (0.06 * fill - through), 0.0, 2.0)
        drain = np.where(second > 0.8, True, np.where(second < 0.3, False, drain))
        second = np.clip(second + 0.5 * (through - 0.05 * drain), 0.0, 2.0)
        seen.append(np.stack([first, second]))
    return dict(zip(("first", "second"), np.stack(seen, axis=-1), strict=True))


def counter(points: Floats) -> Signals:
    """Charge that each rising edge of a trigger adds to, and that leaks away; 60 s, 30 pieces."""
    trigger = held(points, 30, 300)
    armed = np.ones(len(points), bool)
    charge, seen = np.zeros(len(points)), []
    for level in trigger:
        fires = armed & (level > 0.6)
        armed = np.where(level < 0.4, True, armed & ~fires)
        charge = charge * np.exp(-0.2 / 8.0) + fires
        seen.append(charge)
    return {"charge": np.stack(seen, axis=-1)}


def chain(points: Floats) -> Signals:
    """Four carts in a row, each drawn after the one before; gaps; 40 s, 20 pieces of force."""
    force = 2.0 * held(points, 20, 400) - 1.0

    def change(state: Floats, push: Floats) -> Floats:
        x, v = state[:4], state[4:]
        pulls = 1.5 * (x[:-1] - x[1:] - 4.0) + 0.8 * (v[:-1] - v[1:])
        lead = 2.0 * push - 0.3 * v[0]
        return np.vstack([v, lead[None], pulls])

    start = np.repeat([[12.0], [8.0], [4.0], [0.0], [0.0], [0.0], [0.0], [0.0]], len(points), 1)
    x = rolled(start, [force], change, tuple(f"s{i}" for i in range(8)))
    return {f"g{i}": x[f"s{i - 1}"] - x[f"s{i}"] for i in (1, 2, 3)}


def stopping(points: Floats) -> Signals:
    """Whether a vehicle stops before an obstacle: four numbers and a choice of sensor."""
    speed, grip, delay, sight = (
        low + (high - low) * points[:, i]
        for i, (low, high) in enumerate([(5, 20), (0.4, 0.9), (0.1, 1.2), (25, 60)])
    )
    sensor = np.minimum((points[:, 4] * 3).astype(int), 2)
    # Late sight of one sensor at middling speeds, where it changes its range.
    blind = 18.0 * (sensor == 1) * np.exp(-(((speed - 13.0) / 1.0) ** 2))
    needed = speed * delay + speed**2 / (2 * 9.81 * grip * 1.6)
    return {"rest": (sight - blind - 0.45 * needed + 4.0)[:, None]}


def inputs(*names: str, pieces: int) -> Layout:
    """Inputs over time."""
    return Layout(tuple(Group(name, pieces) for name in names))


SYSTEMS = {
    "cart": System(
        inputs("force", pieces=20),
        cart,
        STEP,
        {
            "cart far": "always (x <= 60)",
            "cart at rest": (
                "always[5:20] ((x <= 11.5) or (x >= 12.5) or (v >= 0.1) or (v <= -0.1))"
            ),
        },
    ),
    "spring": System(inputs("force", pieces=30), spring, STEP, {"spring": "always (x <= 8.5)"}),
    "gearbox": System(
        inputs("throttle", "brake", pieces=16),
        gearbox,
        STEP,
        {
            "gear speed": "always[0:30] (speed <= 38)",
            "gear slow": "always ((gear <= 2.5) or (speed >= 9))",
            "gear held": "not (eventually[10:20] (always[0:15] (gear >= 1.5 and gear <= 2.5"
            " and engine >= 45)))",
        },
    ),
    "tanks": System(
        inputs("pump", "valve", pieces=20),
        tanks,
        0.5,
        {
            "tank over": "always (second <= 1.13)",
            "tank band": (
                "not (eventually[30:60] (always[0:40] (second >= 0.45 and second <= 0.7)))"
            ),
        },
    ),
    "counter": System(
        inputs("trigger", pieces=30),
        counter,
        0.2,
        {
            "counted": "always (charge <= 2.4)",
            "kept": "always[0:20] (eventually[0:30] (always[0:4] (charge <= 1.5)))",
        },
    ),
    "chain": System(
        inputs("force", pieces=20),
        chain,
        STEP,
        {"chain": "always (g1 > -11) and always (g2 > -5) and always (g3 > -2.5)"},
    ),
    "stopping": System(
        Layout(
            (Group("speed"), Group("grip"), Group("delay"), Group("sight"), Group("sensor", 1, 3))
        ),
        stopping,
        STEP,
        {"stopping": "always (rest > 0)"},
    ),
}
