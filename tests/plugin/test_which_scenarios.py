"""Which scenarios a gate is made of: the project's own, or the built-in ones."""

from __future__ import annotations

import shutil

import pytest

from pytest_dura.library import builtin_paths, load_library

OWN = "dura: the project's own scenarios; --dura-scenarios=builtin runs the built-in ones"
BUILTIN = "dura: the built-in scenarios"
NONE = f"{BUILTIN}, since the project has none of its own"


def collected(result) -> set[str]:
    lines = result.stdout.lines
    return {line.partition("/")[0] for line in lines if "::" in line and "/" in line}


def test_a_project_runs_its_own_scenarios_alone_and_says_so(project) -> None:
    result = project.run("--dura-scenarios", "--collect-only", "-q")
    assert collected(result) == {"corridor"}
    result = project.run("--dura-scenarios", "--collect-only")
    result.stdout.fnmatch_lines([OWN])


def test_the_builtin_ones_run_by_their_value_which_takes_no_path_that_follows(project) -> None:
    (project.path / "test_it.py").write_text("def test_it(): pass\n")
    result = project.run("--dura-scenarios=builtin", "test_it.py", "--collect-only")
    result.stdout.fnmatch_lines([BUILTIN, "*test_it.py*"])
    result = project.run("--dura-scenarios=builtin", "--collect-only", "-q")
    assert collected(result) == {"intersection"}
    # An ini file may hold the switch: the value counts beside it, as the last one given.
    project.write("pytest.ini", "[pytest]\naddopts = --dura-scenarios\npythonpath = .\n")
    result = project.run("--dura-scenarios=builtin", "--collect-only", "-q")
    assert collected(result) == {"intersection"}


@pytest.mark.parametrize("left", ["requirements.yaml", "found", ""])
def test_without_scenarios_of_its_own_a_project_runs_the_builtin_ones(project, left) -> None:
    """Requirements alone are none, nor are counterexamples, which run beside the built-in ones."""
    own = project.path / "scenarios"
    kept = (own / "corridor/free.yaml").read_text()
    shutil.rmtree(own / "corridor")
    if left == "found":
        project.write("scenarios/found/it.yaml", kept.replace("corridor/free", "found/it"))
    elif not left:
        shutil.rmtree(own)
    result = project.run("--dura-scenarios", "--collect-only")
    result.stdout.fnmatch_lines([NONE])
    result = project.run("--dura-scenarios", "--collect-only", "-q")
    assert collected(result) == {"intersection", *(["found"] if left == "found" else [])}


def test_a_gate_of_scenarios_on_request_alone_is_an_error_and_no_pass(project) -> None:
    (project.path / "test_it.py").write_text("def test_it(): pass\n")
    for file in (project.path / "scenarios").glob("corridor/*.yaml"):
        file.write_text(file.read_text() + "on_request: true\n")
    result = project.run("--dura-scenarios", "test_it.py")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    assert "each of the project's own is on request" in result.stdout.str() + result.stderr.str()
    result = project.run("--dura-scenarios", "--dura-select=corridor/*", "--collect-only", "-q")
    assert collected(result) == {"corridor"}


def test_a_file_in_capitals_is_none_that_is_passed_over(project) -> None:
    own = project.path / "scenarios"
    kept = (own / "corridor/free.yaml").read_text()
    project.write("scenarios/LOUD.YAML", kept.replace("corridor/free", "loud/free"))
    result = project.run("--dura-scenarios", "--collect-only", "-q")
    assert collected(result) == {"corridor", "loud"}


def test_the_checkout_of_this_package_has_none_of_its_own() -> None:
    """Its folder of scenarios is that of the built-in ones, which its gate and its CI run."""
    library = load_library(builtin_paths())
    assert library.own == []
    assert library.gate("project") == library.gate("builtin") == library.scenarios


def test_a_glob_of_builtin_scenarios_is_refused_with_the_option_that_runs_them(project) -> None:
    result = project.run("--dura-scenarios", "--dura-select=intersection/n*")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    text = result.stderr.str()
    assert "'intersection/n*' names a built-in scenario, and the project's own are run" in text
    assert "run the built-in ones by --dura-scenarios=builtin" in text
    result = project.run("--dura-scenarios=builtin", "--dura-select=intersection/n*", "--co", "-q")
    assert collected(result) == {"intersection"}


def test_another_value_is_refused(project) -> None:
    result = project.run("--dura-scenarios=mine")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    assert "--dura-scenarios" in result.stderr.str()
