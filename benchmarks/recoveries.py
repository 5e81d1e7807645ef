"""Every recovery planner against no recovery, on the same seeds.

Run: python benchmarks/recoveries.py [--generator reactive] [--runs 40] [--jobs 2]

Each run of each built-in scenario once with the policy log_only and once with each planner. A pair
shares seed, traffic, timing, variation and faults. What is compared is whether the ego collided:
prevented (only without), introduced (only with), futile (in both, though it acted), unnecessary (in
neither, though it acted), and the exact two-sided McNemar test of the first two, uncorrected.
Clearance times are of pairs that cleared both times; gridlock is neither a collision nor clearing.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from statistics import mean, quantiles

import numpy as np
from machine import machine, table

from pytest_dura.core import Orchestrator, RoleSpec, switching
from pytest_dura.domains import DOMAINS
from pytest_dura.driving import clearance_time
from pytest_dura.library import expand_cases, load_library
from pytest_dura.requirements import mcnemar

OFF = "off"
PLANNERS = tuple(DOMAINS["driving"].short_names["recovery_planner"])
Key = tuple[str, str, int]
"""Scenario, planner or ``off``, run."""


@dataclass(frozen=True)
class Outcome:
    """What the tables need of an episode; ``share`` of the time recovery was in control."""

    collided: bool
    clearance: float | None
    acted: bool
    share: float
    microseconds: tuple[float, ...]
    valid: bool

    @property
    def gridlock(self) -> bool:
        """Whether the ego never got through, and met nobody."""
        return not self.collided and self.clearance is None


def run(job: tuple[Key, str, int]) -> tuple[Key, Outcome]:
    """One episode."""
    key, generator, base_seed = job
    scenario, planner, number = key
    roles = {"generator": RoleSpec(generator)}
    if planner != OFF:
        roles["recovery_planner"] = RoleSpec(planner)
    (case,) = expand_cases(load_library([]).scenarios, select=[scenario])
    policy = "log_only" if planner == OFF else "recover"
    spec = case.spec(number, base_seed, roles, policy=policy)
    episode = Orchestrator.build(spec).run(spec)
    if episode.failure is not None:
        raise RuntimeError(episode.failure)
    time = clearance_time(episode)
    _, spent = episode.metrics.processing_ns.get("recovery_planner", ([], []))
    return key, Outcome(
        collided=episode.collided,
        clearance=None if np.isnan(time) else time,
        acted=bool(episode.metrics.recoveries),
        share=switching(episode).share or 0.0,
        microseconds=tuple(one / 1000.0 for one in spent),
        valid=episode.validity == "valid",
    )


Pairs = list[tuple[Outcome, Outcome]]
"""Without and with recovery."""

HEADERS = ["planner", "collisions off", "collisions on", "prevented", "introduced", "futile"]
HEADERS += ["unnecessary", "p", "clearance s, off", "mean change", "gridlock off", "gridlock on"]
HEADERS += ["in control %"]


def row(planner: str, pairs: Pairs) -> list[str]:
    """One planner's cells, in the order of ``HEADERS``.

    Raises:
        RuntimeError: If a pair differs although recovery never acted: equal seeds make equal runs.
    """
    if any(not on.acted and off.collided != on.collided for off, on in pairs):
        raise RuntimeError(f"{planner}: a pair differs although recovery never acted")
    prevented = sum(off.collided and not on.collided for off, on in pairs)
    introduced = sum(on.collided and not off.collided for off, on in pairs)
    futile = sum(off.collided and on.collided and on.acted for off, on in pairs)
    unnecessary = sum(on.acted and not off.collided and not on.collided for off, on in pairs)
    cleared = [
        (off.clearance, on.clearance)
        for off, on in pairs
        if off.clearance is not None and on.clearance is not None
    ]
    counts = [
        sum(off.collided for off, _ in pairs), sum(on.collided for _, on in pairs),
        prevented, introduced, futile, unnecessary,
    ]  # fmt: skip
    times = ["-", "-"]
    if cleared:
        times = [f"{mean(a for a, _ in cleared):.1f}", f"{mean(b - a for a, b in cleared):+.2f}"]
    stuck = [sum(off.gridlock for off, _ in pairs), sum(on.gridlock for _, on in pairs)]
    share = 100 * mean(on.share for _, on in pairs)
    cells = [*map(str, counts), f"{mcnemar(prevented, introduced):.2g}", *times, *map(str, stuck)]
    return [planner, *cells, f"{share:.1f}"]


def cost(pairs: Pairs) -> list[str]:
    """Calls, and microseconds per call: median and 99th percentile."""
    spent = [one for _, on in pairs for one in on.microseconds]
    if len(spent) < 2:
        return [str(len(spent)), "-", "-"]
    cuts = quantiles(spent, n=100, method="inclusive")
    return [str(len(spent)), f"{cuts[49]:.0f}", f"{cuts[98]:.0f}"]


def main() -> None:
    """Run, compare, print."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--generator", default="reactive")
    arguments.add_argument("--runs", type=int, default=40)
    arguments.add_argument("--jobs", type=int, default=2)
    arguments.add_argument("--seed", type=int, default=0)
    arguments.add_argument("--select", default="*", help="scenarios, as a glob")
    options = arguments.parse_args()
    cases = expand_cases(load_library([]).scenarios, select=[options.select])
    scenarios = [case.id for case in cases]
    numbers = range(options.runs)
    keys: list[Key] = [(s, p, n) for s in scenarios for p in (OFF, *PLANNERS) for n in numbers]
    with ProcessPoolExecutor(options.jobs) as pool:
        jobs = [(key, options.generator, options.seed) for key in keys]
        found = dict(pool.map(run, jobs, chunksize=10))

    def pairs(planner: str, *where: str) -> Pairs:
        return [(found[s, OFF, n], found[s, planner, n]) for s in where for n in numbers]

    seeds = f"{options.runs} paired seeds a scenario, base seed {options.seed}"
    print(f"{machine()}\n\n{options.generator}, {seeds}\n")
    rows = [[s, *row(p, pairs(p, s))] for s in scenarios for p in PLANNERS]
    print(table(["scenario", *HEADERS], rows))
    print("\nAll scenarios together:\n")
    together = {planner: pairs(planner, *scenarios) for planner in PLANNERS}
    rows = [[*row(planner, both), *cost(both)] for planner, both in together.items()]
    print(table([*HEADERS, "calls", "us/call", "99 % within"], rows))
    invalid = sum(not outcome.valid for outcome in found.values())
    print(f"\n{invalid} of {len(found)} episodes were invalid")


if __name__ == "__main__":
    main()
