"""The CartPole suite, copied and run as a user would."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest
from suites import SUITES, run_suite

SUITE = SUITES / "cartpole"


@pytest.fixture
def suite(tmp_path: Path) -> Path:
    return shutil.copytree(SUITE, tmp_path / "my_suite")


def test_the_suite_passes_where_it_was_copied_to(suite: Path) -> None:
    done = run_suite(suite)
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.search(r"\b2\d passed", done.stdout)


def test_a_worse_controller_fails_the_suite(suite: Path, forked_workers) -> None:
    parts = suite / "cartpole_parts.py"
    text = parts.read_text()
    assert "damping: float = 0.4" in text
    parts.write_text(text.replace("damping: float = 0.4", "damping: float = -0.4"))
    done = run_suite(suite, python=forked_workers.command())
    assert done.returncode == 1, done.stdout + done.stderr
    assert "test_the_pole_stays_up[0]" in done.stdout


def test_its_own_defects_are_seeded_and_mutants_that_provoke_stand_in(
    suite: Path, forked_workers
) -> None:
    """A suite without a domain registers them by a decorator, and names no provokers."""
    chosen = "balance or other_side or no_rate or always_unsafe or generator.scaled"
    done = run_suite(
        suite, "--dura-scenarios", "--dura-select=cartpole/balance", "--dura-qualify",
        "--dura-runs=2", "-k", chosen, python=forked_workers.command(),
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    record = json.loads((suite / "dura-evidence" / "evidence.json").read_text())
    results = {fact["about"]: fact["data"] for fact in record["facts"]}
    for name in ("generator.other_side", "generator.no_rate"):
        assert "POLE-1" in {kill["requirement"] for kill in results[name]["kills"]}
    # Actions are choices, so that a mutant which scales numbers changes nothing.
    assert results["generator.scaled[factor=2]"]["status"] == "no difference"
    unsafe = results["safety_monitor.always_unsafe"]
    # The case as it is, and with each component that stands in for provokers: other_side, no_rate,
    # inverted and frozen.
    assert (unsafe["status"], unsafe["runs"]) == ("caught", 5)


def test_runs_that_are_no_sample_credit_no_requirement(suite: Path, forked_workers) -> None:
    done = run_suite(
        suite, "--dura-scenarios", "--dura-select=cartpole/glitch", "--dura-qualify",
        "-k", "glitch or inert", python=forked_workers.command(),
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    record = json.loads((suite / "dura-evidence" / "evidence.json").read_text())
    (result,) = (
        fact["data"] for fact in record["facts"] if fact["about"] == "fault_injector.inert"
    )
    (kill,) = result["kills"]
    assert (result["status"], kill["requirement"]) == ("caught", "validity")


def test_the_readme_names_what_there_is() -> None:
    readme = (SUITE / "README.md").read_text()
    for name in re.findall(r"^\| `(\w+\.py)`", readme, flags=re.MULTILINE):
        assert (SUITE / name).is_file()
    assert "cp -r example_suites/cartpole my_suite && pytest my_suite" in readme
