"""How much memory a session takes that runs a great many episodes.

Run: python benchmarks/evidence_memory.py [--episodes 1000 5000 10000]

One campaign test of so many episodes each, in a session of its own: a world of one number, ten
ticks long, so that the memory is that of the loop, the store and the evidence, not of a simulator.
The peak is that of the whole pytest process, from its import to the last file of the bundle.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path
from subprocess import DEVNULL, Popen

from machine import machine, table

from pytest_dura.evidence import open_record

WORLD = """
import numpy as np

from pytest_dura import Generator, Proposal, Simulator, Tick, stream


class World(Simulator):
    def reset(self, scenario, seed):
        self.x, self.index, self.noise = 0.0, 0, stream(seed, "noise")
        return self.now()

    def step(self, action):
        self.index += 1
        self.x += action + float(self.noise.normal())
        return self.now()

    def now(self):
        truth = {"x": self.x}
        return Tick(self.index, self.index * self.time_step, truth, {"x": self.x})

    def signals(self, ticks):
        return {"x": np.array([tick.truth["x"] for tick in ticks])}

    def fallback_action(self):
        return 0.0


class Still(Generator):
    def propose(self, view):
        return Proposal(0.0)
"""
SCENARIO = """
name: bench/noise
simulator: world:World
duration: 1.0
world: {}
roles: {generator: "world:Still", safety_monitor: null, security_assessor: null,
        performance_oracle: null, fault_injector: null, recovery_planner: null}
"""
TEST = """
import pytest

@pytest.mark.dura(scenario="bench/noise", runs=%d)
@pytest.mark.requirement("B-1", text="It stays near.", kind="safety")
def test_stays_near(campaign):
    campaign.require("always (x < 8)", at_most=0.5)
"""


def measured(episodes: int) -> tuple[float, float, float]:
    """Peak memory in MB, seconds, and the size of the bundle in MB."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "scenarios").mkdir()
        (folder / "scenarios" / "noise.yaml").write_text(SCENARIO)
        (folder / "world.py").write_text(WORLD)
        (folder / "test_it.py").write_text(TEST % episodes)
        (folder / "pytest.ini").write_text("[pytest]\npythonpath = .\n")
        begun = time.perf_counter()
        command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_it.py"]
        with Popen(command, cwd=folder, stdout=DEVNULL) as process:
            # Of this process alone, which subprocess itself does not tell.
            _, status, usage = os.wait4(process.pid, 0)
            process.returncode = os.waitstatus_to_exitcode(status)
        seconds = time.perf_counter() - begun
        bundle = folder / "dura-evidence"
        record = open_record(bundle / "evidence.json")
        if process.returncode or sum(1 for _ in record.episodes()) != episodes:
            raise RuntimeError(f"pytest returned {process.returncode}")
        size = sum(file.stat().st_size for file in bundle.rglob("*") if file.is_file())
        return usage.ru_maxrss / 1024, seconds, size / 1e6


def main() -> None:
    """Measure and print."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--episodes", type=int, nargs="+", default=[1000, 5000, 10000])
    counts = options.parse_args().episodes
    found = [measured(count) for count in counts]
    print(machine(), "\n")
    rows = []
    for i, (count, (memory, seconds, size)) in enumerate(zip(counts, found, strict=True)):
        growth = "-"
        if i and count > counts[0]:
            growth = f"{1000 * (memory - found[0][0]) / (count - counts[0]):.1f}"
        rows.append([str(count), f"{memory:.0f}", growth, f"{seconds:.0f}", f"{size:.1f}"])
    headers = ["episodes", "peak memory, MB", "MB more per 1000", "session, s", "bundle, MB"]
    print(table(headers, rows))


if __name__ == "__main__":
    main()
