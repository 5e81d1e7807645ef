"""Pages that run as printed: their files are written, their commands run, their output compared."""

from __future__ import annotations

import itertools
import os
import re
import shlex
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

REPOSITORY = Path(__file__).parents[2]
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
OTHERS = re.compile(r"^<!-- files: (\S+) -->$", re.MULTILINE)
"""What a page needs as well: a page with files, or a folder of the repository."""
NAMED = re.compile(r"<!-- (\S+) -->\n```\w+\n(.*?)^```$", re.DOTALL | re.MULTILINE)
FILE = re.compile(r"# ([\w./-]+\.\w+)$")


class Block(NamedTuple):
    language: str
    text: str

    @property
    def file(self) -> str:
        """Name of the file that it is, by its first line; empty where it is none."""
        name = FILE.match(self.text.partition("\n")[0])
        return name[1] if name and self.language else ""

    @property
    def command(self) -> str:
        """The command of a block that shows its output; empty where it is none."""
        first = self.text.partition("\n")[0]
        return first.removeprefix("$ ") if first.startswith("$ ") else ""


def blocks_of(page: Path) -> list[Block]:
    return [Block(*match.groups()) for match in FENCE.finditer(page.read_text("utf-8"))]


def write_needed(page: Path, folder: Path) -> None:
    """Write the files of the pages that a page builds on, and copy the folders that it names."""
    for name in OTHERS.findall(page.read_text("utf-8")):
        other = (page.parent / name).resolve()
        if other.is_dir():
            shutil.copytree(other, folder / other.relative_to(REPOSITORY))
            continue
        for file, text in NAMED.findall(other.read_text("utf-8")):
            (folder / file).parent.mkdir(parents=True, exist_ok=True)
            (folder / file).write_text(text, "utf-8")


def run_page(blocks: list[Block], folder: Path, workers) -> Iterator[tuple[Block, str]]:
    """Write the files of a page and run its commands, in their order.

    Yields each command's block and what is wrong, empty where the output is as printed.
    """
    environment = {name: value for name, value in os.environ.items() if "PYTEST" not in name}
    for block in blocks:
        if block.file:
            (folder / block.file).parent.mkdir(parents=True, exist_ok=True)
            (folder / block.file).write_text(block.text, "utf-8")
        elif block.command:
            program, *arguments = shlex.split(block.command)
            assert program in ("pytest", "python"), block.command
            module = ["-m", "pytest"] if program == "pytest" else []
            done = subprocess.run(
                workers.command(*module, *arguments), env=environment,
                cwd=folder, capture_output=True, text=True, check=False, timeout=120,
            )  # fmt: skip
            output = [*done.stdout.splitlines(), *done.stderr.splitlines()]
            traceback = "Traceback" in done.stdout + done.stderr
            expected = block.text.splitlines()[1:]
            same = not expected or is_shown(expected, output)
            yield block, "" if same and not traceback else "\n".join([block.command, *output])


def is_shown(expected: list[str], lines: list[str]) -> bool:
    """Whether lines are as expected, where a line ``...`` stands for any lines, or for the rest."""
    at = 0
    for cut, group in itertools.groupby(expected, "...".__eq__):
        if cut:
            continue
        block = list(group)
        starts = range(at, len(lines) - len(block) + 1)
        found = [i for i in starts if all(map(is_line, block, lines[i : i + len(block)]))]
        if not found:
            return False
        at = found[0] + len(block)
    return expected[-1] == "..." or at == len(lines)


def is_line(expected: str, line: str) -> bool:
    return line.startswith(expected[:-3]) if expected.endswith("...") else line == expected
