"""Time of the measures of criticality: ``python benchmarks/criticality_speed.py [TICKS]``.

An ego drives at 10 m/s among objects that cross its way, meet it and lead it, at 10 Hz. Beside the
time of all measures stands how many times as fast as real time that is.
"""

from __future__ import annotations

import sys
import time

import numpy as np

from pytest_dura.driving.bodies import BodyList, proximity
from pytest_dura.driving.criticality import Encounters, criticality

STEP = 0.1


def traffic(ticks: int, objects: int) -> tuple[np.ndarray, list[BodyList]]:
    """An ego and objects that keep about it, each on a course of its own."""
    random = np.random.default_rng(0)
    t = np.arange(ticks) * STEP
    ego = np.stack([10 * t, 0 * t, 0 * t, 10 + 0 * t, 0 * t], axis=1)
    names = tuple(f"V{number}" for number in range(objects))
    heading = random.uniform(-np.pi, np.pi, objects)
    speed = random.uniform(1, 12, objects)
    velocity = np.stack([speed * np.cos(heading), speed * np.sin(heading)], axis=1)
    first = random.uniform(-60, 60, (objects, 2))
    bodies = []
    for at in t.tolist():
        # Who has left the surroundings of 120 m comes back on the other side.
        place = (first + velocity * at - [10 * at, 0] + 60) % 120 - 60 + [10 * at, 0]
        rows = [place, heading[:, None], velocity, np.tile([5.0, 2.0], (objects, 1))]
        bodies.append(BodyList(names, np.concatenate(rows, axis=1)))
    return ego, bodies


def main() -> None:
    ticks = int(sys.argv[1]) if sys.argv[1:] else 6000
    print(f"{ticks} ticks of {STEP:g} s")
    for objects in (5, 50):
        ego, bodies = traffic(ticks, objects)
        start = time.perf_counter()
        proximity(ego, bodies)
        near = time.perf_counter() - start
        start = time.perf_counter()
        met = Encounters(ego, bodies, STEP)
        found = criticality(met, np.full(ticks, 50.0), np.zeros(ticks))
        rest = time.perf_counter() - start
        print(
            f"{objects:>3} objects: gap and time to collision {near:.3f} s, the rest {rest:.3f} s; "
            f"{ticks * STEP / (near + rest):,.0f} times real time; "
            f"{found['near_misses'][-1]:.0f} near misses"
        )


if __name__ == "__main__":
    main()
