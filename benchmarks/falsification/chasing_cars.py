"""Chasing cars (CC), after Hu, Lygeros and Sastry (2000), as the ARCH falsification contest has it.

Five cars in a row. The first has a throttle and a brake; each other one keeps its speed, chases or
brakes by the gap to the car before it. Modes are linear, so that each has a closed form; guards are
looked at every 0.01 s.
"""

from __future__ import annotations

import math

import numpy as np

from falsification.systems import Floats, Signals, System
from pytest_dura.search import Group, Layout

STEP = 0.01
END = 100.0
PIECES = 20
CARS = 5

KEEP, CHASE, BRAKE = range(3)

FORMULAS = {
    "CC1": "always[0:100] (d54 <= 40)",
    "CC2": "always[0:70] (eventually[0:30] (d54 >= 15))",
    "CC3": "always[0:80] ((always[0:20] (d21 <= 20)) or (eventually[0:20] (d54 >= 40)))",
    "CC4": "always[0:65] (eventually[0:30] (always[0:5] (d54 >= 8)))",
    "CC5": (
        "always[0:72] (eventually[0:8] ((always[0:5] (d21 >= 9)) implies"
        " (always[5:20] (d54 >= 9))))"
    ),
    "CCx": " and ".join(f"(always[0:50] (d{i + 1}{i} > 7.5))" for i in range(1, CARS)),
}


def leader(throttle: Floats, brake: Floats, step: float = STEP) -> Floats:
    """Where the first car is: y' = v, v' = -throttle - brake v, from rest at 0.

    Args:
        throttle: In [0, 1], one for each piece of 5 s.
        brake: The same.
        step: Seconds between samples; a piece has a whole number of them.
    """
    time = np.arange(1, round(END / PIECES / step) + 1) * step
    seen = [np.zeros(1)]
    place = speed = 0.0
    for push, pull in zip(throttle, brake, strict=True):
        first, second = _integrals(-pull * time)
        seen.append(place + speed * time * first - push * time**2 * second)
        place = seen[-1][-1]
        speed -= (pull * speed + push) * time[-1] * first[-1]
    return np.concatenate(seen)


def follower(front: Floats, start: float, step: float = STEP) -> Floats:
    """Where a car is that follows another, from rest and in mode Keep.

    Args:
        front: Where the other is, sample by sample.
        start: Where it begins.
        step: Seconds between samples, at each of which the guards are looked at.
    """
    fallen, faded = step**2 / 2.0, -math.expm1(-step)
    # Plain numbers: modes change so often that arrays would be the slower.
    rest = iter(front[1:].tolist())
    seen = [start]
    place, speed, mode = start, 0.0, KEEP
    while len(seen) < len(front):
        if mode == KEEP:
            way = speed * step
            for other in rest:
                place += way
                seen.append(place)
                if not 5.0 < place - other < 15.0:
                    mode = CHASE if place - other >= 15.0 else BRAKE
                    break
        elif mode == CHASE:
            for other in rest:
                place -= speed * step + fallen
                speed += step
                seen.append(place)
                if place - other <= 10.0:
                    mode = KEEP
                    break
        else:
            for other in rest:
                place -= speed * faded
                speed -= speed * faded
                seen.append(place)
                if place - other >= 20.0:
                    mode = CHASE
                    break
    return np.array(seen)


def simulate(points: Floats, step: float = STEP) -> Signals:
    """The distances between neighbours, such as ``d54`` from car 4 to car 5.

    Args:
        points: Shape ``(k, 40)``: the pieces of the throttle, then those of the brake.
        step: Seconds between samples.
    """
    seen = np.empty((len(points), CARS, round(END / step) + 1))
    for run, point in zip(seen, points, strict=True):
        run[0] = leader(point[:PIECES], point[PIECES:], step)
        for car in range(1, CARS):
            run[car] = follower(run[car - 1], 10.0 * car, step)
    return {f"d{car + 1}{car}": seen[:, car] - seen[:, car - 1] for car in range(1, CARS)}


def _integrals(x: Floats) -> tuple[Floats, Floats]:
    """(e^x - 1) / x and (e^x - 1 - x) / x^2, by their series near 0, where they would cancel."""
    small = np.abs(x) < 0.1
    safe = np.where(small, 1.0, x)
    first, second = np.zeros_like(x), np.zeros_like(x)
    for n in range(10, 0, -1):
        first = 1.0 + x * first / (n + 1)
        second = 1.0 + x * second / (n + 2)
    exact = np.expm1(safe)
    return (
        np.where(small, first, exact / safe),
        np.where(small, second / 2.0, (exact - safe) / safe**2),
    )


CHASING_CARS = System(
    Layout((Group("throttle", PIECES), Group("brake", PIECES))), simulate, STEP, FORMULAS
)
