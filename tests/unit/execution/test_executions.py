"""Episodes that other processes simulate: the same ones, and none lost without a word."""

from __future__ import annotations

import importlib
import json
import os
import signal
import time
from concurrent.futures import Executor, Future
from dataclasses import replace
from pathlib import Path

import psutil
import pytest
from shaft import lift_library
from shaky import begun, shaky
from thermostat import Controller

from pytest_dura import ConfigurationError, RoleSpec, Runner
from pytest_dura.core import Policy, Termination
from pytest_dura.core.clock import Clock
from pytest_dura.execution import (
    IN_FLIGHT,
    EpisodeStore,
    EpisodeTask,
    Execution,
    ExecutorChoice,
    ProcessPool,
)
from pytest_dura.execution.address import address_of, conditions_of, simulate
from pytest_dura.execution.executors import time_limit_of
from pytest_dura.execution.processes import usable_cores
from pytest_dura.execution.task import reason_not_portable
from pytest_dura.library import LocalRole, load_library
from pytest_dura.requirements import Requirement
from pytest_dura.requirements.episode_verdicts import judge_by_check

SCENARIO = """
name: room/shaky
simulator: thermostat:Thermostat
duration: 1.0
runs: 40
roles: {generator: "thermostat:Controller"}
faults: []
requirements: []
"""


@pytest.fixture(scope="module")
def pool():
    made = ProcessPool(2)
    yield made
    made.shutdown(wait=False, cancel_futures=True)


@pytest.fixture
def store(pool):
    return EpisodeStore(execution=Execution("processes", pool))


@pytest.fixture
def bench(tmp_path, store):
    (tmp_path / "room.yaml").write_text(SCENARIO)
    library = load_library([tmp_path / "room.yaml"], builtin=False)
    log = tmp_path / "log"
    log.mkdir()
    room = RoleSpec("shaky:ShakyRoom", {"log": str(log)})
    return Runner(lambda: library, simulator=room, time_budget=1e-3, store=store)


def until(condition, seconds=60.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def seed_of(bench, run):
    return str(bench.task(bench.case("room/shaky"), run).spec.seed)


def log_of(bench):
    return Path(bench.simulator.params["log"])


def steady(episode):
    return [event for event in episode.events if not event.wall_clock]


def test_episodes_are_those_of_this_process(store):
    lifts = Runner(lift_library, recorded=True, end_when_decided=True)
    names = "shaft/biased", "shaft/up"
    tasks = [shaky(1), *(lifts.task(lifts.case(name)) for name in names)]
    assert tasks[-1].judging
    for task in tasks:
        there, here = store.get(task), task.run()
        assert there.digest == here.digest
        assert there.termination == here.termination
        assert steady(there) == steady(here)
    assert not store.execution.here


@pytest.mark.of_guest  # whose imports take long
def test_what_episodes_import_is_imported_once_for_all_processes_that_simulate_several(tmp_path):
    runner = Runner(lambda: load_library([]))
    case = runner.case("intersection/nominal")
    pool = ProcessPool(1)
    pool.preload = [case.scenario.simulator_spec().path]
    try:
        store, seconds = EpisodeStore(execution=Execution("processes", pool)), []
        for run in range(3):
            before = psutil.Process(pool.pids[0]).cpu_times().user if pool.pids else 0.0
            store.get(runner.task(case, run))
            (pid,) = pool.pids
            seconds.append(psutil.Process(pid).cpu_times().user - before)
        template = psutil.Process(pid).parent()
        assert seconds[0] < template.cpu_times().user / 2
        assert store.get(runner.task(case, 9)).failure is None
        assert pool.pids == [pid], "an episode that leaves nothing behind keeps its process"
    finally:
        pool.shutdown(wait=False)


def test_an_episode_that_ends_its_process_is_missing_and_the_others_are_there(bench):
    bench.simulator = bench.simulator.with_params(
        {**bench.simulator.params, "deeds": {seed_of(bench, 3): "ends"}}
    )
    campaign = bench.campaign("room/shaky", runs=8)
    verdict = campaign.judge(Requirement(id="R", check="always (temperature < 90)"))
    assert (verdict.verdict, verdict.episodes, verdict.missing) == ("undecided", 7, 1)
    lost = bench.run("room/shaky", run=3)
    assert lost.failure == (
        "infrastructure: its process was ended by SIGKILL in a call of the simulator at tick 0"
    )
    assert begun(log_of(bench)).count(int(seed_of(bench, 3))) == 2


def test_an_episode_that_blocks_for_ever_is_missing(pool, tmp_path):
    store = EpisodeStore(execution=Execution("processes", pool, seconds=2.5))
    store.get(shaky(0))  # a process has imported by then what it needs
    started = time.monotonic()
    lost = store.get(shaky(1, tmp_path, deeds={"1": "blocks"}))
    assert lost.failure == (
        "infrastructure: its process was ended, since it took longer than 2.5 s in a call of the "
        "simulator at tick 0"
    )
    assert time.monotonic() - started < 10.0
    assert begun(tmp_path) == [1]
    assert store.get(shaky(2, tmp_path)).failure is None


def test_imports_that_take_longer_than_an_episode_may_cost_no_episode(tmp_path, monkeypatch):
    source = "import time\nfrom shaky import ShakyRoom as Slow\ntime.sleep(3.5)\n"
    (tmp_path / "slow_to_import.py").write_text(source)
    monkeypatch.syspath_prepend(str(tmp_path))
    with ProcessPool(1) as slow:
        execution = Execution("processes", slow, seconds=3.0)
        task = shaky(1)
        slow_task = replace(
            task, spec=replace(task.spec, simulator=RoleSpec("slow_to_import:Slow"))
        )
        assert execution.submit(slow_task).result()


def test_a_campaign_that_is_decided_cancels_what_is_queued(bench):
    requirement = Requirement(
        id="R", check="always (temperature < 16)", at_most=0.3, method="e-process"
    )
    campaign = bench.campaign("room/shaky", until_decided=True)
    verdict = campaign.judge(requirement)
    assert verdict.verdict == "violated"
    assert 0 < verdict.episodes < campaign.planned // 2
    begun_by_then = len(begun(log_of(bench)))
    time.sleep(0.3)
    assert len(begun(log_of(bench))) <= begun_by_then + bench.store.execution.width
    assert begun_by_then <= verdict.episodes + IN_FLIGHT * bench.store.execution.width


def test_what_is_queued_at_the_pool_is_cancelled(store, tmp_path):
    futures = [store.execution.submit(shaky(seed, tmp_path, seconds=1.0)) for seed in range(10)]
    until(lambda: len(begun(tmp_path)) >= 2)
    carried_out = [future for future in futures if not future.cancel()]
    assert [future.result(timeout=60.0) for future in carried_out]
    assert len(begun(tmp_path)) == len(carried_out) < 5


def test_a_process_that_is_killed_loses_no_episode(pool, store, tmp_path):
    tasks = [shaky(seed, tmp_path, seconds=0.1) for seed in range(8)]
    episodes = []
    for number, task in enumerate(tasks):
        if number == 2:
            os.kill(pool.pids[0], signal.SIGKILL)
        episodes.append(store.get(task, tasks[number + 1 :]))
    assert [one.digest for one in episodes] == [task.run().digest for task in tasks]
    assert all(one.failure is None for one in episodes)


def test_what_cannot_travel_is_simulated_here_and_noted(store):
    bare = replace(shaky(1).spec, roles={"generator": RoleSpec.of(Controller())})
    local = replace(bare, roles={"generator": LocalRole("conftest.py:Controller", Controller)})
    for spec in (bare, bare, local):
        assert store.get(EpisodeTask(spec)).failure is None
    assert set(store.execution.here) == {
        ("Controller", "its generator is a bare instance"),
        ("Controller", "the class of its generator is in a conftest.py"),
    }


def test_why_an_episode_stays_here():
    def reason(role, **metrics):
        return reason_not_portable(
            EpisodeTask(replace(shaky(1).spec, roles={"generator": role}), (), metrics)
        )

    path = "thermostat:Controller"
    assert reason(RoleSpec(path, {"target": [1.5, "a", None]})) is None
    assert reason(RoleSpec("conftest:Planner")) == (
        "no import path leads to the class of its generator"
    )
    assert reason(RoleSpec(path, {"target": (1, 2)})) == (
        "the parameters of its generator are no plain data"
    )
    assert reason(RoleSpec(path, {"target": object()})) == (
        "the parameters of its generator are no plain data"
    )
    assert reason(RoleSpec(path), late=lambda _: 0.0) == "no import path leads to the metric late"
    assert reason(RoleSpec(path), late=time_limit_of) is None


@pytest.mark.of_guest
def test_a_component_that_asks_a_language_model_stays_here():
    asks = {"model": "m", "server": {"fingerprint": "f"}}
    stays = replace(shaky(1).spec, roles={"generator": RoleSpec("thermostat:Controller", asks)})
    assert reason_not_portable(EpisodeTask(stays)) == "its generator asks a language model"


def test_a_configuration_error_comes_back_as_it_is_here(store):
    task = EpisodeTask(replace(shaky(1).spec, roles={"generator": RoleSpec("thermostat:Nobody")}))
    with pytest.raises(ConfigurationError) as here:
        task.run()
    with pytest.raises(ConfigurationError) as there:
        store.execution.submit(task).result()
    assert str(there.value) == str(here.value)


def test_code_that_changed_in_the_meantime_is_refused(pool, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(tmp_path))
    file = tmp_path / "changing_planner.py"
    file.write_text("from thermostat import Controller\nclass Planner(Controller):\n    pass\n")
    importlib.invalidate_caches()
    task = EpisodeTask(
        replace(shaky(1).spec, roles={"generator": RoleSpec("changing_planner:Planner")})
    )
    fresh = ProcessPool(1)  # which reads the files when it is first asked
    try:
        execution = Execution("processes", fresh)
        assert address_of(task) is not None  # it is imported here, as it is now
        assert "changing_planner" in execution.modules.digests()
        file.write_text(file.read_text() + "    other = 1\n")
        with pytest.raises(ConfigurationError) as refused:
            execution.submit(task).result()
    finally:
        fresh.shutdown(wait=False)
    assert "differs in module changing_planner" in str(refused.value)
    assert "start it again" in refused.value.remedy


def test_a_machine_with_other_versions_is_refused():
    given = conditions_of(Execution().modules)
    conditions = {**given, "machine": {**given["machine"], "numpy": "0.1"}}
    with pytest.raises(ConfigurationError) as refused:
        simulate(json.dumps(shaky(1).to_json()), {**conditions, "where": "the worker X"})
    assert str(refused.value).startswith("the worker X would simulate other episodes")
    assert "expected: numpy: 0.1" in str(refused.value)
    assert f"found:    'numpy: {given['machine']['numpy']}'" in str(refused.value)


class OtherMachine(Executor):
    """Carries out calls at once, and says nothing of the files that it imports."""

    def submit(self, fn, /, *args, **kwargs):
        future = Future()
        future.set_result(fn(*args, **kwargs))
        return future


def test_a_function_that_checks_is_called_where_the_same_files_are_imported(pool):
    """A formula means the same everywhere, and a lambda in a conftest is known here alone."""
    formula, function = "always (temperature < 90)", "shaky:is_warm"
    checks = (formula, function, "conftest:whatever")
    judged_there = {OtherMachine(): {formula}, pool: {formula, function}}
    for executor, there in judged_there.items():
        store = EpisodeStore(execution=Execution("elsewhere", executor))
        episode = store.get(replace(shaky(1), checks=checks))
        assert set(episode.check_verdicts) == there
        for check in (formula, function):
            assert judge_by_check(check, episode).status == "satisfied"


def test_the_limit_leaves_the_component_its_time():
    spec = replace(shaky(1).spec, time_budget=2.0, termination=Termination(1.0))
    assert time_limit_of(spec, 10.0) == 10.0 + 11 * 2.0
    paced = replace(spec, clock=Clock(kind="wall"))
    assert time_limit_of(paced, 10.0) == 10.0 + spec.termination.time_limit + 11 * 2.0
    assert time_limit_of(replace(spec, policy=Policy.parse("refine(2)")), 10.0) == 10.0 + 33 * 2.0
    assert time_limit_of(replace(spec, time_budget=None), 10.0) == 10.0
    few = replace(spec, termination=Termination(1.0, iterations=3))
    assert time_limit_of(few, 10.0) == 10.0 + 3 * 2.0


def test_executors_are_chosen_by_name():
    assert ExecutorChoice.parse(None) == ExecutorChoice.parse("in-process") == ExecutorChoice()
    assert ExecutorChoice.parse("processes").processes == usable_cores()
    assert ExecutorChoice.parse("processes:3").processes == 3
    dask = ExecutorChoice.parse("dask://host:8786")
    assert (dask.name, dask.processes, vars(dask.kind)["address"]) == (
        "dask", None, "tcp://host:8786"
    )  # fmt: skip
    assert vars(ExecutorChoice.parse("dask://[::1]:1/").kind)["address"] == "tcp://[::1]:1"
    assert ExecutorChoice().execution().inside
    execution = replace(ExecutorChoice.parse("processes"), seconds=5.0).execution()
    assert (execution.name, execution.width, execution.seconds) == ("processes", usable_cores(), 5)
    execution.close()


@pytest.mark.parametrize(
    "text",
    ["", "threads", "processes:", "processes:0", "processes:-1", "processes:two", "dask://",
     "dask://host", "dask://host:0", "dask://host:65536", "dask://host:1/x", "tcp://host:1"],
)  # fmt: skip
def test_other_names_are_refused(text):
    with pytest.raises(ConfigurationError, match="no such executor") as refused:
        ExecutorChoice.parse(text)
    assert refused.value.found == text


def test_what_later_items_need_is_begun_and_survives_the_end_of_a_campaign(bench, store):
    tasks = [bench.task(bench.case("room/shaky"), run) for run in range(10)]
    assert store.lacks_plan
    store.plan(tasks)
    assert not store.lacks_plan
    store.get(tasks[0])
    log = Path(bench.simulator.params["log"])
    until(lambda: len(begun(log)) >= 2 * IN_FLIGHT)  # nobody has asked for them yet
    store.cancel()
    seeds = [store.get(task).spec.seed for task in tasks]
    assert begun(log) == sorted(seeds) == sorted(task.spec.seed for task in tasks)  # each once
