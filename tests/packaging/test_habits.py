"""What `.ci/run` and the sessions of nox do, and that README and CONTRIBUTING say the same."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]
FENCE = re.compile(r"^```sh\n(.*?)^```$", re.DOTALL | re.MULTILINE)
PROGRAMS = (
    "apt-get", "chromium", "lint-imports", "mkdocs", "mypy", "pip", "pytest", "ruff", "twine",
)  # fmt: skip
SYSTEM = ("basename", "bash", "cp", "dirname", "env", "mkdir", "rm", "sh")
LOGGED = """#!/bin/sh
echo "$(basename "$0")${1+ }$*" >> "$CALLS"
case "$(basename "$0") $*" in $FAILS) exit 3 ;; esac
"""
# Of Python, `-m venv` makes what `activate` needs, and `-m nox` is the real one.
PYTHON = """#!/bin/sh
echo "$(basename "$0")${1+ }$*" >> "$CALLS"
if [ "$1 $2" = "-m venv" ]; then
    mkdir -p "$3/bin"
    cp "$0" "$3/bin/python"
    echo "VIRTUAL_ENV='$PWD/$3'; export VIRTUAL_ENV" > "$3/bin/activate"
fi
"""


class Commands:
    """A copy of what is run, among programs that do nothing but tell how they were called."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / "clone"
        (self.folder / ".ci").mkdir(parents=True)
        shutil.copy(REPOSITORY / ".ci" / "run", self.folder / ".ci")
        for name in ("noxfile.py", "pyproject.toml"):
            shutil.copy(REPOSITORY / name, self.folder)
        self.programs = folder / "programs"
        self.programs.mkdir()
        for name in SYSTEM:
            (self.programs / name).symlink_to(shutil.which(name))
        self.log = folder / "calls"
        for name in PROGRAMS:
            self.add(name, LOGGED)
        self.add("python", PYTHON)
        self.add("python3", PYTHON)
        self.add("nox", f'#!/bin/sh\nexec {shlex.quote(sys.executable)} -m nox "$@"\n')

    def add(self, name: str, script: str) -> None:
        (self.programs / name).write_text(script)
        (self.programs / name).chmod(0o755)

    def run(self, *command: str, fails: str = "nothing") -> int:
        """Run a command, and return its exit code; ``calls`` are those of this run."""
        kept = {name: value for name, value in os.environ.items() if "NOX" not in name}
        self.log.write_text("")
        self.done = subprocess.run(
            command, cwd=self.folder, capture_output=True, text=True, check=False, timeout=120,
            env={**kept, "PATH": str(self.programs), "CALLS": str(self.log), "FAILS": fails},
        )  # fmt: skip
        return self.done.returncode

    @property
    def calls(self) -> list[str]:
        return self.log.read_text().splitlines()


@pytest.fixture
def commands(tmp_path):
    return Commands(tmp_path)


def shown(page: str) -> list[list[str]]:
    """The lines of a page that join commands by ``&&``, as their commands without quotes."""
    blocks = "".join(FENCE.findall((REPOSITORY / page).read_text("utf-8")))
    lines = [line for line in blocks.splitlines() if "&&" in line]
    return [[" ".join(shlex.split(part)) for part in line.split(" && ")] for line in lines]


def test_the_gate_runs_the_commands_of_the_readme_in_a_new_environment(commands):
    (commands.folder / ".venv").mkdir()
    (commands.folder / ".venv" / "left").touch()
    assert commands.run(".ci/run") == 0, commands.done.stdout + commands.done.stderr
    assert not (commands.folder / ".venv" / "left").exists()
    gate, tests = shown("README.md")
    own, linters = shown("CONTRIBUTING.md")
    assert own == tests
    assert gate[:2] == tests[:2] == ["python3 -m venv .venv", ". .venv/bin/activate"]
    assert gate[2:] == ["pip install -e .", "pytest --dura-scenarios"]
    called = iter(commands.calls)
    assert [next(called) for _ in range(3)] == [tests[0], *tests[2:]]
    assert sorted(next(called) for _ in linters) == sorted(linters)
    assert [next(called), next(called)] == [
        f"{gate[3]} -o dura_stl_engine=both", "python -m pytest_dura verify dura-evidence"
    ]  # fmt: skip
    assert next(called) == "python tests/support/house.py -n auto"
    made, installed, tested = called
    assert made.startswith("python -m venv /")
    assert "--constraint" in installed
    assert re.match(r"python -m pytest tests/plugin/test_what_counts\.py ", tested)


@pytest.mark.parametrize(
    "fails", ["pip *", "ruff check *", "mypy*", "pytest -n *", "pytest --dura*"]
)
def test_the_gate_ends_with_the_session_that_fails(commands, fails):
    assert commands.run(".ci/run", fails=fails) != 0
    assert re.match(fails.replace("*", ".*"), commands.calls[-1])


def test_a_browser_is_installed_where_there_is_none(commands):
    (commands.programs / "chromium").unlink()
    assert commands.run(".ci/run") == 0
    assert commands.calls[0] == "apt-get install -y --no-install-recommends chromium"


def test_the_gate_takes_no_arguments(commands):
    assert commands.run(".ci/run", "--list") == 2
    assert commands.calls == []
    assert "nox --list" in commands.done.stderr
