from __future__ import annotations

import pytest
from corridors import scenario


@pytest.mark.parametrize(
    "arguments, lines",
    [
        (
            ["--dura-runs=many"],
            ["ERROR: --dura-runs takes a whole number", "  found:    'many'", "*at least 1*"],
        ),
        (["--dura-runs=0"], ["ERROR: --dura-runs takes a whole number", "*at least 1*"]),
        (
            ["--dura-time-budget=nan"],
            ["ERROR: --dura-time-budget takes a number of seconds", "  found:    'nan'"],
        ),
        (["--dura-time-budget=0"], ["ERROR: --dura-time-budget takes a number*", "*above 0*"]),
        (["--dura-seed=-1"], ["ERROR: --dura-seed takes a whole number", "*at least 0*"]),
        (
            ["--dura-path=nowhere"],
            ["ERROR: there is no such directory", "  key:      --dura-path", "*nowhere*"],
        ),
        (
            ["--dura-select=corridor/fre"],
            ["ERROR: no case matches 'corridor/fre'", "*did you mean 'corridor/free'?"],
        ),
        (
            ["--dura-generator=reactiv"],
            ["ERROR: unknown generator 'reactiv'", "*did you mean 'reactive'?"],
        ),
        (
            ["--dura-generator=nowhere:Planner"],
            ["ERROR: cannot import 'nowhere:Planner'*", "  key:      --dura-generator", "*remedy*"],
        ),
        (
            ["--dura-generator=corridor:Planner"],
            ["ERROR: cannot import 'corridor:Planner'*", "  key:      --dura-generator"],
        ),
        (
            ["--dura-generator=corridor:NoGenerator"],
            ["ERROR: corridor:NoGenerator is not a Generator", "*derive it from*"],
        ),
        (
            ["--dura-generator=pytest_dura:Generator"],
            ["ERROR: pytest_dura:Generator lacks propose", "*define propose in Generator"],
        ),
        (
            ["--dura-generator=corridor:STEPS"],
            ["ERROR: 'corridor:STEPS' is neither a class nor a factory *"],
        ),
        (["--dura-evidence=pytest.ini"], ["ERROR: the evidence goes into a directory*"]),
    ],
)
def test_a_wrong_value_is_one_usage_error(project, arguments, lines):
    is_one_usage_error(project.run("--dura-scenarios", *arguments), lines)


@pytest.mark.parametrize("argument", ["--dura-runs=many", "--dura-generator=corridor:Planner"])
def test_a_wrong_value_is_one_usage_error_beside_workers_too(project, argument):
    """One is refused as options are read, the other as the session is planned."""
    is_one_usage_error(project.run("--dura-scenarios", argument, "-n", "2"), ["ERROR: *"])


def is_one_usage_error(result, lines):
    assert result.ret == 4
    result.stderr.fnmatch_lines(lines)
    text = result.stdout.str() + result.stderr.str()
    assert text.count("ERROR") == 1
    assert "Traceback" not in text
    assert "INTERNALERROR" not in text


def test_select_without_scenarios(project):
    result = project.run("--dura-select=corridor/*")
    assert result.ret == 4
    result.stderr.fnmatch_lines(
        ["ERROR: --dura-select chooses*", "  remedy:   add --dura-scenarios*"]
    )


def test_a_broken_scenario_file_is_one_usage_error(project):
    project.write("scenarios/broken.yaml", "name: broken\nsimulator: driving\nduratoin: 3\n")
    result = project.run("--dura-scenarios")
    assert result.ret == 4
    result.stderr.fnmatch_lines(["ERROR: *scenarios/broken.yaml:*", "*duratoin*"])
    assert "Traceback" not in result.stderr.str()


def test_more_directories(project):
    folder = project.path / "more"
    folder.mkdir()
    text = (project.path / "scenarios/corridor/tight.yaml").read_text()
    (folder / "other.yaml").write_text(text.replace("corridor/tight", "other/tight"))
    result = project.scenarios("--dura-path=more", select="other/*")
    result.assert_outcomes(passed=1)
    assert "--dura-path=more" in project.evidence().command


def test_ini_replaces_the_default_directory(project):
    (project.path / "scenarios").rename(project.path / "mine")
    project.write("pytest.ini", "[pytest]\npythonpath = .\ndura_scenario_paths = mine\n")
    project.scenarios().assert_outcomes(passed=3)


def test_ini_with_a_directory_that_does_not_exist(project):
    project.write("pytest.ini", "[pytest]\ndura_scenario_paths = nowhere\n")
    result = project.run("--dura-scenarios")
    assert result.ret == 4
    result.stderr.fnmatch_lines(["ERROR: there is no such directory", "*ini dura_scenario_paths"])


def test_list_shows_everything_and_runs_nothing(project):
    result = project.run("--dura-list", "--dura-select=corridor/*", "--dura-runs=7")
    assert result.ret == 0
    result.stdout.fnmatch_lines(
        [
            "  corridor/free: Nothing but a wall far away.",
            "      3 runs, 2 s each, faults: none",
            "      requirements: GAP-1, GO-1",
            "  intersection/ghost-obstacle:*",
            "  ghost-obstacle (objects): *",
            "  GAP-1 (safety): It touches nothing.",
            "  safety_monitor: *",
            "  rule_based: *",
            "  corridor/free::GO-1",
            "3 items, 2 cases, 14 episodes",
        ]
    )
    assert "test session starts" not in result.stdout.str()
    assert not (project.path / "dura-evidence").exists()


def test_the_evidence_goes_where_it_is_told_to(project):
    project.scenarios("--dura-evidence=out/here")
    assert project.evidence("out/here").status == "complete"
    assert not (project.path / "dura-evidence").exists()


def test_evidence_that_cannot_be_written(project):
    result = project.scenarios("--dura-evidence=pytest.ini/below")
    assert result.ret == 4
    result.stderr.fnmatch_lines(["ERROR: the evidence cannot be written: Not a directory"])


def test_a_time_budget_replaces_that_of_the_scenarios(project):
    scenario(project)  # with a budget of its own, as the others have none
    result = project.scenarios("--dura-time-budget=1.5", "--dura-runs=1")
    episodes = project.evidence().episodes
    assert {one.case for one in episodes} == {"corridor/free", "corridor/it", "corridor/tight"}
    assert {one.spec.time_budget for one in episodes} == {1.5}
    assert "--dura-time-budget=1.5" in result.stdout.str()
