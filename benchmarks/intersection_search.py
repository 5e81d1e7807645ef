"""How many simulations it takes to the first confirmed collision: random seeds and the search.

Run: python benchmarks/intersection_search.py [--seeds 5] [--budget 100] [--jobs 2]

Every method starts from the same base seeds. `random seeds` are the runs of the campaign itself,
without added faults; all others look for scenario and fault parameters in one space, with at most
one fault of the list below. A collision counts once its replay had an equal digest. The method
`with surrogate` is the search with `surrogate=True`.
"""

from __future__ import annotations

import argparse
import multiprocessing
import statistics

from machine import machine, table

from pytest_dura import RoleSpec, Runner
from pytest_dura.campaign import Limits
from pytest_dura.domains import DOMAINS
from pytest_dura.library import case_with_faults, load_library
from pytest_dura.search import Objective, SearchSpace, Trials, trivial_searchers
from pytest_dura.search.falsify import falsify
from pytest_dura.search.trials import run_alone

FAULTS = (
    "object-miss", "position-noise", "range-cut", "class-change", "moved-obstacle",
    "ghost-obstacle", "delay", "freeze", "omission", "gnss-jump", "gnss-drag-off",
    "loss-of-effectiveness", "lag",
)  # fmt: skip
"""What can go wrong with what the planners read, and with what they command."""
PLANNERS = ("reactive", "aggressive", "rule_based")
SCENARIOS = ("conflicting-traffic", "congested")
SEARCH, RANDOM, SURROGATE = "search", "random seeds", "with surrogate"
METHODS = (RANDOM, "uniform", "constant", "bang-bang", SEARCH, SURROGATE)

Job = tuple[str, str, str, int, int]


def simulations(job: Job) -> int | None:
    """Simulations up to the first confirmed collision; ``None`` if there was none."""
    planner, scenario, method, seed, budget = job
    library = load_library([])
    path = DOMAINS["driving"].short_names["generator"][planner]
    bench = Runner(lambda: library, seed, roles={"generator": RoleSpec(path)})
    case = case_with_faults(library.scenarios[f"intersection/{scenario}"], "none")
    asked = Objective(library.requirements["SAF-1"])
    if method in (SEARCH, SURROGATE):
        limits = Limits(budget, shrink=0, baselines=False, surrogate=method == SURROGATE)
        (outcome,) = falsify(bench, case, [asked], limits=limits, faults=FAULTS).outcomes
        return outcome.simulations if outcome.status == "falsified" else None
    lasting = float(bench.searched(case).time[-1])
    space = SearchSpace.of(case, FAULTS, begin_within=lasting)
    trials = Trials(bench, space, [asked])
    trivial = dict(trivial_searchers(space.layout, seed))
    (first,) = run_alone(trials, trivial.get(method), budget).first
    if first is None:
        return None
    if method == RANDOM:
        _, repeats = trials.replay(case, asked, first.world)
    else:
        _, repeats = trials.replay(trials.case(first.point.tolist(), first.world), asked)
    return first.number if repeats.confirmed else None


def told(found: list[int | None], budget: int) -> str:
    """The median, and in how many searches there was a collision."""
    hits = sum(one is not None for one in found)
    if 2 * hits <= len(found):
        return f"> {budget} ({hits} of {len(found)})"
    median = statistics.median(budget + 1 if one is None else one for one in found)
    return f"{median:g} ({hits} of {len(found)})"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--budget", type=int, default=100)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=METHODS[:-1])
    parser.add_argument("--planners", nargs="+", default=PLANNERS)
    parser.add_argument("--scenarios", nargs="+", default=SCENARIOS)
    options = parser.parse_args()
    rows = [(planner, scenario) for planner in options.planners for scenario in options.scenarios]
    jobs = [
        (planner, scenario, method, seed, options.budget)
        for planner, scenario in rows
        for method in options.methods
        for seed in range(options.seeds)
    ]
    with multiprocessing.get_context("spawn").Pool(options.jobs) as pool:
        found = dict(zip(jobs, pool.imap(simulations, jobs), strict=True))
    print(machine())
    print(
        f"\nSimulations to the first confirmed collision: median over {options.seeds} base seeds, "
        f"budget {options.budget}\n"
    )
    lines = [
        [
            planner,
            scenario,
            *(
                told(
                    [
                        found[planner, scenario, method, seed, options.budget]
                        for seed in range(options.seeds)
                    ],
                    options.budget,
                )
                for method in options.methods
            ),
        ]
        for planner, scenario in rows
    ]
    print(table(["planner", "scenario", *options.methods], lines))


if __name__ == "__main__":
    main()
