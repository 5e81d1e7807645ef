"""How the time and the memory of a session grow, with episodes and with items.

Run: python benchmarks/growth.py [--episodes 10 100 1000 10000] [--items 10 100 1000 10000]
    [--repeats 3] [--plot benchmarks/growth.svg]

Whole sessions in processes of their own, from start to bundle, of a world of one number and ten
ticks. `episodes` is one campaign test of so many runs; `items` are so many tests that look at one
episode; `plain tests` are as many tests of pytest alone, without the plugin. Time is that of the
processor, of pytest and of all processes that it waited for; memory is the highest resident set
among them. Sessions of up to 100 are repeated, and the least counts.

A slope is that of the logarithm of what a session takes beyond a session of one, over the logarithm
of the number (least squares): 1 where twice as many take twice as much. What is below the least
share of the session of one is noise, and enters no slope.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from subprocess import Popen

import numpy as np
from evidence_memory import SCENARIO, TEST, WORLD
from machine import machine, table

from pytest_dura.evidence import open_record

ITEMS = """
import pytest

@pytest.mark.parametrize("number", range(%d))
@pytest.mark.dura(scenario="bench/noise", runs=1)
@pytest.mark.requirement("B-1", text="It stays near.", kind="safety")
def test_stays_near(episode, number):
    assert episode.robustness("always (x < 100)") > 0
"""
PLAIN = """
import pytest

@pytest.mark.parametrize("number", range(%d))
def test_nothing(number):
    assert number >= 0
"""
TESTS = {"episodes": TEST, "items": ITEMS, "plain tests": PLAIN}
QUICK = 100
"""Up to so many are repeated."""
LEAST = 0.1
"""A session that takes less than this beyond a session of one, as a share of that, shows noise."""


@dataclass(frozen=True)
class Cost:
    """What a session takes.

    Args:
        seconds: Of the processor.
        memory: The highest resident set of its processes, in MB.
    """

    seconds: float
    memory: float


def session(kind: str, number: int) -> Cost:
    """Run a session, and return its cost."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "scenarios").mkdir()
        (folder / "scenarios" / "noise.yaml").write_text(SCENARIO)
        (folder / "world.py").write_text(WORLD)
        (folder / "test_it.py").write_text(TESTS[kind] % number)
        (folder / "pytest.ini").write_text("[pytest]\npythonpath = .\n")
        command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_it.py"]
        command += ["-p", "no:dura"] if kind == "plain tests" else []
        with (
            (folder / "output").open("w") as output,
            Popen(command, cwd=folder, stdout=output) as process,
        ):
            # Of this process and of those it waited for, which subprocess does not report.
            _, status, usage = os.wait4(process.pid, 0)
            process.returncode = os.waitstatus_to_exitcode(status)
        record = folder / "dura-evidence" / "evidence.json"
        episodes = open_record(record).head.totals.episodes if record.exists() else 0
        text = (folder / "output").read_text()
        passed = int((re.search(r"(\d+) passed", text) or ["0", "0"])[1])
        # A single run is too few for the bound of the campaign.
        expected = (number, int(number > 1)) if kind == "episodes" else (kind == "items", number)
        if (episodes, passed) != expected:
            raise SystemExit(f"{number} {kind}: {episodes} episodes, {passed} passed\n{text}")
        return Cost(usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024)


def cost(kind: str, number: int, repeats: int) -> Cost:
    """The least that sessions of this number take."""
    times = repeats if number <= QUICK else 1
    costs = [session(kind, number) for _ in range(times)]
    return Cost(min(each.seconds for each in costs), min(each.memory for each in costs))


def slope(numbers: Sequence[int], costs: Sequence[float], fixed: float) -> float | None:
    """The slope of costs beyond a fixed one; ``None`` where fewer than two are beyond noise."""
    beyond = [
        (number - 1, each - fixed)
        for number, each in zip(numbers, costs, strict=True)
        if each - fixed > LEAST * fixed
    ]
    if len(beyond) < 2:
        return None
    x, y = np.log(np.array(beyond, float)).T
    return float(np.polyfit(x, y, 1)[0])


def drawn(path: Path, measured: dict[str, dict[int, Cost]]) -> None:
    """Write a plot of the costs over the numbers, both on logarithmic axes."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    # Equal figures give equal bytes, and texts stay texts.
    mpl.rcParams.update({"svg.hashsalt": "growth", "svg.fonttype": "none"})
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    for kind, costs in measured.items():
        seconds = [each.seconds for each in costs.values()]
        axes[0].loglog(list(costs), seconds, "o-", label=kind)
        axes[1].loglog(list(costs), [each.memory for each in costs.values()], "o-", label=kind)
    for ax, title in zip(axes, ("time of the processor, s", "peak memory, MB"), strict=True):
        ax.set(title=title, xlabel="episodes or items of a session")
        ax.grid(alpha=0.3)
        ax.legend()
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)


def main() -> None:
    """Measure, print and draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, nargs="*", default=[10, 100, 1000, 10000])
    parser.add_argument(
        "--items", type=int, nargs="*", default=[10, 100, 1000, 10000], help="and plain tests"
    )
    parser.add_argument("--kinds", nargs="+", choices=list(TESTS), default=list(TESTS))
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--plot", type=Path, help="an SVG file")
    options = parser.parse_args()
    print(machine(), "\n")
    measured: dict[str, dict[int, Cost]] = {}
    rows, slopes = [], []
    for kind in options.kinds:
        numbers = sorted({1, *(options.episodes if kind == "episodes" else options.items)})
        costs = measured[kind] = {each: cost(kind, each, options.repeats) for each in numbers}
        one = costs[1]
        for number, each in costs.items():
            more = "" if number == 1 else f"{1e3 * (each.seconds - one.seconds) / (number - 1):.2f}"
            figures = (str(number), f"{each.seconds:.2f}", more, f"{each.memory:.0f}")
            rows.append([kind, *figures])
        found = (
            slope(numbers, [each.seconds for each in costs.values()], one.seconds),
            slope(numbers, [each.memory for each in costs.values()], one.memory),
        )
        slopes.append([kind, *("no growth seen" if f is None else f"**{f:.2f}**" for f in found)])
    print(table(["of", "number", "time, s", "ms more for each", "peak memory, MB"], rows))
    print()
    print(table(["slope", "of time", "of memory"], slopes))
    if options.plot is not None:
        drawn(options.plot, measured)


if __name__ == "__main__":
    main()
