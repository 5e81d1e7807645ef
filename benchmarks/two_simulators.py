"""The two simulators of driving side by side: verdicts, flags, clearance times, and speed.

Run: python benchmarks/two_simulators.py [--runs 15] [--select 'intersection/*'] [--timed 3]

Two sessions run the scenarios with the same roles and requirements, one in `driving`, one in
`driving.sumo` (extra `sumo`), each in a process of its own at the same time. Runs of one number
have the same seed in both: the same traffic demand, variation and attacks. Flags of such pairs are
compared by the exact McNemar test, clearance times of those that cleared in both by the exact sign
test; p-values are two-sided and uncorrected. Speed is measured afterwards in one process, in turns:
the whole loop with all roles, and the simulator's own steps in it.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from importlib.metadata import version
from itertools import product
from pathlib import Path
from statistics import mean
from time import perf_counter
from typing import Any

from machine import machine, table
from scipy.stats import binomtest

from pytest_dura.core import Orchestrator, RoleSpec
from pytest_dura.core.simulator import SIMULATORS
from pytest_dura.core.simulator_process import simulating
from pytest_dura.library import expand_cases, load_library
from pytest_dura.requirements import mcnemar

NAMES = ("driving", "driving.sumo")
Record = Mapping[str, Any]


def records(runs: int, select: str) -> list[Record]:
    """The evidence of a session in each simulator, both at the same time."""
    with tempfile.TemporaryDirectory() as place:
        sessions = [
            subprocess.Popen(
                [
                    *(sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"),
                    *("--dura-scenarios", f"--dura-select={select}", f"--dura-runs={runs}"),
                    *(f"--dura-simulator={name}", f"--dura-evidence={name}"),
                    "--dura-evidence-level=summary",
                ],
                cwd=place,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
            )
            for name in NAMES
        ]
        outputs = [session.communicate()[0] for session in sessions]
        for session, output in zip(sessions, outputs, strict=True):
            if session.returncode not in (0, 1):  # a gate may fail, a session may not
                sys.exit(output)
        files = [Path(place, name, "evidence.json") for name in NAMES]
        return [json.loads(file.read_text()) for file in files]


def agreement(ours: Record, theirs: Record) -> None:
    """Print how many verdicts agree, by requirement, and which do not."""
    first, second = (
        {(each["requirement"], each["case"]): each for each in record["verdicts"]}
        for record in (ours, theirs)
    )
    agreeing: dict[str, list[bool]] = defaultdict(list)
    rows = []
    for key in sorted(first.keys() | second.keys()):
        left, right = first[key], second[key]
        agreeing[key[0]].append(left["verdict"] == right["verdict"])
        if not agreeing[key[0]][-1]:
            shown = [
                f"{each['verdict']} ({each['violations']} of {each['episodes']})"
                for each in (left, right)
            ]
            rows.append([key[0], key[1].removeprefix("intersection/"), *shown])
    counts = [[name, f"{sum(same)} of {len(same)}"] for name, same in sorted(agreeing.items())]
    total = [same for group in agreeing.values() for same in group]
    counts.append(["all", f"**{sum(total)} of {len(total)}**"])
    print(f"\n{table(['requirement', 'verdicts that agree'], counts)}\n")
    print(table(["requirement", "scenario", *NAMES], rows) if rows else "none differs")


def planned(record: Record) -> dict[tuple[str, int], Record]:
    """Planned episodes of the scenarios as they are, by case and run: no second runs of pairs."""
    episodes = [
        each for each in record["episodes"] if each["planned"] and not set("+~") & set(each["case"])
    ]
    return {(each["case"], int(each["id"].rpartition("#")[2])): each for each in episodes}


def outcomes(ours: Record, theirs: Record) -> Iterator[list[str]]:
    """Flags and clearance times of each scenario, with paired tests."""
    first, second = planned(ours), planned(theirs)
    pairs: dict[str, list[tuple[Record, Record]]] = defaultdict(list)
    for case, run in sorted(first.keys() & second.keys()):
        left, right = (side[case, run]["outcome"] for side in (first, second))
        pairs[case].append((left, right))
    everything = [pair for group in pairs.values() for pair in group]
    for case, group in [*pairs.items(), ("all", everything)]:
        flags = [(left["flagged"], right["flagged"]) for left, right in group]
        only = flags.count((True, False)), flags.count((False, True))
        times = [
            (left["measures"]["clearance_time"], right["measures"]["clearance_time"])
            for left, right in group
        ]
        both = [(a, b) for a, b in times if a is not None and b is not None]
        stuck = [sum(pair[side] is None for pair in times) for side in (0, 1)]
        yield [
            case.removeprefix("intersection/"),
            str(len(group)),
            *(f"{sum(flag[side] for flag in flags)}" for side in (0, 1)),
            f"{mcnemar(*only):.2g}",
            *(f"{mean(pair[side] for pair in both):.1f}" if both else "-" for side in (0, 1)),
            f"{sign_test(both):.2g}",
            f"{stuck[0]}, {stuck[1]}",
        ]


def sign_test(pairs: Sequence[tuple[float, float]]) -> float:
    """Two-sided p-value of "as often longer as shorter"."""
    longer, shorter = sum(b > a for a, b in pairs), sum(b < a for a, b in pairs)
    return float(binomtest(longer, longer + shorter).pvalue) if longer + shorter else 1.0


def timed(name: str, case: Any, run: int) -> tuple[int, float, float]:
    """Ticks of an episode, its seconds, and those of them in the simulator's steps."""
    spec = case.spec(run, 0, simulator=RoleSpec(SIMULATORS.path(name)))
    with simulating(SIMULATORS[name]):
        loop = Orchestrator.build(spec)
        stepping = [0.0]
        step = loop.simulator.step

        def measured(action: Any) -> Any:
            begin = perf_counter()
            tick = step(action)
            stepping[0] += perf_counter() - begin
            return tick

        loop.simulator.step = measured  # type: ignore[method-assign]
        begin = perf_counter()
        episode = loop.run(spec)
        seconds = perf_counter() - begin
        loop.close(episode)
    return episode.ticks - 1, seconds, stepping[0]


def speed(select: str, runs: int) -> Iterator[list[str]]:
    """Ticks a second of each scenario: the loop, and the simulator's steps alone."""
    totals = {name: [0.0, 0.0, 0.0] for name in NAMES}
    for case in expand_cases(load_library([]).scenarios, select=[select]):
        sums = {name: [0.0, 0.0, 0.0] for name in NAMES}
        for run, name in product(range(-1, runs), NAMES):
            figures = timed(name, case, max(run, 0))
            if run >= 0:  # the first one imports and fills caches
                sums[name] = [a + b for a, b in zip(sums[name], figures, strict=True)]
        for name in NAMES:
            totals[name] = [a + b for a, b in zip(totals[name], sums[name], strict=True)]
        yield [case.id.removeprefix("intersection/"), *rates(sums)]
    yield ["all", *rates(totals)]


def rates(sums: Mapping[str, Sequence[float]]) -> Iterator[str]:
    """Ticks a second of the loop and of the steps, and how many times SUMO is faster."""
    for part in (1, 2):
        ours, theirs = (sums[name][0] / sums[name][part] for name in NAMES)
        yield from (f"{ours:.0f}", f"{theirs:.0f}", f"{theirs / ours:.2f}")


def main() -> None:
    """Run, compare and print."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--runs", type=int, default=15)
    arguments.add_argument("--select", default="intersection/*")
    arguments.add_argument("--timed", type=int, default=3, help="episodes of a scenario")
    options = arguments.parse_args()
    print(f"{machine()}, libsumo {version('libsumo')}; {options.runs} runs a scenario")
    ours, theirs = records(options.runs, options.select)
    agreement(ours, theirs)
    sides = ["driving", "sumo"]
    headers = ["scenario", "n", *(f"flagged, {side}" for side in sides), "p",
               *(f"clearance s, {side}" for side in sides), "p", "not cleared"]  # fmt: skip
    print(f"\n{table(headers, list(outcomes(ours, theirs)))}\n")
    headers = ["scenario", *(f"loop, {side}" for side in sides), "times",
               *(f"step, {side}" for side in sides), "times"]  # fmt: skip
    print(table(headers, list(speed(options.select, options.timed))))


if __name__ == "__main__":
    main()
