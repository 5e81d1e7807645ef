"""Runs an example suite as a user would who copied it."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from forked_workers import WITHOUT_RETRIES

REPOSITORY = Path(__file__).parents[2]
SUITES = REPOSITORY / "example_suites"


def run_suite(
    folder: Path, *arguments: str, python: Sequence[str] = (sys.executable,)
) -> subprocess.CompletedProcess[str]:
    """pytest in the folder of a copied suite; a warning is an error.

    Args:
        folder: That of the suite.
        arguments: Further ones of pytest.
        python: Default: an interpreter that starts afresh, as a user's does.
    """
    environment = {key: value for key, value in os.environ.items() if "PYTEST" not in key}
    environment |= {"PYTHONPATH": str(REPOSITORY), "PYTEST_ADDOPTS": WITHOUT_RETRIES}
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
