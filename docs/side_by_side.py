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
import textwrap
from collections import Counter
from difflib import SequenceMatcher
from pathlib import Path

PAGE = Path(__file__).with_name("releases") / "terminal.md"
BEFORE = "commit e139dc19"
WIDTH = 80
PLANNER = '''\
# planner.py
import json

from pytest_dura import Generator, Proposal


class Reader(Generator):
    """Reads its plan from a text, which is not JSON."""

    def propose(self, view):
        return Proposal(self.plan("{do: wait}"))

    def plan(self, text):
        return json.loads(text)["do"]
'''
SESSIONS = {
    "A session that passes": "pytest --dura-scenarios --dura-select=intersection/nominal",
    "A component that never gives way": (
        "pytest --dura-scenarios --dura-generator=aggressive"
        " --dura-select=intersection/pedestrian-crossing"
    ),
    "A component that raises at its first call": (
        "pytest --dura-scenarios --dura-generator=planner:Reader"
        " --dura-select=intersection/nominal --dura-runs=3"
    ),
}


def output(python: str, command: str) -> list[str]:
    """Return the lines of a command as an interpreter's environment prints them."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "pytest.ini").write_text("[pytest]\ndura_progress_interval = never\n")
        Path(folder, "planner.py").write_text(PLANNER)
        done = subprocess.run(
            [python, "-m", *command.split()], cwd=folder, capture_output=True, text=True,
            check=False, env={**os.environ, "COLUMNS": str(WIDTH)},
        )  # fmt: skip
    if done.returncode not in (0, 1):
        raise SystemExit(done.stdout + done.stderr)
    text = re.sub(r"in [\d.]+s( \([\d:]+\))?", "in N s", done.stdout.replace(folder, "FOLDER"))
    return [line.rstrip() for line in text.splitlines() if not line.startswith("plugins: ")]


def wrapped(lines: list[str]) -> list[str]:
    """Return lines of at most the width of a column."""
    return [
        part
        for line in lines
        for part in (textwrap.wrap(line, WIDTH, drop_whitespace=False) or [""])
    ]


def side_by_side(before: list[str], after: list[str]) -> list[str]:
    """Return both in two columns, equal lines beside each other."""
    left, right = wrapped(before), wrapped(after)
    rows: list[tuple[str, str]] = []
    for _, i, j, k, m in SequenceMatcher(None, left, right, autojunk=False).get_opcodes():
        rows += itertools.zip_longest(left[i:j], right[k:m], fillvalue="")
    return [f"{old.rstrip():{WIDTH}} | {new}".rstrip() for old, new in rows]


LABEL = re.compile(
    r" *(also in|check|component|episode|event|next|replay|required|rerun|twin|worst): "
)


def paragraphs(lines: list[str]) -> list[str]:
    """Join lines that go on in the next one, as cards are written."""
    joined: list[str] = []
    for line in lines:
        starts = LABEL.match(line) or re.match(r" +[A-Z-]+\d:", line)
        starts = starts or bool(joined and re.search(r"of \d+ causes?\)$", joined[-1]))
        deeper = line.startswith("  ") and not starts
        if deeper and joined and joined[-1]:
            joined[-1] += f" {line.strip()}"
        else:
            joined.append(line.strip())
    return joined


def labels(lines: list[str]) -> Counter[str]:
    """Count the lines that begin with each label, such as ``replay:``."""
    return Counter(match[1] for line in lines if (match := LABEL.match(line)))


def sentences(lines: list[str]) -> list[str]:
    """Return the sentences of an output that stand behind no label."""
    free = [text for text in paragraphs(lines) if not LABEL.match(text)]
    parts = [part for text in free for part in re.split(r"(?<=[a-z\d)])\. (?=[A-Z])", text)]
    return [part for part in parts if re.match(r"[A-Za-z].*[a-z] .* .* [a-z]", part)]


def figures_left_out(text: str) -> str:
    """Return text with a letter for each number."""
    return re.sub(r"\d[\d.]*", "N", text)


def gone(before: list[str], after: list[str]) -> list[str]:
    """Return what went, as entries of a list: lines by their labels, then sentences."""
    old, new = labels(before), labels(after)
    entries = [f"`{name}:` {old[name]} -> {new[name]}" for name in old if new[name] < old[name]]
    kept = {figures_left_out(each).rstrip(".") for each in sentences(after)}
    left = [each for each in sentences(before) if figures_left_out(each).rstrip(".") not in kept]
    return entries + [f"`{each}`" for each in dict.fromkeys(left)]


def session(title: str, command: str, python: str) -> list[str]:
    """Return the section of a session."""
    before, after = output(python, command), output(sys.executable, command)
    listed = [f"- {entry}" for entry in gone(before, after)] or ["- nothing"]
    return [
        f"## {title}", "", "```sh", command, "```", "",
        f"{len(before)} lines before, {len(after)} after. What went:", "", *listed, "",
        "```text", *side_by_side(before, after), "```", "",
    ]  # fmt: skip


def page(python: str) -> str:
    """Return the page."""
    lines = [
        "# The terminal, before and after",
        "",
        "<!-- Written by `python docs/side_by_side.py PYTHON`; do not edit. -->",
        "",
        "Three sessions as they were printed before reports and terminal were written from one",
        f"document ({BEFORE}, left) and now (right), {WIDTH} columns wide. In the lists of what",
        "went, a label such as `replay:` stands for the lines that begin with it. The planner of",
        "the third session is this one:",
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
