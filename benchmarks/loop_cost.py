"""What the loop costs: all six roles against bare stepping of the same road for the same ticks.

Run: python benchmarks/loop_cost.py [--runs 3] [--repeats 3]

Each episode is run once with the loop; its executed accelerations then drive a bare road of the
same scenario and seed, with neither sensors nor signals nor roles. Both are repeated in turns and
the quickest of each counts. Sums over the six scenarios weigh each by its time.
"""

from __future__ import annotations

import argparse
from time import perf_counter

from machine import machine, table

from pytest_dura.campaign.cases import expand_cases
from pytest_dura.campaign.loading import load_library
from pytest_dura.core.episode import Episode, EpisodeSpec
from pytest_dura.core.orchestrator import Orchestrator
from pytest_dura.driving.highway import HighwaySimulator

Parts = dict[str, float]


class TimedSimulator(HighwaySimulator):
    """Splits its time into road and sensing."""

    def __init__(self) -> None:
        super().__init__()
        self.road_seconds = self.step_seconds = 0.0

    def drive(self, acceleration: float) -> None:
        """Bare stepping, timed."""
        start = perf_counter()
        super().drive(acceleration)
        self.road_seconds += perf_counter() - start

    def step(self, action: object) -> object:  # type: ignore[override]
        """A whole step, timed."""
        start = perf_counter()
        tick = super().step(action)
        self.step_seconds += perf_counter() - start
        return tick


def loop(spec: EpisodeSpec) -> tuple[Parts, Episode, list[float]]:
    """Seconds by part of one episode in the loop, the episode, and what the ego was commanded."""
    simulator = TimedSimulator()
    orchestrator = Orchestrator(simulator, {n: r.create() for n, r in spec.roles.items()})
    start = perf_counter()
    episode = orchestrator.run(spec)
    total = perf_counter() - start
    parts = {role: sum(values) / 1e9 for role, (_, values) in episode.metrics.processing_ns.items()}
    parts["road"] = simulator.road_seconds
    parts["sensors"] = simulator.step_seconds - simulator.road_seconds
    start = perf_counter()
    simulator.signals(orchestrator.state.ticks)
    simulator.percept_signals(orchestrator.state.percepts)
    parts["signals"] = perf_counter() - start
    parts["bookkeeping"] = total - sum(parts.values())
    parts["total"] = total
    commanded = [tick.truth["ego"].commanded for tick in orchestrator.state.ticks[1:]]
    return parts, episode, commanded


def bare(spec: EpisodeSpec, commanded: list[float]) -> float:
    """Seconds for the same road and ticks with nothing around it."""
    simulator = HighwaySimulator()
    start = perf_counter()
    simulator.reset(spec.scenario, spec.seed)
    for acceleration in commanded:
        simulator.drive(acceleration)
        simulator._clear()
        simulator._admit()
    return perf_counter() - start


def main() -> None:
    """Measure and print."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--runs", type=int, default=3, help="episodes per scenario")
    arguments.add_argument("--repeats", type=int, default=3, help="times each is repeated")
    options = arguments.parse_args()
    sums: Parts = {}
    ticks, bare_sum, rows = 0, 0.0, []
    for case in expand_cases(load_library([]).scenarios):
        case_bare = case_loop = case_generator = 0.0
        case_ticks = 0
        for run in range(options.runs):
            spec = case.spec(run, base_seed=0)
            loops, bares = [], []
            for _ in range(options.repeats):
                parts, episode, commanded = loop(spec)
                loops.append(parts)
                bares.append(bare(spec, commanded))
            best = min(loops, key=lambda parts: parts["total"])
            for name, seconds in best.items():
                sums[name] = sums.get(name, 0.0) + seconds
            case_bare += min(bares)
            case_loop += best["total"]
            case_generator += best["generator"]
            case_ticks += episode.ticks - 1
        ticks += case_ticks
        bare_sum += case_bare
        rows.append([
            case.id, f"{case_bare / case_ticks * 1e6:.0f}", f"{case_loop / case_ticks * 1e6:.0f}",
            f"{(case_loop - case_generator) / case_bare:.2f}", f"{case_loop / case_bare:.2f}",
        ])  # fmt: skip
    total, generator = sums["total"], sums["generator"]
    rows.append([
        "all, weighted by time", f"{bare_sum / ticks * 1e6:.0f}", f"{total / ticks * 1e6:.0f}",
        f"**{(total - generator) / bare_sum:.2f}**", f"**{total / bare_sum:.2f}**",
    ])  # fmt: skip
    print(machine(), f"\n{ticks} ticks, {options.runs} episodes a scenario\n")
    headers = ["scenario", "bare, us/tick", "loop, us/tick", "ratio without Generator", "ratio"]
    print(table(headers, rows))
    print()
    order = sorted((name for name in sums if name != "total"), key=lambda name: -sums[name])
    print(table(["part of the loop", "us/tick"], [
        [name, f"{sums[name] / ticks * 1e6:.1f}"] for name in order
    ]))  # fmt: skip
    ours = total - generator - sums["road"] - sums["sensors"] - sums["signals"]
    print(f"\noutside simulator and Generator: {ours / ticks * 1e6:.0f} us/tick")


if __name__ == "__main__":
    main()
