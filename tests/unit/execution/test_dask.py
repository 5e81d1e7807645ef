"""A real scheduler and real workers on loopback: the same verdicts, whoever is killed."""

from __future__ import annotations

import json
import logging
import os
import signal
import threading
import time

import pytest
from dask_clusters import Cluster, children_of
from distributed.scheduler import KilledWorker
from shaft import lift_library
from shaky import begun, shaky

from pytest_dura import ConfigurationError, RoleSpec, Runner
from pytest_dura.execution import (
    IN_FLIGHT,
    CallFailedError,
    EpisodeStore,
    Execution,
    ProcessLostError,
    dask,
)
from pytest_dura.execution.address import conditions_of, simulate
from pytest_dura.execution.dask import DaskExecutor
from pytest_dura.execution.sources import LoadedModules
from pytest_dura.execution.surroundings import surroundings
from pytest_dura.library import load_library
from pytest_dura.requirements import Requirement

SCENARIO = """
name: room/shaky
simulator: thermostat:Thermostat
duration: 1.0
runs: 12
roles: {generator: "thermostat:Controller"}
faults: []
requirements: []
"""
COLD = Requirement(id="R", check="always (temperature < 16)", at_most=0.3)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """The cluster of all tests; Dask's own limits are 3 lost workers, and no end of waiting."""
    settings = {"ALLOWED_FAILURES": "1", "NO_WORKERS_TIMEOUT": "3s"}
    made = Cluster(
        tmp_path_factory.mktemp("dask"),
        {f"DASK_DISTRIBUTED__SCHEDULER__{name}": value for name, value in settings.items()},
    )
    yield made
    made.close()


@pytest.fixture(scope="module")
def workers(cluster):
    return [cluster.worker(), cluster.worker()]


@pytest.fixture(autouse=True)
def short_end(monkeypatch):
    """A scheduler that does not answer is asked to end our processes for half a second."""
    monkeypatch.setattr(dask, "_SECONDS_TO_END", 0.5)


@pytest.fixture(scope="module")
def executor(cluster, workers):
    made = DaskExecutor(cluster.address)
    yield made
    made.shutdown(wait=False, cancel_futures=True)


@pytest.fixture
def store(executor):
    return EpisodeStore(execution=Execution("dask", executor))


def bench_of(folder, store, **params):
    (folder / "room.yaml").write_text(SCENARIO)
    library = load_library([folder / "room.yaml"], builtin=False)
    log = folder / "log"
    log.mkdir()
    room = RoleSpec("shaky:ShakyRoom", {"log": str(log), **params})
    return Runner(lambda: library, simulator=room, time_budget=10.0, store=store), log


def until(condition, seconds=60.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_without_a_scheduler_one_message_says_so(monkeypatch):
    monkeypatch.setattr(dask, "SECONDS_TO_CONNECT", 0.3)
    with pytest.raises(ConfigurationError, match="no Dask scheduler") as refused:
        DaskExecutor("tcp://127.0.0.1:9")
    assert "127.0.0.1:9" in refused.value.found


def test_without_a_worker_one_message_says_so(cluster, monkeypatch):
    monkeypatch.setattr(dask, "SECONDS_TO_FIRST_WORKER", 0.3)
    with pytest.raises(ConfigurationError, match=r"no worker for 0\.3 s") as refused:
        DaskExecutor(cluster.address)
    assert refused.value.remedy == f"start some: dask worker {cluster.address} --nthreads 1"


def test_episodes_are_those_of_this_process(store):
    until(lambda: store.execution.width == 2)
    lifts = Runner(lift_library, recorded=True)
    tasks = [shaky(1), lifts.task(lifts.case("shaft/biased"))]
    assert [store.get(one).digest for one in tasks] == [one.run().digest for one in tasks]
    assert not store.execution.here


def test_an_episode_that_ends_its_process_is_missing_and_its_worker_stays(store, workers, tmp_path):
    lost = store.get(shaky(1, tmp_path, deeds={"1": "ends"}))
    assert lost.failure == (
        "infrastructure: its process was ended by SIGKILL in a call of the simulator at tick 0"
    )
    assert store.get(shaky(2, tmp_path)).failure is None
    assert begun(tmp_path) == [1, 1, 2]
    assert [one.poll() for one in workers] == [None, None]


@pytest.mark.parametrize("is_here", [True, False])
def test_coverage_counts_on_this_machine_only(executor, monkeypatch, is_here):
    """A worker elsewhere has files of the same names, which the session does not measure."""
    if not is_here:
        monkeypatch.setitem(executor._session, "place", ["another machine", 1, 2])
    measured = {
        "branch": False,
        "source": None,
        "include": None,
        "omit": None,
        "config_file": False,
    }
    future = executor.submit(
        simulate,
        json.dumps(shaky(1).to_json()),
        conditions_of(LoadedModules()),
        {**surroundings(), "coverage": measured},
        seconds=60.0,
    )
    assert future.result(timeout=60.0)
    captured = vars(future)["captured"]
    assert "a simulator that prints" in captured.stdout
    assert ("coverage" in captured.seen) is is_here


def test_a_campaign_that_is_decided_cancels_what_is_queued(store, tmp_path):
    bench, log = bench_of(tmp_path, store, seconds=0.05)
    campaign = bench.campaign("room/shaky", runs=60, until_decided=True)
    verdict = campaign.judge(COLD)
    assert verdict.verdict == "violated"
    time.sleep(0.3)
    assert len(begun(log)) <= verdict.episodes + IN_FLIGHT * store.execution.width < 60


def test_what_is_queued_on_the_cluster_is_cancelled(store, tmp_path):
    futures = [store.execution.submit(shaky(seed, tmp_path, seconds=0.3)) for seed in range(20)]
    until(lambda: len(begun(tmp_path)) >= 2)
    for future in futures:
        future.cancel()
    by_then = len(begun(tmp_path))
    time.sleep(1.5)
    assert len(begun(tmp_path)) <= by_then + 2  # what was on its way to the two workers
    assert store.get(shaky(1, tmp_path)).failure is None


def test_a_worker_killed_in_the_middle_loses_nothing(cluster, store, workers, tmp_path):
    bench, log = bench_of(tmp_path, store, seconds=0.1)
    campaign = bench.campaign("room/shaky")
    episodes = []
    for episode in campaign:
        episodes.append(episode)
        if len(episodes) == 3:
            assert len(children_of(workers[0])) == 1
            cluster.kill(workers[0])
    assert len(set(begun(log))) == campaign.planned
    here = Runner(bench.library, simulator=bench.simulator, time_budget=10.0)
    alone = list(here.campaign("room/shaky"))
    assert [one.digest for one in episodes] == [one.digest for one in alone]
    verdict, expected = campaign.judge(COLD), here.campaign("room/shaky").judge(COLD)
    assert (verdict.verdict, verdict.episodes, verdict.violations, verdict.missing) == (
        expected.verdict, expected.episodes, expected.violations, expected.missing,
    )  # fmt: skip
    until(lambda: store.execution.width == 1)


def test_a_worker_that_differs_is_refused_also_if_it_joins_later(
    cluster, executor, store, workers, tmp_path
):
    (tmp_path / "something_else-1.0.dist-info").mkdir()
    kept = filter(None, [os.environ.get("PYTHONPATH")])
    other = cluster.worker({"PYTHONPATH": os.pathsep.join([str(tmp_path), *kept])})
    until(lambda: executor.width == 2)
    with pytest.raises(ConfigurationError, match="differs in other packages") as refused:
        DaskExecutor(cluster.address)
    assert refused.value.problem.startswith("the Dask worker tcp://127.0.0.1:")
    assert "pip freeze" in refused.value.remedy
    futures = [store.execution.submit(one) for one in map(shaky, range(8))]
    errors = [one.exception() for one in futures]
    told = {one.problem for one in errors if isinstance(one, ConfigurationError)}
    assert told == {refused.value.problem}
    cluster.kill(other)


def test_who_leaves_the_cluster_ends_what_it_started_there_and_dask_logs_again(
    executor, store, workers
):
    assert logging.getLogger("distributed.client").disabled
    assert store.get(shaky(1)).failure is None
    assert any(children_of(worker) for worker in workers if worker.poll() is None)
    executor.shutdown(wait=False, cancel_futures=True)
    assert not logging.getLogger("distributed.client").disabled
    with pytest.raises(RuntimeError, match="closed"):
        Execution("dask", executor).submit(shaky(1))
    until(lambda: not any(children_of(worker) for worker in workers if worker.poll() is None))


def test_what_dask_tells_of_a_lost_worker(executor):
    killed = KilledWorker("task", last_worker=None, allowed_failures=3)
    assert str(executor._episode_error(killed)) == "it ended 4 workers"
    assert isinstance(executor._episode_error(killed), ProcessLostError)
    assert isinstance(executor._episode_error(ModuleNotFoundError("x")), CallFailedError)


# -- Workers and schedulers that are lost: each test connects to the cluster by itself --------


@pytest.fixture
def connect(cluster):
    """Connect to the cluster that all tests share, as often as a test does, and leave it."""
    executors = []

    def executor_of():
        executors.append(DaskExecutor(cluster.address))
        return executors[-1]

    yield executor_of
    for executor in executors:
        executor.shutdown(wait=False, cancel_futures=True)


def test_a_worker_that_is_lost_while_it_is_compared_is_left_out(cluster, connect):
    stays, goes = cluster.keep(2)
    goes.send_signal(signal.SIGSTOP)  # it is there, and never answers
    made = []
    asking = threading.Thread(target=lambda: made.append(connect()))
    asking.start()
    until(lambda: children_of(stays))  # which answers in a process of its own
    cluster.kill(goes)
    asking.join(timeout=60.0)
    assert [executor.width for executor in made] == [1]


def test_an_episode_that_ends_every_worker_it_is_given_to_is_missing(cluster, connect, tmp_path):
    workers = cluster.keep(3)
    store = EpisodeStore(execution=Execution("dask", connect()))
    lost = store.get(shaky(1, tmp_path, deeds={"1": "ends its worker"}))
    assert lost.failure == "infrastructure: it ended 2 workers"
    assert begun(tmp_path) == [1, 1], "each of them simulated it once, and the third is spared"
    assert store.get(shaky(2, tmp_path)).failure is None
    until(lambda: [worker.poll() for worker in workers].count(None) == 1)


def test_where_dask_gives_up_without_workers_its_limit_is_told(cluster, connect):
    (worker,) = cluster.keep(1)
    store = EpisodeStore(execution=Execution("dask", connect()))
    cluster.kill(worker)
    with pytest.raises(ConfigurationError, match="no worker for 3 s"):
        store.get(shaky(3))


def test_nobody_waits_for_ever_where_the_last_worker_is_gone(cluster, connect, monkeypatch):
    monkeypatch.setattr(dask, "SECONDS_WITHOUT_WORKERS", 2.0)
    monkeypatch.setattr(dask, "_POLL_SECONDS", 0.5)
    (worker,) = cluster.keep(1)
    execution = Execution("dask", connect())
    future = execution.submit(shaky(1, seconds=30.0))
    until(lambda: children_of(worker))
    cluster.kill(worker)
    with pytest.raises(ConfigurationError, match="no worker for 2 s") as told:
        future.result(timeout=20.0)
    assert told.value.remedy == f"start some: dask worker {cluster.address} --nthreads 1"
    # The next one does not wait as long once more. A worker that comes is not given the first.
    with pytest.raises(ConfigurationError, match="no worker"):
        execution.submit(shaky(2)).result(timeout=1.8)
    cluster.worker()
    until(execution.executor._client.nthreads)
    assert execution.submit(shaky(3)).result(timeout=20.0)


def test_nobody_waits_for_ever_for_a_scheduler_that_does_not_answer(cluster, connect, monkeypatch):
    monkeypatch.setattr(dask, "SECONDS_WITHOUT_ANSWER", 1.0)
    monkeypatch.setattr(dask, "_POLL_SECONDS", 0.2)
    cluster.keep(1)
    execution = Execution("dask", connect())
    future = execution.submit(shaky(1, seconds=30.0))
    cluster.scheduler.send_signal(signal.SIGSTOP)
    try:
        with pytest.raises(ConfigurationError, match=r"connection .* is lost"):
            future.result(timeout=15.0)
        assert execution.is_lost
    finally:
        cluster.scheduler.send_signal(signal.SIGCONT)


def test_a_scheduler_that_is_gone_is_told_and_nobody_waits(cluster, connect):
    """The last test of the cluster, which it ends."""
    cluster.keep(1)
    execution = Execution("dask", connect())
    future = execution.submit(shaky(1, seconds=30.0))
    cluster.kill(cluster.scheduler)
    with pytest.raises(ConfigurationError, match=r"connection .* is lost") as lost:
        future.result(timeout=20.0)
    assert "--dura-resume" in lost.value.remedy
    assert execution.is_lost, "so that the session stops, and can be resumed"
    begun_at = time.monotonic()
    execution.close()
    assert time.monotonic() - begun_at < 15.0
