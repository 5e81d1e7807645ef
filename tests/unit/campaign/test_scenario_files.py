"""Scenario files that cannot be used: each message names file, line, key and remedy."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import pytest

from pytest_dura import ConfigurationError
from pytest_dura.library import Scenario, load_library, load_scenarios, parse_yaml

HEAD = """\
name: room/warm
simulator: thermostat:Thermostat
duration: 4.0
roles: {generator: "thermostat:Controller"}
"""
DRIVING = """\
name: intersection/some
simulator: driving
duration: 40.0
"""
SHAFT = """\
name: shaft/some
simulator: lift_dura.domain:Lift
domain: shaft:SHAFT
duration: 40.0
"""
FAULT = """\
faults:
  - type: bias
    activation: {at: 2.0}
    duration: 4.0
"""


class Bad(NamedTuple):
    text: str
    line: int
    key: str
    problem: str
    remedy: str


CASES = {
    "a misspelt key": Bad(HEAD + "rans: 3\n", 5, "rans", "unknown key 'rans'", "mean 'runs'"),
    "a key like no other": Bad(HEAD + "zzzz: 3\n", 5, "zzzz", "unknown key", "description"),
    "a wrong type": Bad(HEAD + "runs: many\n", 5, "runs", "a valid integer", "correct"),
    "a number as text": Bad(HEAD + "time_step: '1'\n", 5, "time_step", "valid number", "correct"),
    "a boolean as number": Bad(HEAD + "runs: true\n", 5, "runs", "valid integer", "correct"),
    "no runs": Bad(HEAD + "runs: 0\n", 5, "runs", "greater than or equal to 1", "correct"),
    "a negative duration": Bad(
        HEAD.replace("4.0", "-4.0"), 3, "duration", "'duration' must be greater than 0", "correct"
    ),
    "no duration": Bad(
        HEAD.replace("duration: 4.0\n", ""), 1, "duration", "'duration' is missing", "add `duration"
    ),
    "no iteration at all": Bad(
        HEAD + "iterations: 0\n", 5, "iterations", "'iterations' must be greater than or", "correct"
    ),
    "a time step beyond the duration": Bad(
        HEAD + "time_step: 5.0\n", 1, "", "time step is longer than the duration", "correct"
    ),
    "a zero time step": Bad(HEAD + "time_step: 0\n", 5, "time_step", "greater than 0", "correct"),
    "a negative budget": Bad(HEAD + "time_budget: -1\n", 5, "time_budget", "greater", "correct"),
    "a policy": Bad(HEAD + "policy: refine(0)\n", 5, "policy", "recover, halt", "correct"),
    "a name with a plus": Bad(HEAD.replace("warm", "wa+rm"), 1, "name", "pattern", "correct"),
    "an interval": Bad(
        HEAD + "variation:\n  world.start: {min: 3, max: 2}\n",
        6,
        "variation.world.start",
        "min is above max",
        "correct",
    ),
    "half an interval": Bad(
        HEAD + "variation:\n  world.start: {min: 3}\n",
        6,
        "variation.world.start.max",
        "'max' is missing",
        "add `max",
    ),
    "an empty choice": Bad(
        HEAD + "variation:\n  world.start: {choice: []}\n",
        6,
        "variation.world.start.choice",
        "at least one entry",
        "correct",
    ),
    "a path that cannot be varied": Bad(
        HEAD + "variation:\n  wrld.start: {min: 2, max: 3}\n",
        6,
        "variation.wrld.start",
        "cannot be varied",
        "did you mean 'world'?",
    ),
    "a path that does not exist": Bad(
        HEAD + "world: {start: 3}\nvariation:\n  world.stat: {min: 2, max: 3}\n",
        7,
        "variation.world.stat",
        "there is no 'stat' to vary",
        "did you mean 'start'?",
    ),
    "a path below a number": Bad(
        HEAD + "world: {start: 3}\nvariation:\n  world.start.x: {min: 2, max: 3}\n",
        7,
        "variation.world.start.x",
        "there is no 'x' to vary",
        "remove it",
    ),
    "variation of a fault that is not there": Bad(
        SHAFT + FAULT + "variation:\n  faults.gost.activation.at: {min: 1, max: 2}\n",
        10,
        "variation.faults.gost.activation.at",
        "no fault 'gost'",
        "bias",
    ),
    "variation that a fault refuses": Bad(
        SHAFT + FAULT + "variation:\n  faults.bias.activation.at: {min: -1, max: 2}\n",
        10,
        "variation.faults.bias.activation.at",
        "cannot take the value -1.0",
        "choose values",
    ),
    "variation that the world refuses": Bad(
        SHAFT + "variation:\n  world.floor: {min: -1, max: 2}\n",
        6,
        "variation.world.floor",
        "cannot take the value -1.0",
        "choose values",
    ),
    "an unknown fault": Bad(
        SHAFT + "faults:\n  - type: bais\n    activation: {at: 1}\n",
        6,
        "faults.0.type",
        "unknown fault 'bais'",
        "did you mean 'bias'?",
    ),
    "a misspelt key of a fault": Bad(
        SHAFT + "faults:\n  - type: bias\n    activation:\n      att: 1\n",
        8,
        "faults.0.activation.att",
        "cannot be used",
        "did you mean 'at'?",
    ),
    "a fault's number as text": Bad(
        SHAFT + "faults:\n  - type: bias\n    activation: {at: '1'}\n",
        7,
        "faults.0.activation.at",
        "valid number",
        "correct",
    ),
    "a negative time of a fault": Bad(
        SHAFT + "faults:\n  - type: bias\n    activation: {at: -1}\n",
        7,
        "faults.0.activation.at",
        "greater than or equal to 0",
        "correct",
    ),
    "a negative duration of a fault": Bad(
        SHAFT + FAULT.replace("4.0", "-4.0"), 8, "faults.0.duration", "greater than 0", "correct"
    ),
    "two faults of one id": Bad(
        SHAFT + FAULT + FAULT.removeprefix("faults:\n"), 1, "", "listed twice: bias", "correct"
    ),
    "a misspelt key of the world": Bad(
        SHAFT + "world:\n  flor: 3\n",
        6,
        "world.flor",
        "unknown key 'flor'",
        "did you mean 'floor'?",
    ),
    "a wrong type in the world": Bad(
        SHAFT + "world:\n  floor: high\n",
        6,
        "world.floor",
        "valid number",
        "correct",
    ),
    "two bodies of one id": Bad(
        DRIVING + "world:\n  vehicles:\n    - {id: EGO, arm: west, distance: 20}\n",
        5,
        "world.vehicles",
        "the same id",
        "correct",
    ),
    "a simulator's misspelt alias": Bad(
        DRIVING.replace("driving", "drivin"), 2, "simulator", "unknown simulator", "mean 'driving'?"
    ),
    "a simulator that cannot be imported": Bad(
        DRIVING.replace("driving", "nowhere:Sim"), 2, "simulator", "cannot import", "spelling"
    ),
    "a simulator's parameters": Bad(
        HEAD.replace("thermostat:Thermostat", "{path: thermostat:Thermostat, params: {x: 1}}"),
        2,
        "simulator",
        "does not take these parameters",
        "correct the parameters",
    ),
    "a role that does not exist": Bad(
        HEAD.replace("Controller", "Controler"), 4, "roles.generator", "cannot import", "spelling"
    ),
    "a module that does not exist": Bad(
        HEAD.replace('"thermostat:C', '"thermstat:C'), 4, "roles.generator", "thermstat", "spelling"
    ),
    "an unknown short name": Bad(
        DRIVING + "roles: {generator: reactiv}\n",
        4,
        "roles.generator",
        "unknown generator 'reactiv'",
        "did you mean 'reactive'?",
    ),
    "a role's name misspelt": Bad(
        HEAD + "requirements: []\n".replace("requirements", "requirments"),
        5,
        "requirments",
        "unknown key",
        "did you mean 'requirements'?",
    ),
    "a role misspelt": Bad(
        HEAD.replace("generator:", "genrator:"),
        4,
        "roles.genrator",
        "there is no role 'genrator'",
        "did you mean 'generator'?",
    ),
    "switching off a role that is not there": Bad(
        HEAD.replace("}", ", watch: null}"), 4, "roles.watch", "no role 'watch' to switch", "use"
    ),
    "switching off the generator": Bad(
        SHAFT + "roles: {generator: null}\n", 5, "roles.generator", "cannot be switched", "name"
    ),
    "a role of the wrong kind": Bad(
        HEAD.replace("Controller", "HeatMonitor"),
        4,
        "roles.generator",
        "is not a Generator",
        "derive it from pytest_dura.Generator",
    ),
    "a fault given by its name alone": Bad(
        SHAFT + "faults: [stuck-at]\n",
        5,
        "faults.0",
        "no mapping",
        "write `{type: stuck-at, ...}`",
    ),
    "a role's parameters": Bad(
        HEAD.replace('"thermostat:Controller"', "{path: 'thermostat:Controller', params: {zz: 1}}"),
        4,
        "roles.generator",
        "does not take these parameters",
        "correct the parameters",
    ),
    "a requirement twice": Bad(
        HEAD + "requirements: [A, A]\n", 5, "requirements", "listed twice: A", "correct"
    ),
}


OF_A_GUEST = ("two bodies of one id", "a simulator's misspelt alias", "an unknown short name")


@pytest.mark.parametrize(
    "bad",
    [
        pytest.param(bad, id=name, marks=[pytest.mark.of_guest] if name in OF_A_GUEST else [])
        for name, bad in CASES.items()
    ],
)
def test_the_message_names_file_line_key_and_remedy(tmp_path: Path, bad: Bad) -> None:
    file = tmp_path / "bad.yaml"
    file.write_text(bad.text)
    with pytest.raises(ConfigurationError) as caught:
        load_scenarios([file])
    error, text = caught.value, str(caught.value)
    assert text.startswith(f"{file}:{bad.line}: ")
    assert (error.key or "") == bad.key
    assert bad.problem in text
    assert bad.remedy in str(error.remedy)
    assert "Traceback" not in text
    assert "pydantic" not in text


def test_all_errors_of_a_file_are_listed_and_the_first_in_full(tmp_path: Path) -> None:
    file = tmp_path / "bad.yaml"
    file.write_text(HEAD + "runs: 0\ntyme_step: 1\npolicy: hope\n")
    with pytest.raises(ConfigurationError) as caught:
        load_scenarios([file])
    lines = str(caught.value).splitlines()
    assert lines[0].startswith(f"{file}:5: 'runs' must be")
    assert "the first of 3 problems" in lines[0]
    also = [line for line in lines if line.startswith("  also:")]
    assert [f"{file}:6:" in also[0], f"{file}:7:" in also[1]] == [True, True]
    assert "did you mean 'time_step'?" in also[0]
    assert len(also) == 2


def test_errors_of_several_files_are_one_message(tmp_path: Path) -> None:
    for stem in "ab":
        (tmp_path / f"{stem}.yaml").write_text(HEAD.replace("warm", stem) + "runs: 0\nrans: 1\n")
    with pytest.raises(ConfigurationError) as caught:
        load_scenarios([tmp_path])
    assert "the first of 4 problems" in str(caught.value)
    assert f"{tmp_path / 'b.yaml'}:6:" in str(caught.value)


def test_a_second_monitor_may_have_a_name_of_its_own(tmp_path: Path) -> None:
    file = tmp_path / "good.yaml"
    roles = '{generator: "thermostat:Controller", safety_monitor_2: "thermostat:HeatMonitor"}'
    file.write_text(HEAD.replace('{generator: "thermostat:Controller"}', roles))
    assert list(load_scenarios([file])["room/warm"].roles) == ["generator", "safety_monitor_2"]


def test_an_unknown_requirement(tmp_path: Path) -> None:
    (tmp_path / "requirements.yaml").write_text(
        "requirements:\n  - {id: HOT-1, text: t, kind: safety, check: always (headroom > 0)}\n"
    )
    file = tmp_path / "room.yaml"
    file.write_text(HEAD + "requirements:\n  - HOT-1\n  - HOT-2\n")
    with pytest.raises(ConfigurationError) as caught:
        load_library([tmp_path], builtin=False)
    error = caught.value
    assert str(error).startswith(f"{file}:7: unknown requirement 'HOT-2'")
    assert error.key == "requirements.1"
    assert error.remedy == "did you mean 'HOT-1'?"


def test_a_scenario_knows_the_lines_of_its_keys() -> None:
    scenario = Scenario.from_document(parse_yaml(HEAD, "some.yaml"))
    assert scenario.file == "some.yaml"
    assert scenario.line_of("roles.generator") == 4


def test_a_scenario_cannot_be_changed() -> None:
    scenario = Scenario.from_document(parse_yaml(HEAD, "some.yaml"))
    with pytest.raises(ValueError, match="frozen"):
        scenario.runs = 3  # type: ignore[misc]


@pytest.mark.parametrize(
    "formula, message",
    [
        ("always (headroom > 0)", "cannot know the future"),
        ("historically[0:0.05] (headroom > 0)", "falls between two samples"),
        ("headroom >", "cannot read the formula"),
    ],
)
def test_a_monitor_with_an_impossible_formula_is_refused(tmp_path, formula, message):
    text = f"""
name: room
simulator: thermostat:Thermostat
duration: 4.0
time_step: 0.1
roles:
  generator: thermostat:Controller
  watch:
    path: pytest_dura:StlSafetyMonitor
    params: {{formula: "{formula}"}}
"""
    (tmp_path / "room.yaml").write_text(text.lstrip())
    with pytest.raises(ConfigurationError, match=message) as caught:
        load_scenarios([tmp_path])
    assert (caught.value.key, caught.value.line) == ("roles.watch", 7)
