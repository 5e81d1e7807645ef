"""Speed and memory of a recorded log: ``python benchmarks/recorded_logs.py [MINUTES]``.

A log of 20 signals at 100 Hz, with jitter, in CSV and, where pyarrow is installed, in Parquet. Each
is read, resampled and judged by three formulas in a process of its own; beside it the same table is
read by pandas, where it is installed, and judged by rtamt.
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

FORMULAS = (
    "always (s0 > -9)",
    "always (s1 > 2 implies eventually[0:2] (s1 < 2))",
    "always (s2 - s3 < 12)",
)
SIGNALS, RATE = 20, 100


def written(folder: Path, minutes: float) -> list[Path]:
    """Write the log in each format that can be written here."""
    count = round(minutes * 60 * RATE)
    random = np.random.default_rng(0)
    stamps = np.arange(count) * 10**7 + random.integers(0, 10**6, count) + 1_764_288_000 * 10**9
    seconds = np.arange(count) / RATE
    columns = {f"s{i}": 3 * np.sin(seconds / (1 + i) + i) for i in range(SIGNALS)}
    files = [folder / "log.csv"]
    with files[0].open("w") as stream:
        stream.write(",".join(["timestamp", *columns]) + "\n")
        for stamp, *row in zip(
            stamps.tolist(), *(c.tolist() for c in columns.values()), strict=True
        ):
            stream.write(f"{stamp}," + ",".join(f"{value:.6f}" for value in row) + "\n")
    if importlib.util.find_spec("pyarrow") is not None:
        import pyarrow as pa
        from pyarrow import parquet

        files.append(folder / "log.parquet")
        parquet.write_table(pa.table({"timestamp": stamps, **columns}), files[-1])
    return files


def ours(file: str) -> dict[str, float]:
    """Read, resample and judge a log."""
    from pytest_dura import read_log

    start = time.perf_counter()
    log = read_log(file, {"time_step": 0.01})
    read = time.perf_counter() - start
    for formula in FORMULAS:
        log.robustness(formula)
    return {"read": read, "all": time.perf_counter() - start}


def theirs(file: str) -> dict[str, float]:
    """Read the same table by pandas, and judge it by rtamt."""
    import pandas as pd
    import rtamt

    start = time.perf_counter()
    table = pd.read_csv(file) if file.endswith(".csv") else pd.read_parquet(file)
    read = time.perf_counter() - start
    for formula in FORMULAS:
        names = sorted(
            {part for part in table.columns if part in formula.replace("(", " ").split()}
        )
        spec = rtamt.StlDiscreteTimeSpecification()
        for name in names:
            spec.declare_var(name, "float")
        spec.set_sampling_period(10, "ms", 0.1)
        spec.spec = formula
        spec.parse()
        count = len(table)
        spec.evaluate(
            {"time": list(range(count)), **{name: table[name].tolist() for name in names}}
        )
    return {"read": read, "all": time.perf_counter() - start}


def main() -> None:
    if len(sys.argv) > 2:  # in a process of its own
        measured = {"ours": ours, "theirs": theirs}[sys.argv[1]](sys.argv[2])
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(json.dumps(measured | {"MB": peak}))
        return
    minutes = float(sys.argv[1]) if sys.argv[1:] else 10.0
    with tempfile.TemporaryDirectory() as folder:
        for file in written(Path(folder), minutes):
            size = file.stat().st_size / 2**20
            print(f"{file.name}: {minutes:g} min, {SIGNALS} signals at {RATE} Hz, {size:.1f} MB")
            for who in ("ours", "theirs"):
                if who == "theirs" and importlib.util.find_spec("pandas") is None:
                    continue
                done = subprocess.run(
                    [sys.executable, __file__, who, str(file)],
                    check=True, capture_output=True, text=True,
                )  # fmt: skip
                got = json.loads(done.stdout.splitlines()[-1])
                faster = minutes * 60 / got["all"]
                print(
                    f"  {who:<6} read {got['read']:.2f} s, with verdicts {got['all']:.2f} s, "
                    f"{faster:.0f} times real time, peak {got['MB']:.0f} MB"
                )


if __name__ == "__main__":
    main()
