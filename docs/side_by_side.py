"""Sessions in the terminal, before and after; ``python docs/side_by_side.py PYTHON`` writes them.

PYTHON is the interpreter of an environment with an earlier version. Each session runs in a folder
of its own with both; what takes time and where it lies is left out.
"""  # noqa: INP001 - a script, no package

from __future__ import annotations

import itertools
import os
import re
import subprocess
import sys
import tempfile
from difflib import SequenceMatcher
from pathlib import Path

PAGE = Path(__file__).with_name("releases") / "terminal.md"
BEFORE = "commit e139dc19"
WIDTH = 100
PLANNER = '''\
# planner.py
import json

from pytest_dura import Generator, Proposal


class Reader(Generator):
    """Reads its plan from a text, which is not JSON once something is near."""

    def propose(self, view):
        near = len(view.percept["objects"])
        plan = json.loads("{do: wait}" if near else '{"do": "proceed"}')
        return Proposal(plan["do"])
'''
SESSIONS = {
    "A session that passes": "pytest --dura-scenarios --dura-select=intersection/nominal",
    "A component that never gives way": (
        "pytest --dura-scenarios --dura-generator=aggressive"
        " --dura-select=intersection/pedestrian-crossing"
    ),
    "A component that raises": (
        "pytest --dura-scenarios --dura-generator=planner:Reader"
        " --dura-select=intersection/nominal --dura-runs=3"
    ),
}


def output(python: str, command: str) -> list[str]:
    """Return the lines of a command as an interpreter's environment prints them."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "pytest.ini").write_text("[pytest]\n")
        Path(folder, "planner.py").write_text(PLANNER)
        done = subprocess.run(
            [python, "-m", *command.split()], cwd=folder, capture_output=True, text=True,
            check=False, env={**os.environ, "COLUMNS": str(WIDTH)},
        )  # fmt: skip
    if done.returncode not in (0, 1):
        raise SystemExit(done.stdout + done.stderr)
    text = done.stdout.replace(folder, "FOLDER")
    text = re.sub(r"in [\d.]+s( \([\d:]+\))?", "in N s", text)
    return [line.rstrip() for line in text.splitlines()]


def side_by_side(before: list[str], after: list[str]) -> list[str]:
    """Return both in two columns, equal lines beside each other."""
    rows = []
    for _, i, j, k, m in SequenceMatcher(None, before, after, autojunk=False).get_opcodes():
        rows += itertools.zip_longest(before[i:j], after[k:m], fillvalue="")
    return [f"{left:{WIDTH}} | {right}".rstrip() for left, right in rows]


def sentences(lines: list[str]) -> list[str]:
    """Return the sentences of an output: paragraphs joined, figures and names left out."""
    joined: list[str] = []
    for line in lines:
        continues = joined and line.startswith("  ") and not re.match(r"\s+\S+:  ", line)
        if continues and joined[-1]:
            joined[-1] += f" {line.strip()}"
        else:
            joined.append(line.strip())
    parts = itertools.chain.from_iterable(re.split(r"(?<=[a-z)][.:]) ", line) for line in joined)
    return [part for part in parts if re.match(r"[A-Z][a-z]+ .* .* .*\.$", part)]


def session(title: str, command: str, python: str) -> list[str]:
    """Return the section of a session."""
    before, after = output(python, command), output(sys.executable, command)
    kept = {re.sub(r"\d[\d.]*", "N", each) for each in sentences(after)}
    gone = [
        each
        for each in dict.fromkeys(sentences(before))
        if re.sub(r"\d[\d.]*", "N", each) not in kept
    ]
    listed = [f"- {each}" for each in gone] or ["- none"]
    return [
        f"## {title}", "", "```sh", command, "```", "",
        f"{len(before)} lines before, {len(after)} after. Sentences that went:", "", *listed, "",
        "```text", *side_by_side(before, after), "```", "",
    ]  # fmt: skip


def page(python: str) -> str:
    """Return the page."""
    lines = [
        "# The terminal, before and after",
        "",
        "<!-- Written by `python docs/side_by_side.py PYTHON`; do not edit. -->",
        "",
        f"Three sessions as they were printed before one document was made of a record ({BEFORE}, left)",
        f"and now (right), {WIDTH} columns wide. The planner of the third is this one:",
        "",
        "```python",
        *PLANNER.splitlines(),
        "```",
        "",
    ]
    for title, command in SESSIONS.items():
        lines += session(title, command, python)
    return "\n".join(lines)


if __name__ == "__main__":
    PAGE.write_text(page(sys.argv[1]), "utf-8")
