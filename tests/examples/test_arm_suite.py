"""The arm and the person beside it: installed as a package of its own, used as a whole."""

from __future__ import annotations

import numpy as np
import yaml
from suites import SUITES, lines_of_code, suite_fixtures

from pytest_dura.evidence import verify_bundle
from pytest_dura.evidence.mcap import read_trace

installed, project = suite_fixtures("arm")


def test_the_considerate_planner_passes_the_gate_and_each_fault_acts(project):
    done = project("--dura-scenarios", "--dura-runs=1", "--dura-evidence-level=all")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "21 supported\n" in done.stdout
    episodes = {one["case"]: one for one in project.record["episodes"]}
    assert {one["validity"] for one in episodes.values()} == {"valid"}  # each fault manifested
    faults = {case: [fault["id"] for fault in one["faults"]] for case, one in episodes.items()}
    assert {case: ids for case, ids in faults.items() if ids} == {
        f"cell/scanner+{id_}": [id_] for id_ in ("dropout", "drift", "late", "frozen", "ghost")
    }
    assert verify_bundle(project.folder / "dura-evidence").problems == []
    (trace,) = (project.folder / "dura-evidence" / "episodes").glob("*scanner*ghost*.mcap")
    scene = read_trace(trace).recording.scene
    true = dict(zip(scene.truth.ids, scene.truth.poses[25, :, :2], strict=True))
    seen = dict(zip(scene.percept.ids, scene.percept.poses[25, :, :2], strict=True))
    assert np.hypot(*true["person"]) > 3.0 > np.hypot(*seen["person"])  # the left scanner's ghost
    assert np.isnan(seen["by the right scanner"]).all()  # which is drawn where it is wrong
    assert "hand" in true
    assert "hand" not in seen  # a scanner sees legs


def test_without_monitoring_the_careless_planner_strikes_the_person(project):
    """The same visit with `policy: log_only`: what monitor and protective stop are for."""
    chosen = ["--dura-scenarios", "--dura-generator=careless", "--dura-select=cell/visit"]
    done = project(*chosen)
    assert done.returncode == 0, done.stdout + done.stderr
    file = project.folder / "scenarios" / "visit.yaml"
    file.write_text(file.read_text() + "policy: log_only\n")
    done = project(*chosen)
    assert done.returncode == 1, done.stdout + done.stderr
    assert project.verdicts["cell/visit", "CON-1"] == "violated"
    assert project.verdicts["cell/visit", "SEP-1"] == "violated"
    assert "it struck the person at" in done.stdout


def test_a_ghost_costs_time_and_stops_the_arm_without_need(project):
    file = project.folder / "scenarios" / "scanner.yaml"
    text = file.read_text()
    file.write_text(text.replace("[CON-1, SEP-1]", "[CON-1, SEP-1, STOP-1]"))
    assert file.read_text() != text
    done = project("--dura-scenarios", "--dura-select=cell/scanner+ghost", "--dura-runs=1")
    assert done.returncode == 1, done.stdout + done.stderr
    assert project.verdicts == {
        ("cell/scanner+ghost", "CON-1"): "supported",
        ("cell/scanner+ghost", "SEP-1"): "supported",
        ("cell/scanner+ghost", "STOP-1"): "violated",
    }


def test_a_search_strikes_with_one_scanner_and_finds_nothing_with_two(project):
    done = project("test_arm.py", "-k", "scanner", "--runxfail")
    assert done.returncode == 1, done.stdout + done.stderr
    outcomes = {
        search["case"]: outcome["status"]
        for search in project.record["searches"]
        for outcome in search["outcomes"]
    }
    assert outcomes == {"cell/visit": "nothing found", "cell/one-scanner": "falsified"}
    (file,) = (project.folder / "scenarios" / "found").glob("*.yaml")
    found = yaml.safe_load(file.read_text())
    (fault,) = found["faults"]
    assert fault["target"].startswith("left")
    again = project("--dura-scenarios", "--dura-select=found/*")
    assert again.returncode == 1
    assert "violated: CON-1 on found/" in again.stdout
    file.write_text(file.read_text().replace("[left]", "[left, right]"))
    again = project("--dura-scenarios", "--dura-select=found/*")
    assert again.returncode == 0, again.stdout


def test_the_other_tests_of_the_suite_pass(project):
    done = project("test_arm.py", "-k", "not one_scanner and not two_scanners")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "4 passed" in done.stdout


def test_the_suite_has_at_most_300_lines_of_code() -> None:
    assert sum(map(lines_of_code, (SUITES / "arm").rglob("*.py"))) <= 300
