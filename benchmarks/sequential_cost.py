"""What it costs to show "at most 5 % violations": a fixed design, Wald's SPRT, the e-process.

Run: python benchmarks/sequential_cost.py [--campaigns 10000] [--budget 2000] [--seed 0]

Pure statistics of independent episodes with a constant rate of violations; no simulator runs.
Exact figures come from dynamic programming over the test's own decisions, simulated ones from
synthetic campaigns that are decided by the same table of boundaries. The fixed design is the least
number of episodes that keeps both levels: at the limit it supports, and at p0 it does not support,
with probability of at most 5 %. Campaigns that the budget ends are undecided, and count it whole.
"""

from __future__ import annotations

import argparse

import numpy as np
from characteristics import Boundaries, Characteristics, operating_characteristics, simulate
from machine import machine, table
from scipy.stats import binom

from pytest_dura.requirements import (
    EProcess,
    FixedN,
    SequentialTest,
    Sprt,
    runs_needed,
)
from pytest_dura.requirements.sequential import Decision

LIMIT, P0, LEVEL = 0.05, 0.01, 0.05
RATES = (0.0, 0.005, 0.01, 0.02, 0.0258, 0.05, 0.1, 0.3)
HOPELESS = (0.3, 0.5, 1.0)


class UntilHopeless:
    """The fixed design for a runner that stops as soon as it can no longer support."""

    def __init__(self, design: FixedN, most: int) -> None:
        self.design, self.most = design, most

    def verdict(self, violations: int, episodes: int) -> Decision | None:
        if violations > self.most:
            return "violated"
        return self.design.verdict(violations, episodes)


def fixed_design() -> tuple[int, int]:
    """The least number of episodes that keeps both levels, and the violations that it allows."""
    episodes = runs_needed(LIMIT, 1 - LEVEL)
    while True:
        most = int(binom.ppf(LEVEL, episodes, LIMIT))
        if binom.cdf(most, episodes, LIMIT) > LEVEL:
            most -= 1
        if binom.sf(most, episodes, P0) <= LEVEL:
            return episodes, most
        episodes += 1


def clean_runs(test: SequentialTest) -> int:
    """Episodes without a violation after which the limit is supported."""
    while test.update(False) is None:
        pass
    return test.episodes


def costs(found: Characteristics) -> list[str]:
    """Mean number of episodes, share of supported campaigns, 99th percentile."""
    percentile = found.percentile(0.99)
    last = "over budget" if percentile is None else str(percentile)
    return [f"{found.mean_episodes:.1f}", f"{found.supported:.4f}", last]


def sprt_table(budget: int, campaigns: int, random: np.random.Generator) -> str:
    """Wald's test: exact and simulated."""
    boundaries = Boundaries.of(Sprt(LIMIT, P0, LEVEL), budget)
    rows = []
    for rate in RATES:
        exact = costs(operating_characteristics(boundaries, rate, budget))
        seen = costs(simulate(boundaries, rate, campaigns, random))
        rows.append(
            [f"{rate:g}", *(cell for pair in zip(exact, seen, strict=True) for cell in pair)]
        )
    names = ("mean runs", "supported", "99 % within")
    return table(["true rate", *(f"{n}, {h}" for n in names for h in ("SPRT", "simulated"))], rows)


def other_table(design: FixedN, most: int, budget: int) -> str:
    """The fixed design and the e-process, exact."""
    e_process, curtailed = EProcess(LIMIT, 1 - LEVEL), UntilHopeless(design, most)
    boundaries = Boundaries.of(e_process, budget)
    fixed = Boundaries.of(curtailed, design.planned)
    rows = []
    for rate in RATES:
        plain = operating_characteristics(fixed, rate, design.planned)
        found = operating_characteristics(boundaries, rate, budget)
        shares = [f"{found.violated:.4f}", f"{found.undecided:.4f}"]
        row = [f"{rate:g}", f"{plain.mean_episodes:.1f}", f"{plain.supported:.4f}"]
        rows.append([*row, *costs(found), *shares])
    headers = ["true rate", f"mean runs, fixed {design.planned}", "supported, fixed"]
    headers += ["mean runs, e-process", "supported", "99 % within", "violated", "undecided"]
    return table(headers, rows)


def clean_table(design: FixedN) -> str:
    """What a component without violations costs."""
    needed = runs_needed(LIMIT, 1 - LEVEL)
    methods = {
        "fixed, planned for no violation": FixedN(LIMIT, 1 - LEVEL, needed),
        f"fixed, planned for both levels ({design.planned})": design,
        f"SPRT against {P0:g}": Sprt(LIMIT, P0, LEVEL),
        "e-process": EProcess(LIMIT, 1 - LEVEL),
    }
    rows = [[name, str(clean_runs(test))] for name, test in methods.items()]
    return table(["method", f"0 violations certify {LIMIT:.0%} after n runs"], rows)


def hopeless_table(design: FixedN, most: int, budget: int) -> str:
    """How soon a bad component is rejected: mean and 99th percentile of the episodes."""
    rules = {
        f"fixed {design.planned}, stopped when hopeless": UntilHopeless(design, most),
        f"fixed {design.planned}, until violated": design,
        f"SPRT against {P0:g}": Sprt(LIMIT, P0, LEVEL),
        "e-process": EProcess(LIMIT, 1 - LEVEL),
    }
    rows = []
    for name, rule in rules.items():
        runs = design.planned if name.startswith("fixed") else budget
        found = [operating_characteristics(rule, rate, runs) for rate in HOPELESS]
        rows.append([name, *(f"{one.mean_episodes:.1f} ({one.percentile(0.99)})" for one in found)])
    return table(["rejected after, mean (99 % within)", *(f"rate {p:g}" for p in HOPELESS)], rows)


def main() -> None:
    """Compute and print."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--campaigns", type=int, default=10_000)
    arguments.add_argument("--budget", type=int, default=2000)
    arguments.add_argument("--seed", type=int, default=0)
    options = arguments.parse_args()
    planned, most = fixed_design()
    design = FixedN(LIMIT, 1 - LEVEL, planned)
    random = np.random.default_rng(options.seed)
    print(f"""{machine()}

At most {LIMIT:.0%} at {1 - LEVEL:.0%} confidence, p0 {P0:.0%}; budget {options.budget} runs,
{options.campaigns} simulated campaigns a rate. Fixed design of both levels: {planned} runs, not
supported from {most + 1} violations; it ends as soon as it is decided or hopeless.
""")
    print(f"{sprt_table(options.budget, options.campaigns, random)}\n")
    print(f"{other_table(design, most, options.budget)}\n")
    print(f"{clean_table(FixedN(LIMIT, 1 - LEVEL, planned))}\n")
    print(hopeless_table(design, most, options.budget))


if __name__ == "__main__":
    main()
