"""The same episodes by this process, by a pool of two processes, and by two workers of Dask.

Run: python benchmarks/executors.py [--runs 10] [--repeats 3] [--select GLOB]
     python benchmarks/executors.py --sessions PAIRS [--runs 15] [--select GLOB]

The built-in scenarios with so many runs each, one after the other through an episode store, as a
session asks for them. The executors take turns, the quickest time of each counts, and what it takes
to start them is told apart: processes import once what they need. Digests are compared.

With ``--sessions``, whole sessions of pytest in pairs, in turns first: in one process, and as
``--dura-executor=auto`` chooses. Seconds and digests are those of the whole process.
"""

from __future__ import annotations

import argparse
import json
import logging
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from statistics import median

from machine import machine, table

from pytest_dura import Runner
from pytest_dura.execution import EpisodeStore, EpisodeTask, Execution, ExecutorChoice
from pytest_dura.library import expand_cases, load_library

WIDTH = 2


def tasks(runs: int, select: str) -> list[EpisodeTask]:
    """The episodes."""
    library = load_library([])
    bench = Runner(lambda: library)
    cases = expand_cases(library.scenarios, select=[select], read=library.faults)
    return [bench.task(case, run) for case in cases for run in range(runs)]


def simulated(execution: Execution, wanted: Sequence[EpisodeTask]) -> tuple[float, list[str]]:
    """Seconds until all are there, and their digests."""
    store = EpisodeStore(execution=execution)
    start = time.perf_counter()
    digests = [
        store.get(task, wanted[number + 1 : number + 20]).digest
        for number, task in enumerate(wanted)
    ]
    return time.perf_counter() - start, digests


def compare(executions: dict[str, Execution], wanted: Sequence[EpisodeTask], repeats: int) -> None:
    """Let them take turns, and print what came of it."""
    first, best = {}, {}
    expected = None
    for name, execution in executions.items():  # everything is imported afterwards
        first[name], digests = simulated(execution, wanted[: 2 * WIDTH])
    for _ in range(repeats):
        for name, execution in executions.items():
            seconds, digests = simulated(execution, wanted)
            expected = expected or digests
            if digests != expected:
                raise SystemExit(f"{name}: other episodes")
            best[name] = min(seconds, best.get(name, seconds))
    alone, pool, _ = best.values()
    rows = [
        [name, f"{first[name]:.1f}", f"{seconds:.2f}", f"{alone / seconds:.2f}",
         f"{seconds / pool:.2f}"]
        for name, seconds in best.items()
    ]  # fmt: skip
    headers = ["executor", f"first {2 * WIDTH} episodes, s", f"{len(wanted)} episodes, s",
               "times faster than in-process", "time against the pool"]  # fmt: skip
    print(table(headers, rows))


def time_starts(task: EpisodeTask, repeats: int) -> None:
    """Print what a process takes until it simulates: its first episode, less the same again."""
    taken = []
    for _ in range(repeats):
        execution = ExecutorChoice.parse("processes:1").execution()
        try:
            first, again = (simulated(execution, [task])[0] for _ in range(2))
        finally:
            execution.close()
        taken.append(first - again)
    print()
    print(table(["a process starts and imports, s", "at most"],
                [[f"{median(taken):.2f}", f"{max(taken):.2f}"]]))  # fmt: skip


def session(executor: str, folder: Path, options: argparse.Namespace) -> tuple[float, list[str]]:
    """Seconds of a session as a process, and the digests of its episodes."""
    command = [
        sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--dura-scenarios",
        f"--dura-select={options.select}", f"--dura-runs={options.runs}",
        f"--dura-executor={executor}", f"--dura-evidence={folder / executor}",
    ]  # fmt: skip
    # As for whoever installed the package: its bytecode lies beside it.
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    start = time.perf_counter()
    ended = subprocess.run(
        command, cwd=folder, env=kept, capture_output=True, text=True, check=False
    )
    seconds = time.perf_counter() - start
    record = json.loads((folder / executor / "evidence.json").read_text())
    chosen = record["execution"]["executor"]
    if ended.returncode > 1 or chosen != {"auto": "processes"}.get(executor, executor):
        raise SystemExit(f"{executor}: {chosen}\n{ended.stdout}{ended.stderr}")
    return seconds, [f"{each['id']} {each['digest']}" for each in record["episodes"]]


def compare_sessions(options: argparse.Namespace) -> None:
    """Run pairs of sessions, and print the times and their ratio."""
    names = ("in-process", "auto")
    times: dict[str, list[float]] = {name: [] for name in names}
    with tempfile.TemporaryDirectory() as folder:
        for pair in range(options.sessions):
            digests = {}
            for name in names if pair % 2 == 0 else reversed(names):
                seconds, digests[name] = session(name, Path(folder), options)
                times[name].append(seconds)
            if digests["auto"] != digests["in-process"]:
                raise SystemExit("auto: other episodes")
    ratios = [alone / auto for alone, auto in zip(*times.values(), strict=True)]
    rows = [
        [f"{number}", *(f"{times[name][number - 1]:.2f}" for name in names), f"{ratio:.2f}"]
        for number, ratio in enumerate(ratios, 1)
    ]
    medians = [f"{median(times[name]):.2f}" for name in names]
    rows.append(["median", *medians, f"**{median(ratios):.2f}**"])
    print(table(["pair", "in-process, s", "auto, s", "times faster"], rows))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--select", default="*")
    parser.add_argument("--sessions", type=int, metavar="PAIRS")
    options = parser.parse_args()
    if options.sessions:
        print(f"Measured on: {machine()}\n")
        compare_sessions(options)
        return

    import distributed

    wanted = tasks(options.runs, options.select)
    print(f"Measured on: {machine()}\n")
    with (
        tempfile.TemporaryDirectory() as folder,
        distributed.LocalCluster(
            n_workers=WIDTH,
            threads_per_worker=1,
            processes=True,
            dashboard_address=None,
            local_directory=str(Path(folder)),
            silence_logs=logging.CRITICAL,
        ) as cluster,
    ):
        names = {
            "in-process": "in-process",
            f"processes:{WIDTH}": f"processes:{WIDTH}",
            f"dask, {WIDTH} workers": cluster.scheduler_address.replace("tcp", "dask"),
        }
        executions = {name: ExecutorChoice.parse(text).execution() for name, text in names.items()}
        try:
            compare(executions, wanted, options.repeats)
            time_starts(wanted[0], options.repeats)
        finally:
            for execution in executions.values():
                execution.close()


if __name__ == "__main__":
    main()
