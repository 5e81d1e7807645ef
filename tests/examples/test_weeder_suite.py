"""The weeding robot in its field: installed as a package of its own, used as a whole."""

from __future__ import annotations

import yaml
from suites import SUITES, lines_of_code, suite_fixtures

from pytest_dura.evidence import verify_bundle
from pytest_dura.evidence.mcap import read_trace

FAULTS = {
    "gnss-drift": "gnss.y",
    "gnss-lost": "gnss",
    "all-weeds": "camera.crop",
    "misaligned": "camera.distance",
    "late": "camera",
    "heat-haze": "thermal.range",
}

installed, project = suite_fixtures("weeder")


def test_the_sighted_planner_passes_the_gate_and_each_fault_acts(project):
    done = project("--dura-scenarios", "--dura-runs=1", "--dura-evidence-level=all")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "30 supported\n" in done.stdout
    episodes = project.record["episodes"]
    assert {one["validity"] for one in episodes} == {"valid"}  # each fault manifested
    faults = {
        fault["id"]: fault["target"] for one in episodes for fault in one["faults"] if one["faults"]
    }
    assert faults == FAULTS
    cut = [one["outcome"]["measures"]["weeds_missed"] for one in episodes
           if one["case"] == "field/row"]  # fmt: skip
    assert cut == [0.0]
    assert verify_bundle(project.folder / "dura-evidence").problems == []
    trace = next((project.folder / "dura-evidence" / "episodes").glob("*gnss-drift*.mcap"))
    scene = read_trace(trace).recording.scene
    true, seen = scene.truth.poses[-1, 0], scene.percept.poses[-1, 0]
    assert seen[1] > true[1] + 0.5  # it is perceived beside its row


def test_without_a_monitor_a_drifting_map_ruins_the_rows(project):
    """The planner that steers by its map, watched and not: what monitor and recovery are for."""
    chosen = [
        "--dura-scenarios",
        "--dura-generator=by_map",
        "--dura-select=field/faults+gnss-drift",
        "--dura-runs=1",
    ]
    done = project(*chosen)
    assert done.returncode == 0, done.stdout + done.stderr
    file = project.folder / "scenarios" / "faults.yaml"
    file.write_text(file.read_text() + "policy: log_only\n")
    done = project(*chosen)
    assert done.returncode == 1, done.stdout + done.stderr
    assert project.verdicts["field/faults+gnss-drift", "CROP-1"] == "violated"
    assert project.verdicts["field/faults+gnss-drift", "ROW-1"] == "violated"


def test_a_camera_that_takes_cabbages_for_weeds_costs_them_where_nothing_lifts_the_hoe(project):
    file = project.folder / "scenarios" / "faults.yaml"
    file.write_text(file.read_text() + "policy: log_only\n")
    done = project("--dura-scenarios", "--dura-select=field/faults+all-weeds", "--dura-runs=1")
    assert done.returncode == 1, done.stdout + done.stderr
    assert project.verdicts["field/faults+all-weeds", "CROP-1"] == "violated"


def test_an_animal_that_no_sensor_shows_is_run_over(project):
    file = project.folder / "scenarios" / "fawn.yaml"
    scenario = yaml.safe_load(file.read_text())
    blind = {"type": "stuck-at", "target": "thermal.range", "activation": {"at": 0}}
    scenario["faults"] = [blind | {"parameters": {"value": 5.0}}]
    file.write_text(yaml.safe_dump(scenario))
    done = project("--dura-scenarios", "--dura-select=field/fawn", "--dura-runs=1")
    assert done.returncode == 1, done.stdout + done.stderr
    assert project.verdicts["field/fawn", "ANI-1"] == "violated"
    assert {one["termination"] for one in project.record["episodes"]} == {"critical"}


def test_searches_find_a_camera_that_is_off_only_where_there_is_no_monitor(project):
    done = project("test_weeder.py", "-k", "sensor or monitor", "--runxfail")
    assert done.returncode == 1, done.stdout + done.stderr
    outcomes = {
        search["case"]: outcome["status"]
        for search in project.record["searches"]
        for outcome in search["outcomes"]
    }
    assert outcomes == {"field/row": "nothing found", "field/unwatched": "falsified"}
    (file,) = (project.folder / "scenarios" / "found").glob("*.yaml")
    found = yaml.safe_load(file.read_text())
    assert found["world"] == {}  # the fault alone does it
    assert len(found["faults"]) == 1
    again = project("--dura-scenarios", "--dura-select=found/*")
    assert again.returncode == 1
    assert "violated: CROP-1 on found/" in again.stdout
    file.write_text(file.read_text().replace("policy: log_only", "policy: recover"))
    assert project("--dura-scenarios", "--dura-select=found/*").returncode == 0


def test_slip_and_a_confused_camera_cost_weeds_and_no_crop(project):
    """Far beyond what the scenario declares."""
    file = project.folder / "scenarios" / "row.yaml"
    text = file.read_text().replace("{min: 0.0, max: 0.1}", "{min: 0.5, max: 0.6}")
    file.write_text(text)
    done = project("--dura-scenarios", "--dura-select=field/row", "--dura-runs=2")
    assert done.returncode == 1, done.stdout + done.stderr
    assert project.verdicts["field/row", "WEED-1"] == "violated"
    assert project.verdicts["field/row", "CROP-1"] == "supported"


def test_the_other_tests_of_the_suite_pass(project):
    done = project("test_weeder.py", "-k", "not sensor and not monitor")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "3 passed" in done.stdout


def test_the_suite_has_at_most_300_lines_of_code() -> None:
    assert sum(map(lines_of_code, (SUITES / "weeder").rglob("*.py"))) <= 300
