"""What it costs to have the plugin installed but unused.

Run: python benchmarks/plugin_cost.py [--pairs 30] [--kind NAME] [--list]

Time: on the clock and of the processor, of whole processes of `pytest` on one plain test, in pairs
of one without the plugin (`-p no:dura`) and one with it, in alternating order. The package is
installed as a wheel would be, into a folder of its own, in three kinds:

- cached: Python's bytecode and pytest's, as for everybody after the first run;
- read-only: Python's bytecode alone, as in a container whose packages belong to root;
- source: no bytecode of the package at all, as in its very first run.

The interval of the median is that of order statistics, of at least 95 %. Plugins of others that
come with the package are switched off on both sides. Weight: which modules the run imports with
the plugin alone.
"""

from __future__ import annotations

import argparse
import compileall
import math
import os
import re
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

from machine import machine, table

HEAVY = (
    "numpy", "highway_env", "rtamt", "pydantic", "gymnasium", "scipy", "yaml", "pandas",
    "jinja2", "jsonschema", "mcap", "sqlite3", "hypothesis",
)  # fmt: skip
KINDS = ("cached", "read-only", "source")
OTHERS = ("no:hypothesispytest", "no:allure_pytest", "no:xdist", "no:rerunfailures")
PACKAGE = Path(__file__).parents[1] / "pytest_dura"
_LINE = re.compile(r"import time:\s+(\d+) \|\s+(\d+) \| (\s*)(\S+)")


def install(folder: Path, kind: str) -> None:
    """Lay the package out as an installed wheel, with the bytecode of this kind."""
    own = folder / "pytest_dura"
    shutil.copytree(PACKAGE, own, ignore=shutil.ignore_patterns("__pycache__"))
    info = folder / "pytest_dura-0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: pytest-dura\nVersion: 0\n")
    (info / "entry_points.txt").write_text("[pytest11]\ndura = pytest_dura.plugin\n")
    files = sorted(path.relative_to(folder).as_posix() for path in own.rglob("*") if path.is_file())
    (info / "RECORD").write_text("".join(f"{file},,\n" for file in files))
    if kind != "source":
        compileall.compile_dir(own, quiet=2)


class Run(NamedTuple):
    """A run of pytest: milliseconds on the clock and of the processor, and its error stream."""

    clock: float
    processor: float
    errors: str


def run(folder: Path, kind: str, *arguments: str, python: tuple[str, ...] = ()) -> Run:
    """Run pytest on a plain test."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    kept |= {"PYTHONPATH": str(folder)}
    if kind != "cached":
        kept["PYTHONDONTWRITEBYTECODE"] = "1"
    others = [argument for name in OTHERS for argument in ("-p", name)]
    command = [
        sys.executable, *python, "-m", "pytest", "-q", "-p", "no:cacheprovider", *others, *arguments
    ]  # fmt: skip
    begin, spent = time.perf_counter(), processor_time()
    done = subprocess.run(
        command, cwd=folder / "project", env=kept, capture_output=True, text=True, check=False
    )
    elapsed = (time.perf_counter() - begin) * 1000
    if done.returncode != 0 or "1 passed" not in done.stdout:
        raise RuntimeError(done.stdout + done.stderr)
    return Run(elapsed, processor_time() - spent, done.stderr)


def processor_time() -> float:
    """Milliseconds that the processes of this one have taken so far."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return (usage.ru_utime + usage.ru_stime) * 1000


WITHOUT = ("-p", "no:dura")


def pairs_of(folder: Path, kind: str, pairs: int) -> list[tuple[Run, Run]]:
    """Run pytest so many times without the plugin and with it."""
    for warm in ((), WITHOUT):
        run(folder, kind, *warm)
    done = []
    for number in range(pairs):
        order = ((), WITHOUT) if number % 2 else (WITHOUT, ())
        runs = {arguments: run(folder, kind, *arguments) for arguments in order}
        done.append((runs[WITHOUT], runs[()]))
    return done


def cells(done: list[tuple[Run, Run]], name: str) -> list[str]:
    """Median without the plugin, and of what it adds with the interval of that."""
    plain = [getattr(without, name) for without, _ in done]
    added = [getattr(loaded, name) - getattr(without, name) for without, loaded in done]
    median = f"**{statistics.median(added):.1f}**"
    return [f"{statistics.median(plain):.0f}", f"{median} ({interval(added)})"]


def interval(values: list[float]) -> str:
    """Interval of the median by order statistics; empty where there are too few values."""
    n, ordered = len(values), sorted(values)
    outside, rank = 0.0, 0
    while outside + math.comb(n, rank) / 2**n <= 0.025:
        outside += math.comb(n, rank) / 2**n
        rank += 1
    return f"{ordered[rank - 1]:.1f} to {ordered[n - rank]:.1f}" if rank else ""


def imported(folder: Path, *arguments: str) -> set[str]:
    """The modules that a run imports."""
    text = run(folder, "cached", *arguments, python=("-X", "importtime")).errors
    return {match[4] for match in _LINE.finditer(text)}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pairs", type=int, default=30)
    parser.add_argument("--kind", choices=KINDS, action="append")
    parser.add_argument("--list", action="store_true", help="name the modules")
    options = parser.parse_args()
    rows = []
    print(machine(), "\n")
    for kind in options.kind or KINDS:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            install(folder, kind)
            (folder / "project").mkdir()
            (folder / "project" / "test_plain.py").write_text("def test_plain():\n    pass\n")
            done = pairs_of(folder, kind, options.pairs)
            rows.append([kind, *cells(done, "clock"), *cells(done, "processor")])
            extra = imported(folder) - imported(folder, *WITHOUT)
    headers = ["pytest without it, ms", "it adds, ms (interval)"]
    print(table(["unused plugin", *headers, "of the processor, ms", "it adds, ms"], rows))
    own = sorted(module for module in extra if module.startswith("pytest_dura"))
    if not own:
        raise RuntimeError("the plugin is not installed, or could not be switched off")
    heavy = sorted(extra & set(HEAVY))
    print(f"\nModules that only it imports: {len(extra)}, of them {len(own)} of its own;")
    print("of " + ", ".join(HEAVY) + ": " + (", ".join(heavy) or "none") + ".")
    if options.list:
        print(*sorted(extra), sep="\n")


if __name__ == "__main__":
    main()
