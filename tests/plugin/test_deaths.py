"""Processes that end in the middle of an episode: whose death it was, and what it comes to."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time

import psutil
import pytest
from corridors import IDLE, scenario
from outputs import output

from pytest_dura.evidence import verify_bundle

EXECUTOR = "auto"

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="deeds and limits are Linux's")
PARTS = """
import ctypes, os
from corridor import Careful, Corridor, Watch

C = ctypes.CDLL(None)
LOCK = ctypes.create_string_buffer(64)
kept = []

def touched(count):
    kept.append(bytearray(b"x") * count)

def waits():
    with open(f"waits-{os.getpid()}", "w"):
        pass
    C.pthread_mutex_lock(LOCK)
    C.pthread_mutex_lock(LOCK)  # past any signal

DEEDS = {
    "exits": lambda: C._exit(0),
    "exits by Python": lambda: os._exit(0),
    "crashes": lambda: ctypes.string_at(0),
    "aborts": lambda: C.abort(),
    "closes": lambda: os.closerange(0, 256),
    "waits": lambda: waits(),
    "kills": lambda: os.kill(os.getpid(), 9),
    "allocates": lambda: touched(10 * 2**30),
    "allocates in C": lambda: C.memset(C.mmap(0, ctypes.c_size_t(10 << 30), 3, 34, -1, 0), 1, 1),
    "forks": lambda: C.fork(),
    "forks by Python": os.fork,
    "runs a program": lambda: os.execv("/bin/true", ["true"]),
}

class Deed:
    deed = ""
    def do(self, index):
        if index == 2:
            DEEDS[self.deed]()

class Component(Deed, Careful):
    def propose(self, view):
        self.do(view.index)
        return super().propose(view)

class Monitor(Deed, Watch):
    def run(self, view):
        self.do(view.index)
        return super().run(view)

class Plant(Deed, Corridor):
    steps = 0
    def step(self, action):
        self.do(self.steps)
        self.steps += 1
        return super().step(action)

class Leaves(Careful):
    def __del__(self):
        C._exit(0)

class EndsAll(Careful):
    def propose(self, view):
        os.kill(os.getppid(), 9)
        C.pause()

for base in (Component, Monitor, Plant):
    for deed in DEEDS:
        name = base.__name__ + deed.title().replace(" ", "")
        globals()[name] = type(name, (base,), {"deed": deed, "__module__": __name__})
"""
ENDS = {
    "exits": "ended with exit code 0",
    "exits by Python": "ended with exit code 0",
    "crashes": "was ended by SIGSEGV",
    "aborts": "was ended by SIGABRT",
    "closes": "ended with exit code 70",
    "kills": "was ended by SIGKILL",
    "waits": "was ended, since it took longer than 4 s",
    "forks by Python": "was ended, since it made a copy of itself",
    "runs a program": "ended with exit code 0",
}
LIMITS = ["--dura-episode-timeout=1", "--dura-time-budget=0.5", "--dura-episode-memory=500MB"]
PROCESSES = ["--dura-executor=processes:2", *LIMITS]


def case(deed):
    return f"d-{deed.replace(' ', '-').lower()}"


def name(kind, deed):
    return f"deadly:{kind}{deed.title().replace(' ', '')}"


def run(project, role, kind, deeds, *arguments):
    """Run a case for each deed, each beside one of the same component that does nothing."""
    project.write("deadly.py", PARTS)
    for deed in deeds:
        part = {role: name(kind, deed)}
        scenario(project, case(deed), runs=1, requirements="[GAP-1]", **part)
    scenario(project, "d-well", runs=3, requirements="[GAP-1]")
    result = project.scenarios(*arguments, select="corridor/d-*")
    assert "INTERNALERROR" not in output(result)
    assert project.verdict("GAP-1", "corridor/d-well").verdict == "supported"
    episodes = {each.case.removeprefix("corridor/"): each for each in project.evidence().episodes}
    return result, episodes


def test_a_component_that_ends_its_process_is_named_and_its_run_is_open(project):
    result, episodes = run(project, "generator", "Component", ENDS, *PROCESSES)
    assert result.ret == 1
    result.assert_outcomes(passed=1, failed=len(ENDS))
    for deed, how in ENDS.items():
        episode, verdict = episodes[case(deed)], project.verdict("GAP-1", f"corridor/{case(deed)}")
        assert (episode.validity, episode.termination) == ("valid", "lost")
        (event,) = episode.events
        assert (event.kind, event.tick) == ("component_failure", 2)
        assert event.subject == name("Component", deed).partition(":")[2]
        assert event.detail == f"its process {how}"
        assert verdict.verdict == "undecided"
        assert f"failed: its process {how} (t = 0.20 s)" in output(result)
    assert project.evidence().gate.result == "failed"
    assert verify_bundle(project.path / "dura-evidence").problems == []


UNCAPTURED, WORKERS = ["-s"], ["-n", "2"]
FEW = {deed: ENDS[deed] for deed in ("exits", "crashes", "forks by Python")}


@pytest.mark.parametrize(
    "mode, role, kind, named",
    [
        (UNCAPTURED, "generator", "Component", ""),
        (WORKERS, "generator", "Component", ""),
        (WORKERS, "simulator", "Plant", "simulator"),
    ],
    ids=["component uncaptured", "component of a worker", "simulator of a worker"],
)
def test_deaths_are_named_in_every_mode_of_a_session(project, mode, role, kind, named):
    result, episodes = run(project, role, kind, FEW, *mode)
    assert result.ret == 1
    for deed, how in FEW.items():
        episode = episodes[case(deed)]
        if named:
            where = f"in a call of the {named} at tick 2"
            assert episode.failure == f"infrastructure: its process {how} {where}"
        else:
            assert [each.detail for each in episode.events] == [f"its process {how}"]
        assert project.verdict("GAP-1", f"corridor/{case(deed)}").verdict == "undecided"


def test_deaths_on_a_dask_worker_are_named_as_those_of_processes(project, dask_worker):
    scenario(project, "d-plant", simulator=name("Plant", "exits"), requirements="[GAP-1]", runs=1)
    deeds = ["exits", "crashes", "waits", "allocates"]
    began = time.monotonic()
    result, episodes = run(project, "generator", "Component", deeds, dask_worker.executor, *LIMITS)
    assert time.monotonic() - began < 60.0
    for deed in deeds[:3]:
        assert (episodes[case(deed)].validity, episodes[case(deed)].termination) == (
            "valid",
            "lost",
        )
        events = [(each.kind, each.tick, each.detail) for each in episodes[case(deed)].events]
        assert events == [("component_failure", 2, f"its process {ENDS[deed]}")]
        assert project.verdict("GAP-1", f"corridor/{case(deed)}").verdict == "undecided"
    (event, *_) = [each for each in episodes["d-allocates"].events if "failure" in each.kind]
    assert (event.tick, event.detail[:18]) == (2, "raised MemoryError")
    where = "in a call of the simulator at tick 2"
    assert episodes["d-plant"].failure == f"infrastructure: its process {ENDS['exits']} {where}"
    assert (result.ret, project.evidence().gate.result) == (1, "failed")
    assert dask_worker.poll() is None


@pytest.mark.parametrize(
    "kind, how",
    [
        ("Leaves", "ended with exit code 0"),
        ("EndsAll", "ended with its template, which was ended by SIGKILL"),
    ],
)
def test_a_death_that_may_be_of_others_is_blamed_on_no_role(project, kind, how):
    """Of what a component leaves behind, and of the process from which all are forked."""
    project.write("deadly.py", PARTS)
    scenario(project, generator=f"deadly:{kind}", runs=1, requirements="[GAP-1]")
    result = project.run("corridor/it", "--dura-executor=processes:1")
    (episode,) = project.evidence().episodes
    assert (episode.failure, result.ret) == (f"infrastructure: its process {how}", 1)


def test_a_component_that_ends_its_process_under_a_fault_is_judged_too(project):
    """Whether the fault had an effect by then is not known."""
    project.write("deadly.py", PARTS)
    parts = {"generator": name("Component", "exits"), "fault_injector": "Idle"}
    scenario(project, runs=1, requirements="[GAP-1]", faults=IDLE, **parts)
    result = project.run("corridor/it", "--dura-executor=processes:1")
    (episode,) = project.evidence().episodes
    assert (episode.validity, episode.termination, result.ret) == ("valid", "lost", 1)


@pytest.mark.parametrize(
    "role, kind, named",
    [("monitor", "Monitor", "safety_monitor"), ("simulator", "Plant", "simulator")],
)
def test_a_role_or_simulator_that_ends_its_process_is_named_and_its_run_missing(
    project, role, kind, named
):
    ends = {deed: ENDS[deed] for deed in (*FEW, "waits")}
    result, episodes = run(project, role, kind, ends, *PROCESSES)
    assert result.ret == 1
    for deed, how in ends.items():
        where = f"in a call of the {named} at tick 2"
        assert episodes[case(deed)].failure == f"infrastructure: its process {how} {where}"
        assert project.verdict("GAP-1", f"corridor/{case(deed)}").verdict == "undecided"
    assert project.evidence().gate.result == "failed"


def test_a_component_that_wants_more_memory_than_it_may_take_fails(project):
    result, episodes = run(project, "generator", "Component", ["allocates"], *PROCESSES)
    (event, *_) = [each for each in episodes["d-allocates"].events if "failure" in each.kind]
    assert (event.tick, event.detail[:18]) == (2, "raised MemoryError")
    assert result.ret == 0, "it fell back at one tick"


def test_a_copy_of_its_process_that_a_component_makes_in_c_goes_no_further(project):
    result, episodes = run(project, "generator", "Component", ["forks"], *PROCESSES)
    assert result.ret == 0
    episode = episodes["d-forks"]
    assert (episode.validity, episode.termination) == ("valid", "time")


LASTING = """
import os, random, threading, time
from corridor import Careful

class Lasting(Careful):
    def reset(self, context):
        super().reset(context)
        assert os.getcwd() != "/" and threading.active_count() == 1
        assert random.random is not time.time is not None
        os.chdir("/")
        threading.Thread(target=time.sleep, args=(600,), daemon=True).start()
        random.random = time.time = None
"""


def test_what_a_component_leaves_in_its_process_is_named_and_reaches_no_other_episode(project):
    project.write("lasting.py", LASTING)
    scenario(project, generator="lasting:Lasting", runs=3, requirements="[GAP-1]")
    result = project.run("corridor/it", "--dura-executor=processes:1", "-rP")
    episodes = project.evidence().episodes
    assert not [each for each in episodes for event in each.events if "failure" in event.kind]
    left = "another working directory, a thread, another random.random, another time.time"
    assert f"Lasting left behind in its process {left}" in output(result)


@pytest.mark.parametrize("arguments", [[], ["-x"]], ids=" ".join)
def test_the_end_of_a_session_ends_its_processes_whatever_they_wait_for(project, arguments):
    """By Ctrl-C while a component waits in C, or after a failure with more under way."""
    project.write("deadly.py", PARTS)
    for number in range(3):
        scenario(project, f"e-{number}", generator=name("Component", "waits"), runs=1)
    project.write("conftest.py", NUMBERED)
    seconds = 1 if arguments else 600
    limits = f"--dura-episode-timeout={seconds}", "--dura-time-budget=0.1"
    command = project.workers.command(
        "-m", "pytest", "-p", "no:cacheprovider", "--dura-scenarios",
        "--dura-select=corridor/e-*", "--dura-executor=processes:2", *limits, *arguments,
    )  # fmt: skip
    kept = {key: text for key, text in os.environ.items() if "PYTEST" not in key}
    session = subprocess.Popen(
        command, cwd=project.path, env=kept, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    )
    number = project.path / "number"
    try:
        while not number.exists():
            assert session.poll() is None
            time.sleep(0.01)
        controller = psutil.Process(int(number.read_text()))
        processes = started(session, controller)
        if not arguments:
            while len([*project.path.glob("waits-*")]) < 2:
                assert session.poll() is None
                time.sleep(0.01)
            controller.send_signal(signal.SIGINT)
        printed = session.communicate(timeout=120)[0].decode()
    finally:
        session.kill()
        if number.exists():
            with contextlib.suppress(ProcessLookupError):
                os.kill(int(number.read_text()), signal.SIGKILL)
    assert session.returncode == (1 if arguments else 2), printed
    assert not psutil.wait_procs(processes, timeout=30.0)[1]


NUMBERED = """
import os
from pathlib import Path

def pytest_configure(config):
    Path("new").write_text(str(os.getpid()))
    Path("new").rename("number")
"""
"""The session is a copy of another process, and what was started waits for it."""


def started(session, controller):
    """The template of a session and two children."""
    while True:
        processes = controller.children(recursive=True)
        if len(processes) > 2:
            return processes
        assert session.poll() is None
        time.sleep(0.01)
