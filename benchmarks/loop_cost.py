"""What the loop costs: all six roles, a monitor by formula and metrics, against bare stepping.

Run: python benchmarks/loop_cost.py [--runs 3] [--repeats 3] [--generator NAME]

Each episode is run with the loop; its executed accelerations then drive the same scenario and seed
for the same ticks without any role, in two ways:

- ``highway-env``: the same road and cars by highway-env's own methods (``published_road``), without
  sensors. ``pytest_dura.driving`` does the same quicker, to the last bit;
- ``step``: the simulator's own ``step``, quickened, which senses what roles would perceive.

The loop runs twice as well: with the six roles of the scenario, and with a ``StlSafetyMonitor``
beside them and all measures of ``pytest_dura.driving.measures`` as user-defined metrics. All are
repeated in turns, and of each tick the quickest counts, since episodes are the same tick by tick
and other work on the machine is not. Beginning and end of an episode are part of it. Times are
those of the processor, those of the parts by the clock. Sums over the scenarios weigh each by its
time.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from time import perf_counter_ns, process_time_ns
from typing import Any

import numpy as np
from machine import machine, table

from pytest_dura.core import STANDARD_ROLES, EpisodeSpec, Orchestrator, RoleSpec
from pytest_dura.domains import DOMAINS
from pytest_dura.driving import Command, HighwaySimulator, measures
from pytest_dura.library import expand_cases, load_library

Parts = Counter[str]
Laps = dict[str, list[int]]

MONITOR = RoleSpec(
    "pytest_dura:StlSafetyMonitor",
    {
        "formula": "historically[0:0.5] (gap > 0.5)",
        "warning": "ttc > 2",
        "signals": "pytest_dura.driving.signals:percept_at",
    },
)
METRICS = {
    measure.__name__: measure
    for measure in (
        measures.clearance_time,
        measures.minimum_gap,
        measures.peak_deceleration,
        measures.time_stopped,
    )
}
SIX, ALL = "six roles", "six roles, STL monitor, metrics"
PUBLISHED, STEP = "highway-env", "step"

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))
from published_road import published_road  # noqa: E402 - found only from here on


class TimedSimulator(HighwaySimulator):
    """Notes when each step begins, and how long step and road take, in ns."""

    def __init__(self) -> None:
        super().__init__()
        self.begun: list[int] = []
        self.roads: list[int] = []
        self.steps: list[int] = []

    def drive(self, acceleration: float) -> None:
        """Only the road, timed."""
        start = perf_counter_ns()
        super().drive(acceleration)
        self.roads.append(perf_counter_ns() - start)

    def step(self, action: Any) -> Any:
        """A whole step, timed."""
        self.begun.append(process_time_ns())
        start = perf_counter_ns()
        tick = super().step(action)
        self.steps.append(perf_counter_ns() - start)
        return tick


def arms(spec: EpisodeSpec) -> dict[str, tuple[EpisodeSpec, dict[str, Any]]]:
    """The same episode with six roles, and with all that there is; and the metrics of each."""
    missing = [name for name in STANDARD_ROLES if name not in spec.roles]
    if missing:
        raise SystemExit(f"{spec.id} runs without {', '.join(missing)}")
    watched = replace(spec, roles={**spec.roles, "stl_monitor": MONITOR})
    return {SIX: (spec, {}), ALL: (watched, METRICS)}


def loop(spec: EpisodeSpec, metrics: dict[str, Any]) -> tuple[Laps, list[Command]]:
    """Nanoseconds by part and tick of one episode in the loop, and what the ego was commanded."""
    simulator = TimedSimulator()
    roles = {name: role.create() for name, role in spec.roles.items()}
    orchestrator = Orchestrator(simulator, roles, metrics=metrics)
    start = process_time_ns()
    episode = orchestrator.run(spec)
    end = process_time_ns()
    if episode.failure is not None:
        raise SystemExit(f"{spec.id}: {episode.failure}")
    laps = {name: list(times) for name, (_, times) in episode.metrics.processing_ns.items()}
    # What the first one takes is in the total as well.
    laps["total"] = np.diff([start, *simulator.begun, end]).tolist()
    laps["road"], laps["step"] = simulator.roads, simulator.steps
    start = process_time_ns()
    simulator.signals(orchestrator.state.ticks)
    simulator.percept_signals(orchestrator.state.percepts)
    laps["signals"] = [process_time_ns() - start]
    past, ticks = orchestrator.state.past, orchestrator.state.ticks[1:]
    return laps, [
        Command(one.executed.maneuver, tick.truth["ego"].commanded)
        for one, tick in zip(past, ticks, strict=False)
    ]


def bare(spec: EpisodeSpec, commands: Sequence[Command], what: str) -> Laps:
    """Nanoseconds by tick of the same ticks without any role, in one of the two ways."""
    simulator = HighwaySimulator()
    with published_road() if what == PUBLISHED else nullcontext():
        begun = [process_time_ns()]
        simulator.reset(spec.scenario, spec.seed)
        for command in commands:
            begun.append(process_time_ns())
            if what == STEP:
                simulator.step(command)
            else:
                assert command.acceleration is not None
                simulator.drive(command.acceleration)
                simulator._clear()
                simulator._admit()
        begun.append(process_time_ns())
    return {"total": np.diff(begun).tolist()}


def measured(spec: EpisodeSpec, repeats: int) -> dict[str, Parts]:
    """Seconds of each arm and of each bare stepping by part: the quickest of each tick."""
    runs: dict[str, list[Laps]] = {name: [] for name in (SIX, ALL, PUBLISHED, STEP)}
    ticks = 0
    for _ in range(repeats):
        for name, (arm, metrics) in arms(spec).items():
            laps, commands = loop(arm, metrics)
            runs[name].append(laps)
            ticks = len(commands)
        for name in (PUBLISHED, STEP):
            runs[name].append(bare(spec, commands, name))
    found = {"ticks": Parts(total=ticks)}
    for name, several in runs.items():
        found[name] = Parts()
        for part in several[0]:
            quickest = map(min, zip(*(laps[part] for laps in several), strict=True))
            found[name][part] = sum(quickest) / 1e9
    return found


def row(name: str, sums: dict[str, Parts], arm: str) -> list[str]:
    """Of an arm's table: microseconds per tick, and ratios."""
    scale = 1e6 / sums["ticks"]["total"]
    published, step = (sums[one]["total"] for one in (PUBLISHED, STEP))
    total = sums[arm]["total"]
    own = total - sums[arm]["generator"]
    cells = [name, *(f"{seconds * scale:.0f}" for seconds in (published, step, own))]
    return [*cells, *(f"{one:.2f}" for one in (own / published, total / published, own / step))]


def parts_of(parts: Parts) -> Parts:
    """Where the time of the loop went."""
    found = Parts(parts)
    found["sensors"] = found.pop("step") - found["road"]
    found["bookkeeping"] = found.pop("total") - sum(found.values())
    return found


def main() -> None:
    """Measure and print."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--runs", type=int, default=3, help="episodes per scenario")
    arguments.add_argument("--repeats", type=int, default=3, help="times each is repeated")
    arguments.add_argument("--generator", default="rule_based", help="the component under test")
    options = arguments.parse_args()
    component = RoleSpec(DOMAINS["driving"].short_names["generator"][options.generator])
    sums: dict[str, dict[str, Parts]] = {}
    for case in expand_cases(load_library([]).scenarios):
        for run in range(options.runs):
            spec = case.spec(run, base_seed=0)
            spec = replace(spec, roles={**spec.roles, "generator": component})
            for name, parts in measured(spec, options.repeats).items():
                for rows in (case.id, "all, weighted by time"):
                    sums.setdefault(rows, {}).setdefault(name, Parts()).update(parts)
    every = sums.pop("all, weighted by time")
    ticks = every["ticks"]["total"]
    told = f"{ticks} ticks, {options.runs} episodes a scenario, generator {options.generator}"
    print(machine(), f"\n{told}")
    heads = [
        "highway-env, us/tick", "step, us/tick", "loop without Generator, us/tick",
        "ratio to highway-env without Generator", "with Generator", "to step without Generator",
    ]  # fmt: skip
    for arm in (SIX, ALL):
        last = row("all, weighted by time", every, arm)
        last[4:] = [f"**{cell}**" for cell in last[4:]]
        rows_of = [*(row(name, one, arm) for name, one in sums.items()), last]
        print(f"\n{arm}:\n")
        print(table(["scenario", *heads], rows_of))
    print()
    split = {arm: parts_of(every[arm]) for arm in (SIX, ALL)}
    print(table(["part of the loop, us/tick", SIX, ALL], [
        [name, *(f"{split[arm][name] / ticks * 1e6:.1f}" for arm in split)]
        for name, _ in split[ALL].most_common()
    ]))  # fmt: skip
    print()
    for arm, parts in split.items():
        other = sum(parts.values()) - parts["road"] - parts["sensors"] - parts["generator"]
        print(f"outside step and Generator, {arm}: {other / ticks * 1e6:.0f} us/tick")


if __name__ == "__main__":
    main()
