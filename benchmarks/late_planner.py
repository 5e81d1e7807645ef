"""What a late planner costs: the same planner with and without latency, on the same seeds.

Run: python benchmarks/late_planner.py [--runs 100] [--jobs 2] [--scenario conflicting-traffic]

The planner declares its latency, the world goes on meanwhile (`latency: declared`), and its command
before stays in force (`hold` longer than any latency, so that nothing but lateness is compared).
Pairs share seed, traffic and variation with the planner for which the world waits. What is compared
is whether the ego collided: worse (only late), better (only in time), by the exact two-sided
McNemar test, uncorrected; and the clearance times of pairs that cleared both times, by the sign
test.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from itertools import product
from statistics import mean
from typing import Any

import numpy as np
from machine import machine, table

from pytest_dura.core import Orchestrator, Proposal, RoleSpec
from pytest_dura.core.clock import Clock
from pytest_dura.driving import clearance_time
from pytest_dura.driving.roles.tactical import Tactical
from pytest_dura.library import expand_cases, load_library
from pytest_dura.requirements import mcnemar

POLICIES = ("log_only", "recover")
HEADERS = ["recovery", "latency s", "collided", "worse", "better", "p", "clearance s"]
HEADERS += ["mean change s", "slower, quicker", "p (sign)", "not cleared", "late ticks %"]
Arm = tuple[str, float]


class Late(Tactical):
    """The stand-in for the paper's planner, with a declared latency.

    Args:
        latency: Seconds.
    """

    def __init__(self, latency: float) -> None:
        super().__init__()
        self.latency = latency

    def propose(self, view: Any) -> Proposal:
        return replace(super().propose(view), latency=self.latency)


@dataclass(frozen=True)
class Outcome:
    collided: bool
    clearance: float | None
    late: float


def run(job: tuple[str, str, float, int]) -> Outcome:
    scenario, policy, latency, number = job
    (case,) = expand_cases(load_library([]).scenarios, select=[f"intersection/{scenario}"])
    roles = {"generator": RoleSpec.of(Late, {"latency": latency})}
    spec = case.spec(number, 0, roles, policy=policy)
    spec = replace(spec, clock=Clock(latency="declared", hold=latency + 1.0))
    episode = Orchestrator.build(spec).run(spec)
    if episode.failure is not None:
        raise RuntimeError(episode.failure)
    time = clearance_time(episode)
    late = float(episode.signals["loop.late"].mean())
    return Outcome(episode.collided, None if np.isnan(time) else time, late)


def row(arm: Arm, base: Sequence[Outcome], outcomes: Sequence[Outcome]) -> list[str]:
    pairs = list(zip(base, outcomes, strict=True))
    worse = sum(late.collided and not in_time.collided for in_time, late in pairs)
    better = sum(in_time.collided and not late.collided for in_time, late in pairs)
    times = [
        (in_time.clearance, late.clearance)
        for in_time, late in pairs
        if in_time.clearance is not None and late.clearance is not None
    ]
    clearance = ["-", "-"]
    if times:
        clearance = [f"{mean(b for _, b in times):.1f}", f"{mean(b - a for a, b in times):+.2f}"]
    slower, quicker = sum(b > a for a, b in times), sum(b < a for a, b in times)
    return [
        "off" if arm[0] == "log_only" else "on",
        f"{arm[1]:g}",
        f"{sum(each.collided for each in outcomes)} of {len(outcomes)}",
        str(worse),
        str(better),
        f"{mcnemar(worse, better):.2g}",
        *clearance,
        f"{slower}, {quicker}",
        f"{mcnemar(slower, quicker):.2g}",
        str(sum(each.clearance is None and not each.collided for each in outcomes)),
        f"{100 * mean(each.late for each in outcomes):.0f}",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--scenario", default="conflicting-traffic")
    parser.add_argument("--latency", type=float, nargs="+", default=[0.5, 1.5, 3.0])
    arguments = parser.parse_args()
    arms = list(product(POLICIES, [0.0, *arguments.latency]))
    jobs = [
        (arguments.scenario, policy, latency, number)
        for policy, latency in arms
        for number in range(arguments.runs)
    ]
    with ProcessPoolExecutor(arguments.jobs) as pool:
        found = list(pool.map(run, jobs, chunksize=5))
    outcomes = {
        arm: found[index * arguments.runs : (index + 1) * arguments.runs]
        for index, arm in enumerate(arms)
    }
    print(f"{machine()}; intersection/{arguments.scenario}, {arguments.runs} runs\n")
    print(table(HEADERS, [row(arm, outcomes[arm[0], 0.0], outcomes[arm]) for arm in arms]))


if __name__ == "__main__":
    main()
