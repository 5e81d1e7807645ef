"""The mobile robot: a domain that is installed as a package of its own, used as a whole."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest
import yaml
from suites import REPOSITORY, SUITES

from pytest_dura.evidence import verify_bundle

SUITE = SUITES / "mobile_robot"
PAGE = REPOSITORY / "docs" / "mobile-robot.md"


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """A folder like ``site-packages`` with the package alone."""
    folder = tmp_path_factory.mktemp("robot") / "site-packages"
    pip = ["-m", "pip", "install", "--no-deps", "--no-index", "--no-build-isolation", "--quiet"]
    command = [sys.executable, *pip, "--target", str(folder), str(SUITE)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture
def project(installed, tmp_path, forked_workers):
    """A copy of the suite without its package, which is installed; runs commands in it.

    They run in copies of a process that has the imports, but where ``python`` is given.
    """
    folder = tmp_path / "field_robot"
    shutil.copytree(SUITE, folder, ignore=shutil.ignore_patterns("mobile_robot", "pyproject.toml"))
    kept = {name: value for name, value in os.environ.items() if "PYTEST" not in name}
    path = os.pathsep.join(map(str, (installed, REPOSITORY)))

    def run(*arguments: str, python: Sequence[str] = ()) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [*(python or forked_workers.command()), "-m", *arguments],
            cwd=folder,
            env={**kept, "PYTHONPATH": path},
            capture_output=True,
            text=True,
            check=False,
            timeout=120,
        )

    run.folder = folder
    return run


def session(project, *arguments, **python):
    command = ["pytest", "-q", "-W", "error", "-p", "no:cacheprovider"]
    return project(*command, *arguments, **python)


def record(project):
    return json.loads((project.folder / "dura-evidence" / "evidence.json").read_text())


def test_the_list_shows_this_domain_and_no_other(project):
    done = session(project, "--dura-list", "--dura-faults=catalogue")
    assert done.returncode == 0, done.stdout + done.stderr
    lines = done.stdout.splitlines()
    for line in (
        "signals of the domain mobile_robot",
        "  gap: [m]; between the body and the nearest thing; 0 on contact",
        "  command.left: [m/s]; -1 to 1; speed of the left wheel",
        "  arrival_time: mean; s; time until it arrived, over the runs that did",
        "  generator: mobile_robot.roles:FollowGap",
        "  hasty: mobile_robot.roles:Hasty",
        "  room/posts+stuck-at::COL-1",
        "  room/posts+stuck-command::COL-1",
        "  room/posts+freeze::COL-1",
    ):
        assert line in lines, done.stdout
    assert not re.search(r"intersection/|SAF-1|ghost-obstacle", done.stdout)


def test_the_planner_passes_the_gate_and_the_reports_are_the_robot_s(project):
    done = session(project, "--dura-scenarios", "--dura-runs=2", python=[sys.executable])
    assert done.returncode == 0, done.stdout + done.stderr
    assert "7 supported\n" in done.stdout
    head = next(line for line in done.stdout.splitlines() if line.startswith("case "))
    assert head.split()[4:9] == ["hit", "%", "arrival", "s", "gap"]
    assert "coll" not in head
    told = record(project)
    assert [measure["name"] for measure in told["measures"]] == ["hit", "arrival_time", "least_gap"]
    blinded = [one for one in told["episodes"] if one["case"] == "room/blinded-monitor"]
    assert [one["validity"] for one in blinded] == ["valid"] * 2
    assert all(one["faults"][0]["read_by"] == ["safety_monitor"] for one in blinded)
    page = (project.folder / "dura-evidence" / "report.html").read_text()
    assert "odometry.speed, read by safety_monitor" in page
    assert "Arrival time by scenario" in page
    assert verify_bundle(project.folder / "dura-evidence").problems == []


def test_a_blinded_monitor_lets_the_hasty_planner_run_into_a_post(project):
    arguments = ["--dura-generator=hasty", "--dura-select=room/*", "--dura-evidence-level=all"]
    done = session(project, "--dura-scenarios", *arguments)
    assert done.returncode == 1, done.stdout + done.stderr
    verdicts = {(one["case"], one["requirement"]): one for one in record(project)["verdicts"]}
    assert verdicts["room/posts", "COL-1"]["verdict"] == "supported"
    violated = verdicts["room/blinded-monitor", "COL-1"]
    assert (violated["verdict"], violated["invalid"]) == ("violated", 0)
    assert violated["also_without"] == 0
    assert "fault: 1 fault in 4 runs: 4 activated, 4 manifested, 1 propagated" in done.stdout
    counterexample = violated["counterexamples"][0]["episode"]
    page = (project.folder / "dura-evidence" / "report.html").read_text()
    assert counterexample in page
    assert "post 0" in _scenes(project)
    replayed = session(project, f"--dura-replay={counterexample}")
    assert replayed.returncode == 0, replayed.stdout + replayed.stderr
    assert "  the same" in replayed.stdout


def _scenes(project):
    """Names of the things in the scene of the first trace."""
    from pytest_dura.evidence.mcap import read_trace

    traces = sorted((project.folder / "dura-evidence" / "episodes").glob("*.mcap"))
    scenes = [read_trace(file).recording.scene for file in traces]
    assert all(scene.ego == "robot" for scene in scenes)
    return " ".join(scenes[0].truth.ids)


def test_a_search_finds_the_blinded_monitor_and_makes_it_small(project):
    done = session(project, "test_robot.py", "-k", "brings", "--dura-generator=hasty")
    assert done.returncode == 1, done.stdout + done.stderr
    (search,) = record(project)["searches"]
    (outcome,) = search["outcomes"]
    assert outcome["status"] == "falsified"
    (file,) = (project.folder / "scenarios" / "found").glob("*.yaml")
    found = yaml.safe_load(file.read_text())
    assert len(found["world"]["posts"]) == 1  # of three
    (fault,) = found["faults"]
    assert (fault["type"], fault["target"]) == ("stuck-at", "odometry.speed")
    again = session(project, "--dura-scenarios", "--dura-select=found/*", "--dura-generator=hasty")
    assert again.returncode == 1
    assert "violated: COL-1 on found/" in again.stdout
    assert session(project, "--dura-scenarios", "--dura-select=found/*").returncode == 0


def test_the_field_is_crossed_and_a_slippery_one_is_named(project):
    done = session(project, "test_robot.py", "-k", "plants")
    assert done.returncode == 0, done.stdout + done.stderr
    file = project.folder / "scenarios" / "field.yaml"
    text = file.read_text()
    assert "world.slip: {min: 0.05, max: 0.4}" in text
    file.write_text(text.replace("{min: 0.05, max: 0.4}", "{min: 0.8, max: 0.95}"))
    done = session(project, "--dura-scenarios", "--dura-select=field/*")
    assert done.returncode == 1
    verdicts = {one["requirement"]: one["verdict"] for one in record(project)["verdicts"]}
    assert verdicts["SLIP-1"] == "violated"


def test_the_simulator_keeps_its_contract(project):
    checks = (
        "from pytest_dura import check_simulator\n"
        "from mobile_robot.world import RobotWorld, Wheels, World\n"
        "world = {'name': 'a', 'duration': 3.0, 'world': World().model_dump()}\n"
        "check_simulator(RobotWorld, world, [Wheels(0.5, 0.3)] * 20)\n"
    )
    (project.folder / "check.py").write_text(checks)
    done = project("check")
    assert done.returncode == 0, done.stderr


def test_a_world_with_a_wrong_key_is_refused_at_its_line(project):
    file = project.folder / "scenarios" / "field.yaml"
    file.write_text(file.read_text().replace("rows: {count: 2", "rows: {cuont: 2"))
    done = session(project, "--dura-scenarios")
    assert done.returncode == 4
    assert "scenarios/field.yaml:8" in done.stderr
    assert "cuont" in done.stderr


def test_its_own_defects_are_seeded_and_the_hasty_planner_provokes_its_guards(project):
    """Entry points of the package bring them; the planner as it is needs neither guard."""
    arguments = ["--dura-scenarios", "--dura-select=room/*", "--dura-qualify", "--dura-runs=2"]
    done = session(project, *arguments, "-k", "posts or (mobile_robot and not 0.2)")
    assert done.returncode == 0, done.stdout + done.stderr
    results = {fact["about"]: fact["data"] for fact in record(project)["facts"]}
    catchers = {
        name: {(kill["requirement"], kill["provoker"]) for kill in result["kills"]}
        for name, result in results.items()
    }
    assert ("ARR-1", "") in catchers["mobile_robot.generator.crossed_wheels"]
    for name in (
        "mobile_robot.safety_monitor.far_sighted[metres=1]",
        "mobile_robot.recovery_planner.rolls_on",
    ):
        assert catchers[name] == {("COL-1", "hasty")}
    assert results["mobile_robot.generator.blind_ahead[angle=0.8]"]["status"] == "caught"


RIGID = "--dura-simulator=mobile_robot.mujoco"


def test_rigid_bodies_give_the_verdicts_of_the_kinematics(project):
    pytest.importorskip("mujoco", reason="the package mujoco is not installed")
    done = session(project, "--dura-scenarios", RIGID, "--dura-runs=1")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "7 supported\n" in done.stdout
    assert verify_bundle(project.folder / "dura-evidence").problems == []
    done = session(
        project, "--dura-scenarios", RIGID, "--dura-generator=hasty", "--dura-select=room/*"
    )
    assert done.returncode == 1, done.stdout + done.stderr
    verdicts = {(one["case"], one["requirement"]): one for one in record(project)["verdicts"]}
    assert verdicts["room/posts", "COL-1"]["verdict"] == "supported"
    assert verdicts["room/blinded-monitor", "COL-1"]["verdict"] == "violated"


def test_wheels_of_rigid_bodies_slip_on_ground_that_does_not_hold(project):
    pytest.importorskip("mujoco", reason="the package mujoco is not installed")
    file = project.folder / "scenarios" / "field.yaml"
    text = file.read_text()
    assert "world.slip: {min: 0.05, max: 0.4}" in text
    file.write_text(text.replace("{min: 0.05, max: 0.4}", "{min: 0.98, max: 0.99}"))
    done = session(project, "--dura-scenarios", RIGID, "--dura-select=field/*")
    assert done.returncode == 1, done.stdout + done.stderr
    verdicts = {one["requirement"]: one["verdict"] for one in record(project)["verdicts"]}
    assert verdicts["SLIP-1"] == "violated"


def test_the_rigid_bodies_keep_the_contract(project):
    pytest.importorskip("mujoco", reason="the package mujoco is not installed")
    checks = (
        "import numpy as np\n"
        "from pytest_dura import check_simulator\n"
        "from mobile_robot.rigid import RigidRobotWorld\n"
        "from mobile_robot.world import RobotWorld, Wheels, World\n"
        "world = World(posts=[{'x': 2.5, 'y': 3.0}]).model_dump()\n"
        "scenario = {'name': 'a', 'duration': 3.0, 'world': world}\n"
        "check_simulator(RigidRobotWorld, scenario, [Wheels(0.8, 0.75)] * 20)\n"
        "rigid, plain = RigidRobotWorld(), RobotWorld()\n"
        "ticks = [each.reset({'world': world}, 0) for each in (rigid, plain)]\n"
        "np.testing.assert_allclose(*[tick.channels['lidar'] for tick in ticks], atol=1e-6)\n"
        "for _ in range(30):\n"
        "    ticks = [each.step(Wheels(0.8, 0.8)) for each in (rigid, plain)]\n"
        "    if ticks[0].critical: break\n"
        "assert ticks[0].critical == 'it ran into something', ticks[0]\n"
        "assert 1.1 < ticks[0].truth['x'] - 1.0 < 1.2, ticks[0]\n"
    )
    (project.folder / "check.py").write_text(checks)
    done = project("check")
    assert done.returncode == 0, done.stderr


def test_the_domain_is_small_beside_its_world() -> None:
    package = SUITE / "mobile_robot"
    lines = sum(
        len(file.read_text().splitlines())
        for file in package.glob("*.py")
        if file.name not in ("world.py", "rigid.py", "mutants.py")
    )
    assert lines <= 150


def test_the_tutorial_quotes_the_suite_as_it_is() -> None:
    text = PAGE.read_text()
    for name, quoted in re.findall(r"<!-- (\S+) -->\n```\w+\n(.*?)```", text, flags=re.DOTALL):
        whole = (SUITE / Path(name)).read_text()
        for part in quoted.split("...\n"):
            assert part in whole, f"{name}: {part}"
    assert text.count("<!-- ") >= 4
