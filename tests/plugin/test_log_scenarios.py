"""Scenarios from logs: a drive that violates becomes a scenario that runs in closed loop."""

from __future__ import annotations

import math

import numpy as np
import pytest
import yaml
from recorded_drives import poses, simulated, sizes, written

from pytest_dura import Orchestrator
from pytest_dura.__main__ import main
from pytest_dura.library import expand_cases, load_scenarios
from pytest_dura.logs.scenarios import scenario_file

BEFORE = 4.0
CHECK = "always (gap > 0)"
REQUIREMENTS = """
requirements:
  - {id: LOG-1, text: Nothing is touched., kind: safety, check: always (gap > 0)}
  - {id: LOG-2, text: It brakes no harder than a car can., kind: safety,
     check: always (required_deceleration < 10)}
"""


def moved(columns, by=0.7, at=(123.0, -45.0)):
    """The poses in another frame: turned, moved, and with y to the left."""
    found = dict(columns)
    for name in {each.rpartition(".")[0] for each in columns}:
        for a, b, x, y in (("x", "y", *at), ("vx", "vy", 0.0, 0.0)):
            u, v = columns[f"{name}.{a}"], columns[f"{name}.{b}"]
            found[f"{name}.{a}"] = math.cos(by) * u - math.sin(by) * v + x
            found[f"{name}.{b}"] = -(math.sin(by) * u + math.cos(by) * v + y)
        found[f"{name}.heading"] = -(columns[f"{name}.heading"] + by)
    return found


@pytest.fixture(scope="module")
def crash():
    """A drive that ends in a collision with a crossing car."""
    episode, ticks = simulated("intersection/conflicting-traffic")
    assert episode.ever("collided")
    return episode, ticks


def mapped(ticks):
    return {"time_step": 0.1, "world": {"driving": {"objects": sizes(ticks)}}}


def test_a_log_becomes_a_scenario_that_begins_as_it_did(crash, tmp_path, capsys) -> None:
    episode, ticks = crash
    log = written(tmp_path / "drive.csv", moved(poses(ticks)))
    mapping, output = tmp_path / "mapping.yaml", tmp_path / "crossing.yaml"
    mapping.write_text(yaml.safe_dump(mapped(ticks)))
    command = ["logs", "scenario-from-log", str(log), "--mapping", str(mapping)]
    assert main([*command, "--check", CHECK, "--output", str(output)]) == 0
    shown = capsys.readouterr().out
    text = output.read_text()
    for note in ("The log has no road", "The junction is where", "the others are simulated"):
        assert note in shown
        assert note in text
    (case,) = expand_cases(load_scenarios([tmp_path / "crossing.yaml"]), select=["crossing"])
    spec = case.spec(0, 0, {"generator": episode.spec.roles["generator"], "recovery_planner": None})
    loop = Orchestrator.build(spec)
    again = loop.run(spec)
    assert again.failure is None
    assert again.ever("collided")
    first = int(np.argmax(episode.signal("gap") <= 0)) - round(BEFORE / 0.1)
    was, now = ticks[first], loop.state.ticks[0]
    assert (now.truth["ego"].x, now.truth["ego"].y) == pytest.approx(
        (was.truth["ego"].x, was.truth["ego"].y), abs=0.05
    )
    before = {body.id: body for body in was.truth["bodies"]}
    placed = {body.id: body for body in now.truth["bodies"]}
    assert {"WEST", "EAST"} <= set(placed)
    for name in ("WEST", "EAST"):
        for key in ("x", "y", "vx", "vy"):
            assert getattr(placed[name], key) == pytest.approx(getattr(before[name], key), abs=0.05)
    assert main([*command, "--check", CHECK, "--output", str(output)]) != 0
    assert "the scenario is there already" in capsys.readouterr().err


def test_the_junction_is_where_a_crossing_car_is_on_its_lane(crash, tmp_path) -> None:
    episode, ticks = crash
    one = {name: each for name, each in moved(poses(ticks)).items() if not name.startswith("EAST")}
    mapping = mapped(ticks)
    del mapping["world"]["driving"]["objects"]["EAST"]
    text, _ = scenario_file(str(written(tmp_path / "l.csv", one)), mapping, CHECK, "one")
    world = yaml.safe_load(text)["world"]
    first = int(np.argmax(episode.signal("gap") <= 0)) - round(BEFORE / 0.1)
    distance = episode.spec.scenario["world"]["ego"]["distance"]
    expected = distance - episode.signal("progress")[first]
    assert world["ego"]["distance"] == pytest.approx(expected, abs=0.05)


def test_someone_on_foot_crosses_again(tmp_path) -> None:
    episode, ticks = simulated("intersection/pedestrian-crossing")
    (walker,) = episode.spec.scenario["world"]["pedestrians"]
    columns = {
        name: column
        for name, column in moved(poses(ticks)).items()
        if name.startswith(("ego.", f"{walker['id']}."))
    }
    log = written(tmp_path / "drive.csv", columns)
    mapping = {"time_step": 0.1, "world": {"driving": {}}}
    mapping["world"]["driving"]["objects"] = {walker["id"]: sizes(ticks)[walker["id"]]}
    near = float(episode.signal("gap").min()) + 8.0
    text, notes = scenario_file(str(log), mapping, f"always (gap > {near})", "again")
    world = yaml.safe_load(text)["world"]
    (found,) = world["pedestrians"]
    assert {
        "id": walker["id"],
        "arm": walker["arm"],
        "side": walker["side"],
    }.items() <= found.items()
    assert found["speed"] == pytest.approx(walker["speed"], abs=0.02)
    assert f"where {walker['id']} crosses 3 m before" in " ".join(notes)


def test_who_runs_faster_than_a_scenario_lets_anyone_is_said_to_be_slower(tmp_path) -> None:
    episode, ticks = simulated("intersection/pedestrian-crossing")
    (walker,) = (each["id"] for each in episode.spec.scenario["world"]["pedestrians"])
    columns = {
        name: column * (4.0 if name.startswith(f"{walker}.v") else 1.0)
        for name, column in moved(poses(ticks)).items()
        if name.startswith(("ego.", f"{walker}."))
    }
    log = str(written(tmp_path / "drive.csv", columns))
    objects = {walker: sizes(ticks)[walker]}
    mapping = {"time_step": 0.1, "world": {"driving": {"objects": objects}}}
    near = float(episode.signal("gap").min()) + 8.0
    text, notes = scenario_file(log, mapping, f"always (gap > {near})", "again")
    (found,) = yaml.safe_load(text)["world"]["pedestrians"]
    assert found["speed"] == 3.0
    assert "m/s, and walks 3 m/s." in " ".join(notes)


def test_sizes_and_places_that_a_scenario_does_not_keep_stand_in_it(crash, tmp_path) -> None:
    episode, ticks = crash
    columns = moved(poses(ticks))
    first = int(np.argmax(episode.signal("gap") <= 0)) - round(BEFORE / 0.1)
    heading = columns["WEST.heading"][first]
    columns["WEST.x"] = columns["WEST.x"] + 0.4 * np.sin(heading)  # to the right of its way
    columns["WEST.y"] = columns["WEST.y"] - 0.4 * np.cos(heading)
    mapping = mapped(ticks)
    mapping["world"]["driving"]["objects"]["EAST"] = {"length": 12.0, "width": 2.5}
    log = str(written(tmp_path / "drive.csv", columns))
    text, notes = scenario_file(log, mapping, CHECK, "crossing")
    found = " ".join(notes)
    assert "EAST was 12.0 m long and 2.5 m wide, and is a car of 5 m by 2 m." in found
    # The junction is in the middle of where both have it.
    for name in ("EAST", "WEST"):
        assert f"{name} was 0.2 m to the right of the middle of its lane" in found
    assert all(f"# {note}" in text for note in notes)


def test_what_no_scenario_can_be_made_of_is_refused(crash, tmp_path, capsys) -> None:
    _, ticks = crash
    log = written(tmp_path / "drive.csv", poses(ticks))
    mapping = tmp_path / "mapping.yaml"
    world = mapped(ticks) | {"world": {"driving": {"axes": "left-handed"}}}
    mapping.write_text(yaml.safe_dump(world))
    output = ["--output", str(tmp_path / "s.yaml")]
    command = ["logs", "scenario-from-log", str(log)]
    for arguments, problem in (
        (["--mapping", str(mapping), "--check", "always (gap >= 0)", *output], "does not violate"),
        (["--check", CHECK, *output], "the mapping names no world"),
        (["--mapping", str(mapping), *output], "needs --check"),
        (["--mapping", str(mapping), "--check", CHECK, *output, "--before=0.5"], "not on its arm"),
    ):
        code = None
        try:
            code = main([*command, *arguments])
        except SystemExit as error:
            code = error.code
        seen = capsys.readouterr()
        assert problem in seen.err + seen.out + str(code)
        assert code != 0
    assert not (tmp_path / "s.yaml").exists()


def test_drives_with_poses_are_judged_and_shown_in_the_player(crash, project) -> None:
    _episode, ticks = crash
    written(project.path / "drive.csv", moved(poses(ticks)))
    project.write("mapping.yaml", yaml.safe_dump(mapped(ticks)))
    project.write("requirements.yaml", REQUIREMENTS)
    result = project.run(
        "--dura-log=drive.csv",
        "--dura-log-mapping=mapping.yaml",
        "--dura-requirements=requirements.yaml",
    )
    assert result.ret == 1
    assert project.verdict("LOG-1", "drive.csv").verdict == "violated"
    assert project.verdict("LOG-2", "drive.csv").verdict == "violated"
    page = (project.path / "dura-evidence" / "report.html").read_text("utf-8")
    assert "EGO" in page
    assert "WEST" in page
