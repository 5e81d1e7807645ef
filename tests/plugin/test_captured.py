"""What components print, log, warn of and execute in other processes is shown as if done here."""

from __future__ import annotations

import json
import re

import pytest
from corridors import scenario
from outputs import output

EXECUTOR = "auto"

PROCESSES = "--dura-executor=processes:2"
TALKS = """
import logging, sys, warnings
from corridor import Careful

class Talks(Careful):
    def reset(self, context):
        super().reset(context)
        print("printed by the component")
        print("an error by the component", file=sys.stderr)
        logging.getLogger("talks").warning("logged by the %s", "component")
        logging.getLogger("talks").info("only where levels say so")
        warnings.warn("careless, says the component", UserWarning)
        try:
            1 / 0
        except ZeroDivisionError:
            logging.getLogger("talks").exception("it failed")
"""
TEST = """
import pytest

def test_seen(orchestrator, capsys, caplog):
    with caplog.at_level("INFO", "talks"), pytest.warns(UserWarning, match="careless"):
        orchestrator.run("corridor/it", seed=5)
    assert "only where levels say so" in caplog.messages
    record = next(each for each in caplog.records if each.msg == "it failed")
    assert "1 / 0" in record.exc_text
    out, error = capsys.readouterr()
    assert "printed by the component" in out
    assert "an error by the component" in error
"""


@pytest.fixture
def talking(project):
    project.write("talks.py", TALKS)
    scenario(project, generator="talks:Talks", runs=1, requirements="[GO-1]", duration=0.2)
    project.write("pytest.ini", "[pytest]\npythonpath = .\nfilterwarnings = default\n")
    return project


@pytest.fixture(params=["--dura-executor=in-process", PROCESSES, "dask"])
def executor(request):
    """Option that chooses who simulates."""
    return executor_of(request, request.param)


def executor_of(request, option):
    return request.getfixturevalue("dask_worker").executor if option == "dask" else option


def test_what_a_component_says_is_shown_with_the_item_that_asked_for_its_episode(talking, executor):
    text = output(talking.scenarios(executor, select="corridor/it"))
    pattern = r"^-+ Captured (\w+) call -+\n((?:(?!---|===).*\n)*)"
    sections = dict(re.findall(pattern, text, re.MULTILINE))
    assert "printed by the component" in sections["stdout"]
    assert "an error by the component" in sections["stderr"]
    assert "logged by the component" in sections["log"]
    assert "1 / 0" in sections["log"], "with the traceback"
    assert "only where levels say so" not in text
    assert "UserWarning: careless, says the component" in text


def test_capsys_caplog_and_warns_of_a_test_see_it(talking, executor):
    talking.write("test_it.py", TEST)
    talking.run(executor, "test_it.py").assert_outcomes(passed=1)


def test_without_capture_it_is_shown_at_once(talking):
    text = output(talking.scenarios(PROCESSES, "-s", select="corridor/it"))
    assert "printed by the component" in text.partition("FAILURES")[0]


MEASURED = """
from corridor import Careful

def far(view):
    return view.index > 2

class Measured(Careful):
    def propose(self, view):
        if far(view):
            return super().propose(view)
        elif view.index > 1000:
            never = 1
            return never
        return super().propose(view)
"""


def test_coverage_counts_what_other_processes_execute(project, dask_worker):
    pytest.importorskip("pytest_cov")
    project.write("measured.py", MEASURED)
    scenario(project, generator="measured:Measured", requirements="[GAP-1]")
    counted = {}
    executors = ["--dura-executor=in-process", PROCESSES, dask_worker.executor]
    for executor in executors:
        result = project.run_apart(
            "corridor/it", executor, "-p", "pytest_cov", "--cov=measured",
            "--cov-branch", "--cov-report=json",
        )  # fmt: skip
        assert result.ret == 0, output(result)
        (file,) = json.loads((project.path / "coverage.json").read_text())["files"].values()
        counted[executor] = file["executed_lines"], file["missing_branches"]
        assert not list(project.path.glob(".coverage.*")), "nothing is left to combine"
    result.stdout.fnmatch_lines(
        ["dura: * by Dask, *; coverage counts its workers on this machine only"]
    )
    here, *elsewhere = (counted[each] for each in executors)
    assert elsewhere == [here, here]
    assert len(here[0]) == 9


STOPS = """
from corridor import Careful

class Stops(Careful):
    def propose(self, view):
        breakpoint()
        return super().propose(view)
"""


@pytest.mark.parametrize("how", ["", "--dura-executor=in-process", "--pdb", "dask"])
def test_a_breakpoint_opens_in_pytests_process_and_to_quit_it_ends_the_session(
    project, how, request
):
    project.write("stops.py", STOPS)
    scenario(project, generator="stops:Stops", runs=2, requirements="[GAP-1]")
    options = executor_of(request, how).split()
    command = project.workers.command(
        "-m", "pytest", "-p", "no:cacheprovider", "corridor/it", *options
    )
    result = project.pytester.run(*command, stdin=b"c\nq\n")
    assert result.ret == 2, output(result)
    assert output(result).count("(Pdb)") == 2, "the one that was left, and the one that was quit"
    assert project.evidence().status == "interrupted"


def test_to_quit_a_debugger_in_a_replay_ends_it_as_it_ends_a_session(project, monkeypatch):
    project.write("stops.py", STOPS)
    scenario(project, generator="stops:Stops", runs=1, requirements="[GAP-1]")
    with monkeypatch.context() as context:
        context.setenv("PYTHONBREAKPOINT", "0")
        project.run("corridor/it")
    episode = project.evidence().episodes[0].id
    command = ("-m", "pytest", "-p", "no:cacheprovider", f"--dura-replay={episode}", "-s")
    result = project.pytester.run(*project.workers.command(*command), stdin=b"c\nq\n")
    assert result.ret == 2, output(result)
    assert output(result).count("(Pdb)") == 2
    assert result.outlines[-1].endswith("Exit: Quitting debugger")
    assert "Traceback" not in output(result)


def test_breakpoints_that_the_environment_switches_off_stop_nothing(project, monkeypatch):
    monkeypatch.setenv("PYTHONBREAKPOINT", "0")
    project.write("stops.py", STOPS)
    scenario(project, generator="stops:Stops", runs=2, requirements="[GAP-1]")
    result = project.run("corridor/it", PROCESSES)
    assert "(Pdb)" not in output(result)
    assert result.ret == 0
    assert "pytest's own process" not in output(result)
