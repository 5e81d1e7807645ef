"""``--dura-executor=auto``, the default: copies of the session's process, and equal results."""

from __future__ import annotations

import json
import os
import sys

import pytest

from pytest_dura.evidence import verify_bundle
from pytest_dura.execution import ProcessPool

EXECUTOR = "auto"

LONG = "--dura-runs=5"
"""Of two cases."""
REASON = "auto: 2 cores"
CONFTEST = """
import pytest
from corridor import Careful

import speeds
speeds.top = lambda: 2.0

@pytest.fixture(scope="session")
def generator():
    class Planner(Careful):
        def propose(self, view):
            assert speeds.top() == 2.0
            return super().propose(view)
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


def test_a_session_is_simulated_by_processes_with_the_same_record(project):
    project.scenarios("--dura-executor=in-process", LONG)
    plain = record(project)
    assert chosen(project) == ("in-process", None, None)
    result = project.scenarios(LONG, "-v")
    result.stdout.fnmatch_lines([f"dura: episodes are simulated in 2 processes ({REASON})"])
    result.stdout.no_fnmatch_line("*simulated in pytest's own process*")
    assert chosen(project) == ("processes", 2, REASON)
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
    project.write("conftest.py", "import sys\nsys.settrace(lambda *_: None)\n")
    project.run_apart("--dura-scenarios", "--dura-select=corridor/*", LONG)
    assert chosen(project)[2].startswith("auto: a debugger or profiler is on")


def test_one_usable_core_simulates_in_one_other_process(project, monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {3}, raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    result = project.scenarios(LONG)
    result.stdout.no_fnmatch_line("dura: episodes are simulated*")
    assert chosen(project) == ("processes", 1, "auto: 1 core")


def test_a_component_of_a_conftest_is_simulated_by_copies_with_what_that_file_changes(project):
    """Also a class in a function, and a function of a module that the conftest replaces."""
    project.write("speeds.py", "def top():\n    return 0.0\n")
    project.write("conftest.py", CONFTEST)
    project.scenarios("--dura-executor=in-process", LONG)
    plain = record(project)
    project.scenarios(LONG)
    assert chosen(project) == ("processes", 2, REASON)
    assert record(project) == plain
    events = [event["kind"] for each in plain["episodes"] for event in each["events"]]
    assert not [kind for kind in events if "failure" in kind]


OWN = """
import os, pytest
import corridor, speeds

HERE = os.getpid()

class Own(corridor.Careful):
    seen = []
    def propose(self, view):
        self.seen.append(os.getpid())
        assert os.getpid() != HERE and speeds.top() == 2.0
        return super().propose(view)

@pytest.fixture(scope="session")
def generator():
    return Own

def test_by_hand(orchestrator, monkeypatch):
    monkeypatch.setattr(speeds, "top", lambda: 2.0)
    episode = orchestrator.run("corridor/free")
    assert not [event for event in episode.events if "failure" in event.kind], episode.events
    assert not Own.seen
    monkeypatch.undo()
    episode = orchestrator.run("corridor/free", seed=1)
    assert [event for event in episode.events if "failure" in event.kind]
"""
ENDS = """
import ctypes, pytest
import corridor

class Ends(corridor.Careful):
    def propose(self, view):
        ctypes.CDLL(None)._exit(0)

@pytest.fixture(scope="session")
def generator():
    return Ends

def test_that_ends_its_process(orchestrator):
    (event,) = orchestrator.run("corridor/free").events
    assert (event.kind, event.detail) == ("component_failure", "its process ended with exit code 0")
"""
BARE = """
import os, pytest
from corridor import Careful

HERE = os.getpid()

class Own(Careful):
    def propose(self, view):
        assert os.getpid() == HERE
        self.seen = view.index
        return super().propose(view)

@pytest.fixture(scope="session")
def generator():
    return Own()

def test_by_hand(orchestrator, generator):
    episode = orchestrator.run("corridor/free")
    assert not [event for event in episode.events if "failure" in event.kind]
    assert generator.seen > 0
"""


@pytest.mark.parametrize("test", [OWN, ENDS, BARE], ids=["patched", "ends", "bare"])
def test_episodes_of_a_test_are_simulated_by_copies_in_which_its_patches_hold(project, test):
    """What the component keeps is gone with the copy; a bare instance stays in this process."""
    project.write("speeds.py", "def top():\n    return 0.0\n")
    project.write("test_it.py", test)
    result = project.run_apart("test_it.py")  # where no other test has left a thread
    assert result.parseoutcomes().get("passed") == 1, result.stdout.str()
    note = "*Own simulated in pytest's own process: its generator is a bare instance*"
    if test is BARE:
        result.stdout.fnmatch_lines([note])


@pytest.mark.parametrize("executor", ["auto", "processes"])
def test_processes_that_do_not_start_fail_the_session(project, monkeypatch, executor):
    from pytest_dura.execution import CallFailedError

    def fail(*_):
        raise CallFailedError("no process can be started: no memory")

    monkeypatch.setattr(ProcessPool, "_start", fail)
    result = project.scenarios(LONG, f"--dura-executor={executor}")
    result.stdout.fnmatch_lines(["*no process can be started: no memory*"])
    assert result.ret == 1


SLOW_ONCE = """
import time
from pathlib import Path
from corridor import Careful

class SlowOnce(Careful):
    def propose(self, view):
        marker = Path("slow")
        if view.index == 2 and not marker.exists():
            marker.touch()
            time.sleep(0.6)
        return super().propose(view)
"""


@pytest.mark.parametrize("executor, overruns", [("processes:2", 0), ("in-process", 1)])
def test_an_overrun_beside_others_is_repeated_alone(project, executor, overruns):
    """Nothing else had the processor where only one episode was simulated at a time."""
    project.write("slow_once.py", SLOW_ONCE)
    project.run(
        "corridor/tight", f"--dura-executor={executor}", "--dura-generator=slow_once:SlowOnce",
        "--dura-runs=2", "--dura-time-budget=0.3",
    )  # fmt: skip
    episodes = project.evidence().episodes
    assert sum(len(each.spec.timeouts) for each in episodes) == overruns
    assert verify_bundle(project.path / "dura-evidence").problems == []


THREADED = """
import threading, time
import pytest

@pytest.fixture(autouse=True)
def busy():
    stop = threading.Event()
    def work():
        while not stop.is_set():
            time.sleep(0.001)
    thread = threading.Thread(target=work)
    thread.start()
    yield
    stop.set()
    thread.join()

def test_by_hand(orchestrator):
    assert not orchestrator.run("corridor/free").collided
"""


def test_a_test_whose_threads_work_is_simulated_in_pytests_process_which_is_said(project):
    project.write("test_it.py", THREADED)
    result = project.run("test_it.py")
    assert result.parseoutcomes().get("passed") == 1, result.stdout.str()
    result.stdout.fnmatch_lines(
        ["*pytest's own process: a test asks for them, and a copy of this *"]
    )


MANY_FILES = """
import os, resource
FILES = []

def pytest_sessionstart():
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, min(hard, 2000)), hard))
    FILES.extend(os.open(os.devnull, os.O_RDONLY) for _ in range(1100))

def pytest_sessionfinish():
    while FILES:
        os.close(FILES.pop())
"""


@pytest.mark.skipif(sys.platform != "linux", reason="raises a limit of Linux")
def test_a_session_with_a_great_many_open_files_is_simulated_by_processes(project):
    project.write("conftest.py", MANY_FILES)
    assert project.run_apart("corridor/free", "--dura-executor=processes:2").ret == 0
    assert chosen(project) == ("processes", 2, None)
