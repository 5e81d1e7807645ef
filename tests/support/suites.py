"""Runs an example suite as a user would who copied it."""

from __future__ import annotations

import ast
import json
import os
import shutil
import subprocess
import sys
import tokenize
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from forked_workers import WITHOUT_RETRIES

REPOSITORY = Path(__file__).parents[2]
SUITES = REPOSITORY / "example_suites"


def run_suite(
    folder: Path,
    *arguments: str,
    python: Sequence[str] = (sys.executable,),
    packages: Sequence[Path] = (),
) -> subprocess.CompletedProcess[str]:
    """pytest in the folder of a copied suite; a warning is an error.

    Args:
        folder: That of the suite.
        arguments: Further ones of pytest.
        python: Default: an interpreter that starts afresh, as a user's does.
        packages: Folders like ``site-packages``.
    """
    environment = {key: value for key, value in os.environ.items() if "PYTEST" not in key}
    path = os.pathsep.join(map(str, (*packages, REPOSITORY)))
    environment |= {"PYTHONPATH": path, "PYTEST_ADDOPTS": WITHOUT_RETRIES}
    options = ["-q", "-W", "error", "-p", "no:cacheprovider", *arguments]
    return subprocess.run(
        [*python, "-m", "pytest", *options],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )


def install_suite(name: str, folder: Path) -> Path:
    """Install the package of a suite into a folder like ``site-packages``, and return that."""
    sources = shutil.copytree(SUITES / name, folder / "sources")
    target = folder / "site-packages"
    pip = ["-m", "pip", "install", "--no-deps", "--no-index", "--no-build-isolation", "--quiet"]
    command = [sys.executable, *pip, "--target", str(target), str(sources)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    return target


class InstalledSuite:
    """A copy of a suite without its package, which is installed; runs pytest in it.

    Args:
        name: Of the suite and of its package.
        packages: The folder that it was installed into.
        folder: The copy's, which must not exist.
        python: The interpreter's command.
    """

    def __init__(self, name: str, packages: Path, folder: Path, python: Sequence[str]) -> None:
        ignored = shutil.ignore_patterns(name, "pyproject.toml", "dura-evidence", "found")
        shutil.copytree(SUITES / name, folder, ignore=ignored)
        self.folder, self.packages, self.python = folder, packages, python

    def __call__(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        """Run pytest."""
        return run_suite(self.folder, *arguments, python=self.python, packages=(self.packages,))

    @property
    def record(self) -> dict[str, Any]:
        """The record that the last session left."""
        record: dict[str, Any] = json.loads(
            (self.folder / "dura-evidence/evidence.json").read_text()
        )
        return record

    @property
    def verdicts(self) -> dict[tuple[str, str], str]:
        """Verdicts of the last session, by case and requirement."""
        rows = self.record["verdicts"]
        return {(row["case"], row["requirement"]): row["verdict"] for row in rows}


def suite_fixtures(name: str) -> tuple[Any, Any]:
    """Make the fixtures ``installed`` and ``project`` of a suite that is a package of its own."""

    @pytest.fixture(scope="module")
    def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
        """A folder like ``site-packages`` with the package alone."""
        return install_suite(name, tmp_path_factory.mktemp(name))

    @pytest.fixture
    def project(installed: Path, tmp_path: Path, forked_workers: Any) -> InstalledSuite:
        """A copy of the suite without its package, which is installed; runs pytest in it."""
        return InstalledSuite(name, installed, tmp_path / "my", forked_workers.command())

    return installed, project


def lines_of_code(file: Path) -> int:
    """Number of lines without docstrings, comments and blank ones."""
    strings: set[int] = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            strings |= set(range(node.lineno, node.end_lineno + 1))
    left = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT)
    lines: set[int] = set()
    with file.open() as source:
        for token in tokenize.generate_tokens(source.readline):
            if token.type not in (*left, tokenize.ENDMARKER):
                lines |= set(range(token.start[0], token.end[0] + 1))
    return len(lines - strings)
