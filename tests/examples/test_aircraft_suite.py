"""The aircraft on JSBSim: a domain that is installed as a package of its own, used as a whole."""

from __future__ import annotations

import re

import pytest
import yaml
from suites import SUITES, lines_of_code, suite_fixtures

from pytest_dura.evidence import verify_bundle
from pytest_dura.evidence.mcap import read_trace

pytest.importorskip("jsbsim", reason="the extra jsbsim is not installed")

SUITE = SUITES / "aircraft"

installed, project = suite_fixtures("aircraft")


def test_the_protected_autopilot_passes_the_gate_and_each_fault_acts(project):
    done = project("--dura-scenarios", "--dura-runs=1", "--dura-evidence-level=all")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "30 supported\n" in done.stdout
    episodes = {one["case"]: one for one in project.record["episodes"]}
    assert {one["validity"] for one in episodes.values()} == {"valid"}  # each fault manifested
    faults = {case: [(fault["id"], fault["target"]) for fault in one["faults"]]
              for case, one in episodes.items() if one["faults"]}  # fmt: skip
    assert faults == {
        "flight/gps-drift": [("drift", "gps.east")],
        "flight/pitot-blocked": [("freeze", "air.pitot")],
        "flight/static-blocked": [("freeze", "air.static")],
        "flight/servo+lag": [("lag", "command.elevator")],
        "flight/servo+stuck-command": [("stuck-command", "command.elevator")],
    }
    assert verify_bundle(project.folder / "dura-evidence").problems == []
    (trace,) = (project.folder / "dura-evidence" / "episodes").glob("*static-blocked*.mcap")
    scene = read_trace(trace).recording.scene
    true, seen = scene.truth.poses[-1, 0], scene.percept.poses[-1, 0]
    assert seen[1] < true[1] - 100.0  # y points down: it takes itself to be 100 m higher


def test_without_protection_a_blocked_port_brings_it_down(project):
    """The same two flights with `policy: log_only`: what monitor and recovery are for."""
    for name in ("pitot", "static"):
        file = project.folder / "scenarios" / f"{name}.yaml"
        file.write_text(file.read_text() + "policy: log_only\n")
    done = project("--dura-scenarios", "--dura-select=flight/*-blocked", "--dura-runs=1")
    assert done.returncode == 1, done.stdout + done.stderr
    told = project.record
    verdicts = {(one["case"], one["requirement"]): one["verdict"] for one in told["verdicts"]}
    assert verdicts["flight/pitot-blocked", "STALL-1"] == "violated"
    assert verdicts["flight/static-blocked", "DESC-1"] == "violated"
    assert verdicts["flight/static-blocked", "TERR-1"] == "violated"
    ends = {one["case"]: one["termination"] for one in told["episodes"]}
    assert ends["flight/static-blocked"] == "critical"  # it flew into the ground


def test_a_search_stalls_it_without_protection_and_makes_the_case_small(project):
    done = project("test_aircraft.py", "-k", "without_protection", "--runxfail")
    assert done.returncode == 1, done.stdout + done.stderr
    (search,) = project.record["searches"]
    (outcome,) = search["outcomes"]
    assert outcome["status"] == "falsified"
    (file,) = (project.folder / "scenarios" / "found").glob("*.yaml")
    found = yaml.safe_load(file.read_text())
    (fault,) = found["faults"]
    assert fault["target"].startswith("air.pitot")
    assert "turbulence" not in found["world"]  # the fault alone does it
    again = project("--dura-scenarios", "--dura-select=found/*")
    assert again.returncode == 1
    assert "violated: STALL-1 on found/" in again.stdout
    file.write_text(file.read_text().replace("policy: log_only", "policy: recover"))
    assert project("--dura-scenarios", "--dura-select=found/*").returncode == 0


def test_the_other_tests_of_the_suite_pass(project):
    done = project("test_aircraft.py", "-k", "not without_protection")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "4 passed" in done.stdout
    assert "nothing found in 20 simulations" in re.sub(r"\s+", " ", done.stdout)


def test_the_suite_has_at_most_300_lines_of_code() -> None:
    assert sum(map(lines_of_code, SUITE.rglob("*.py"))) <= 300
