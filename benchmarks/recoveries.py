"""Every recovery planner against no recovery, on the same seeds.

Run: python benchmarks/recoveries.py [--generator reactive] [--runs 40] [--jobs 2]
     python benchmarks/recoveries.py --select 'intersection/sudden/*' --runs 200 --keep FILE \\
         --generator rule_based --generator tactical --generator reactive --table together

With ``--keep`` each outcome is written to a file, and a run that was stopped goes on from there.
Without ``--table`` all tables are printed.

Each run of each built-in scenario once with the policy log_only and once with each planner. A pair
shares seed, traffic, timing, variation and faults. What is compared is whether the ego collided:
prevented (only without), introduced (only with), futile (in both, though it acted), unnecessary (in
neither, though it acted), and the exact two-sided McNemar test of the first two, uncorrected.
The careful driver of UN R157 runs the same seeds: of the collisions without recovery, those that it
avoids are avoidable, and the others unavoidable; the test takes in both. Of the avoidable ones
recovery prevents a share, with its exact 95 % interval.
Clearance times are of pairs that cleared both times; gridlock is neither a collision nor clearing.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import cache
from itertools import product
from pathlib import Path
from statistics import mean, quantiles
from typing import NamedTuple

import numpy as np
from machine import machine, table

from pytest_dura.core import Orchestrator, RoleSpec, switching
from pytest_dura.core.roles import Assessed
from pytest_dura.domains import DOMAINS
from pytest_dura.driving import clearance_time
from pytest_dura.library import Case, expand_cases, load_library
from pytest_dura.requirements import lower_bound, mcnemar, upper_bound

OFF = "off"
TABLES = ("components", "together", "shares", "against", "scenarios")
REFERENCE = "careful_driver"
PLANNERS = tuple(DOMAINS["driving"].short_names["recovery_planner"])
Key = tuple[str, str, str, int]
"""Component, scenario, planner or ``off``, run."""


@dataclass(frozen=True)
class Outcome:
    """What the tables need of an episode; ``share`` of the time recovery was in control."""

    collided: bool
    clearance: float | None
    acted: bool
    share: float
    microseconds: tuple[float, ...]
    valid: bool
    refused: bool
    """Whether a proposal was refused, so that recovery would act."""

    @property
    def gridlock(self) -> bool:
        """Whether the ego never got through, and met nobody."""
        return not self.collided and self.clearance is None


@cache
def _case(scenario: str) -> Case:
    (case,) = expand_cases(load_library([]).scenarios, select=[scenario])
    return case


Job = tuple[str, str, int, tuple[str, ...], int]
"""Component, scenario, run, planners and base seed."""


def run(job: Job) -> list[tuple[Key, Outcome]]:
    """A run without recovery, and with each planner; the reference is run without alone.

    Recovery acts on what the monitors refuse: where that is nothing, the runs with it are the same,
    and not simulated again.
    """
    generator, scenario, number, planners, seed = job
    off = _outcome(generator, scenario, OFF, number, seed)
    outcomes = [((generator, scenario, OFF, number), off)]
    for planner in planners:
        on = _outcome(generator, scenario, planner, number, seed) if off.refused else off
        outcomes.append(((generator, scenario, planner, number), on))
    return outcomes


def _outcome(generator: str, scenario: str, planner: str, number: int, seed: int) -> Outcome:
    roles = {"generator": RoleSpec(generator)}
    if planner != OFF:
        roles["recovery_planner"] = RoleSpec(planner)
    policy = "log_only" if planner == OFF else "recover"
    spec = _case(scenario).spec(number, seed, roles, policy=policy)
    episode = Orchestrator.build(spec).run(spec)
    if episode.failure is not None:
        raise RuntimeError(episode.failure)
    time = clearance_time(episode)
    _, spent = episode.metrics.processing_ns.get("recovery_planner", ([], []))
    return Outcome(
        collided=episode.collided,
        clearance=None if np.isnan(time) else time,
        acted=bool(episode.metrics.recoveries),
        share=switching(episode).share or 0.0,
        microseconds=tuple(one / 1000.0 for one in spent),
        valid=episode.validity == "valid",
        refused=bool((episode.decisions["verdict"] == Assessed.UNSAFE).any()),
    )


Pairs = list[tuple[Outcome, Outcome]]
"""Without and with recovery."""
Cells = list[str]
Found = dict[Key, Outcome]

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


AVOIDABLE = ["recovery", "collisions off", "unavoidable", "avoidable", "prevented", "share %"]
AVOIDABLE += ["95 % interval", "introduced", "p"]


def avoidable_row(planner: str, pairs: Pairs, references: list[Outcome]) -> list[str]:
    """What recovery makes of the collisions that the reference avoids, as ``AVOIDABLE`` has it."""
    both = list(zip(pairs, references, strict=True))
    collided = sum(off.collided for off, _ in pairs)
    avoidable = [on for (off, on), own in both if off.collided and not own.collided]
    prevented = sum(not on.collided for on in avoidable)
    introduced = sum(on.collided and not off.collided for off, on in pairs)
    share = interval = "-"
    if avoidable:
        share = f"{100 * prevented / len(avoidable):.0f}"
        low = lower_bound(prevented, len(avoidable), 0.975)
        high = upper_bound(prevented, len(avoidable), 0.975)
        interval = f"{100 * low:.0f} to {100 * high:.0f}"
    counts = [collided, collided - len(avoidable), len(avoidable), prevented]
    all_prevented = sum(off.collided and not on.collided for off, on in pairs)
    test = f"{mcnemar(all_prevented, introduced):.2g}"
    return [planner, *map(str, counts), share, interval, str(introduced), test]


TOGETHER = ["component", "recovery", "collisions off", "unavoidable", "avoidable"]
TOGETHER += ["prevented of these", "share %", "95 % interval", "prevented of all", "introduced"]
TOGETHER += ["futile", "p", "mean change s", "gridlock off", "gridlock on"]
SHARES = ["component", "runs", "collisions without recovery, %", "unavoidable, %", "recovery"]
SHARES += ["prevented, % of the avoidable", "prevented, % of all", "introduced, % of the others"]


def together_row(generator: str, planner: str, pairs: Pairs, references: list[Outcome]) -> Cells:
    """One component with one recovery over all scenarios, as ``TOGETHER`` has it."""
    _, off, unavoidable, avoidable, of_these, share, interval, _, _ = avoidable_row(
        planner, pairs, references
    )
    _, _, _, prevented, introduced, futile, _, p, _, change, stuck_off, stuck_on, _ = row(
        planner, pairs
    )
    return [
        generator, planner, off, unavoidable, avoidable, of_these, share, interval, prevented,
        introduced, futile, p, change, stuck_off, stuck_on,
    ]  # fmt: skip


def shares_row(generator: str, planner: str, pairs: Pairs, references: list[Outcome]) -> Cells:
    """The same as shares with exact 95 % intervals, as ``SHARES`` has it."""
    both = list(zip(pairs, references, strict=True))
    off = sum(without.collided for without, _ in pairs)
    unavoidable = sum(without.collided and own.collided for (without, _), own in both)
    prevented = sum(without.collided and not on.collided for without, on in pairs)
    of_these = sum(
        without.collided and not own.collided and not on.collided for (without, on), own in both
    )
    introduced = sum(on.collided and not without.collided for without, on in pairs)
    return [
        generator, str(len(pairs)), share(off, len(pairs)), share(unavoidable, len(pairs)), planner,
        share(of_these, off - unavoidable), share(prevented, off),
        share(introduced, len(pairs) - off),
    ]  # fmt: skip


def share(count: int, of: int) -> str:
    """A share in per cent, its exact 95 % interval, and of how many."""
    if not of:
        return "-"
    low, high = lower_bound(count, of, 0.975), upper_bound(count, of, 0.975)
    return f"{100 * count / of:.1f} ({100 * low:.1f}-{100 * high:.1f}) of {of}"


AGAINST = ["recovery", "pairs", "collides only with the first", "only with it", "p"]
AGAINST += ["gridlock only with the first", "only with it", "p"]


class Arms(NamedTuple):
    """All that was run, for tables across components."""

    found: Found
    generators: list[str]
    planners: tuple[str, ...]
    scenarios: list[str]
    numbers: Sequence[int]

    def against_first(self, planner: str) -> list[str]:
        """Runs of equal seeds with two recoveries: in which only one collides, or stands."""
        pairs = [
            (self.found[g, s, self.planners[0], n], self.found[g, s, planner, n])
            for g, s, n in product(self.generators, self.scenarios, self.numbers)
        ]
        cells = [planner, str(len(pairs))]
        for what in ("collided", "gridlock"):
            first = sum(getattr(a, what) and not getattr(b, what) for a, b in pairs)
            second = sum(getattr(b, what) and not getattr(a, what) for a, b in pairs)
            cells += [str(first), str(second), f"{mcnemar(first, second):.2g}"]
        return cells

    def all_scenarios(self, generator: str, planner: str) -> tuple[Pairs, list[Outcome]]:
        """Pairs of a component in all scenarios, and the reference's runs of the same seeds."""
        where = list(product(self.scenarios, self.numbers))
        pairs = [
            (self.found[generator, s, OFF, n], self.found[generator, s, planner, n])
            for s, n in where
        ]
        return pairs, [self.found[REFERENCE, s, OFF, n] for s, n in where]

    def row(self, scenario: str, generator: str) -> list[str]:
        """What a component comes to in a scenario without recovery, and with each."""
        off = [self.found[generator, scenario, OFF, n] for n in self.numbers]
        reference = [self.found[REFERENCE, scenario, OFF, n] for n in self.numbers]
        both = sum(a.collided and b.collided for a, b in zip(off, reference, strict=True))
        cells = [scenario.rpartition("/")[2], generator, f"{sum(a.collided for a in off)} ({both})"]
        cells.append(str(sum(a.refused for a in off)))
        for planner in self.planners:
            on = [self.found[generator, scenario, planner, n] for n in self.numbers]
            stuck = sum(each.gridlock for each in on)
            cells.append(
                f"{sum(each.collided for each in on)}" + f", {stuck} gridlock" * (stuck > 0)
            )
        return cells


def outcomes(jobs: list[Job], keep: Path | None, processes: int) -> Found:
    """Run what is not kept yet, and keep it as it comes."""
    found = dict(_kept(keep)) if keep is not None and keep.exists() else {}
    due = [job for job in jobs if not _keys(job) <= found.keys()]
    seeds = {job[4] for job in jobs}
    assert len(seeds) == 1, "a file of outcomes is of one base seed"
    with ProcessPoolExecutor(processes) as pool:
        for several in pool.map(run, due, chunksize=2):
            found |= several
            if keep is not None:
                keep.parent.mkdir(parents=True, exist_ok=True)
                lines = [{"key": key, **asdict(outcome)} for key, outcome in several]
                with keep.open("a") as opened:
                    opened.writelines(json.dumps(line) + "\n" for line in lines)
    return found


def _keys(job: Job) -> set[Key]:
    generator, scenario, number, planners, _ = job
    return {(generator, scenario, planner, number) for planner in (OFF, *planners)}


def _kept(keep: Path) -> Iterator[tuple[Key, Outcome]]:
    for line in keep.read_text().splitlines():
        data = json.loads(line)
        generator, scenario, planner, number = data.pop("key")
        data["microseconds"] = tuple(data["microseconds"])
        yield (generator, scenario, planner, number), Outcome(**data)


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
    arguments.add_argument("--generator", action="append", help="repeatable; by default reactive")
    arguments.add_argument("--recovery", action="append", help="repeatable; by default all")
    arguments.add_argument("--runs", type=int, default=40)
    arguments.add_argument("--jobs", type=int, default=2)
    arguments.add_argument("--seed", type=int, default=0)
    arguments.add_argument("--select", help="scenarios, as a glob; by default the six")
    arguments.add_argument("--keep", type=Path, help="file of outcomes of a seed, to go on from")
    arguments.add_argument("--table", action="append", choices=TABLES, help="repeatable")
    options = arguments.parse_args()
    cases = expand_cases(
        load_library([]).scenarios, select=[options.select] if options.select else []
    )
    scenarios, numbers = [case.id for case in cases], range(options.runs)
    planners = tuple(options.recovery or PLANNERS)
    generators = options.generator or ["reactive"]
    # Run by run, so that what is kept of a comparison that was stopped is about all of it.
    jobs: list[Job] = []
    for number, scenario in product(numbers, scenarios):
        if REFERENCE not in generators:
            jobs.append((REFERENCE, scenario, number, (), options.seed))
        jobs += [(each, scenario, number, planners, options.seed) for each in generators]
    wanted = {key for job in jobs for key in _keys(job)}
    outcome_of = outcomes(jobs, options.keep, options.jobs)
    found = {key: outcome_of[key] for key in wanted}
    print(f"{machine()}\n\n{options.runs} paired seeds a scenario, base seed {options.seed}")
    arms = Arms(found, generators, planners, scenarios, numbers)
    chosen = options.table or TABLES
    if "components" in chosen:
        for generator in generators:
            print(f"\n### {generator}\n")
            _print(found, generator, planners, scenarios, numbers)
    for name, headers, make in (
        ("together", TOGETHER, together_row),
        ("shares", SHARES, shares_row),
    ):
        if name in chosen:
            rows = [make(g, p, *arms.all_scenarios(g, p)) for g, p in product(generators, planners)]
            print(f"\n### All scenarios together{', as shares' * (name == 'shares')}\n")
            print(table(headers, rows))
    if "against" in chosen:
        print(f"\n### Of all components, against {planners[0]}\n")
        print(table(AGAINST, [arms.against_first(planner) for planner in planners[1:]]))
    if "scenarios" in chosen:
        print("\n### By scenario and component\n")
        headers = [
            "scenario",
            "component",
            "collisions without (unavoidable)",
            "refused",
            *planners,
        ]
        print(table(headers, [arms.row(s, each) for s in scenarios for each in generators]))
    print(
        f"\n{sum(not each.valid for each in found.values())} of {len(found)} episodes were invalid"
    )


def _print(
    found: Found,
    generator: str,
    planners: tuple[str, ...],
    scenarios: list[str],
    numbers: Sequence[int],
) -> None:
    """Print the tables of one component."""

    def pairs(planner: str, *where: str) -> Pairs:
        return [
            (found[generator, s, OFF, n], found[generator, s, planner, n])
            for s in where
            for n in numbers
        ]

    rows = [[s, *row(p, pairs(p, s))] for s in scenarios for p in planners]
    print(table(["scenario", *HEADERS], rows))
    print("\nAll scenarios together:\n")
    together = {planner: pairs(planner, *scenarios) for planner in planners}
    rows = [[*row(planner, both), *cost(both)] for planner, both in together.items()]
    print(table([*HEADERS, "calls", "us/call", "99 % within"], rows))
    references = {s: [found[REFERENCE, s, OFF, n] for n in numbers] for s in scenarios}
    print("\nOf the collisions without recovery, those that the careful driver avoids:\n")
    rows = [[s, *avoidable_row(p, pairs(p, s), references[s])] for s in scenarios for p in planners]
    everything = [each for s in scenarios for each in references[s]]
    rows += [
        ["all together", *avoidable_row(p, pairs(p, *scenarios), everything)] for p in planners
    ]
    print(table(["scenario", *AVOIDABLE], rows))


if __name__ == "__main__":
    main()
