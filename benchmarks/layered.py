"""How quickly a session begins where its packages lie in another environment.

Run: python benchmarks/layered.py [--pairs 10]

The same session of a component that imports NumPy and highway-env, 2 runs of ten ticks in pytest's
own process, as whole processes: with the interpreter that runs the script, and in two environments
made by `python -m venv` that hold nothing themselves:

- `.pth`: a file in its `site-packages` names those of that interpreter;
- `--system-site-packages`: those of that interpreter are the user's, which such an environment
  sees.

Each is run in pairs with the plain one, in alternating order; time is on the clock and of the
processor. The interval of the median is that of order statistics, of at least 95 %.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import sysconfig
import tempfile
import time
from pathlib import Path

from machine import machine, table
from plugin_cost import Run, cells, processor_time

REPOSITORY = Path(__file__).parents[1]
PROJECT = {
    "pytest.ini": "[pytest]\npythonpath = .\n",
    "plant.py": """import highway_env
import numpy as np

from pytest_dura import BlackBox


def run(time, inputs):
    return {"x": np.zeros(len(time))}


PLANT = BlackBox(run, inputs=[], signals=["x"])
""",
    "scenarios/plant.yaml": "name: plant/run\nsimulator: plant:PLANT\nduration: 1\ntime_step: 0.1\n"
    "runs: 2\nrequirements: []\n",
    "test_plant.py": """import pytest


@pytest.mark.dura(scenario="plant/run", runs=2)
@pytest.mark.requirement("P-1", text="x stays low", kind="safety")
def test_low(campaign):
    campaign.require("always (x < 0.5)")
""",
}


def environments(folder: Path) -> dict[str, tuple[Path, dict[str, str]]]:
    """Interpreter and environment variables of each; the plain one is the first."""
    packages = Path(sysconfig.get_path("purelib"))
    own = sysconfig.get_path("purelib", vars={"base": ""}).lstrip(os.sep)
    made = {"plain": (Path(sys.executable), {})}
    for name, options in ((".pth", []), ("--system-site-packages", ["--system-site-packages"])):
        home = folder / name.strip(".-")
        subprocess.run([sys.executable, "-m", "venv", "--without-pip", *options, home], check=True)
        python = home / Path(sys.executable).relative_to(sys.prefix)
        made[name] = (python, {"PYTHONUSERBASE": str(folder / "user")})
    # The package is named apart, since `.pth` files of the other folder are not read.
    (folder / "pth" / own / "other.pth").write_text(f"{packages}\n{REPOSITORY}\n")
    (folder / "user" / own).parent.mkdir(parents=True)
    (folder / "user" / own).symlink_to(packages)
    return made


def run(python: Path, variables: dict[str, str], project: Path) -> Run:
    """Run the session once."""
    kept = {name: text for name, text in os.environ.items() if not name.startswith("PYTHON")}
    command = [python, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--dura-executor=in-process"]
    begin, spent = time.perf_counter(), processor_time()
    done = subprocess.run(
        command, cwd=project, env=kept | variables, capture_output=True, text=True, check=False
    )
    elapsed = (time.perf_counter() - begin) * 1000
    if done.returncode != 0 or "1 passed" not in done.stdout:
        raise RuntimeError(done.stdout + done.stderr)
    return Run(elapsed, processor_time() - spent, done.stderr)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pairs", type=int, default=10)
    options = parser.parse_args()
    print(machine(), "\n")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        project = folder / "project"
        for file, text in PROJECT.items():
            (project / file).parent.mkdir(parents=True, exist_ok=True)
            (project / file).write_text(text)
        plain, *layered = environments(folder).items()
        rows = []
        for environment in layered:
            pairs = []
            for number in range(options.pairs):
                order = (plain, environment) if number % 2 else (environment, plain)
                runs = {kind: run(*where, project) for kind, where in order}
                pairs.append((runs[plain[0]], runs[environment[0]]))
            rows.append([environment[0], *cells(pairs, "clock"), *cells(pairs, "processor")])
    headers = ["environment", "plain, ms", "it adds, ms (interval)"]
    print(table([*headers, "of the processor, ms", "it adds, ms"], rows))


if __name__ == "__main__":
    main()
