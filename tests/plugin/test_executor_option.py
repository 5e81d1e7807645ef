"""``--dura-executor``: the same session, simulated by other processes."""

from __future__ import annotations

import os
import signal
import time

import psutil
import pytest
from corridors import scenario

EXECUTOR = "auto"


def told(project):
    keys = {"cases", "episodes", "verdicts", "requirements"}
    evidence = project.evidence().to_json(include=keys)
    for episode in evidence["episodes"]:
        del episode["metrics"]["processing_us"], episode["timings"]["processing_seconds"]
    return evidence


def test_a_pool_of_processes_leaves_the_same_record(project):
    project.scenarios("--dura-executor=in-process")
    plain = told(project)
    assert project.evidence().execution.executor == "in-process"
    before = {*psutil.Process(os.getpid()).children()}
    result = project.scenarios("--dura-executor=processes:2")
    result.stdout.fnmatch_lines(["dura: episodes are simulated in 2 processes"])
    result.stdout.no_fnmatch_line("*simulated in pytest's own process*")
    assert told(project) == plain
    assert project.evidence().execution.to_json() == {"executor": "processes", "processes": 2}
    assert before.issuperset(psutil.Process(os.getpid()).children())
    assert not (project.path / "dura-evidence" / ".episodes").exists()


def test_what_is_simulated_here_all_the_same_is_said(project):
    project.write(
        "conftest.py",
        "import pytest\n"
        "from corridor import Careful\n"
        "@pytest.fixture(scope='session')\n"
        "def generator():\n"
        "    return Careful()\n",
    )
    result = project.scenarios("--dura-executor=processes:1")
    line = "* of Careful simulated in pytest's own process: its generator is a bare instance"
    result.stdout.fnmatch_lines([line])


@pytest.mark.parametrize(
    "arguments, problem",
    [
        (["--dura-executor=threads"], "there is no such executor"),
        (["--dura-executor=processes", "-n", "2"], "the workers of pytest-xdist would each start"),
        (["--dura-executor=processes", "--dura-llm=record"], "a cassette is of this process"),
        (
            ["--dura-executor=in-process", "--dura-episode-timeout=9"],
            "--dura-episode-timeout is held by ending the process",
        ),
    ],
)
def test_what_makes_no_sense_is_refused(project, arguments, problem):
    result = project.scenarios(*arguments)
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines([f"*{problem}*", "*--dura-executor*"])
    assert not (project.path / "dura-evidence").exists()


@pytest.mark.parametrize("text", ["0", "-1", "nan", "soon"])
def test_a_limit_for_episodes_that_is_none_is_refused(project, text):
    result = project.scenarios("--dura-executor=processes:1", f"--dura-episode-timeout={text}")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines(["*--dura-episode-timeout takes a number of seconds*"])


DEAF = """
import signal
import time
from corridor import Careful

class Deaf(Careful):
    def propose(self, view):
        if view.index == 1:
            signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
            time.sleep(600)
        return super().propose(view)
"""


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="there are no signals to block")
def test_a_component_that_no_alarm_interrupts_is_ended_with_its_process(project):
    project.write("deaf.py", DEAF)
    scenario(project, "it", runs=1, requirements="[GAP-1]", generator="deaf:Deaf")
    scenario(project, "well", requirements="[GAP-1]")
    began = time.monotonic()
    result = project.scenarios(
        "--dura-executor=processes:1", "--dura-episode-timeout=1.5", "--dura-time-budget=0.1"
    )
    assert time.monotonic() - began < 60.0
    assert result.ret == 1
    (lost, *_) = (one for one in project.evidence().episodes if one.case == "corridor/it")
    assert (lost.validity, lost.termination, lost.events[0].tick) == ("valid", "lost", 1)
    assert lost.events[0].detail.startswith("its process was ended, since it took longer than")
    assert project.verdict("GAP-1", "corridor/it").verdict == "undecided"
    assert project.verdict("GAP-1", "corridor/well").verdict == "supported"
    assert project.evidence().gate.result == "failed"


def test_without_a_cluster_nothing_is_run_or_written(project, monkeypatch):
    from pytest_dura.execution import dask

    monkeypatch.setattr(dask, "SECONDS_TO_CONNECT", 0.2)
    result = project.scenarios("--dura-executor=dask://127.0.0.1:9")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines(["*there is no Dask scheduler at this address*"])
    assert not (project.path / "dura-evidence").exists()
