"""Whatever ends a session: what is left never reads as a pass, and nobody's files suffer."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time

import pytest
from corridors import scenario
from outputs import output

from pytest_dura.evidence import DirectoryLock, open_record
from pytest_dura.evidence.bundle import default_files, rendered_files
from pytest_dura.plugin.session.recorder import MOST_PENDING

WAIT = 60.0
"""Seconds that a session may take to get going on a busy machine."""

HOLDS = """
import time
from pathlib import Path

def test_first(orchestrator):
    orchestrator.run("corridor/it")

def test_then():
    Path("begun").write_text("")
    time.sleep(120)
"""


def begun(project, *arguments, **environment):
    """A session in a process of its own that is in the middle of its second test."""
    project.write("test_it.py", HOLDS)
    kept = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST")}
    # What runs in the background of a shell ignores ctrl-C, and so would all that it starts.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        process = subprocess.Popen(
            [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "test_it.py", *arguments],
            cwd=project.path,
            env=kept | environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
        )
    finally:
        signal.signal(signal.SIGINT, before)
    deadline = time.monotonic() + WAIT
    while not (project.path / "begun").exists():
        assert process.poll() is None, process.communicate()[0]
        if time.monotonic() > deadline:
            process.kill()
            raise AssertionError(process.communicate()[0])
        time.sleep(0.02)
    return process


def test_a_killed_session_is_incomplete_and_takes_no_pass_over(project):
    scenario(project, requirements="[GAP-1]")
    project.run("corridor/it")
    evidence = project.path / "dura-evidence"
    assert project.evidence().gate.result == "passed"
    assert {*default_files()} <= {file.name for file in evidence.iterdir()}
    process = begun(project)
    process.send_signal(signal.SIGKILL)
    process.communicate(timeout=WAIT)
    record = open_record(evidence / "evidence.json")
    assert (record.head.status, record.head.gate.result) == ("running", "incomplete")
    assert record.head.gate.exit_code != 0
    assert not {*rendered_files()} & {file.name for file in evidence.iterdir()}
    assert not list(evidence.glob(".session*")), "episodes on disk leave no file"
    project.run("corridor/it")
    assert project.evidence().gate.result == "passed", "its lock blocks nobody"
    assert {file.name for file in evidence.iterdir()} - {*rendered_files()} <= {
        "evidence.json",
        "episodes",
    }


def test_an_interrupted_session_tells_what_it_got_to(project):
    """With ctrl-C, in a locale of ASCII alone, in a directory whose name is no text."""
    scenario(project, requirements="[GAP-1]")
    folder = "caf\udce9"
    process = begun(
        project, f"--dura-evidence={folder}", LC_ALL="C", PYTHONUTF8="0", PYTHONCOERCECLOCALE="0"
    )
    process.send_signal(signal.SIGINT)
    told = process.communicate(timeout=WAIT)[0]
    assert process.returncode == 2, told
    assert b"Traceback" not in told
    record = open_record(project.path / folder / "evidence.json")
    assert (record.head.status, record.head.gate.result) == ("interrupted", "incomplete")
    assert [one.id for one in record.episodes()] == ["corridor/it#0"]


DIES = """
import os, signal
from pathlib import Path
from corridor import Careful

class Dies(Careful):
    def reset(self, context):
        tried = Path("tried")
        tried.write_text(tried.read_text() + "x" if tried.exists() else "x")
        if len(tried.read_text()) == 3:
            os.kill(os.getpid(), signal.SIGKILL)
"""
EACH_RUN = """
import pytest

@pytest.mark.dura(scenario="corridor/it", runs=5)
@pytest.mark.requirement("GAP-1")
def test_it(episode):
    assert not episode.collided
"""


def test_the_episodes_of_a_dead_worker_are_listed_as_missing(project):
    scenario(project, generator="deadly:Dies")
    project.write("deadly.py", DIES)
    project.write("test_it.py", EACH_RUN)
    result = project.run("test_it.py", "-n", "1")
    assert result.ret == 1
    record = project.evidence()
    (case,) = record.cases
    heard = {one.spec.run for one in record.episodes}
    assert case.missing_runs == sorted({*range(5)} - heard)
    assert case.missing_runs_total == len(case.missing_runs) == 1
    found = project.verdict("GAP-1")
    assert (found.verdict, found.planned, found.run) == ("undecided", 5, 4)


FULL = """
import pytest, resource

def full():
    resource.setrlimit(resource.RLIMIT_FSIZE, (1024, resource.RLIM_INFINITY))
"""
FULL_AT_THE_END = (
    FULL
    + """
@pytest.hookimpl(tryfirst=True)
def pytest_sessionfinish():
    full()
"""
)
FULL_MEANWHILE = (
    FULL
    + """
@pytest.hookimpl(tryfirst=True)
def pytest_runtest_call():
    full()
"""
)


@pytest.mark.parametrize(
    "conftest, executor, ends",
    [
        (FULL_AT_THE_END, "auto", (1, b"the evidence cannot be written: File too large")),
        (FULL_MEANWHILE, "in-process", (2, b"the episodes of the session cannot be kept")),
        (FULL_MEANWHILE, "auto", (1, b"no process can be started: the disk of temporary files")),
    ],
    ids=["at the end", "meanwhile", "before a process"],
)
def test_a_full_disk_fails_the_session_and_leaves_no_half_record(
    project, conftest, executor, ends, forked_workers
):
    scenario(project, requirements="[GAP-1]")
    project.write("conftest.py", conftest)
    kept = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST")}
    done = subprocess.run(
        [
            *forked_workers.command("-m", "pytest"), "-p", "no:cacheprovider", "corridor/it",
            f"--dura-executor={executor}",
        ],
        cwd=project.path, env=kept, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        check=False, timeout=WAIT,
    )  # fmt: skip
    code, message = ends
    assert done.returncode == code, done.stdout
    assert message in done.stdout
    assert b"Traceback" not in done.stdout
    assert b"INTERNALERROR" not in done.stdout
    record = project.evidence()
    assert (record.status, record.gate.result) == ("running", "incomplete")
    names = {file.name for file in (project.path / "dura-evidence").iterdir()}
    assert names <= {"evidence.json", "episodes", ".episodes"}


def test_a_directory_that_cannot_be_written_is_told_before_anything_runs(project, monkeypatch):
    scenario(project, requirements="[GAP-1]")
    monkeypatch.setenv("CORRIDOR_LOG", str(project.path / "log"))
    (project.path / "file").write_text("mine")
    result = project.run("corridor/it", "--dura-evidence=file/folder")
    assert result.ret == 4
    assert "cannot be" in output(result)
    assert "Traceback" not in output(result)
    assert not (project.path / "log").exists()
    assert (project.path / "file").read_text() == "mine"


def test_two_sessions_do_not_write_one_directory(project):
    scenario(project, requirements="[GAP-1]")
    project.run("corridor/it")
    before = project.evidence()
    lock = DirectoryLock(project.path / "dura-evidence")
    result = project.run("corridor/it")
    assert result.ret == 4
    assert "is writing to this evidence directory" in output(result)
    assert f"another session (process {os.getpid()} on " in output(result)
    assert project.evidence() == before
    other = project.run("corridor/it", "--dura-evidence=other")
    assert other.ret == 0
    lock.release()
    assert project.run("corridor/it").ret == 0


def test_links_in_the_directory_are_replaced_and_never_followed(project):
    scenario(project, requirements="[GAP-1]")
    evidence, outside = project.path / "dura-evidence", project.path / "outside"
    outside.mkdir()
    assert project.run("corridor/it", "--dura-evidence-level=summary").ret == 0
    for name in ("manifest.json", *default_files()):
        (outside / name).write_text("mine")
        (evidence / name).unlink()
        (evidence / name).symlink_to(outside / name)
    assert project.run("corridor/it").ret == 0
    assert not any(file.is_symlink() for file in evidence.iterdir())
    assert {file.read_text() for file in outside.iterdir() if file.is_file()} == {"mine"}
    assert json.loads((evidence / "evidence.json").read_text())["status"] == "complete"


@pytest.mark.parametrize("name", ["evidence.json", "episodes"])
def test_a_record_or_a_folder_that_is_a_link_is_refused(project, name):
    scenario(project, requirements="[GAP-1]")
    evidence, outside = project.path / "dura-evidence", project.path / "outside"
    outside.mkdir()
    assert project.run("corridor/it", "--dura-evidence-level=summary").ret == 0
    (evidence / name).unlink(missing_ok=True)
    (evidence / name).symlink_to(outside)
    assert project.run("corridor/it").ret == 4
    assert (evidence / name).is_symlink()
    assert not list(outside.iterdir())


@pytest.mark.parametrize("arguments", [["-p", "no:xdist"], ["-n", "1"]], ids=["plain", "n1"])
def test_all_of_a_great_many_episodes_of_one_item_arrive(project, arguments):
    scenario(project, runs=MOST_PENDING * 2 + 3, requirements="[GAP-1]")
    project.run("corridor/it", *arguments)
    record = project.evidence()
    assert [one.spec.run for one in record.episodes] == list(range(131))
    (case,) = record.cases
    assert (case.planned, case.metrics.run, case.missing_runs) == (131, 131, [])
