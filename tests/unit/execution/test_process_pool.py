"""A pool that outlives its processes: nothing is lost, and guilt is exact."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import CancelledError
from pathlib import Path

import pool_calls
import psutil
import pytest

from pytest_dura import ConfigurationError
from pytest_dura.core import Places, use_places
from pytest_dura.execution import (
    MAX_STARTS,
    CallFailedError,
    ProcessLostError,
    ProcessPool,
    processes,
)
from pytest_dura.execution.processes import ProcessEnvironment

SUPPORT = str(Path(pool_calls.__file__).parent)


@pytest.fixture
def pool():
    made = ProcessPool(2)
    yield made
    made.shutdown(wait=False, cancel_futures=True)


def is_there(pid: int) -> bool:
    """Whether it runs; one that has ended and whose parent has not asked does not."""
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def until(condition, seconds=20.0):
    end = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < end
        time.sleep(0.01)
    return found


def test_a_process_killed_in_the_middle_loses_nothing(pool, tmp_path):
    names = [f"call{n}" for n in range(6)]
    futures = [pool.submit(pool_calls.noted, str(tmp_path), name, 0.1) for name in names]
    until(lambda: len(list(tmp_path.iterdir())) >= 3)
    newest = max(tmp_path.iterdir(), key=lambda file: file.stat().st_mtime_ns)
    os.kill(int(newest.suffix[1:]), signal.SIGKILL)  # not one that is still starting
    assert [one.result().decode() for one in futures] == names
    assert len(list(tmp_path.iterdir())) == len(names) + 1  # what was under way, once more


def test_a_call_that_ends_its_process_twice_is_given_up_and_no_other_is(pool, tmp_path):
    guilty = pool.submit(pool_calls.fatal, 7)
    others = [pool.submit(pool_calls.noted, str(tmp_path), f"{n}", 0.05) for n in range(6)]
    with pytest.raises(ProcessLostError, match=r"ended 2 processes .* exit code 7"):
        guilty.result()
    assert [one.result() for one in others] == [b"%d" % n for n in range(6)]
    assert len(list(tmp_path.iterdir())) == len(others)


def test_a_signal_is_named(pool, tmp_path):
    futures = [pool.submit(pool_calls.endless, str(tmp_path))]
    for count in (1, 2):
        until(lambda so_many=count: len(list(tmp_path.iterdir())) == so_many)
        os.kill(pool.pids[0], signal.SIGSEGV)
    with pytest.raises(ProcessLostError, match="SIGSEGV"):
        futures[0].result(timeout=20.0)


def test_a_process_killed_while_it_starts_is_started_again(pool, monkeypatch, tmp_path):
    starts = pool_calls.KilledStarts(monkeypatch, tmp_path, MAX_STARTS - 1)
    assert int(pool.submit(pool_calls.number).result(timeout=20.0)) == pool.pids[0]
    assert starts.count == MAX_STARTS


def test_starts_are_bounded_and_no_call_is_blamed_for_them(pool, monkeypatch, tmp_path):
    starts = pool_calls.KilledStarts(monkeypatch, tmp_path, MAX_STARTS)
    with pytest.raises(CallFailedError, match="did not start: it was ended by SIGKILL"):
        pool.submit(pool_calls.number).result(timeout=20.0)
    assert starts.count == MAX_STARTS
    assert pool.submit(pool_calls.number).result(timeout=20.0), "the next call starts afresh"


def test_a_process_that_is_starting_does_not_delay_the_end(pool, monkeypatch):
    begun, real = [], processes.WorkerProcess.wait_until_ready

    def stopped(started):
        os.kill(started.pid, signal.SIGSTOP)
        begun.append(started.pid)
        real(started)

    monkeypatch.setattr(processes.WorkerProcess, "wait_until_ready", stopped)
    future = pool.submit(pool_calls.number)
    until(lambda: begun)
    began = time.monotonic()
    pool.shutdown(wait=False, cancel_futures=True)
    assert time.monotonic() - began < processes.SECONDS_TO_START / 10
    with pytest.raises(CallFailedError):
        future.result(timeout=0)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the system does not fork")
def test_a_process_that_another_one_keeps_the_pipe_of_is_not_waited_for(
    pool, tmp_path, monkeypatch
):
    """A copy of the process in a session of its own has the pipe as well, and is never killed."""
    monkeypatch.setattr(processes, "_POLL_SECONDS", 0.1)
    future = pool.submit(pool_calls.outlived, str(tmp_path), seconds=60.0)
    try:
        with pytest.raises(ProcessLostError, match="ended 2 processes"):
            future.result(timeout=30.0)
    finally:
        for noted in tmp_path.iterdir():
            os.kill(int(noted.name), signal.SIGKILL)


def test_a_process_that_reads_nothing_is_ended(pool, monkeypatch):
    assert pool.submit(pool_calls.number).result(timeout=20.0)
    os.kill(pool.pids[0], signal.SIGSTOP)
    monkeypatch.setattr(processes, "SECONDS_TO_START", 0.5)
    much = "x" * 2**20  # more than the pipe takes
    with pytest.raises(ProcessLostError, match=r"its imports took longer than 0\.5 s"):
        pool.submit(pool_calls.limited, much, seconds=60.0).result(timeout=20.0)


def test_the_limit_of_a_call_begins_after_its_imports(pool, monkeypatch):
    first = pool.submit(pool_calls.prepared, 1.0, seconds=0.5).result(timeout=20.0)
    monkeypatch.setattr(processes, "SECONDS_TO_START", 0.5)
    with pytest.raises(ProcessLostError, match=r"its imports took longer than 0\.5 s"):
        pool.submit(pool_calls.prepared, 60.0, seconds=90.0).result(timeout=20.0)
    assert int(first) not in pool.pids


def test_a_call_that_overruns_its_limit_is_ended_with_all_that_it_started(pool, tmp_path):
    assert pool.submit(pool_calls.number).result(timeout=20.0)  # it has started
    with pytest.raises(ProcessLostError, match=r"ended, since it took longer than 2 s"):
        pool.submit(pool_calls.endless, str(tmp_path), seconds=2.0).result()
    [noted] = tmp_path.iterdir()  # it was not tried again
    until(lambda: not any(is_there(int(pid)) for pid in noted.name.split()))
    assert pool.submit(pool_calls.noted, str(tmp_path), "after").result() == b"after"


def test_errors_come_back_as_they_were(pool):
    with pytest.raises(ConfigurationError) as here:
        pool_calls.refused([1, 2])
    with pytest.raises(ConfigurationError) as there:
        pool.submit(pool_calls.refused, [1, 2]).result()
    assert str(there.value) == str(here.value)
    assert (there.value.line, there.value.remedy) == (3, "d")
    with pytest.raises(CallFailedError, match="ZeroDivisionError: of the role's own"):
        pool.submit(pool_calls.broken).result()
    with pytest.raises(TypeError, match="JSON"):
        pool.submit(pool_calls.refused, {1}).result()


def test_a_process_that_leaks_gives_way(pool):
    def ask(most):
        return pool.submit(pool_calls.leaky, 8, most).result()

    first = ask(2**30)
    assert ask(2**30) == first  # it may grow
    assert ask(2**20) == first  # it has grown by more
    assert ask(2**30) != first


def test_a_process_finds_what_this_one_finds(pool, tmp_path, monkeypatch):
    (tmp_path / "of_the_project.py").write_text("def answer():\n    return b'42'\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.chdir(tmp_path)
    import of_the_project

    assert pool.submit(of_the_project.answer).result() == b"42"
    path, folder, optimize = json.loads(pool.submit(pool_calls.surroundings).result())
    assert path == ProcessEnvironment.here().path
    assert (folder, optimize) == (str(tmp_path), sys.flags.optimize)


def test_a_process_imports_nothing_of_strangers_as_this_one_does(pool, tmp_path, monkeypatch):
    (tmp_path / "of_a_stranger.py").write_text("open('imported', 'w').close()\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.chdir(tmp_path)
    before = use_places(Places.of([], [tmp_path]))
    try:
        with pytest.raises(ConfigurationError, match="beside files that name it"):
            pool.submit(pool_calls.built, "of_a_stranger:Planner").result()
    finally:
        use_places(before)
    assert not (tmp_path / "imported").exists()


def test_what_is_queued_is_cancelled_and_what_runs_is_ended_at_the_end(pool, tmp_path):
    futures = [pool.submit(pool_calls.endless, str(tmp_path)) for _ in range(5)]
    pids = until(lambda: (found := list(tmp_path.iterdir())) and len(found) == 2 and found)
    pool.shutdown(wait=False, cancel_futures=True)
    for one in futures[:2]:
        with pytest.raises(CallFailedError, match="the session ended"):
            one.result(timeout=0)
    for one in futures[2:]:
        with pytest.raises(CancelledError):
            one.result(timeout=0)
    # The kernel takes its time on a machine that does much else.
    until(lambda: not any(is_there(int(pid)) for pair in pids for pid in pair.name.split()))
    with pytest.raises(RuntimeError, match="closed"):
        pool.submit(pool_calls.number)


def test_a_pool_that_waits_carries_out_what_it_was_given(tmp_path):
    pool = ProcessPool(1)
    futures = [pool.submit(pool_calls.noted, str(tmp_path), f"{n}") for n in range(3)]
    pool.shutdown()
    assert [one.result(timeout=0) for one in futures] == [b"0", b"1", b"2"]


def test_no_more_processes_are_started_than_there_are_calls(pool):
    assert {pool.submit(pool_calls.number).result() for _ in range(3)} == {b"%d" % pool.pids[0]}
    assert len(pool.pids) == 1


def test_a_process_that_cannot_start_says_why():
    pool = ProcessPool(1, ProcessEnvironment([], str(Path.cwd())))
    with pytest.raises(CallFailedError, match=r"did not start: (?s:.*)No module named"):
        pool.submit(pool_calls.number).result()
    pool.shutdown()


PARENT = """
import sys, time
sys.path.insert(0, sys.argv[1])
import pool_calls
from pytest_dura.execution.processes import ProcessPool
ProcessPool(1).submit(pool_calls.endless, sys.argv[2])
time.sleep(600)
"""


def test_processes_end_with_a_parent_that_is_killed(tmp_path):
    parent = subprocess.Popen([sys.executable, "-c", PARENT, SUPPORT, str(tmp_path)])
    try:
        [noted] = until(lambda: list(tmp_path.iterdir()))
    finally:
        parent.kill()
        parent.wait()
    until(lambda: not any(is_there(int(pid)) for pid in noted.name.split()))
