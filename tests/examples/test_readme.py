"""The README runs as printed: its files are written, its commands run, their output is compared.

The two commands that begin with a virtual environment are what `.ci/run` runs
(`tests/packaging/test_habits.py`).
"""

from __future__ import annotations

import shlex
import subprocess
from pathlib import Path

import pytest
from printed import blocks_of, is_shown

README = Path(__file__).parents[2] / "README.md"
SMALL = ["--dura-select=intersection/nominal", "--dura-runs=1"]
"""A command of the README whose output is not shown runs on this much."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("readme")
    (folder / "pytest.ini").write_text("[pytest]\n")
    return folder


@pytest.fixture(scope="module")
def run(folder, forked_workers):
    def run(command: str, *more: str) -> list[str]:
        program, *arguments = shlex.split(command)
        module = ["-m", "pytest"] if program == "pytest" else []
        done = subprocess.run(
            forked_workers.command(*module, *arguments, *more),
            cwd=folder, capture_output=True, text=True, check=False, timeout=120,
        )  # fmt: skip
        assert not done.stderr
        assert "Traceback" not in done.stdout
        return done.stdout.splitlines()

    return run


def test_every_file_and_command_of_the_readme_does_what_it_shows(folder, run):
    blocks = blocks_of(README)
    ran = 0
    for block in blocks:
        if block.file:
            (folder / block.file).write_text(block.text)
        elif block.language == "sh" and "&&" not in block.text:
            assert any("component under test MyPlanner" in line for line in run(block.text, *SMALL))
            ran += 1
        elif block.text.startswith("$ "):
            command, *expected = block.text.splitlines()
            lines = run(command.removeprefix("$ "))
            assert is_shown(expected, lines), "\n".join([command, *lines])
            ran += 1
    assert ran == len([block for block in blocks if block.text.startswith(("$ ", "pytest "))]) == 5
    # The conftest.py of the README came last: the test above it now judges the planner.
    lines = run("pytest test_crossing.py -k never_collides")
    assert any(line.startswith("component under test: MyPlanner") for line in lines)


def test_the_readme_is_read_in_a_sitting():
    assert len(README.read_text("utf-8").splitlines()) <= 150


@pytest.mark.parametrize(
    "expected, same",
    [
        (["a", "...", "c"], True),
        (["a", "...", "b..."], False),
        (["...", "c"], True),
        (["a", "b", "c"], True),
        (["a", "c", "..."], False),
        (["a", "..."], True),
        (["...", "b"], False),
    ],
)
def test_a_cut_stands_for_any_lines(expected, same):
    assert is_shown(expected, ["a", "b", "c"]) is same
