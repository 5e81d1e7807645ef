"""The suite of a detector that learns, copied and run as a user would."""

from __future__ import annotations

import importlib
import json
import math
import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from forked_workers import ForkedWorkers
from roads import car, channels_of
from suites import SUITES, run_suite

SUITE = SUITES / "anomaly_detection"
ATTACKS = ("ghost-obstacle", "trajectory-spoof", "gnss-drag-off")
LEARNS_FROM = '"intersection/congested", 10, 1'
ROW = re.compile(
    r"^\| (\S+) \| (learned|rules) \| (\d+) of \d+ \| \S+ \| (\d+) of \d+ \|", re.MULTILINE
)


@pytest.fixture
def suite(tmp_path: Path) -> Path:
    return shutil.copytree(SUITE, tmp_path / "my_suite")


def rewrite(suite: Path, old: str, new: str) -> None:
    parts = suite / "anomaly_assessor.py"
    assert old in parts.read_text("utf-8")
    parts.write_text(parts.read_text("utf-8").replace(old, new), "utf-8")


def record_of(suite: Path) -> dict:
    return json.loads((suite / "dura-evidence" / "evidence.json").read_text())


def verdicts_of(suite: Path) -> dict[tuple[str, str], str]:
    return {
        (one["requirement"], one["case"]): one["verdict"] for one in record_of(suite)["verdicts"]
    }


def learned_from(suite: Path) -> set[str]:
    episodes = record_of(suite)["episodes"]
    return {each["spec"]["roles"]["security_assessor"]["params"]["rows"] for each in episodes}


def test_the_suite_passes_and_shows_what_each_assessor_detects(suite: Path) -> None:
    done = run_suite(suite, "-rP")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "18 passed" in done.stdout
    cases = [f"intersection/congested+{attack}" for attack in ATTACKS]
    assert verdicts_of(suite) == {
        **{("DET-1", case): "supported" for case in cases},
        ("DET-2", "intersection/congested"): "supported",
    }
    assert {(case, who): row for case, who, *row in ROW.findall(done.stdout)} == {
        **{(case, "learned"): ["3", "0"] for case in cases},
        **{(case, "rules"): ["3", "0"] for case in cases[:2]},
        (cases[2], "rules"): ["0", "0"],
    }


def test_another_process_learns_the_same_and_other_episodes_are_refused(
    suite: Path, forked_workers: ForkedWorkers
) -> None:
    python, few = forked_workers.command(), '"intersection/congested", 2, 1'
    rewrite(suite, LEARNS_FROM, few)
    done = run_suite(suite, "--dura-runs=1", "-k", "false_alarm", python=python)
    assert done.returncode == 0, done.stdout + done.stderr
    (rows,) = learned_from(suite)
    replay = "--dura-replay=intersection/congested#0"
    assert run_suite(suite, replay, python=python).returncode == 0
    rewrite(suite, few, '"intersection/congested", 2, 2')
    done = run_suite(suite, replay, python=python)
    assert done.returncode != 0
    assert "it learned from other episodes" in done.stdout + done.stderr
    assert rows in done.stdout + done.stderr


def test_an_assessor_that_does_not_compare_lidar_with_radar_fails_the_suite(
    suite: Path, forked_workers: ForkedWorkers
) -> None:
    rewrite(suite, LEARNS_FROM, '"intersection/congested", 2, 1')
    rewrite(suite, "np.abs(places - returns).min(axis=1, initial=REACH).max(initial=0.0)", "0.0")
    chosen = ["--dura-runs=1", "-k", "ghost and in_time"]
    done = run_suite(suite, *chosen, python=forked_workers.command())
    assert done.returncode == 1, done.stdout + done.stderr
    assert verdicts_of(suite) == {("DET-1", "intersection/congested+ghost-obstacle"): "violated"}


@pytest.mark.parametrize("absurd", [0.0, 1e300, -1e300, sys.float_info.max, math.inf, math.nan])
def test_its_features_are_finite_whatever_a_sensor_reports(absurd: float, monkeypatch) -> None:
    monkeypatch.syspath_prepend(str(SUITE))
    features = importlib.import_module("anomaly_assessor").features
    sound = channels_of(car("V1", 0.0, 2.0))
    for channel in ("localisation", "odometry", "imu"):
        value = sound[channel]
        odd = {**sound, channel: value._replace(**dict.fromkeys(value._fields, absurd))}
        for before, now in ((sound, odd), (odd, sound), (odd, odd)):
            assert np.isfinite(features(before, now, 0.1)).all()


def test_the_readme_has_the_rows_that_the_suite_prints() -> None:
    readme = (SUITE / "README.md").read_text("utf-8")
    shown = {(case, who) for case, who, *_ in ROW.findall(readme)}
    assert shown == {
        (f"intersection/congested+{attack}", who)
        for attack in ATTACKS
        for who in ("learned", "rules")
    }
    for name in re.findall(r"^\| `(\w+\.py)`", readme, flags=re.MULTILINE):
        assert (SUITE / name).is_file()
    assert sum(len(file.read_text("utf-8").splitlines()) for file in SUITE.glob("*.py")) <= 200
