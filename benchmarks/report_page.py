"""Measure the report in a browser: its height, the first paint, a view of many rows, a filter.

``python benchmarks/report_page.py [DIR]`` renders a page of the bundle in DIR, and one of as many
copies of its cases as have the number of verdicts that ``--verdicts`` asks for; ``--page FILE``
measures a page as it is, such as one of an earlier version. Needs Chromium and Playwright.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import is_dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

from machine import machine, table

from pytest_dura.evidence import SessionRecord, open_record
from pytest_dura.reports.html.page import render

FLAGS = (
    "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-quic",
    "--disable-component-update", "--disable-sync", "--no-first-run",
)  # fmt: skip
WINDOW = {"width": 1400, "height": 900}
FILTER = """async text => {
  const field = document.querySelector("#verdicts-filter, #filter-text");
  const count = document.querySelector("form[data-table=verdicts] output");
  const start = performance.now();
  field.value = text;
  field.dispatchEvent(new Event("input", { bubbles: true }));
  while (count?.textContent.endsWith("…")) await new Promise((next) => setTimeout(next, 5));
  document.body.offsetHeight;  // until it is laid out
  return performance.now() - start;
}"""


def small_session(folder: Path) -> Path:
    """Run the simplest built-in scenario once, with a planner that never gives way."""
    options = ["--dura-select=intersection/nominal", "--dura-runs=1"]
    options += ["--dura-generator=aggressive", f"--dura-evidence={folder / 'bundle'}"]
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "--dura-scenarios"]
    subprocess.run([*command, *options], cwd=folder, capture_output=True, check=False)
    return folder / "bundle"


def enlarged(record: SessionRecord, verdicts: int) -> SessionRecord:
    """Copy the cases of a record, with their verdicts and cells, until there are so many verdicts.

    The copies refer to the episodes of the first ones.
    """
    head = record.head
    copies = -(-verdicts // len(head.verdicts))

    def copied(entries: Any, key: str) -> Iterator[Any]:
        for number in range(copies):
            for entry in entries:
                mark = f"-{number}" if number else ""
                changes = {key: getattr(entry, key) + mark}
                if hasattr(entry, "scenario"):
                    changes["scenario"] = entry.scenario + mark
                yield replace(entry, **changes) if is_dataclass(entry) else entry.replace(**changes)

    coverage = head.coverage.replace(cells=list(copied(head.coverage.cells, "case")))
    return replace(
        record,
        head=head.replace(
            cases=list(copied(head.cases, "id")),
            verdicts=list(copied(head.verdicts, "case"))[:verdicts],
            coverage=coverage,
        ),
    )


def measured(browser: Any, file: Path, repeats: int) -> dict[str, float]:
    """Medians over some openings: the height in pixels, the rest in milliseconds."""
    rows: list[dict[str, float]] = []
    for _ in range(repeats):
        context = browser.new_context(viewport=WINDOW)
        page = context.new_page()
        page.goto(file.resolve().as_uri())
        page.wait_for_timeout(200)
        paint = "performance.getEntriesByName('first-contentful-paint')[0].startTime"
        ready = "performance.getEntriesByType('navigation')[0].domContentLoadedEventEnd"
        row = {
            "height": page.evaluate("document.documentElement.scrollHeight"),
            "first paint": page.evaluate(paint),
            "usable": page.evaluate(ready),
        }
        start = time.perf_counter()
        page.evaluate("location.hash = 'requirements'")
        page.wait_for_selector("form.filter[data-table='verdicts']:not([hidden])")
        row["view"] = 1000 * (time.perf_counter() - start)
        row["first filter"] = page.evaluate(FILTER, "violated")
        row["next filter"] = page.evaluate(FILTER, "congested")
        rows.append(row)
        context.close()
    return {key: median(row[key] for row in rows) for key in rows[0]}


def main() -> None:
    """Render and measure."""
    from playwright.sync_api import sync_playwright

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "bundle", type=Path, nargs="?", help="directory of evidence; a small session without it"
    )
    parser.add_argument("--verdicts", type=int, default=20_000)
    parser.add_argument("--repeats", type=int, default=3, help="openings of each page")
    parser.add_argument("--page", type=Path, action="append", default=[])
    given = parser.parse_args()
    executable = shutil.which("chromium") or shutil.which("chromium-browser")
    if executable is None:
        sys.exit("there is no chromium on the path")
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        bundle = given.bundle or small_session(Path(folder))
        record = open_record(bundle / "evidence.json")
        files = [(str(file), file) for file in given.page]
        for name, each in (
            (f"{len(record.head.verdicts)} verdicts", record),
            (f"{given.verdicts} verdicts", enlarged(record, given.verdicts)),
        ):
            start = time.perf_counter()
            text = render(each)
            seconds = time.perf_counter() - start
            file = Path(folder) / f"{len(files)}.html"
            file.write_bytes(text.encode(errors="backslashreplace"))
            files.append((f"{name} (rendered in {seconds:.1f} s)", file))
        browser = playwright.chromium.launch(executable_path=executable, args=list(FLAGS))
        print(machine())
        rows = []
        for name, file in files:
            row = measured(browser, file, given.repeats)
            size = f"{file.stat().st_size / 1e6:.1f} MB"
            rows.append([name, size, *(f"{value:.0f}" for value in row.values())])
        heads = ["height, px", "first paint, ms", "usable, ms", "view of requirements, ms"]
        heads += ["filter, ms", "next filter, ms"]
        print(f"Medians of {given.repeats} openings at {WINDOW['width']} x {WINDOW['height']}.")
        print(table(["page", "size", *heads], rows))
        browser.close()


if __name__ == "__main__":
    main()
