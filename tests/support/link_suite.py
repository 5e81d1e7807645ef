"""The example suite of links, copied into a project, with its peer in C."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from suites import SUITES

SUITE = SUITES / "link_tank"
WARNINGS = ("-O2", "-Wall", "-Wextra", "-Wconversion", "-Werror")


def copy_suite(folder: Path) -> Path:
    """Copy the suite, without its tests."""
    shutil.copytree(SUITE, folder, dirs_exist_ok=True)
    return folder


def compile_peer(folder: Path) -> Path:
    """Compile the peer in C; skip where there is no compiler of POSIX systems."""
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None or sys.platform == "win32":
        pytest.skip("there is no C compiler for the peer")
    command = [compiler, *WARNINGS, "-o", str(folder / "controller"), str(SUITE / "controller.c")]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 0, done.stderr
    return folder / "controller"
