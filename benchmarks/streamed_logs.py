"""A large log judged block by block: ``python benchmarks/streamed_logs.py [MB] [SHARE]``.

A table of 20 signals at 100 Hz, by default of 2048 MB, is written into a temporary directory, and
judged by ``pytest_dura logs judge``'s function in a process of its own, by one formula for each
signal. Beside it pandas and rtamt do the same work, on the first SHARE of the log (default: 0.02),
since both need the whole of what they judge in memory.
"""

from __future__ import annotations

import importlib.util
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

SIGNALS, RATE = 20, 100
CHECKS = {
    **{f"s{i}": f"always (s{i} > -9)" for i in range(12)},
    **{f"s{i}": f"always (once[0:1] (s{i} < 9))" for i in range(12, 16)},
    **{f"s{i}": f"always (s{i} > 2 implies eventually[0:1] (s{i} < 4))" for i in range(16, 20)},
}
_PERIOD = 20_000
"""Lines after which the values, but not the stamps, begin again."""
_START = 1_764_288_000 * 10**9


def written(file: Path, megabytes: float, share: float) -> tuple[int, int]:
    """Write the log and, beside it, a share of it; returns the lines of both."""
    seconds = np.arange(_PERIOD) / RATE
    columns = [3 * np.sin(seconds / (1 + i) + i) for i in range(SIGNALS)]
    bodies = [
        "".join(f",{value:.6f}" for value in row) + "\n" for row in zip(*columns, strict=True)
    ]
    jitter = np.random.default_rng(0).integers(0, 10**6, _PERIOD).tolist()
    header = ",".join(["timestamp", *(f"s{i}" for i in range(SIGNALS))]) + "\n"
    lines, size, part, part_lines = 0, 0, False, 0
    with file.open("w") as stream, file.with_suffix(".part.csv").open("w") as beside:
        stream.write(header)
        beside.write(header)
        while size < megabytes * 2**20:
            text = "".join(
                [f"{_START + (lines + i) * 10**7 + jitter[i]}{bodies[i]}" for i in range(_PERIOD)]
            )
            stream.write(text)
            if not part:
                beside.write(text)
                part_lines += _PERIOD
            size += len(text)
            lines += _PERIOD
            part = size >= share * megabytes * 2**20
    return lines, part_lines


def ours(file: str) -> None:
    """Judge the log block by block."""
    from pytest_dura.logs.judging import judge_log

    found, _ = judge_log(file, {"time_step": 1 / RATE}, CHECKS)
    assert {each.status for each in found.values()} == {"satisfied"}


def theirs(file: str) -> None:
    """Read the table by pandas, and judge it by rtamt."""
    import pandas as pd
    import rtamt

    table = pd.read_csv(file)
    count = list(range(len(table)))
    for name, check in CHECKS.items():
        spec = rtamt.StlDiscreteTimeSpecification()
        spec.declare_var(name, "float")
        spec.set_sampling_period(10, "ms", 0.1)
        spec.spec = check
        spec.parse()
        spec.evaluate({"time": count, name: table[name].tolist()})


def main() -> None:
    if len(sys.argv) > 2 and sys.argv[1] in ("ours", "theirs"):  # in a process of its own
        start = time.perf_counter()
        {"ours": ours, "theirs": theirs}[sys.argv[1]](sys.argv[2])
        took = time.perf_counter() - start
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(json.dumps({"took": took, "MB": peak}))
        return
    megabytes = float(sys.argv[1]) if sys.argv[1:] else 2048.0
    share = float(sys.argv[2]) if sys.argv[2:] else 0.02
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "log.csv"
        lines, part_lines = written(file, megabytes, share)
        for who, name, count in (
            ("ours", file, lines),
            ("theirs", file.with_suffix(".part.csv"), part_lines),
        ):
            if who == "theirs" and None in map(importlib.util.find_spec, ("pandas", "rtamt")):
                continue
            done = subprocess.run(
                [sys.executable, __file__, who, str(name)],
                check=True, capture_output=True, text=True,
            )  # fmt: skip
            got = json.loads(done.stdout.splitlines()[-1])
            recorded = count / RATE
            tool = "block by block" if who == "ours" else "pandas and rtamt"
            print(
                f"{tool}: {name.stat().st_size / 2**20:.0f} MB, {recorded / 3600:.2f} h of "
                f"{SIGNALS} signals at {RATE} Hz, {len(CHECKS)} formulas: {got['took']:.1f} s, "
                f"{recorded / got['took']:.0f} times real time, peak {got['MB']:.0f} MB\n"
            )


if __name__ == "__main__":
    main()
