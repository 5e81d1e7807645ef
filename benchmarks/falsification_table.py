"""Simulations to the first counterexample: the portfolio beside other methods and trivial inputs.

Run: python benchmarks/falsification_table.py [--systems development chasing-cars] [--seeds 20]
    [--budget 1500] [--methods uniform ...] [--jobs 2]

Cells are medians over the seeds, with an exact 95 % interval of order statistics where there are
six seeds and more; one that was not falsified counts as the whole budget. In brackets the number of
seeds that falsified, where not all did. The portfolio was chosen on the development systems; of the
chasing cars, CCx and CC4 were looked at meanwhile. The frozen ones were made before its turns were
chosen, and were not looked at for that.
"""

from __future__ import annotations

import argparse
import statistics
from concurrent.futures import ProcessPoolExecutor

from falsification.chasing_cars import CHASING_CARS
from falsification.development import SYSTEMS
from falsification.frozen import SYSTEMS as FROZEN
from falsification.methods import METHODS, Count
from falsification.systems import System
from machine import machine, table

GROUPS: dict[str, dict[str, System]] = {
    "development": SYSTEMS,
    "frozen": FROZEN,
    "chasing-cars": {"chasing cars": CHASING_CARS},
}

Job = tuple[str, str, str, str, int, int]


def first(job: Job) -> int | None:
    """Simulations up to the first counterexample, ``None`` for none."""
    group, name, formula, method, seed, budget = job
    system = GROUPS[group][name]
    return METHODS[method](system.layout, seed, Count(system.objective(formula), budget))


CONFIDENCE = 0.95


def interval(ordered: list[int]) -> tuple[int, int] | None:
    """Exact interval of the median, by order statistics; ``None`` of too few values for one."""
    from scipy.stats import binom

    rank = int(binom.ppf((1.0 - CONFIDENCE) / 2.0, len(ordered), 0.5))
    # So many values below it leave at most 2.5 % on each side.
    if binom.cdf(rank - 1, len(ordered), 0.5) > (1.0 - CONFIDENCE) / 2.0 or rank < 1:
        return None
    return ordered[rank - 1], ordered[-rank]


def cell(found: list[int | None], budget: int) -> str:
    """Median with its interval, and how many were falsified if not all."""
    counts = sorted(budget if one is None else one for one in found)
    falsified = sum(one is not None for one in found)
    if not falsified:
        return f"0/{len(found)}"
    known = interval(counts)
    between = "" if known is None else f" [{known[0]} to {known[1]}]"
    missing = f" ({falsified})" if falsified < len(found) else ""
    return f"{statistics.median(counts):g}{between}{missing}"


def main() -> None:
    """Search and print."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--systems", nargs="+", choices=list(GROUPS), default=list(GROUPS))
    arguments.add_argument("--only", nargs="+", help="requirements")
    arguments.add_argument("--methods", nargs="+", choices=list(METHODS), default=list(METHODS))
    arguments.add_argument("--seeds", type=int, default=20)
    arguments.add_argument("--budget", type=int, default=1500)
    arguments.add_argument("--jobs", type=int, default=1)
    options = arguments.parse_args()
    print(f"{machine()}\n\n{options.seeds} seeds, at most {options.budget} simulations each\n")
    with ProcessPoolExecutor(options.jobs) as pool:
        for group in options.systems:
            # Row by row: the whole table takes long.
            print(table([group, *options.methods], []), flush=True)
            for name, system in GROUPS[group].items():
                for formula in system.formulas:
                    if options.only and formula not in options.only:
                        continue
                    jobs = [
                        (group, name, formula, method, seed, options.budget)
                        for method in options.methods
                        for seed in range(options.seeds)
                    ]
                    found = list(pool.map(first, jobs))
                    cells = [
                        cell(found[i : i + options.seeds], options.budget)
                        for i in range(0, len(found), options.seeds)
                    ]
                    print(f"| {' | '.join([formula, *cells])} |", flush=True)
            print()


if __name__ == "__main__":
    main()
