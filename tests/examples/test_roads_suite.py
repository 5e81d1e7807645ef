"""The suite of other roads, copied and run as a user would, and files whose road cannot be."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest
import yaml
from forked_workers import ForkedWorkers
from suites import REPOSITORY, SUITES, run_suite

from pytest_dura.core import ConfigurationError
from pytest_dura.driving import BUILT_IN, HighwaySimulator
from pytest_dura.library import load_scenarios

SCENARIO = """\
name: roads/wrong
simulator: driving
duration: 20.0
runs: 1
world:
  {road}
  ego: {ego}
requirements: [SAF-1]
"""


@pytest.fixture
def suite(tmp_path: Path) -> Path:
    return shutil.copytree(SUITES / "roads", tmp_path / "my_suite")


def test_the_suite_passes_on_each_road(suite: Path) -> None:
    done = run_suite(suite)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "18 passed" in done.stdout
    record = json.loads((suite / "dura-evidence" / "evidence.json").read_text())
    reached = {(each["requirement"], each["case"]): each["verdict"] for each in record["verdicts"]}
    roads = ("merge", "skew", "t-junction", "wide")
    assert reached == {
        **{("ROAD-1", f"roads/{road}"): "supported" for road in roads},
        **{("ROAD-2", f"roads/{road}"): "supported" for road in ("merge", "t-junction")},
    }


def test_a_component_that_never_gives_way_collides_on_them(
    suite: Path, forked_workers: ForkedWorkers
) -> None:
    """The roads are no easy pass: whoever drives on without looking is seen to."""
    roles = "\npolicy: log_only\nroles:\n  generator: aggressive\n"
    file = suite / "scenarios" / "t-junction.yaml"
    text = file.read_text().replace("\npolicy: recover\n", roles)
    text = text.replace("\nvariation:\n  world.traffic.headway: {min: 20.0, max: 24.0}\n", "\n")
    text = text.replace("  traffic: {headway: 22.0}", "  traffic: {headway: 6.0}\nvariation:")
    file.write_text(text.replace("requirements: [SAF-1, SAF-2]", "requirements: [SAF-4]"))
    chosen = ["--dura-scenarios", "--dura-select=roads/t-junction"]
    done = run_suite(suite, *chosen, python=forked_workers.command())
    assert done.returncode == 1, done.stdout + done.stderr
    assert re.search(r"violated: safety on roads/t-junction ", done.stdout), done.stdout


WRONG = {
    "name": ("road: t_junctoin", "{to: west}", 6, "world.road", "did you mean 't_junction'?"),
    "turn": ("road: t_junction", "{distance: 40.0}", 7, "world.ego.turn", "left (to west)"),
    "arm": ("road: merge", "{arm: ramq}", 7, "world.ego.arm", "did you mean 'ramp'?"),
    "far": ("road: four_way", "{distance: 120.0}", 7, "world.ego.distance", "at most 95 m"),
    "bearing": (
        "road: {arms: [{name: a, bearing: 0}, {name: b, bearing: 400}]}",
        "{}",
        6,
        "world.road.arms.1.bearing",
        "less than 360",
    ),
    "near": (
        "road: {arms: [{name: a, bearing: 0}, {name: b, bearing: 10}]}",
        "{}",
        6,
        "world.road.arms.0.bearing",
        "at least 30 degrees",
    ),
}
"""By file: the road, the ego, and line, key and expectation of the error."""


def write_wrong(folder: Path, name: str) -> Path:
    road, ego, *_ = WRONG[name]
    file = folder / f"{name}.yaml"
    file.write_text(SCENARIO.replace("{road}", road).replace("{ego}", ego))
    return file


@pytest.mark.parametrize("name", WRONG)
def test_a_file_whose_road_cannot_be_is_refused_at_its_line(tmp_path: Path, name: str) -> None:
    _, _, line, key, expected = WRONG[name]
    file = write_wrong(tmp_path, name)
    with pytest.raises(ConfigurationError) as caught:
        load_scenarios([file])
    error = caught.value
    assert (error.line, error.key) == (line, key)
    assert error.file is not None
    assert Path(error.file).name == file.name
    assert error.found is not None
    assert expected in str(error)


def test_a_user_sees_where_the_route_leaves_the_road(
    suite: Path, forked_workers: ForkedWorkers
) -> None:
    write_wrong(suite / "scenarios", "turn")
    collected = ["--dura-scenarios", "--collect-only"]
    done = run_suite(suite, *collected, python=forked_workers.command())
    output = done.stdout + done.stderr
    assert done.returncode != 0
    assert "turn.yaml:7: on the road t_junction, straight from the arm south leaves" in output
    assert "Traceback" not in output


def test_the_roads_of_the_page_are_ones_that_a_scenario_may_have() -> None:
    page = (REPOSITORY / "docs" / "roads.md").read_text("utf-8")
    worlds = [
        yaml.safe_load(text)["world"] for text in re.findall(r"```yaml\n(.*?)```", page, re.DOTALL)
    ]
    checked = [HighwaySimulator.check_scenario(world) for world in worlds]
    assert [world["ego"]["to"] for world in checked] == ["west", "hill"]
    named = re.findall(r"^\| `(\w+)`(?: \(default\))? \| (?:a|the|arms) ", page, re.MULTILINE)
    assert set(BUILT_IN) <= set(named)
