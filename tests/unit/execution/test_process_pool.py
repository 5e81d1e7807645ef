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
    children,
    processes,
)
from pytest_dura.execution.children import ChildSettings

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


def until(condition, seconds=60.0):
    end = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < end
        time.sleep(0.01)
    return found


def test_a_pool_without_calls_has_no_process_until_the_next_one(pool, monkeypatch, tmp_path):
    monkeypatch.setattr(processes, "_IDLE_SECONDS", 0.5)
    others = {*psutil.Process().children()}  # a test before may have left some that it shares
    for name in ("first", "second"):
        pool.submit(pool_calls.noted, str(tmp_path), name, 0.1).result(timeout=60.0)
        until(lambda: others.issuperset(psutil.Process().children()))


def test_a_process_killed_in_the_middle_loses_nothing(pool, tmp_path):
    (log := tmp_path / "log").mkdir()
    go, names = tmp_path / "go", [f"call{n}" for n in range(6)]
    futures = [pool.submit(pool_calls.held, str(log), name, str(go)) for name in names]
    until(lambda: len(list(log.iterdir())) == 2)
    os.kill(int(next(log.iterdir()).suffix[1:]), signal.SIGKILL)  # not one that is still starting
    go.touch()
    assert [one.result().decode() for one in futures] == names
    assert len(list(log.iterdir())) == len(names) + 1  # what was under way, once more


def test_a_call_that_ends_its_process_is_given_up_and_no_other_is(pool, tmp_path):
    guilty = pool.submit(pool_calls.fatal, 7)
    others = [pool.submit(pool_calls.noted, str(tmp_path), f"{n}", 0.05) for n in range(6)]
    with pytest.raises(ProcessLostError, match=r"ended with exit code 7$"):
        guilty.result()
    assert [one.result() for one in others] == [b"%d" % n for n in range(6)]
    assert len(list(tmp_path.iterdir())) == len(others)


@pytest.mark.parametrize("name, times", [("SIGSEGV", 1), ("SIGKILL", 2)])
def test_a_signal_is_named_and_one_from_outside_is_forgiven_once(pool, tmp_path, name, times):
    future = pool.submit(pool_calls.endless, str(tmp_path))
    for count in range(1, times + 1):
        until(lambda so_many=count: len(list(tmp_path.iterdir())) == so_many)
        os.kill(pool.pids[0], getattr(signal, name))
    with pytest.raises(ProcessLostError, match=name):
        future.result(timeout=60.0)


def test_a_template_that_is_killed_takes_no_call_along(pool, tmp_path):
    (log := tmp_path / "log").mkdir()
    go = tmp_path / "go"
    futures = [pool.submit(pool_calls.held, str(log), f"{n}", str(go)) for n in range(4)]
    until(lambda: len(list(log.iterdir())) == 2)
    before = pool.pids
    os.kill(psutil.Process(before[0]).ppid(), signal.SIGKILL)
    go.touch()
    assert [each.result(timeout=60.0) for each in futures] == [b"0", b"1", b"2", b"3"]
    until(lambda: not any(map(is_there, before)))


def test_a_death_is_of_whose_call_was_under_way(pool):
    def death(name):
        with pytest.raises(ProcessLostError) as lost:
            pool.submit(pool_calls.dies_in, name).result(timeout=60.0)
        return lost.value.death

    for name in ("generator", "safety_monitor"):
        assert (death(name).role, death(name).tick) == (name, 7)
        assert str(death(name)) == (
            f"its process ended with exit code 0 in a call of the {name} at tick 7"
        )
    assert death("generator").is_of_component
    assert not death("safety_monitor").is_of_component
    assert death("").role == ""


def test_a_child_that_closed_its_connection_dies_in_the_call_that_did(pool):
    with pytest.raises(ProcessLostError, match="exit code 70 in a call of the generator"):
        pool.submit(pool_calls.closes_all).result(timeout=60.0)


def test_what_a_call_prints_and_logs_comes_with_its_result_also_of_a_child_that_died(pool):
    future = pool.submit(pool_calls.prints, "one")
    assert future.result(timeout=60.0) == b""
    captured = future.captured
    assert (captured.stdout, captured.stderr) == ("one\n", "one to the error stream\n")
    future = pool.submit(pool_calls.prints, "two", dies=True)
    with pytest.raises(ProcessLostError):
        future.result(timeout=60.0)
    assert future.captured.stdout == "two\n"


@pytest.mark.skipif(sys.platform != "linux", reason="the limit is Linux's")
def test_a_child_takes_no_more_memory_than_it_may():
    limited = ProcessPool(1, memory=200 * 2**20)
    try:
        with pytest.raises(CallFailedError, match="MemoryError"):
            limited.submit(pool_calls.leaky, 300, 2**40).result(timeout=60.0)
        assert limited.submit(pool_calls.leaky, 10, 2**40).result(timeout=60.0)
    finally:
        limited.shutdown(wait=False)


@pytest.mark.parametrize("how", ["spawn", "threads"])
def test_children_are_started_anew_where_none_can_be_forked(how, monkeypatch, tmp_path):
    pool = ProcessPool(1)
    if how == "spawn":
        pool._forks = False
    else:
        (tmp_path / "with_a_thread.py").write_text(
            "import threading, time\n"
            "threading.Thread(target=time.sleep, args=(600,), daemon=True).start()\n"
        )
        monkeypatch.syspath_prepend(str(tmp_path))
        pool.preload = ["with_a_thread:Planner"]
    try:
        pid = int(pool.submit(pool_calls.number).result(timeout=60.0))
        assert psutil.Process(pid).ppid() == os.getpid()
        with pytest.raises(ProcessLostError, match=r"exit code 0 in a call of the generator"):
            pool.submit(pool_calls.dies_in, "generator").result(timeout=60.0)
        future = pool.submit(pool_calls.prints, "one")
        assert future.result(timeout=60.0) == b""
        assert future.captured.stdout == "one\n"
    finally:
        pool.shutdown(wait=False)


def test_a_process_killed_while_it_starts_is_started_again(pool, monkeypatch, tmp_path):
    starts = pool_calls.KilledStarts(monkeypatch, tmp_path, MAX_STARTS - 1)
    futures = [pool.submit(pool_calls.number) for _ in range(2)]
    assert {int(each.result(timeout=60.0)) for each in futures} <= {*pool.pids}
    assert starts.count == MAX_STARTS


def test_starts_are_bounded_and_no_call_is_blamed_for_them(pool, monkeypatch, tmp_path):
    starts = pool_calls.KilledStarts(monkeypatch, tmp_path, MAX_STARTS)
    with pytest.raises(CallFailedError, match="did not start: it was ended by SIGKILL"):
        pool.submit(pool_calls.number).result(timeout=60.0)
    assert starts.count == MAX_STARTS
    assert pool.submit(pool_calls.number).result(timeout=60.0), "the next call starts afresh"


def test_a_process_that_is_starting_does_not_delay_the_end(pool, monkeypatch):
    begun, real = [], children.Child.wait_until_ready

    def stopped(started):
        os.kill(started._template.process.pid, signal.SIGSTOP)
        begun.append(started)
        real(started)

    monkeypatch.setattr(children.Child, "wait_until_ready", stopped)
    future = pool.submit(pool_calls.number)
    until(lambda: begun)
    began = time.monotonic()
    pool.shutdown(wait=False, cancel_futures=True)
    assert time.monotonic() - began < children.SECONDS_TO_START / 10
    with pytest.raises(CallFailedError):
        future.result(timeout=0)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the system does not fork")
def test_a_process_that_another_one_keeps_the_pipe_of_is_not_waited_for(
    pool, tmp_path, monkeypatch
):
    """A copy of the process in a session of its own has the pipe as well, and is never killed."""
    monkeypatch.setattr(children, "_POLL_SECONDS", 0.1)
    future = pool.submit(pool_calls.outlived, str(tmp_path), seconds=60.0)
    try:
        with pytest.raises(ProcessLostError, match="exit code 3"):
            future.result(timeout=30.0)
    finally:
        for noted in tmp_path.iterdir():
            os.kill(int(noted.name), signal.SIGKILL)


def test_a_process_that_reads_nothing_is_ended(pool, monkeypatch):
    assert pool.submit(pool_calls.number).result(timeout=60.0)
    os.kill(pool.pids[0], signal.SIGSTOP)
    monkeypatch.setattr(children, "SECONDS_TO_START", 0.5)
    much = "x" * 2**20  # more than the pipe takes
    with pytest.raises(ProcessLostError, match=r"its imports took longer than 0\.5 s"):
        pool.submit(pool_calls.limited, much, seconds=60.0).result(timeout=60.0)


def test_the_limit_of_a_call_begins_after_its_imports(pool, monkeypatch):
    first = pool.submit(pool_calls.prepared, 1.0, seconds=0.5).result(timeout=60.0)
    monkeypatch.setattr(children, "SECONDS_TO_START", 0.5)
    with pytest.raises(ProcessLostError, match=r"its imports took longer than 0\.5 s"):
        pool.submit(pool_calls.prepared, 60.0, seconds=90.0).result(timeout=60.0)
    assert int(first) not in pool.pids


def test_a_call_that_overruns_its_limit_is_ended_with_all_that_it_started(pool, tmp_path):
    assert pool.submit(pool_calls.number).result(timeout=60.0)  # it has started
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
    with pytest.raises(
        CallFailedError, match=r"ZeroDivisionError: of the role's own (?s:.*)raise Zero"
    ):
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
    assert path == ChildSettings.here().path
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
    pool = ProcessPool(1, ChildSettings([], str(Path.cwd())))
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
