"""Counterexamples before and after shrinking.

Run: python benchmarks/shrinking.py [--numbers 2] [--tries 100] [--budget 300] [--jobs 2]

Collisions of each built-in scenario without recovery, with the planners reactive and aggressive,
with up to two faults of the catalogue that a search might add and without: the first that plain
random points with random seeds come to, if any. Each is shrunk within a budget of simulations.
Parameters are those that are not as the scenario has them, where a car that random traffic drew
counts with all that was drawn of it. Road users are cars and pedestrians beside the ego, those of
random traffic included.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from statistics import median

from machine import machine, table

from pytest_dura.core import ConfigurationError, Orchestrator, RoleSpec, derive_seed, stream
from pytest_dura.driving import concrete_world
from pytest_dura.library import Case, SearchedCase, expand_cases, load_library
from pytest_dura.search import SearchSpace, changes_of, count_parameters, shrink

PLANNERS = ("reactive", "aggressive")
Job = tuple[str, str, bool, int, int, int]
"""Scenario, planner, whether faults may be added, number, points that are tried, budget."""


@dataclass(frozen=True)
class Result:
    """One counterexample: each pair is before and after shrinking."""

    stated: int
    parameters: tuple[int, int]
    users: tuple[int, int]
    faults: tuple[int, int]
    left_out: int
    simulations: int
    finished: bool


def collides(searched: SearchedCase, planner: str) -> bool:
    """Whether the ego collides; an episode without an end counts for nothing."""
    spec = searched.spec(0, 0, {"generator": RoleSpec(planner)})
    episode = Orchestrator.build(spec).run(spec)
    return episode.failure is None and episode.collided


def first_collision(case: Case, job: Job) -> SearchedCase | None:
    """The first of some random points that collides."""
    scenario, planner, faulty, number, tries, _ = job
    space = SearchSpace.of(case, ["catalogue"] if faulty else [], at_most=2)
    name = f"{scenario}:{planner}:{faulty}:{number}"
    draws = stream(number, name)
    for trial in range(tries):
        values = space.values(draws.random(space.layout.size))
        try:
            searched = space.case_with(values, derive_seed(number, name, trial))
            if collides(searched, planner):
                return searched
        except ConfigurationError:
            continue
    return None


def users(searched: SearchedCase) -> int:
    """Road users beside the ego."""
    scenario = searched.scenario
    world = concrete_world(scenario.world, scenario.duration, scenario.seed or 0)
    return len(world["vehicles"]) + len(world["pedestrians"])


def run(job: Job) -> Result | None:
    """Find a counterexample and shrink it; ``None`` where none was found."""
    scenario, planner, _, _, _, budget = job
    (bare,) = expand_cases(load_library([]).scenarios, select=[scenario])
    case = bare.switched_off("recovery_planner")
    found = first_collision(case, job)
    if found is None:
        return None
    shrunk = shrink(case, found, lambda one: collides(one, planner), budget=budget)
    return Result(
        count_parameters(changes_of(case, found)),
        (shrunk.shrinking.before, shrunk.shrinking.after),
        (users(found), users(shrunk.case)),
        (len(found.faults), len(shrunk.case.faults)),
        sum(change.value is None for change in shrunk.changes),
        shrunk.shrinking.simulations,
        shrunk.shrinking.finished,
    )


HEADERS = ["planner", "faults", "cases", "as found", "written out", "after", "left out"]
HEADERS += ["simulations", "most", "finished", "users before", "users after", "at most 2 users"]
HEADERS += ["had a fault", "need a fault", "need two"]


def row(planner: str, faulty: str, results: list[Result]) -> list[str]:
    """Medians and counts, in the order of ``HEADERS``."""
    medians = [
        median(one.stated for one in results),
        *(median(one.parameters[i] for one in results) for i in (0, 1)),
        median(one.left_out for one in results),
        median(one.simulations for one in results),
    ]
    counts = [
        max(one.simulations for one in results),
        sum(one.finished for one in results),
        *(median(one.users[i] for one in results) for i in (0, 1)),
        sum(one.users[1] <= 2 for one in results),
        sum(one.faults[0] > 0 for one in results),
        sum(one.faults[1] > 0 for one in results),
        sum(one.faults[1] > 1 for one in results),
    ]
    return [planner, faulty, str(len(results)), *(f"{one:g}" for one in (*medians, *counts))]


def main() -> None:
    """Find, shrink, print."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--numbers", type=int, default=2, help="counterexamples of a kind")
    arguments.add_argument("--tries", type=int, default=100, help="points until there is none")
    arguments.add_argument("--budget", type=int, default=300, help="simulations for shrinking")
    arguments.add_argument("--jobs", type=int, default=2)
    arguments.add_argument("--select", default="*", help="scenarios, as a glob")
    options = arguments.parse_args()
    cases = expand_cases(load_library([]).scenarios, select=[options.select])
    jobs: list[Job] = [
        (case.id, planner, faulty, number, options.tries, options.budget)
        for number in range(options.numbers)
        for case in cases
        for planner in PLANNERS
        for faulty in (False, True)
    ]
    with ProcessPoolExecutor(options.jobs) as pool:
        found = dict(zip(jobs, pool.map(run, jobs), strict=True))
    rows, every = [], [one for one in found.values() if one is not None]
    for planner in PLANNERS:
        for faulty in (False, True):
            results = [
                one for job, one in found.items() if one and (job[1], job[2]) == (planner, faulty)
            ]
            if results:
                rows.append(row(planner, "yes" if faulty else "no", results))
    print(f"{machine()}\n\n{len(every)} collisions of {len(jobs)} times {options.tries} points\n")
    print(table(HEADERS, [*rows, row("all", "", every)] if every else [["-"] * len(HEADERS)]))


if __name__ == "__main__":
    main()
