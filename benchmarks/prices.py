"""What a feature costs: adds it to a copy of the package, uses it, and prints the change.

Run: python benchmarks/prices.py

Each feature is one file of ``benchmarks/prices/``, which is put into a copy of the package; no
other file of the copy changes. Two shards of a session are run with all of them, verified and
merged. The table says whether a feature's figures are in the terminal, in the page and in the
merged bundle, and whether ``verify`` finds one that was changed. A second table is of patches, each
of one file of the package: of a column of a table and of an entry of a card, in each format. A
third one is of a report format, which a project registers by a file of its own.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from machine import table

ROOT = Path(__file__).resolve().parents[1]
FEATURES = Path(__file__).with_name("prices")
SESSION = ("-m", "pytest", "--dura-scenarios", "--dura-select=intersection/[np]*",
           "--dura-runs=2", "-p", "no:cacheprovider", "-v")  # fmt: skip
RED_SESSION = ("-m", "pytest", "--dura-scenarios", "--dura-select=intersection/congested",
               "--dura-runs=2", "-p", "no:cacheprovider", "-v",
               "--dura-generator=tactical")  # fmt: skip
"""A session with a card that names an episode."""


@dataclass(frozen=True)
class Price:
    """A feature.

    Args:
        feature: What it is.
        file: Its file in ``prices/``.
        folder: Where it goes.
        heading: Its heading in the terminal and the page.
        figure: Returns the object that holds its first figure in a record, and the key.
    """

    feature: str
    file: str
    folder: str
    heading: str

    @property
    def is_plot(self) -> bool:
        """Whether it draws a plot."""
        return self.folder == "reports/plots"

    def figure(self, record: dict[str, Any]) -> tuple[Any, Any]:
        """The object that holds a figure of it in a record, and the key there."""
        if self.file == "near_misses.py":
            return record["conclusions"]["near_misses"]["rows"][0], 2
        if self.file == "simulated_time.py":  # it draws what each record has
            return record["episodes"][0]["timings"], "simulated_seconds"
        return record["episodes"][0]["outcome"]["measures"], "hardest_braking"


PRICES = (
    Price("figure of an episode", "hardest_braking.py", "driving/measures", "braking"),
    Price("table of the session", "near_misses.py", "evidence/conclusions", "Near misses"),
    Price("plot", "simulated_time.py", "reports/plots", "Simulated time by case"),
)
FORMAT = "verdicts_csv.py"
"""Of a file of the bundle, beside the project's tests."""


PATCHES = (
    ("column of a table", "ended_early.patch", ("early", "ended early", "ended early")),
    ("entry of a card", "seed_of_a_card.patch", ("its seed", "its seed", "its seed")),
)
"""Feature, its patch, and its headings in the terminal, the summary and the page."""


def run(package: Path, *command: str) -> str:
    """Run a command of Python with the copy of the package."""
    environment = {**os.environ, "PYTHONPATH": str(package), "COLUMNS": "120"}
    done = subprocess.run(
        [sys.executable, *command],
        cwd=package,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    return done.stdout + done.stderr


def copy_to(package: Path) -> None:
    """Copy the package, compiled as it is, and its scenarios."""
    shutil.copytree(ROOT / "pytest_dura", package / "pytest_dura")
    shutil.copytree(ROOT / "scenarios", package / "scenarios")


def patched() -> list[list[str]]:
    """The rows of the table of patches: where each shows, of one session with all of them."""
    with tempfile.TemporaryDirectory() as folder:
        package = Path(folder)
        copy_to(package)
        for _, file, _ in PATCHES:
            subprocess.run(["git", "apply", FEATURES / file], cwd=package, check=True)
        shown = run(package, *RED_SESSION)
        files = [package / "dura-evidence" / name for name in ("summary.md", "report.html")]
        texts = [shown, *(each.read_text("utf-8") for each in files)]
    return [_patch_row(feature, file, headings, texts) for feature, file, headings in PATCHES]


def _patch_row(
    feature: str, file: str, headings: tuple[str, str, str], texts: list[str]
) -> list[str]:
    text = (FEATURES / file).read_text("utf-8")
    edited = re.findall(r"^\+\+\+ b/(\S+)", text, re.MULTILINE)
    added = len(re.findall(r"^\+(?!\+\+)", text, re.MULTILINE))
    found = [own.lower() in each.lower() for own, each in zip(headings, texts, strict=True)]
    places = ["yes" if each else "no" for each in found]
    return [feature, ", ".join(f"`{name}`" for name in edited), str(added), *places]


def measured() -> list[list[str]]:
    """The rows of the table of features: what each file brings, of two shards with all of them."""
    with tempfile.TemporaryDirectory() as folder:
        package = Path(folder)
        copy_to(package)
        for price in PRICES:
            shutil.copy(FEATURES / price.file, package / "pytest_dura" / price.folder)
        parts = [package / f"part-{number}" for number in (1, 2)]
        shown = [
            run(package, *SESSION, f"--dura-shard={number}/2", f"--dura-evidence={part}")
            for number, part in enumerate(parts, 1)
        ]
        intact = all(
            is_intact(run(package, "-m", "pytest_dura", "verify", str(part))) for part in parts
        )
        whole = package / "whole"
        run(package, "-m", "pytest_dura", "merge", *map(str, parts), "--output", str(whole))
        whole_is_intact = is_intact(run(package, "-m", "pytest_dura", "verify", str(whole)))
        page = (whole / "report.html").read_text("utf-8")
        rows = []
        for price in PRICES:
            text = (whole / "evidence.json").read_text("utf-8")
            found, value = _is_found(price, package, whole)
            (whole / "evidence.json").write_text(text, encoding="utf-8")
            heading = f'id="simulated-time-title">{price.heading}<' if price.is_plot else ""
            places = [
                any(price.heading in each for each in shown),
                price.heading.lower() in page.lower() and heading in page,
                intact and found,
                whole_is_intact and value is not None,
            ]
            file = FEATURES / price.file
            lines = str(len(file.read_text("utf-8").splitlines()))
            path = f"`pytest_dura/{price.folder}/{price.file}`"
            rows.append([price.feature, path, lines, *("yes" if each else "no" for each in places)])
    return rows


def _is_found(price: Price, package: Path, whole: Path) -> tuple[bool, Any]:
    """Whether ``verify`` finds a changed figure of the feature; and that figure before."""
    file = whole / "evidence.json"
    record = json.loads(file.read_text("utf-8"))
    place, key = price.figure(record)
    before = place[key]
    place[key] += 1
    file.write_text(json.dumps(record), encoding="utf-8")
    forged = run(package, "-m", "pytest_dura", "verify", str(whole))
    own = r"evidence.json: /|its hardest_braking is|report.html: not as"
    return bool(re.search(own, forged)), before


def registered() -> list[str]:
    """The row of the report format: whether a session writes, lists and checks its file."""
    with tempfile.TemporaryDirectory() as folder:
        package = Path(folder)
        copy_to(package)
        shutil.copy(FEATURES / FORMAT, package)
        loaded = ("-p", Path(FORMAT).stem)
        shown = run(package, *SESSION, *loaded)
        verify = ("-m", "pytest_dura", *loaded, "verify", str(package / "dura-evidence"))
        listed = "verdicts.csv" in run(package, "-m", "pytest", "--dura-list", *loaded)
        bundle = package / "dura-evidence"
        manifest = json.loads((bundle / "manifest.json").read_text("utf-8"))
        written = "verdicts.csv" in manifest["files"] and "evidence: " in shown
        intact = is_intact(run(package, *verify))
        file = bundle / "verdicts.csv"
        file.write_text(file.read_text("utf-8").replace("intersection/", "another/"), "utf-8")
        changed = run(package, *verify)
        found = intact and "verdicts.csv: not as it is rendered" in changed
    lines = str(len((FEATURES / FORMAT).read_text("utf-8").splitlines()))
    places = ["yes" if each else "no" for each in (written, listed, found)]
    return ["report format", f"`{FORMAT}`", lines, *places]


def is_intact(output: str) -> bool:
    """Whether ``verify`` found a bundle intact."""
    return output.rstrip().endswith("\nintact")


def main() -> None:
    """Print the tables, and each file."""
    headers = [
        "feature",
        "new file; no other is edited",
        "lines",
        "terminal",
        "page",
        "verify",
        "merge",
    ]
    print(table(headers, measured()))
    columns = ["feature", "edited; no other is", "lines", "terminal", "summary", "page"]
    print("\n" + table(columns, patched()))
    columns = ["feature", "new file of a project", "lines", "bundle", "--dura-list", "verify"]
    print("\n" + table(columns, [registered()]))
    for file in (*(price.file for price in PRICES), FORMAT):
        print(f"\n```python\n{(FEATURES / file).read_text('utf-8')}```")


if __name__ == "__main__":
    main()
