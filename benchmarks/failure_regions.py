"""Where failures lie: a cart pole whose sensor sticks or is biased, and `tactical` under spoofing.

Run: python benchmarks/failure_regions.py [--budget 300] [--only "cart pole"] [--keep FOLDER]

Each search is a test of a session of its own, which goes on to the end of its budget. The table is
that of the session; with ``--keep`` its bundle stays, whose page has the map of each region.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

from machine import machine, table

SUITES = Path(__file__).parents[1] / "example_suites"


class Subject(NamedTuple):
    """What is searched.

    Args:
        suite: Folder of the example suite; empty for the built-in scenarios.
        scenario: Its scenario.
        requirement: Id of what is to be violated.
        faults: What may be added.
        options: Further options of the session.
    """

    suite: str
    scenario: str
    requirement: str
    faults: tuple[str | Mapping[str, Any], ...]
    options: tuple[str, ...] = ()


SUBJECTS = {
    "cart pole": Subject(
        "cartpole",
        "cartpole/balance",
        "POLE-1",
        ({"type": "bias", "target": "pole.angle"}, {"type": "freeze", "target": "pole"}),
    ),
    "tactical under spoofing": Subject(
        "",
        "intersection/trajectory-spoofing",
        "SAF-2",
        ("trajectory-spoof", "object-miss", "freeze"),
        ("--dura-generator=tactical",),
    ),
}
TEST = """
import pytest

@pytest.mark.dura(scenario={scenario!r})
@pytest.mark.requirement({requirement!r})
def test_where(campaign):
    campaign.falsify(budget={budget}, faults={faults!r}, region_runs={runs}, all=True)
"""


def searched(subject: Subject, folder: Path, budget: int, runs: int) -> dict[str, Any]:
    """Run the session of a subject, and return its record.

    Raises:
        SystemExit: If the session wrote none.
    """
    if subject.suite:
        shutil.copytree(SUITES / subject.suite, folder, dirs_exist_ok=True)
    folder.mkdir(parents=True, exist_ok=True)
    for each in folder.glob("test_*.py"):
        each.unlink()
    given = subject._asdict() | {"faults": list(subject.faults)}
    (folder / "pytest.ini").touch()
    (folder / "test_where.py").write_text(TEST.format(**given, budget=budget, runs=runs), "utf-8")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *subject.options]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    record = folder / "dura-evidence" / "evidence.json"
    if not record.is_file():
        raise SystemExit(done.stdout + done.stderr)
    read: dict[str, Any] = json.loads(record.read_text("utf-8"))
    return read


def main() -> None:
    """Print the regions of each subject."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--budget", type=int, default=300)
    parser.add_argument("--runs", type=int, default=50, help="further runs of each region")
    parser.add_argument("--only", nargs="+", choices=SUBJECTS, default=[*SUBJECTS])
    parser.add_argument("--keep", type=Path)
    options = parser.parse_args()
    print(f"{machine()}\n")
    for name in options.only:
        with tempfile.TemporaryDirectory() as scratch:
            folder = (options.keep or Path(scratch)) / name.replace(" ", "-")
            start = perf_counter()
            record = searched(SUBJECTS[name], folder, options.budget, options.runs)
            print(f"{name}: {options.budget} simulations, {perf_counter() - start:.0f} s\n")
            found = record["conclusions"].get("failure_regions", {"columns": [], "rows": []})
            heads = [column["name"] for column in found["columns"]] or ["no violation"]
            rows = [[str(cell or "-") for cell in row] for row in found["rows"]]
            print(table(heads, rows) + "\n")


if __name__ == "__main__":
    main()
