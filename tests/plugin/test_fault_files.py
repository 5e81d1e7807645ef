"""Faults that cannot be: refused at collection, in files, markers and on the command line."""

from __future__ import annotations

import pytest
from outputs import output, shown_of

SCENARIO = """\
name: cross/one
simulator: driving
duration: 20.0
runs: 1
faults:
  - {type: ghost-obstacle, activation: {at: 2.0}, duration: 4.0}
  - {type: bias, id: late, activation: {after: {fault: ghost-obstacle}}}
"""

BAD = """\
name: cross/two
simulator: driving
duration: 20.0
runs: 1
faults:
  - type: bias
    target: odometry.sped
    activation: {at: 2.0}
  - type: freeze
    activation: {probability: -0.1}
  - type: delay
    activation: {when: odometry.speed = 5}
    duration: {min: 3, max: 2}
"""

MARKED = """\
import pytest

@pytest.mark.dura(scenario="cross/one", faults=[FAULTS])
def test_it(episode):
    raise AssertionError("nothing may run")
"""


@pytest.fixture
def crossing(project):
    project.write("scenarios/cross.yaml", SCENARIO)
    return project


def told(result):
    """What pytest says, of which nothing may be a traceback."""
    text = output(result)
    for leaked in ("Traceback", "INTERNALERROR", "pydantic", "Value error", "Input should"):
        assert leaked not in text
    return text


def test_all_that_is_wrong_with_a_file_is_one_error_before_anything_runs(crossing):
    crossing.write("scenarios/bad.yaml", BAD)
    result = crossing.scenarios(select="cross/*")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    text = told(result)
    file = crossing.path / "scenarios" / "bad.yaml"
    assert f"{file}:7: the fault 'bias' cannot act on 'odometry.sped'" in text
    assert "key:      faults.0.target" in text
    assert "found:    'odometry.sped'" in text
    assert "expected: one of imu.acceleration" in text
    assert "remedy:   did you mean 'odometry.speed'?" in text
    assert f"also:     {file}:10: the fault 'freeze' cannot be used: 'probability' must be" in text
    assert f"also:     {file}:12: the fault 'delay' cannot be used: 'odometry.speed = 5'" in text


REFUSED = [
    (
        '"late"',
        "faults.0.activation.after.fault",
        "'late' waits for 'ghost-obstacle', which is not planned with it",
        "ghost-obstacle+late",
    ),
    (
        '{"type": "bias", "target": "lidar", "activation": {"at": 1.0}}',
        "target",
        "cannot act on 'lidar': it acts on a number",
        "choose a target",
    ),
    (
        '{"type": "bias", "activation": {"at": 1.0, "rate": 2.0}}',
        "activation",
        "at and rate contradict each other",
        "keep one of them",
    ),
    (
        '{"type": "bias", "activation": {"at": 1.0, "evry": 2.0}}',
        "activation.evry",
        "unknown key 'evry'",
        "did you mean 'every'?",
    ),
    (
        '{"type": "bias", "activation": {"at": 20.0}}',
        "activation.at",
        "can only begin at 20 s, when the episode is over",
        "let it begin earlier",
    ),
]


def test_a_marker_s_faults_are_refused_at_the_test(crossing):
    for n, (faults, *_) in enumerate(REFUSED):
        crossing.write(f"test_{n}.py", MARKED.replace("FAULTS", faults).replace("_it", f"_{n}"))
    result = crossing.run(*(f"test_{n}.py" for n in range(len(REFUSED))))
    assert result.ret == pytest.ExitCode.TESTS_FAILED
    assert "nothing may run" not in told(result)
    for n, (_, key, problem, remedy) in enumerate(REFUSED):
        text = str(shown_of(result)[f"test_{n}"])
        assert f"test_{n}.py:3: " in text
        assert problem in text
        assert f"key:      {key}\n" in text
        assert remedy in text


def test_faults_on_the_command_line_are_refused_alike(crossing):
    result = crossing.scenarios("--dura-faults=late", select="cross/*")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    assert "'late' waits for 'ghost-obstacle', which is not planned with it" in told(result)


def test_the_card_of_a_fault_on_a_channel_that_is_missing_names_it_and_those_that_there_are(
    project,
):
    scenario = project.path / "scenarios/corridor/free.yaml"
    fault = "{id: stuck, type: freeze, target: gage, activation: {at: 0.2}, duration: 0.5}"
    scenario.write_text(f"{scenario.read_text()}faults:\n  - {fault}\n")
    section = " ".join(output(project.run("corridor/free")).partition("= dura =")[2].split())
    assert (
        "No run of corridor/free could be judged: the fault 'stuck' cannot be used: there is no "
        "channel 'gage'; key: target; found: 'gage'; expected: one of gap, command;"
    ) in section
    assert section.count("could be judged") == 1, "one cause, whatever the requirements"
    assert "Mend what it names" in section
    assert "were not run" not in section
    items = {"corridor/free::GAP-1", "corridor/free::GO-1"}
    assert project.evidence().stopped_items.keys() == items
