"""The paper's table for one planner, and its two questions as exact paired tests.

Run: python benchmarks/paper_table.py [--generator reactive] [--runs 200] [--jobs 2]

Pairs share their seed, and so traffic, timing and variation. Do attacks raise flags and clearance
time: each attack scenario with and without its fault, recovery on. Does switching recovery off
raise collisions: each scenario with the policies recover and log_only. Binary outcomes are
compared by the exact McNemar test, clearance times of pairs that cleared both times by the exact
sign test; all p-values are two-sided and uncorrected.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from statistics import mean, stdev

import numpy as np
from machine import machine, table
from scipy.stats import binomtest

from pytest_dura.campaign.cases import Case, expand_cases
from pytest_dura.campaign.domains import DOMAINS
from pytest_dura.campaign.loading import load_library
from pytest_dura.core.orchestrator import Orchestrator
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.requirements.statistics import mcnemar

Key = tuple[str, bool, str, int]
"""Scenario, with its own faults, policy, run."""
POLICIES = ("recover", "log_only")


@dataclass(frozen=True)
class Outcome:
    """What the table needs of an episode."""

    flagged: bool
    collided: bool
    struck: bool
    clearance: float | None
    recoveries: int
    alerts: int
    valid: bool


def case_of(scenario: str, attacked: bool) -> Case:
    """The scenario with its own faults, or without any."""
    faults = None if attacked else ["none"]
    (case,) = expand_cases(load_library([]).scenarios, faults=faults, select=[f"{scenario}*"])
    return case


def run(job: tuple[Key, str, int]) -> tuple[Key, Outcome]:
    """One episode."""
    key, generator, base_seed = job
    scenario, attacked, policy, number = key
    roles = {"generator": RoleSpec(DOMAINS["driving"].short_names["generator"][generator])}
    case = case_of(scenario, attacked)
    spec = case.spec(number, base_seed, roles, policy=policy)
    episode = Orchestrator.build(spec).run(spec)
    if episode.failure is not None:
        raise RuntimeError(episode.failure)
    cleared = episode.signals["cleared"] > 0.5
    return key, Outcome(
        flagged=episode.flagged,
        collided=episode.collided,
        struck=episode.ever("struck"),
        clearance=float(episode.time[np.argmax(cleared)]) if cleared.any() else None,
        recoveries=len(episode.metrics.recoveries),
        alerts=episode.metrics.alerts,
        valid=episode.validity == "valid",
    )


def discordant(first: list[bool], second: list[bool]) -> tuple[int, int, float]:
    """Pairs that only the first has, pairs that only the second has, exact p-value."""
    only_first = sum(a and not b for a, b in zip(first, second, strict=True))
    only_second = sum(b and not a for a, b in zip(first, second, strict=True))
    return only_first, only_second, mcnemar(only_first, only_second)


class Arms:
    """The outcomes of all runs, by arm of the comparison."""

    def __init__(self, found: dict[Key, Outcome], runs: int) -> None:
        self._found, self._runs = found, range(runs)

    def of(self, scenario: str, *, attacked: bool = True, policy: str = "recover") -> list[Outcome]:
        """One outcome per run, in the order of the runs."""
        return [self._found[scenario, attacked, policy, number] for number in self._runs]


def paper_table(arms: Arms, scenarios: list[str]) -> str:
    """The paper's table, with recovery on and off."""
    rows = []
    for scenario in scenarios:
        for policy in POLICIES:
            outcomes = arms.of(scenario, policy=policy)
            times = [o.clearance for o in outcomes if o.clearance is not None]
            spread = f"{mean(times):.1f} +- {stdev(times):.1f}" if len(times) > 1 else "-"
            rows.append(
                [
                    scenario,
                    policy,
                    percentage([o.flagged for o in outcomes]),
                    percentage([o.collided for o in outcomes]),
                    percentage([o.struck for o in outcomes]),
                    f"{spread} ({len(times)})",
                    str(sum(o.clearance is None and not o.collided for o in outcomes)),
                    str(sum(o.recoveries for o in outcomes)),
                    str(sum(o.alerts for o in outcomes)),
                    str(sum(not o.valid for o in outcomes)),
                ]
            )
    headers = ["scenario", "policy", "flagged %", "collided %", "struck by others %"]
    headers += ["clearance s (n)", "gridlock", "recoveries", "alerts", "invalid"]
    return table(headers, rows)


def effect_of_attacks(arms: Arms, attacks: list[str]) -> str:
    """Each attack against the same runs without it."""
    rows = []
    for scenario in attacks:
        attacked, free = arms.of(scenario), arms.of(scenario, attacked=False)
        up, down, p = discordant([o.flagged for o in attacked], [o.flagged for o in free])
        deltas = [
            a.clearance - b.clearance
            for a, b in zip(attacked, free, strict=True)
            if a.clearance is not None and b.clearance is not None
        ]
        longer, shorter = sum(d > 0 for d in deltas), sum(d < 0 for d in deltas)
        sign = binomtest(longer, longer + shorter).pvalue if longer + shorter else 1.0
        change = f"{mean(deltas):+.1f}" if deltas else "-"
        rows.append([
            scenario, f"{up} / {down}", f"{p:.2g}", change, f"{longer} / {shorter}", f"{sign:.2g}",
        ])  # fmt: skip
    headers = ["scenario", "flagged only attacked / only free", "p"]
    headers += ["mean change of clearance s", "longer / shorter", "p"]
    return table(headers, rows)


def effect_of_recovery(arms: Arms, scenarios: list[str]) -> str:
    """Each scenario with recovery against the same runs without it, and all together."""
    rows, all_off, all_on = [], [], []
    for scenario in scenarios:
        off = [o.collided for o in arms.of(scenario, policy="log_only")]
        on = [o.collided for o in arms.of(scenario)]
        all_off, all_on = all_off + off, all_on + on
        rows.append([scenario, *compared(off, on)])
    rows.append(["all", *compared(all_off, all_on)])
    headers = ["scenario", "collisions off", "collisions on", "prevented", "introduced"]
    return table([*headers, "in both", "p"], rows)


def compared(off: list[bool], on: list[bool]) -> list[str]:
    """The cells of two arms that are compared pair by pair."""
    prevented, introduced, p = discordant(off, on)
    futile = sum(a and b for a, b in zip(off, on, strict=True))
    counts = (sum(off), sum(on), prevented, introduced, futile)
    return [*map(str, counts), f"{p:.2g}"]


def percentage(hits: list[bool]) -> str:
    """The share of hits."""
    return f"{100 * sum(hits) / len(hits):.1f}"


def main() -> None:
    """Run, compare, print."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--generator", default="reactive")
    arguments.add_argument("--runs", type=int, default=200)
    arguments.add_argument("--jobs", type=int, default=2)
    arguments.add_argument("--seed", type=int, default=0)
    options = arguments.parse_args()
    cases = expand_cases(load_library([]).scenarios)
    scenarios = [case.id for case in cases]
    attacks = [case.id for case in cases if case.faults]
    runs = range(options.runs)
    keys: list[Key] = [(s, True, p, n) for s in scenarios for p in POLICIES for n in runs]
    keys += [(s, False, "recover", n) for s in attacks for n in runs]
    with ProcessPoolExecutor(options.jobs) as pool:
        jobs = [(key, options.generator, options.seed) for key in keys]
        arms = Arms(dict(pool.map(run, jobs, chunksize=20)), options.runs)
    seeds = f"{options.runs} paired seeds a scenario, base seed {options.seed}"
    print(f"{machine()}\n\n{options.generator}, {seeds}\n")
    print(paper_table(arms, scenarios))
    print("\nDo attacks raise flags and clearance time? (attack against none, recovery on)\n")
    print(effect_of_attacks(arms, attacks))
    print("\nDoes switching recovery off raise collisions? (log_only against recover)\n")
    print(effect_of_recovery(arms, scenarios))


if __name__ == "__main__":
    main()
