"""What the built-in suite catches of seeded defects, with and without some requirements, and when.

Run: python benchmarks/qualification.py [--select 'intersection/*'] [--without MON-1 PERF-7]
     [--runs 3] [--processes 2] [--parts generator safety_monitor] [--drawn 20] [--seed 0]

Each mutant is run on the gates of the chosen cases; then the same episodes are judged once more by
the gates without the requirements that ``--without`` names. With ``--drawn`` the mutants have
parameters that are drawn between half the least and twice the greatest of those that a mutation
names, and no named one: no test of this project knows them. CPU time is that of all processes.
"""

from __future__ import annotations

import argparse
import random
import time
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase

import psutil
from machine import machine, table

from pytest_dura import Runner
from pytest_dura.execution.executors import ExecutorChoice
from pytest_dura.execution.store import EpisodeStore
from pytest_dura.library import expand_cases
from pytest_dura.qualification import (
    Gate,
    Mutant,
    Qualification,
    Qualified,
    planned_mutants,
)
from pytest_dura.qualification.table import caught_text, place, quickest, runs_for_power

WITHIN = 15
"""Runs within which a defect is to be caught with 95 %: the planned ones of a built-in case."""


def gates_of(runner: Runner, globs: Sequence[str]) -> list[Gate]:
    """The cases that some globs name, each with the requirements that judge it."""
    library = runner.library()
    return [
        Gate(
            case, tuple(each for each in runner.requirements_of(case) if each.check or each.paired)
        )
        for name, scenario in library.scenarios.items()
        if any(fnmatchcase(name, glob) for glob in globs)
        for case in expand_cases([scenario], read=library.faults)
    ]


def without(gates: Sequence[Gate], names: Sequence[str]) -> list[Gate]:
    """The gates without some requirements."""
    return [
        replace(
            gate, requirements=tuple(each for each in gate.requirements if each.id not in names)
        )
        for gate in gates
    ]


def drawn(mutants: Sequence[Mutant], number: int, seed: int) -> Iterator[Mutant]:
    """Yield mutants with drawn parameters, of mutations whose numbers have a choice."""
    draws = random.Random(seed)  # noqa: S311 - draws of a benchmark
    named: dict[str, list[Mutant]] = defaultdict(list)
    for mutant in mutants:
        named[mutant.mutation].append(mutant)
    numeric = {
        name: known
        for name, known in named.items()
        if any(type(value) in (int, float) for value in known[0].params.values())
    }
    for _ in range(number):
        known = numeric[draws.choice(sorted(numeric))]
        params = dict(known[0].params)
        for name, value in params.items():
            values = {each.params[name] for each in known}
            if type(value) in (int, float):
                params[name] = _drawn(values, draws)
        yield replace(known[0], params=params)


def _drawn(values: set[float], draws: random.Random) -> float:
    """A number near some numbers, and none of them; whole if they are."""
    ends = [scale * value for value in values for scale in (0.5, 2.0)]
    whole = all(type(value) is int for value in values)
    while True:
        number = draws.uniform(min(ends), max(ends))
        number = max(1, round(number)) if whole else float(f"{number:.3g}")
        if number not in values:
            return number


@dataclass
class Timed:
    """Seconds, of the clock and of the cores, since it was made."""

    def __post_init__(self) -> None:
        self._begun = time.perf_counter(), self._cpu()

    @staticmethod
    def _cpu() -> float:
        """Of this process and of those that it began, which are there until it closes them."""
        own = psutil.Process()
        total = sum(own.cpu_times()[:4])
        for child in own.children(recursive=True):
            total += sum(child.cpu_times()[:4])
        return total

    def spent(self) -> tuple[float, float]:
        """Seconds of the clock and of the cores."""
        wall, cpu = self._begun
        return time.perf_counter() - wall, self._cpu() - cpu


def by_part(results: Sequence[Qualified], times: Counter[str]) -> str:
    """A row for each part: what is caught of it, in how many runs, and what that took."""
    parts: dict[str, list[Qualified]] = defaultdict(list)
    for result in results:
        parts[result.role].append(result)
    parts["all"] = list(results)
    rows = []
    for part, own in parts.items():
        caught = [each for each in own if each.status == "caught"]
        quick = sum(_runs(each) <= WITHIN for each in caught)
        alike = sum(each.status == "no difference" for each in own)
        seconds = sum(times.values()) if part == "all" else times[part]
        runs = sum(each.runs for each in own)
        figures = (quick, alike, runs, round(seconds))
        rows.append([part, f"{len(caught)} of {len(own)}", *map(str, figures)])
    headers = ["part", "caught", f"within {WITHIN} runs", "no difference", "runs", "s"]
    return table(headers, rows)


def _runs(result: Qualified) -> float:
    kill = quickest(result)
    runs = None if kill is None else runs_for_power(kill)
    return float("inf") if runs is None else runs


def _by(result: Qualified) -> str:
    """What catches a mutant; of a survivor, what came nearest."""
    kill = quickest(result)
    if kill is not None:
        names = dict.fromkeys(each.requirement for each in result.kills)
        return f"{', '.join(names)}; first on {place(kill.case, kill.provoker)}"
    near = result.nearest
    if near is None:
        return result.problem or f"{result.status}: uses up no margin"
    where = place(near.case, near.provoker)
    return f"{near.requirement} on {where} keeps {near.left:.3g} of {near.before:.3g}"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--select", nargs="+", default=["intersection/*"])
    parser.add_argument("--without", nargs="*", default=[])
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--parts", nargs="*", help="by default all")
    parser.add_argument("--mutants", nargs="*", default=["*"], help="globs of names")
    parser.add_argument("--drawn", type=int, help="mutants with drawn parameters, in their place")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()

    runner = Runner.of()
    gates = gates_of(runner, options.select)
    mutants = [
        each for each in planned_mutants(gates)
        if (not options.parts or each.role in options.parts)
        and any(fnmatchcase(each.name, glob) for glob in options.mutants)
    ]  # fmt: skip
    if options.drawn is not None:
        own = [each for each in mutants if isinstance(each, Mutant)]
        mutants = list(drawn(own, options.drawn, options.seed))
    choice = "in-process" if options.processes == 1 else f"processes:{options.processes}"
    print(machine())
    with closing(ExecutorChoice.parse(choice).execution()) as execution:
        store = EpisodeStore(execution=execution)
        runner = replace(runner, store=store)
        qualification, timed = Qualification(runner, gates, options.runs), Timed()
        qualification.plan(mutants)
        results, times = [], Counter[str]()
        for number, mutant in enumerate(mutants, 1):
            begun = time.perf_counter()
            results.append(qualification.qualify(mutant))
            times[mutant.role] += time.perf_counter() - begun
            last = results[-1]
            print(f"{number} of {len(mutants)}: {last.name} {last.status}, "
                  f"{time.perf_counter() - begun:.1f} s", flush=True)  # fmt: skip
        wall, cpu = timed.spent()
        simulated = store.simulated
        less: list[Qualified] = []
        if options.without:
            fewer = Qualification(runner, without(gates, options.without), options.runs)
            less = [
                fewer.qualify(each) for each in mutants
                if isinstance(each, Mutant) or each.changed.id not in options.without
            ]  # fmt: skip
    print(f"\n{len(gates)} cases, {simulated} episodes simulated in {options.processes} processes: "
          f"{wall:.0f} s, {cpu:.0f} s of CPU time; {caught_text(results)}\n")  # fmt: skip
    print(by_part(results, times))
    if less:
        names = " and ".join(options.without)
        print(f"\nWithout {names}: {caught_text(less)}\n")
        print(by_part(less, Counter()))
    before = {each.name: each for each in less}
    headers = ["mutant", "result", *([f"without {' and '.join(options.without)}"] if less else []),
               "runs for 95 %", "by, or nearest"]  # fmt: skip
    rows = []
    for result in results:
        other = before.get(result.name)
        runs = _runs(result)
        rows.append([
            result.name, result.status,
            *([other.status if other is not None else "not there"] if less else []),
            "" if runs == float("inf") else str(runs), _by(result),
        ])  # fmt: skip
    print("\n" + table(headers, rows))


if __name__ == "__main__":
    main()
