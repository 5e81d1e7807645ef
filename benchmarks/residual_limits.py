"""Thresholds of the residual monitor, from episodes without faults and a stated sensor noise.

Run: python benchmarks/residual_limits.py [--runs 10] [--draws 30] [--rate 1.0] [--seed 1]

The simulator's sensors are exact, and so is the model of the ego's motion up to rounding: on them
any threshold would do, and none would say how much noise it stands. So what the sensors say in
fault-free episodes of all built-in scenarios, under a careful planner and a random one, is replayed
with noise of the standard deviations below, drawn anew for each sample, and each test's threshold
is the least at which it raises its share of the accepted false alarms. The drifts are given. The
base seed is not the one on which detection is measured.
"""

from __future__ import annotations

import argparse
import math
from collections import defaultdict
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
from machine import machine, table

from pytest_dura.core import Orchestrator, Role, RoleSpec, RoleView
from pytest_dura.domains import DOMAINS
from pytest_dura.driving import LIMITS, Snapshot, residuals
from pytest_dura.driving.roles.residuals import Cusum
from pytest_dura.library import expand_cases, load_library

PLANNERS = ("rule_based", "random")
NOISE = {
    "odometry": 0.05,  # m/s
    "imu acceleration": 0.1,  # m/s2
    "imu yaw rate": 0.005,  # rad/s
    "localisation position": 0.05,  # m, each of x and y
    "localisation heading": 0.002,  # rad
    "lidar position": 0.03,  # m, each of x and y
    "lidar velocity": 0.1,  # m/s, each of x and y
}
"""Standard deviations of the sensor noise that the thresholds are set for; the simulator has none.
Independent at each tick. Radar has none."""

Tape = list[tuple[Snapshot, Any]]
"""What the sensors said at each tick, and what had been commanded before it."""


class Recorder(Role):
    """Keeps what a residual monitor would see."""

    name = "recorder"

    def __init__(self) -> None:
        self.tape: Tape = []

    def run(self, view: RoleView) -> None:
        """Keep this tick."""
        self.tape.append((Snapshot.of(view.percept), view.command))


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


def tapes(runs: int, seed: int, select: list[str]) -> Iterator[tuple[Tape, float]]:
    """The tapes of fault-free episodes, and seconds per tick."""
    for case in expand_cases(load_library([]).scenarios, ["none"], select):
        for planner in PLANNERS:
            for run in range(runs):
                recorder = Recorder()
                roles = {
                    "generator": RoleSpec(DOMAINS["driving"].short_names["generator"][planner])
                }
                spec = case.spec(run, seed, {**roles, "recorder": RoleSpec.of(recorder)})
                episode = Orchestrator.build(spec).run(spec)
                if episode.failure is not None:
                    raise RuntimeError(episode.failure)
                yield recorder.tape, spec.time_step


class Peaks:
    """How high the sums of each test rise before they return to 0: each rise is one alarm less."""

    def __init__(self) -> None:
        self.found: dict[str, list[float]] = defaultdict(list)
        self.hours = 0.0

    def add(self, tape: Tape, dt: float) -> None:
        """The rises of one episode."""
        tests: dict[tuple[str, str], Cusum] = {}
        rises: dict[tuple[str, str, str], float] = {}
        self.hours += len(tape) * dt / 3600.0
        for (before, _), (now, command) in pairwise(tape):
            for name, subject, value in residuals(before, now, command, dt):
                test = tests.setdefault((name, subject), Cusum(LIMITS[name].drift, math.inf))
                test.update(value)
                for side, level in (("upper", test.upper), ("lower", test.lower)):
                    rise = name, subject, side
                    if level > 0.0:
                        rises[rise] = max(rises.get(rise, 0.0), level)
                    elif rise in rises:
                        self.found[name].append(rises.pop(rise))
        for (name, _, _), height in rises.items():
            self.found[name].append(height)

    def threshold(self, name: str, rate: float) -> float:
        """The least one with fewer alarms per hour than ``rate``; 0 if it never rises."""
        heights = sorted(self.found[name], reverse=True)
        accepted = int(rate * self.hours)
        return heights[accepted] if accepted < len(heights) else 0.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=10, help="episodes per scenario and planner")
    parser.add_argument("--draws", type=int, default=30, help="times the noise is drawn for each")
    parser.add_argument("--rate", type=float, default=1.0, help="false alarms per hour, all tests")
    parser.add_argument("--seed", type=int, default=1, help="base seed")
    parser.add_argument("--select", nargs="+", default=[], help="scenarios; default: all")
    options = parser.parse_args()
    random = np.random.default_rng(options.seed)
    exact, peaks = Peaks(), Peaks()
    for tape, dt in tapes(options.runs, options.seed, options.select):
        exact.add(tape, dt)
        for _ in range(options.draws):
            peaks.add([(noisy(one, random), command) for one, command in tape], dt)
    share = options.rate / len(LIMITS)
    rows = []
    for name, limits in LIMITS.items():
        found = [one.threshold(name, rate) for one, rate in ((exact, 0.0), (peaks, share))]
        alarms = sum(height >= limits.threshold for height in peaks.found[name])
        cells = [f"{limits.drift:g}", *(f"{value:.3g}" for value in found)]
        rows.append([name, *cells, f"{limits.threshold:g}", f"{alarms / peaks.hours:.2f}"])
    print(f"""{machine()}

{options.runs} episodes of each scenario and planner, base seed {options.seed}, {exact.hours:.2f} h;
with noise drawn {options.draws} times {peaks.hours:.1f} h; accepted: {options.rate:g} false alarms
per hour of all tests together.
""")
    print(table([f"noise of {name}" for name in NOISE], [[f"{one:g}" for one in NOISE.values()]]))
    print()
    headers = ["residual", "drift", "highest without noise", "threshold found", "threshold in use"]
    print(table([*headers, "false alarms per hour with noise"], rows))


if __name__ == "__main__":
    main()
