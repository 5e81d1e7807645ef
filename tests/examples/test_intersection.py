"""The intersection suite, copied and run as a user would."""

from __future__ import annotations

import functools
import json
import shutil
from pathlib import Path

import pytest
from suites import SUITES, run_suite

SUITE = SUITES / "intersection"


@pytest.fixture
def suite(tmp_path: Path) -> Path:
    return shutil.copytree(SUITE, tmp_path / "my_suite")


@pytest.fixture
def again(suite: Path, forked_workers):
    """Runs the suite in a copy of a process that has imported what a session needs."""
    return functools.partial(run_suite, suite, python=forked_workers.command())


def evidence_of(suite: Path) -> dict:
    return json.loads((suite / "dura-evidence" / "evidence.json").read_text())


def verdicts_of(suite: Path) -> dict[tuple[str, str], tuple[str, int]]:
    return {
        (one["requirement"], one["case"]): (one["verdict"], one["episodes"])
        for one in evidence_of(suite)["verdicts"]
    }


def test_the_suite_passes_where_it_was_copied_to(suite: Path) -> None:
    done = run_suite(suite)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "component under test: PatientPlanner" in done.stdout
    assert "19 passed" in done.stdout
    assert evidence_of(suite)["component_under_test"]["name"] == "PatientPlanner"
    assert verdicts_of(suite) == {
        ("SAF-1", "intersection/nominal"): ("supported", 5),
        ("OWN-1", "intersection/nominal"): ("supported", 5),
        ("OWN-1", "intersection/nominal+ghost-obstacle"): ("supported", 5),
        ("OWN-2", "intersection/conflicting-traffic"): ("supported", 60),
        ("OWN-3", "intersection/conflicting-traffic"): ("supported", 74),
        ("OWN-4", "intersection/ghost-obstacle"): ("supported", 5),
    }


def test_too_few_runs_do_not_support_the_rate(suite: Path, again) -> None:
    done = again("--dura-runs=2", "-k", "collision_rate")
    assert done.returncode == 1, done.stdout + done.stderr
    assert "0 of 2 valid episodes violated it" in done.stdout
    assert verdicts_of(suite) == {("OWN-2", "intersection/conflicting-traffic"): ("undecided", 2)}
    said = " ".join(done.stdout.split())
    assert "by a new plan on a fresh seed of 59 runs, which may hold no violations" in said


def test_the_built_in_scenarios_judge_its_planner(again) -> None:
    done = again("--dura-runs=1", "intersection/nominal::SAF-1")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "component under test: PatientPlanner" in done.stdout


def test_a_planner_that_never_goes_fails_the_suite(suite: Path, again) -> None:
    planner = suite / "planner.py"
    text = planner.read_text()
    assert 'Proposal("proceed", "nobody comes")' in text
    planner.write_text(text.replace('Proposal("proceed", "nobody comes")', 'Proposal("wait")'))
    done = again("--dura-runs=2", "-k", "gets_through and not ghost")
    assert done.returncode == 1, done.stdout + done.stderr
    assert verdicts_of(suite) == {("OWN-1", "intersection/nominal"): ("violated", 2)}


@pytest.mark.parametrize("what", [[], ["--dura-scenarios"]], ids=["tests", "scenarios"])
def test_a_generator_on_the_command_line_conflicts_with_its_planner(
    suite: Path, again, what
) -> None:
    done = again("--dura-generator=aggressive", *what)
    assert done.returncode == 4, done.stdout + done.stderr
    assert done.stderr.strip().splitlines() == [
        "ERROR: the component under test is given twice",
        "  key:      --dura-generator",
        "  found:    '--dura-generator and the fixture `generator` in conftest.py'",
        "  expected: one of them",
        "  remedy:   drop the option, or the fixture",
    ]
    assert not (suite / "dura-evidence").exists()
