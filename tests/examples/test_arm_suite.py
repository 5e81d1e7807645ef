"""The arm and the person beside it: installed as a package of its own, used as a whole."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest
import yaml
from suites import SUITES, lines_of_code, suite_fixtures

from pytest_dura.evidence import verify_bundle
from pytest_dura.evidence.mcap import read_trace

installed, project = suite_fixtures("arm")

RIGID = "--dura-simulator=arm.mujoco"

rigid_bodies = pytest.mark.skipif(
    importlib.util.find_spec("mujoco") is None, reason="the package mujoco is not installed"
)


def test_the_considerate_planner_passes_the_gate_and_each_fault_acts(project):
    done = project("--dura-scenarios", "--dura-runs=1", "--dura-evidence-level=all")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "28 supported\n" in done.stdout
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


@rigid_bodies
def test_rigid_bodies_pass_the_gate_and_the_evidence_names_them(project):
    done = project("--dura-scenarios", RIGID, "--dura-runs=1")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "28 supported\n" in done.stdout
    record = project.record
    simulators = {one["spec"]["simulator"]["path"] for one in record["episodes"]}
    assert simulators == {"arm.rigid:RigidCell"}
    assert "mujoco" in record["environment"]["packages"]
    assert {one["validity"] for one in record["episodes"]} == {"valid"}
    assert verify_bundle(project.folder / "dura-evidence").problems == []


@rigid_bodies
def test_without_monitoring_a_blow_is_harder_than_its_limit(project):
    file = project.folder / "scenarios" / "visit.yaml"
    file.write_text(file.read_text() + "policy: log_only\n")
    chosen = ["--dura-scenarios", "--dura-generator=careless", "--dura-select=cell/visit"]
    done = project(*chosen, RIGID)
    assert done.returncode == 1, done.stdout + done.stderr
    assert project.verdicts["cell/visit", "CON-1"] == "violated"
    assert project.verdicts["cell/visit", "FOR-1"] == "violated"
    assert "it struck the person at" in done.stdout


def change_contact(project, known, other):
    file = project.folder / "scenarios" / "contact.yaml"
    text = file.read_text()
    assert known in text
    file.write_text(text.replace(known, other))


@rigid_bodies
def test_a_hand_that_is_fast_hits_itself_harder_than_the_speed_of_the_arm_alone_says(project):
    """At 2 m/s; by the formula, which takes the person to stand, the same contacts are harmless."""
    change_contact(project, "hand: 0.5", "hand: 2.0")
    for options, code, verdict in (((), 0, "supported"), ((RIGID,), 1, "violated")):
        done = project("--dura-scenarios", "--dura-select=cell/contact", "--dura-runs=12", *options)
        assert done.returncode == code, done.stdout + done.stderr
        assert project.verdicts["cell/contact", "FOR-1"] == verdict
        assert project.verdicts["cell/contact", "CON-1"] == "supported"


@rigid_bodies
def test_an_edge_presses_harder_than_a_face(project):
    """The force stays; on a fifth of a square centimetre its pressure is more than allowed."""
    change_contact(project, "face: 1.0", "face: 0.2")
    done = project("--dura-scenarios", "--dura-select=cell/contact", RIGID)
    assert done.returncode == 1, done.stdout + done.stderr
    assert project.verdicts["cell/contact", "PRE-1"] == "violated"
    assert project.verdicts["cell/contact", "FOR-1"] == "supported"


@rigid_bodies
def test_a_search_strikes_the_rigid_person_and_what_it_made_small_replays(project):
    done = project("test_arm.py", "-k", "one_scanner", "--runxfail", RIGID)
    assert done.returncode == 1, done.stdout + done.stderr
    (file,) = (project.folder / "scenarios" / "found").glob("*.yaml")
    (fault,) = yaml.safe_load(file.read_text())["faults"]
    assert fault["target"].startswith("left")
    again = project("--dura-scenarios", "--dura-select=found/*", RIGID)
    assert again.returncode == 1
    assert "violated: CON-1 on found/" in again.stdout
    replayed = project(f"--dura-replay=found/{file.stem}#0", RIGID)
    assert replayed.returncode == 0, replayed.stdout + replayed.stderr
    assert "  the same" in replayed.stdout


LAWS = """
import math

import pytest
from arm.cell import MASS, PARTS, Cell, Joints, World
from arm.rigid import RigidCell
from pytest_dura import check_simulator

STANDING = {"hand": {"stand": 1.6, "reach": 0.3}, "trunk": {"stand": 1.36, "reach": 0.0}}


def begun(cell, **world):
    return cell.reset({"world": World(**world).model_dump()}, 0)


def test_contract():
    for world in ({"delay": 0.5}, {"delay": 0.0, "stand": 0.9}):  # the latter touches the arm
        scenario = {"name": "a", "world": RigidCell.check_scenario(world)}
        check_simulator(RigidCell, scenario, [Joints(0.8, -0.4)] * 30)


def test_without_a_person_and_load_it_moves_as_the_kinematics_do():
    cells = Cell(), RigidCell()
    for cell in cells:
        begun(cell, delay=100.0)
    for place in range(100):
        rates = Joints(math.sin(place / 8), math.cos(place / 5))
        ticks = [cell.step(rates) for cell in cells]
        assert ticks[1].truth["angles"] == pytest.approx(ticks[0].truth["angles"], abs=0.02)
        assert ticks[1].truth["arm_speed"] == pytest.approx(ticks[0].truth["arm_speed"], abs=0.05)


def test_a_heavy_part_is_stopped_later():
    ways = []
    for payload in (0.0, 15.0):
        cell = RigidCell()
        begun(cell, delay=100.0, payload=payload)
        for _ in range(10):
            tick = cell.step(Joints(1.5, 0.0))
        way = -tick.truth["angles"][0]
        for _ in range(30):
            tick = cell.step(Joints(0.0, 0.0))
        ways.append(way + tick.truth["angles"][0])
    assert ways[0] == pytest.approx(1.5**2 / (2 * 5.0), rel=0.1)
    assert ways[1] > 1.2 * ways[0]


@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("rate", [0.15, 0.8, 1.5])
def test_the_force_of_a_blow_is_about_that_of_two_masses_and_a_spring(part, rate):
    cell = RigidCell()
    tick = begun(cell, delay=0.0, stay=60.0, **STANDING[part])
    for _ in range(40):  # the person arrives, and the arm is stretched out
        tick = cell.step(Joints(0.0, max(-1.0, min(1.0, -5.0 * tick.truth["angles"][1]))))
    ticks = [cell.step(Joints(rate, 0.0)) for _ in range(300)]
    first = next(place for place, tick in enumerate(ticks) if tick.truth["gap"] <= 0.0)
    force = max(tick.truth["contact_force"] for tick in ticks[first : first + 2])
    speed = ticks[first].truth["arm_speed"]
    assert speed == pytest.approx(1.2 * rate, rel=0.02)
    mass, stiffness = PARTS[part]
    rigid = speed * math.sqrt(stiffness / (1.0 / MASS + 1.0 / mass))
    if part == "hand":  # hit beside the tool, at 1.11 of 1.2 m from the base
        assert 0.85 * rigid < force < rigid
    else:  # the elbow gives way, and motors push on
        assert 0.6 * rigid < force < rigid + 60.0 / 1.2
"""


@rigid_bodies
def test_the_rigid_bodies_keep_the_contract_and_the_laws_of_motion_and_of_blows(project):
    (project.folder / "test_laws.py").write_text(LAWS)
    done = project("test_laws.py")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "9 passed" in done.stdout


def test_where_mujoco_is_absent_the_remedy_is_named_and_the_kinematics_know_no_load(project):
    (project.folder / "conftest.py").write_text('import sys\n\nsys.modules["mujoco"] = None\n')
    chosen = ["--dura-scenarios", "--dura-select=cell/passing", "--dura-runs=1"]
    assert project(*chosen).returncode == 0
    done = project(*chosen, RIGID)
    assert done.returncode != 0
    assert "the arm's rigid bodies need the package mujoco" in done.stdout + done.stderr
    assert "pip install 'arm-dura[mujoco]'" in done.stdout + done.stderr
    file = project.folder / "scenarios" / "passing.yaml"
    file.write_text(file.read_text().replace("stay: 2}", "stay: 2, payload: 5}"))
    done = project(*chosen)
    assert done.returncode == 4
    assert "lacks payload: its joints brake alike at any load" in done.stderr


def test_the_suite_has_at_most_300_lines_of_code_and_100_more_for_rigid_bodies() -> None:
    lines = {file.name: lines_of_code(file) for file in (SUITES / "arm").rglob("*.py")}
    assert lines["rigid.py"] <= 100
    assert sum(lines.values()) <= 400
