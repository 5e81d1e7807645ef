"""Detectors on recorded logs, in open loop: ``python benchmarks/open_loop.py [LOGS] [FAULT ...]``.

Drives of the rule-based planner through ``intersection/congested`` are written as tables of poses,
as another recorder would, and played back; what the detectors say changes nothing. Faults of the
catalogue are laid over the channels of each log. Noise is that of a sensor
of positions. The learned detector is that of
``example_suites/anomaly_detection``; it has learned from other drives.
"""

from __future__ import annotations

import csv
import math
import sys
import tempfile
from collections.abc import Mapping
from itertools import product
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from pytest_dura import Episode, Orchestrator, RoleSpec
from pytest_dura.domains import DOMAINS
from pytest_dura.library import Scenario, expand_cases, load_library
from pytest_dura.logs.simulator import log_scenario
from pytest_dura.requirements import judge_alerts, monitor_timeline

FAULTS = ("ghost-obstacle", "trajectory-spoof", "gnss-drag-off", "gnss-jump", "id-switch")
NOISES = (0.0, 0.05)
"""Standard deviations of the positions in a log, in m."""
SCENARIO, SEED = "intersection/congested", 100
SUITE = Path(__file__).parent.parent / "example_suites" / "anomaly_detection"
MAPPING = {"time_step": 0.1, "world": {"driving": {"axes": "left-handed", "junction": [0, 0]}}}
_NAMES = DOMAINS["driving"].short_names
DETECTORS = {
    "plausibility": {"security_assessor": RoleSpec(_NAMES["security_assessor"]["plausibility"])},
    "residuals": {
        "security_assessor": None,
        "residual_monitor": RoleSpec(_NAMES["residual_monitor"]["cusum"]),
    },
    "learned": {"security_assessor": RoleSpec("anomaly_assessor:AnomalyAssessor")},
}


def written(file: Path, run: int, noise: float) -> dict[str, dict[str, float]]:
    """Record a drive as a table of poses, with noise in m; returns the sizes of all objects."""
    (case,) = expand_cases([load_library([]).scenarios[SCENARIO]], ["none"])
    spec = case.spec(run, SEED, {"recovery_planner": None})
    loop = Orchestrator.build(spec)
    loop.run(spec)
    ticks, columns, sizes = loop.state.ticks, {}, {}
    for row, tick in enumerate(ticks):
        ego = tick.truth["ego"]
        velocity = ego.speed * math.cos(ego.heading), ego.speed * math.sin(ego.heading)
        things = [("ego", (ego.x, ego.y, ego.heading, *velocity))]
        things += [(body.id, tuple(body[1:6])) for body in tick.truth["bodies"]]
        for name, pose in things:
            for key, value in zip(("x", "y", "heading", "vx", "vy"), pose, strict=True):
                column = columns.setdefault(f"{name}.{key}", np.full(len(ticks), np.nan))
                column[row] = value
        for body in tick.truth["bodies"]:
            sizes[body.id] = {"length": body.length, "width": body.width}
    random = np.random.default_rng(run)
    for name, column in columns.items():
        if name.endswith((".x", ".y")):
            columns[name] = column + noise * random.normal(size=len(column))
    with file.open("w", newline="") as stream:
        table = csv.writer(stream)
        table.writerow(["time", *columns])
        for row in range(len(ticks)):
            cells = [float(column[row]) for column in columns.values()]
            table.writerow([row * 0.1, *("" if math.isnan(cell) else cell for cell in cells)])
    return sizes


def main() -> None:
    logs = int(sys.argv[1]) if sys.argv[1:] else 20
    faults = sys.argv[2:] or FAULTS
    sys.path.insert(0, str(SUITE))
    with tempfile.TemporaryDirectory() as folder:
        sets: dict[float, list[Scenario]] = {}
        for noise, run in product(NOISES, range(logs)):
            file = Path(folder, f"{run}-{noise}.csv")
            world = MAPPING["world"]["driving"] | {"objects": written(file, run, noise)}
            mapping = MAPPING | {"world": {"driving": world}}
            sets.setdefault(noise, []).append(log_scenario(str(file), mapping, played=True))
        print(f"{logs} logs of drives, with positions as they were and with noise\n")
        print(
            "| detector | noise m | fault | detected | latency s | alarms on clean logs, an hour |"
        )
        print("|---|---|---|---|---|---|")
        for name, noise in product(DETECTORS, NOISES):
            scenarios, roles = sets[noise], DETECTORS[name]
            clean = [episode_of(each, "none", roles) for each in scenarios]
            for fault in faults:
                laid = [episode_of(each, fault, roles) for each in scenarios]
                quality = judge_alerts(monitor_timeline(each) for each in (*clean, *laid))
                attacked = quality.true_positives + quality.false_negatives
                delay = f"{median(quality.delays):.1f}" if quality.delays else "-"
                alarms = sum(event.kind == "alert" for each in clean for event in each.events)
                hours = sum(float(each.time[-1]) for each in clean) / 3600
                print(
                    f"| {name} | {noise:g} | {fault} | {quality.true_positives} of {attacked} "
                    f"| {delay} | {alarms} in {hours:.2f} h, {alarms / hours:.0f} |"
                )


def episode_of(scenario: Scenario, fault: str, roles: Mapping[str, Any]) -> Episode:
    """Play a log under a fault to the component that drove it and a detector."""
    (case,) = expand_cases([scenario], [fault])
    spec = case.spec(0, 0, {"recovery_planner": None, **roles})
    episode = Orchestrator.build(spec).run(spec)
    if episode.failure is not None:
        raise RuntimeError(episode.failure)
    return episode


if __name__ == "__main__":
    main()
