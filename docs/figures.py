"""Figures of the documentation; ``python docs/figures.py`` measures and writes them anew.

What a command prints stands in a page between two marks, with the day on which it was measured:

    <!-- figures: python benchmarks/against_gym.py -->
    ...
    <!-- end of figures -->

Figures without marks are history: the page says on which day they were measured.
"""  # noqa: INP001 - a script, no package

from __future__ import annotations

import argparse
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from datetime import datetime, timezone
from fnmatch import fnmatch
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGES = ("README.md", "benchmarks/README.md", "docs/**/*.md", "example_suites/*/README.md")
BLOCK = re.compile(
    r"^<!-- figures: (?P<command>[^\n]+) -->\n(?P<figures>.*?)^<!-- end of figures -->$",
    re.MULTILINE | re.DOTALL,
)


def pages() -> Iterator[Path]:
    """Yield each page with marks."""
    for pattern in PAGES:
        for page in sorted(ROOT.glob(pattern)):
            if BLOCK.search(page.read_text("utf-8")):
                yield page


def measured(command: str) -> str:
    """Run a command in the project's folder; return what it prints, and the day.

    Raises:
        subprocess.CalledProcessError: If it fails.
    """
    arguments = shlex.split(command)
    if arguments[0] == "python":
        arguments[0] = sys.executable
    environment = {**os.environ, "COLUMNS": "120"}
    done = subprocess.run(
        arguments, cwd=ROOT, env=environment, stdout=subprocess.PIPE, text=True, check=True
    )
    today = datetime.now(timezone.utc).date()
    return f"\n{done.stdout.strip()}\n\nMeasured on {today}.\n\n"


def main() -> None:
    """Run the commands that are asked for, and write their figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("only", nargs="*", default=["*"], help="patterns of commands, or all")
    parser.add_argument("--list", action="store_true", help="print the commands, and run none")
    given = parser.parse_args()
    for page in pages():
        for block in BLOCK.finditer(page.read_text("utf-8")):
            command = block["command"]
            if not any(fnmatch(command, f"*{pattern}*") for pattern in given.only):
                continue
            print(f"{page.relative_to(ROOT)}: {command}", flush=True)  # noqa: T201 - its output
            if given.list:
                continue
            figures = measured(command)
            text = page.read_text("utf-8")
            mark = f"<!-- figures: {command} -->\n"
            begin = text.index(mark) + len(mark)
            end = text.index("<!-- end of figures -->", begin)
            page.write_text(text[:begin] + figures + text[end:], "utf-8")


if __name__ == "__main__":
    main()
