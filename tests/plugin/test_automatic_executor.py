"""``--dura-executor=auto``, the default: processes where they pay, and equal results."""

from __future__ import annotations

import json
import os
import sys

import pytest

from pytest_dura.execution import ProcessPool

LONG = "--dura-runs=20"
"""Of two cases, which is as many episodes as processes pay for."""
CONFTEST = """
import pytest
from corridor import Careful

class Planner(Careful):
    pass

@pytest.fixture(scope="session")
def generator():
    return Planner
"""


@pytest.fixture
def project(project, monkeypatch):
    """The example project on a machine with two cores, where warnings are no errors."""
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1}, raising=False)
    project.write("pytest.ini", "[pytest]\npythonpath = .\n")
    return project


def record(project):
    """What does not say who simulated, nor how long it took."""
    plain = project.evidence().to_json(include={"cases", "episodes", "verdicts", "requirements"})
    for episode in plain["episodes"]:
        del episode["metrics"]["processing_us"], episode["timings"]["processing_seconds"]
    return plain


def chosen(project):
    execution = project.evidence().execution
    return execution.executor, execution.processes, execution.chosen


def test_a_long_session_is_simulated_by_processes_with_the_same_record(project):
    project.scenarios("--dura-executor=in-process", LONG)
    plain = record(project)
    assert chosen(project) == ("in-process", None, None)
    result = project.scenarios(LONG)
    reason = "auto: 40 episodes on 2 cores"
    result.stdout.fnmatch_lines([f"dura: episodes are simulated in 2 processes ({reason})"])
    result.stdout.no_fnmatch_line("*simulated in pytest's own process*")
    assert chosen(project) == ("processes", 2, reason)
    assert record(project) == plain
    assert project.evidence().gate.result == "passed"


def test_named_items_are_simulated_by_processes_too(project):
    result = project.run("corridor/free", "corridor/tight", LONG)
    assert result.ret == 0
    assert chosen(project)[:2] == ("processes", 2)
    assert not any(map(project.evidence().to_json()["totals"].get, ["missing", "invalid"]))


@pytest.mark.parametrize(
    "argument, reason",
    [
        ("--pdb", "--pdb or --trace is on"),
        ("--dura-llm=record", "a cassette of a language model is of this process"),
    ],
)
def test_what_needs_this_process_stays_in_it_and_the_reason_is_shown(project, argument, reason):
    result = project.scenarios(LONG, argument)
    line = f"dura: episodes are simulated in pytest's own process (auto: {reason})"
    result.stdout.fnmatch_lines([line])
    assert chosen(project) == ("in-process", None, f"auto: {reason}")


WARNS = """
import warnings
import corridor

class Careless(UserWarning):
    pass

class Planner(corridor.Careful):
    def propose(self, view):
        warnings.warn("slow", DeprecationWarning)
        warnings.warn("careless", Careless)
        return super().propose(view)

class Watch(corridor.Watch):
    def run(self, view):
        warnings.warn("half asleep", RuntimeWarning)
        return super().run(view)
"""
SLOW, CARELESS, ASLEEP = "Warning: slow", "Careless: careless", "RuntimeWarning: half asleep"


@pytest.mark.parametrize(
    "setting, arguments, raised",
    [
        ("error\n ignore:sl[ao]w", [], {CARELESS}),
        ("error\n ignore::DeprecationWarning\n ignore::warns.Careless", [], {ASLEEP}),
        ("error\n ignore:half:RuntimeWarning:warns", ["-W", "ignore::UserWarning"], {SLOW}),
        ("default", ["-W", "error::UserWarning"], {CARELESS}),
    ],
)
def test_warnings_that_are_errors_count_alike_wherever_an_episode_is_simulated(
    project, setting, arguments, raised
):
    """Those of the component are its own failures; those of another role are infrastructure."""
    project.write("warns.py", WARNS)
    project.write("pytest.ini", f"[pytest]\npythonpath = .\nfilterwarnings =\n {setting}\n")
    free = project.path / "scenarios/corridor/free.yaml"
    free.write_text(free.read_text().replace("corridor:Watch", "warns:Watch"))
    arguments = ["--dura-runs=1", "--dura-generator=warns:Planner", *arguments]
    project.scenarios("--dura-executor=in-process", *arguments)
    plain = record(project)
    text = json.dumps(plain["episodes"])
    assert {one for one in (SLOW, CARELESS, ASLEEP) if one in text} == raised
    missing = {one["spec"]["case"] for one in plain["episodes"] if one["validity"] == "missing"}
    assert missing == ({"corridor/free"} if ASLEEP in raised else set())

    project.scenarios("--dura-executor=processes:1", *arguments)
    assert chosen(project)[:2] == ("processes", 1)
    assert record(project) == plain


MARKED = """
import pytest

@pytest.mark.filterwarnings("ignore:slow", "ignore:careless")
@pytest.mark.dura(scenario="corridor/tight", runs=2)
@pytest.mark.requirement("OWN-1", text="It touches nothing.", kind="safety")
def test_it(campaign):
    campaign.require("always (gap > 0)")
"""


def test_the_filters_of_a_test_reach_the_processes_that_it_asks(project):
    project.write("warns.py", WARNS)
    project.write("pytest.ini", "[pytest]\npythonpath = .\nfilterwarnings = error\n")
    project.write("test_it.py", MARKED)
    for marked, outcome in ((True, "passed"), (False, "failed")):
        if not marked:
            project.write("test_it.py", MARKED.replace("@pytest.mark.filterwarnings", "# "))
        for executor in ("in-process", "processes:1"):
            arguments = [f"--dura-executor={executor}", "--dura-generator=warns:Planner"]
            project.run("test_it.py", *arguments).assert_outcomes(**{outcome: 1})


def test_what_is_traced_stays_in_this_process(project):
    before = sys.gettrace()
    sys.settrace(lambda *_: None)
    try:
        project.scenarios(LONG)
    finally:
        sys.settrace(before)
    assert chosen(project)[2].startswith("auto: a debugger or profiler is on")


def test_a_short_session_stays_in_this_process_and_says_why_if_asked(project):
    reason = "auto: 38 episodes, processes pay from 40 on"
    result = project.scenarios("--dura-runs=19")
    result.stdout.no_fnmatch_line("dura: episodes are simulated*")
    assert chosen(project) == ("in-process", None, reason)
    result = project.scenarios("--dura-runs=19", "-v")
    result.stdout.fnmatch_lines(
        [f"dura: episodes are simulated in pytest's own process ({reason})"]
    )


def test_one_usable_core_is_left_to_this_process(project, monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {3}, raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    project.scenarios(LONG)
    assert chosen(project) == ("in-process", None, "auto: 40 episodes on 1 core")


def test_a_component_of_a_conftest_is_simulated_here_and_no_process_is_started(project):
    project.write("conftest.py", CONFTEST)
    result = project.scenarios(LONG)
    reason = "the class of its generator is in a conftest.py"
    line = f"40 episodes of Planner simulated in pytest's own process: {reason}"
    result.stdout.fnmatch_lines([f"*{line.removeprefix('40 episodes')}"])
    assert chosen(project) == ("in-process", None, f"auto: {reason}")


def test_test_functions_that_ask_for_episodes_keep_the_session_in_this_process(project):
    project.write(
        "test_it.py",
        "import pytest\n"
        '@pytest.mark.dura(scenario="corridor/free", runs=1)\n'
        "def test_it(episode):\n"
        "    assert episode.valid\n",
    )
    project.scenarios(LONG, "test_it.py")
    assert chosen(project)[2].startswith("auto: test functions ask for episodes")


@pytest.mark.parametrize("executor", ["auto", "processes"])
def test_processes_that_do_not_start_fail_the_session(project, monkeypatch, executor):
    from pytest_dura.execution import CallFailedError

    def fail(*_):
        raise CallFailedError("no process can be started: no memory")

    monkeypatch.setattr(ProcessPool, "_start", fail)
    result = project.scenarios(LONG, f"--dura-executor={executor}")
    result.stdout.fnmatch_lines(["*no process can be started: no memory*"])
    assert result.ret == 1
