"""A simulated episode as the log of its poses, as another simulator may write it."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np

from pytest_dura import Orchestrator, RoleSpec
from pytest_dura.domains import DOMAINS
from pytest_dura.library import expand_cases, load_library


def simulated(name: str = "intersection/congested", run: int = 0, generator: str = "aggressive"):
    """An episode without recovery, with its ticks and its loop."""
    (case,) = expand_cases(load_library([]).scenarios, select=[name])
    component = RoleSpec(DOMAINS["driving"].short_names["generator"][generator])
    spec = case.spec(run, 0, {"generator": component, "recovery_planner": None})
    loop = Orchestrator.build(spec)
    episode = loop.run(spec)
    return episode, loop.state.ticks


def poses(ticks: Any) -> dict[str, np.ndarray]:
    """Columns ``ego.x`` and so on, with y to the south as in the package; NaN where absent."""
    columns: dict[str, np.ndarray] = {}
    for row, tick in enumerate(ticks):
        ego = tick.truth["ego"]
        velocity = ego.speed * np.cos(ego.heading), ego.speed * np.sin(ego.heading)
        things = [("ego", (ego.x, ego.y, ego.heading, *velocity))]
        things += [(body.id, body[1:6]) for body in tick.truth["bodies"]]
        for name, pose in things:
            for key, value in zip(("x", "y", "heading", "vx", "vy"), pose, strict=True):
                column = columns.setdefault(f"{name}.{key}", np.full(len(ticks), np.nan))
                column[row] = value
    return columns


def sizes(ticks: Any) -> dict[str, dict[str, float]]:
    """Sizes of all objects, for a mapping."""
    return {
        body.id: {"length": body.length, "width": body.width}
        for tick in ticks
        for body in tick.truth["bodies"]
    }


def written(path: Path, columns: dict[str, np.ndarray], step: float = 0.1) -> Path:
    """Write columns as a table; a cell is empty where a value is absent."""
    count = len(next(iter(columns.values())))
    with path.open("w", newline="") as stream:
        table = csv.writer(stream)
        table.writerow(["time", *columns])
        for row in range(count):
            cells = [float(column[row]) for column in columns.values()]
            table.writerow([row * step, *("" if np.isnan(c) else repr(c) for c in cells)])
    return path
