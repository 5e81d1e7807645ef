"""What an installation takes: seconds, distributions, megabytes, and the first command in it.

Run: python benchmarks/install.py [--wheel FILE] [--python PYTHON ...]
     python benchmarks/install.py --list

For each interpreter, in a new virtual environment that is thrown away: the wheel is installed
without pip's cache, and the built-in scenarios run in an empty folder. Without ``--wheel`` one is
built of this repository. Seconds depend on the network first of all.

With ``--list``, it prints the distributions of the environment that runs the script instead: those
that pytest-dura needs, what their files weigh, bytecode included, and which of our dependencies
ask for them.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
import time
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from machine import machine, table

REPOSITORY = Path(__file__).parents[1]
MEGABYTE = 1_000_000
_NAME = re.compile(r"[A-Za-z0-9._-]+")


def needed(name: str) -> list[str]:
    """Installed distributions that a distribution needs itself, without extras."""
    names = []
    for requirement in distribution(name).requires or []:
        match = _NAME.match(requirement)
        if match is None or re.search(r";.*\bextra\s*==", requirement):
            continue
        try:
            names.append(distribution(match[0]).name)
        except PackageNotFoundError:
            continue  # for another Python or system
    return names


def asked_for_by() -> dict[str, set[str]]:
    """Distributions that pytest-dura needs, each with the direct dependencies that lead there."""
    reached: dict[str, set[str]] = {}
    for direct in needed("pytest-dura"):
        waiting, seen = [direct], set[str]()
        while waiting:
            name = waiting.pop()
            if name not in seen:
                seen.add(name)
                reached.setdefault(name, set()).add(direct)
                waiting += needed(name)
    return reached


def megabytes(name: str) -> float:
    """Size of the files of a distribution, bytecode included."""
    files = (file.locate() for file in distribution(name).files or [])
    return sum(Path(str(file)).stat().st_size for file in files if Path(str(file)).is_file()) / (
        MEGABYTE
    )


def show_distributions() -> None:
    """Print the distributions, heaviest first; those below 3 MB share a line."""
    weights = {name: megabytes(name) for name in asked_for_by()}
    weights["pytest-dura"] = megabytes("pytest-dura")
    reached = asked_for_by()
    heavy = sorted(
        (name for name in weights if weights[name] >= 3), key=lambda name: -weights[name]
    )
    rows = [
        [name, f"{weights[name]:.0f}", ", ".join(sorted(reached.get(name, ()))) or "itself"]
        for name in heavy
    ]
    rest = [name for name in weights if name not in heavy]
    rows.append([f"{len(rest)} others", f"{sum(weights[name] for name in rest):.0f}", ""])
    rows.append([f"all {len(weights)}", f"{sum(weights.values()):.0f}", ""])
    print(table(["distribution", "MB", "asked for by"], rows))


def built(folder: Path) -> Path:
    """Build a wheel of this repository."""
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir"]
    subprocess.run([*command, str(folder), str(REPOSITORY)], check=True)
    (wheel,) = folder.glob("*.whl")
    return wheel


def installed(interpreter: str, wheel: Path, folder: Path) -> list[str]:
    """Install the wheel for an interpreter, run the built-in scenarios: a row of the table."""
    subprocess.run([interpreter, "-m", "venv", str(folder / "venv")], check=True)
    scripts = "Scripts" if (folder / "venv" / "Scripts").is_dir() else "bin"
    python = str(folder / "venv" / scripts / "python")

    start = time.perf_counter()
    quiet = ["--quiet", "--no-cache-dir", "--disable-pip-version-check"]
    subprocess.run([python, "-m", "pip", "install", *quiet, str(wheel)], check=True)
    seconds = time.perf_counter() - start

    command = [python, "-c", "import platform; print(platform.python_version())"]
    version = subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()
    environment = [path for path in (folder / "venv").rglob("*") if not path.is_symlink()]
    weight = sum(path.stat().st_size for path in environment if path.is_file()) / MEGABYTE
    count = sum(path.name.endswith(".dist-info") for path in environment) - 1  # without pip

    (folder / "empty").mkdir()
    command = [python, "-m", "pytest", "--dura-scenarios"]
    start = time.perf_counter()
    run = subprocess.run(command, cwd=folder / "empty", capture_output=True, text=True, check=False)
    spent = time.perf_counter() - start
    gate = re.search(r"^gate: .*", run.stdout, re.MULTILINE)
    outcome = gate[0] if gate else f"exit code {run.returncode}, no gate"
    return [version, f"{seconds:.0f}", str(count), f"{weight:.0f}", f"{spent:.0f}", outcome]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--wheel", type=Path)
    parser.add_argument("--python", nargs="+", default=[sys.executable])
    parser.add_argument("--list", action="store_true")
    options = parser.parse_args()

    if options.list:
        print(machine(), end="\n\n")
        show_distributions()
        return
    with tempfile.TemporaryDirectory() as folder:
        wheel = options.wheel or built(Path(folder))
        rows = []
        for interpreter in options.python:
            with tempfile.TemporaryDirectory() as own:
                rows.append(installed(interpreter, wheel.resolve(), Path(own)))
    headers = ["Python", "install, s", "distributions", "MB", "first command, s", "its gate"]
    print(table(headers, rows))


if __name__ == "__main__":
    main()
