"""How a session's time grows: with workers, and with requirements on one campaign.

Run: python benchmarks/session_scale.py [--runs 150] [--requirement-runs 100] [--repeats 1]

Whole sessions of `pytest --dura-scenarios` in processes of their own, from start to bundle: the six
built-in scenarios with so many runs each, without fault-free twins, by `-n 0` and by `-n 2`; and
one scenario with one requirement and with its ten. Each pair runs in turns, and the quickest of
each counts.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path
from subprocess import DEVNULL, run

from machine import machine, table

from pytest_dura.evidence import open_record
from pytest_dura.library import load_library

COUNTED = "intersection/nominal"
TEN = "bench/ten"
CHECKS = (
    "always (gap > 0)",
    "always (gap >= 0.5)",
    "always (leader_gap < 50 implies following_margin >= 0)",
    "always (priority_arrival < 6.5 implies priority_braking <= 3)",
    "eventually (cleared >= 1)",
    "always (acceleration >= -8.5) and always (acceleration <= 4.5)",
    "always (jerk <= 45) and always (jerk >= -45)",
    "always (lateral_acceleration <= 3) and always (lateral_acceleration >= -3)",
    "eventually[0:35] (cleared >= 1)",
    "always (loop.recovering_for <= 10)",
)


def session(folder: Path, name: str, *arguments: str) -> tuple[float, int]:
    """Seconds of a session, and how many episodes it ran."""
    evidence = folder / name
    options = ("--dura-no-twins", "--dura-evidence", str(evidence))
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"]
    start = time.perf_counter()
    done = run([*command, *options, *arguments], cwd=folder, stdout=DEVNULL, check=False)
    seconds = time.perf_counter() - start
    record = open_record(evidence / "evidence.json")
    if record.head.status != "complete" or done.returncode not in (0, 1):
        raise SystemExit(f"the session {name} did not come to its end: exit {done.returncode}")
    return seconds, record.head.totals.episodes


def best(folder: Path, repeats: int, **sessions: tuple[str, ...]) -> dict[str, tuple[float, int]]:
    """The quickest of each session's repetitions, in turns."""
    found: dict[str, tuple[float, int]] = {}
    for _ in range(repeats):
        for name, arguments in sessions.items():
            seconds, episodes = session(folder, name, *arguments)
            found[name] = min(found.get(name, (seconds, episodes)), (seconds, episodes))
    return found


def scenario(folder: Path) -> None:
    """Writes a scenario with ten requirements, each on single runs."""
    head, _, _ = (
        Path(load_library([]).scenarios[COUNTED].file).read_text().partition("requirements:")
    )
    names = [f"R-{number}" for number in range(len(CHECKS))]
    (folder / "scenarios").mkdir()
    own = head.replace(f"name: {COUNTED}", f"name: {TEN}")
    own += f"requirements: [{', '.join(names)}]\n"
    (folder / "scenarios" / "ten.yaml").write_text(own)
    written = "".join(
        f"  - id: {name}\n    text: It holds.\n    kind: safety\n    check: {check}\n"
        for name, check in zip(names, CHECKS, strict=True)
    )
    (folder / "scenarios" / "requirements.yaml").write_text(f"requirements:\n{written}")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=150, help="per scenario, for the workers")
    parser.add_argument("--requirement-runs", type=int, default=100)
    parser.add_argument("--repeats", type=int, default=1)
    parser.add_argument("--select", default="intersection/*", help="scenarios for the workers")
    options = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    print(machine(), "\n")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        scenario(folder)
        selected = ("--dura-scenarios=builtin", "--dura-select", options.select)
        runs = (*selected, f"--dura-runs={options.runs}")
        found = best(folder, options.repeats, alone=(*runs, "-n0"), two=(*runs, "-n2"))
        (alone, episodes), (two, same) = found["alone"], found["two"]
        assert episodes == same > 0
        print(table(["session", "episodes", "seconds", "times faster"], [
            ["-n 0", str(episodes), f"{alone:.1f}", "1"],
            ["-n 2", str(episodes), f"{two:.1f}", f"**{alone / two:.2f}**"],
        ]))  # fmt: skip
        print()
        runs = (f"--dura-runs={options.requirement_runs}",)
        found = best(folder, options.repeats, one=(*runs, f"{TEN}::R-0"), ten=(*runs, TEN))
        (one, _), (several, episodes) = found["one"], found["ten"]
        print(table(["requirements on one campaign", "episodes", "seconds", "times"], [
            ["1", str(episodes), f"{one:.1f}", "1"],
            [str(len(CHECKS)), str(episodes), f"{several:.1f}", f"**{several / one:.2f}**"],
        ]))  # fmt: skip


if __name__ == "__main__":
    main()
