"""A monitor by a formula, named in a scenario file or returned by the fixture."""

from __future__ import annotations

import pytest

LOOK = """
def test_it(orchestrator):
    episode = orchestrator.run("corridor/tight")
    (times, scores) = episode.metrics.robustness[{role!r}]
    assert [round(one, 6) for one in scores] == [
        round(one - {bound}, 6) for one in episode.signals["gap"][:-1]
    ]
    flags = episode.metrics.flags[{role!r}]
    assert flags == [tick for tick, one in enumerate(scores) if one <= 0]
"""
ROLES = 'roles: {generator: "corridor:Careful"'


def with_monitor(project, role, formula, more=""):
    file = project.path / "scenarios/corridor/tight.yaml"
    text = file.read_text()
    assert ROLES in text
    path = "pytest_dura:StlSafetyMonitor"
    entry = f'{role}: {{path: "{path}", params: {{formula: "{formula}"{more}}}}}'
    file.write_text(text.replace(ROLES, f"{ROLES}, {entry}"))


@pytest.mark.parametrize("role", ["safety_monitor", "stl_monitor"])
def test_a_scenario_names_it(project, role):
    with_monitor(project, role, "historically (gap > 3.9)")
    project.write("test_it.py", LOOK.format(role=role, bound=3.9))
    project.run("test_it.py", "corridor/tight").assert_outcomes(passed=2)


def test_the_fixture_returns_it(project):
    project.write(
        "conftest.py",
        "import pytest\n"
        "from pytest_dura import RoleSpec\n"
        "@pytest.fixture(scope='session')\n"
        "def safety_monitor():\n"
        "    return RoleSpec('pytest_dura:StlSafetyMonitor', {'formula': 'gap > 3.9'})\n",
    )
    project.write("test_it.py", LOOK.format(role="safety_monitor", bound=3.9))
    project.run("test_it.py", "corridor/tight").assert_outcomes(passed=2)


@pytest.mark.parametrize(
    "formula, more, told",
    [
        ("eventually[0:1] (gap > 2)", "", "a monitor cannot know the future"),
        ("gab > 2", "", "there is no channel 'gab'"),
        ("gap > 2", ", horizon: 3", "does not take these parameters"),
    ],
)
def test_what_it_cannot_judge_by_is_told_without_a_traceback(project, formula, more, told):
    with_monitor(project, "stl_monitor", formula, more)
    result = project.run("corridor/tight")
    assert result.ret != 0
    text = result.stdout.str() + result.stderr.str()
    assert told in text
    assert "Traceback" not in text
