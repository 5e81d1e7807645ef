"""The whole catalogue against three planners: how far each fault gets along its causal chain.

Run: python benchmarks/fault_table.py [--scenario NAME] [--runs 5] [--jobs 2] [--seed 0]
     [--planners rule_based reactive aggressive] [--faults catalogue]

Each fault acts by itself, as it is by default, on the same seeds for every planner. The scenario's
own roles run with recovery, and the residual monitor beside them. Whether a fault propagated is
told by runs of the same seeds without it.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache

from machine import machine, table
from reads import can_reach, channels_read

from pytest_dura import Runner
from pytest_dura.core import RoleSpec
from pytest_dura.core.metrics import TracedFault
from pytest_dura.domains import DOMAINS
from pytest_dura.library import expand_cases, load_library

DRIVING = DOMAINS["driving"]
PLANNERS = ("rule_based", "reactive", "aggressive")


@dataclass(frozen=True)
class Job:
    """One run of each fault with one planner; they share their twin without faults."""

    scenario: str
    faults: tuple[str, ...]
    planner: str
    run: int
    seed: int


@dataclass(frozen=True)
class Link:
    """One fault of one run."""

    chain: TracedFault
    invalid: bool


def run(job: Job) -> list[Link]:
    """The causal chains of a job."""
    library = load_library([])
    roles: dict[str, RoleSpec | None] = {
        "generator": RoleSpec(DRIVING.short_names["generator"][job.planner]),
        "residual_monitor": RoleSpec(DRIVING.short_names["residual_monitor"]["cusum"]),
    }
    bench = Runner(lambda: library, base_seed=job.seed, roles=roles)
    found = []
    for case in expand_cases([library.scenarios[job.scenario]], job.faults):
        episode = bench.episode(case, job.run)
        if episode.failure is not None:
            raise RuntimeError(episode.failure)
        invalid = episode.validity == "invalid"
        found += [Link(chain, invalid) for chain in bench.chains(case, episode)]
    return found


@cache
def rated() -> frozenset[str]:
    """Requirements that allow a rate, so that a single run that violates them says little."""
    requirements = load_library([]).requirements.items()
    return frozenset(name for name, one in requirements if one.at_most is not None)


def counts(links: Sequence[Link]) -> dict[str, int]:
    """In how many of these runs a fault got how far."""
    chains = [link.chain for link in links]
    return {
        "activated": sum(one.activated_at is not None for one in chains),
        "manifested": sum(one.manifested_at is not None for one in chains),
        "propagated": sum(one.propagation == "propagated" for one in chains),
        "detected": sum(one.detected_at is not None for one in chains),
        "violated": sum(bool({*one.violated} - rated()) for one in chains),
        "newly violated": sum(
            one.violated_without is not None
            and bool({*one.violated} - {*one.violated_without} - rated())
            for one in chains
        ),
        "recovery": sum(one.recovery_at is not None for one in chains),
        "recovered": sum(one.recovered_at is not None for one in chains),
        "invalid": sum(link.invalid for link in links),
    }


def cell(links: Sequence[Link], read: set[str]) -> str:
    """One fault and planner: how far the fault got, or why it never manifested."""
    found = counts(links)
    invalid = f"; {found['invalid']} invalid" if found["invalid"] else ""
    if not found["manifested"]:
        word = "not manifested" if found["activated"] else "never active"
        if not can_reach(links[0].chain.target, read):
            word = "not read"
        return word + invalid
    numbers = [str(found[name]) for name in ("activated", "manifested", "propagated", "detected")]
    numbers.append(share(found["newly violated"], found["violated"]))
    numbers.append(share(found["recovered"], found["recovery"]))
    return " / ".join(numbers) + invalid


def share(part: int, whole: int) -> str:
    """Such as 2 of 5; 0 where there is nothing to be part of."""
    return f"{part} of {whole}" if whole else "0"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenario", default="intersection/nominal")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--planners", nargs="+", default=PLANNERS, choices=DRIVING.short_names["generator"]
    )
    parser.add_argument("--faults", nargs="+", default=["catalogue"])
    options = parser.parse_args()
    planned = [
        Job(options.scenario, tuple(options.faults), planner, number, options.seed)
        for planner in options.planners
        for number in range(options.runs)
    ]
    links: dict[tuple[str, str], list[Link]] = {}
    with ProcessPoolExecutor(options.jobs) as pool:
        for job, found in zip(planned, pool.map(run, planned), strict=True):
            for link in found:
                links.setdefault((link.chain.id, job.planner), []).append(link)
    faults = list(dict.fromkeys(fault for fault, _ in links))
    print(f"""{machine()}

{options.scenario}, {options.runs} runs of each fault and planner, base seed {options.seed}

Each cell: activated / manifested / propagated / detected / violated / recovered, in runs. Violated:
n of m, where m runs violate a requirement that allows no rate from the manifestation on, and n of
them one that the same run without the fault keeps. Recovered: n of m, where recovery acted in m
runs and handed control back in n. A fault of a channel that a planner does not read cannot reach
it; one that changed nothing, such as an object list without objects, is not manifested. Without a
violation such runs are invalid, unless their hits are drawn.
""")
    generators = {
        planner: RoleSpec(DRIVING.short_names["generator"][planner]) for planner in options.planners
    }
    reads = {
        planner: channels_read(options.scenario, component, options.seed)
        for planner, component in generators.items()
    }
    rows = [
        [fault, *(cell(links[fault, planner], reads[planner]) for planner in options.planners)]
        for fault in faults
    ]
    print(table(["fault", *options.planners], rows))
    print()
    totals = [
        (planner, counts([link for fault in faults for link in links[fault, planner]]))
        for planner in options.planners
    ]
    rows = [[planner, *(str(number) for number in found.values())] for planner, found in totals]
    print(table(["planner, all faults", *totals[0][1]], rows))
    told = [f"{planner}: {', '.join(sorted(read)) or 'nothing'}" for planner, read in reads.items()]
    print(f"\nChannels read by {'; '.join(told)}.")


if __name__ == "__main__":
    main()
