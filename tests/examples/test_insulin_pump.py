"""The insulin pump's suite, copied and run as a user would."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest
from suites import SUITES, run_suite

SUITE = SUITES / "insulin_pump"


@pytest.fixture
def suite(tmp_path: Path) -> Path:
    return shutil.copytree(SUITE, tmp_path / "my_suite")


def test_the_suite_passes_with_its_scenarios(suite: Path) -> None:
    done = run_suite(suite, ".", "--dura-scenarios")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "13 passed" in done.stdout


def test_errors_that_no_such_sensor_has_were_counterexamples(suite: Path, forked_workers) -> None:
    """Without range and typical error a drift is one of 0.5 mg/dL per second, whatever drifts."""
    pump = suite / "insulin_pump.py"
    text, lines = re.subn(r"^ +(ranges|errors)=\(.*\n", "", pump.read_text(), flags=re.MULTILINE)
    assert lines == 2
    pump.write_text(text)
    done = run_suite(suite, python=forked_workers.command())
    assert done.returncode == 1, done.stdout + done.stderr
    assert "violated: safety on insulin/day+drift" in done.stdout
    assert "falsified: LOW-1 on insulin/day" in done.stdout
