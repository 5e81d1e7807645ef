"""What it costs to have the plugin installed but unused.

Run: python benchmarks/plugin_cost.py [--repeats 15]

Time: `python -X importtime -c "import pytest, pytest_dura.plugin"`, the cumulative time of the
plugin's module, which is what loading it adds to a pytest run; bytecode is cached, as it is for
everybody after the first run. Weight: which modules `pytest --collect-only` in an empty directory
imports with the plugin and not with `-p no:dura`.
"""

from __future__ import annotations

import argparse
import os
import re
import statistics
import subprocess
import sys
import tempfile

from machine import machine, table

HEAVY = (
    "numpy", "highway_env", "rtamt", "pydantic", "gymnasium", "scipy", "yaml", "pandas",
    "jinja2", "jsonschema", "mcap", "sqlite3",
)  # fmt: skip
NO_TESTS = 5
"""pytest's exit code where nothing was collected."""
_LINE = re.compile(r"import time:\s+(\d+) \|\s+(\d+) \| (\s*)(\S+)")


def run(arguments: list[str]) -> str:
    """What `python -X importtime` says of a run in an empty directory."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    with tempfile.TemporaryDirectory() as empty:
        done = subprocess.run(
            [sys.executable, "-X", "importtime", *arguments],
            cwd=empty, env=kept, capture_output=True, text=True, check=False,
        )  # fmt: skip
    if done.returncode not in (0, NO_TESTS):
        raise RuntimeError(done.stderr)
    return done.stderr


def imported(arguments: list[str]) -> set[str]:
    """The modules that a pytest run imports."""
    return {m[4] for m in _LINE.finditer(run(["-m", "pytest", "--collect-only", *arguments]))}


def loading_time() -> float:
    """Milliseconds to import the plugin after pytest."""
    output = run(["-c", "import pytest, pytest_dura.plugin"])
    (match,) = (m for m in _LINE.finditer(output) if m[4] == "pytest_dura.plugin")
    return int(match[2]) / 1000


def main() -> None:
    """Measure and print."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--repeats", type=int, default=15)
    repeats = options.parse_args().repeats
    loading_time()  # fills the bytecode cache
    times = [loading_time() for _ in range(repeats)]
    # Another plugin may import NumPy itself; what counts is what this one adds.
    others = ["-p", "no:hypothesispytest", "-p", "no:allure_pytest"]
    extra = imported(others) - imported([*others, "-p", "no:dura"])
    if not any(name.startswith("pytest_dura.") for name in extra):
        raise RuntimeError("the plugin is not installed, or could not be switched off")
    heavy = sorted(extra & set(HEAVY))
    print(machine(), "\n")
    print(table(["cost of the unused plugin", f"median of {repeats}"], [
        ["loading it, ms", f"**{statistics.median(times):.1f}**"],
        ["modules that only it imports", str(len(extra))],
        ["of " + ", ".join(HEAVY), ", ".join(heavy) or "none"],
    ]))  # fmt: skip


if __name__ == "__main__":
    main()
