"""Episodes in threads of this process: the same ones, and who blocks costs nobody else anything."""

from __future__ import annotations

import contextvars
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import pytest
from shaft import lift_library
from thermostat import Controller, HeatMonitor

from pytest_dura import Assessment, EpisodeSpec, RoleSpec, Runner, stream
from pytest_dura.core import (
    ComponentEnvironmentError,
    Termination,
    environment_errors,
    report_environment_error,
)
from pytest_dura.core.seeding import recording_draws
from pytest_dura.execution import IN_FLIGHT, CallFailedError, EpisodeStore, EpisodeTask, Execution
from pytest_dura.execution.threads import EpisodeThreads

LIMIT = 0.6
ASKS = {"model": "m", "fingerprint": "f"}


class Asks(Controller):
    """A controller that says which model it asks, and waits as if it did."""

    together = threading.Barrier(1)

    def __init__(self, model: str = "", fingerprint: str = "") -> None:
        super().__init__()

    def propose(self, view: Any) -> Any:
        if view.index == 0:
            type(self).together.wait(10.0)
        return super().propose(view)


class Stuck(HeatMonitor):
    """A monitor that blocks in the middle of some episodes, inside or outside of Python."""

    blocks: Callable[[], None] | None = None
    seeds: tuple[int, ...] = ()

    def reset(self, context: Any) -> None:
        super().reset(context)
        self._seed = context.seed

    def run(self, view: Any) -> Assessment:
        if view.index == 3 and self._seed in self.seeds:
            assert type(self).blocks is not None
            type(self).blocks()
        return super().run(view)


def asking(seed: int, monitor: type[HeatMonitor] | None = None) -> EpisodeTask:
    roles = {"generator": RoleSpec.of(Asks).with_params(ASKS)}
    if monitor is not None:
        roles["safety_monitor"] = RoleSpec.of(monitor)
    return EpisodeTask(room(seed, roles), role_timeout=LIMIT)


def room(seed: int, roles: dict[str, RoleSpec]) -> EpisodeSpec:
    return EpisodeSpec("room", seed, seed, RoleSpec("thermostat:Thermostat"), roles)


@pytest.fixture
def store() -> Iterator[EpisodeStore]:
    made = EpisodeStore(execution=Execution(threads=EpisodeThreads(2)))
    yield made
    made.execution.close()


@pytest.mark.of_guest
def test_so_many_episodes_wait_at_once_and_come_in_their_order(store, monkeypatch) -> None:
    monkeypatch.setattr(Asks, "together", threading.Barrier(4))  # breaks unless four get there
    tasks = [asking(seed) for seed in range(8)]
    episodes = [store.get(task, tasks[number + 1 :]) for number, task in enumerate(tasks)]
    monkeypatch.setattr(Asks, "together", threading.Barrier(1))
    assert [episode.spec.seed for episode in episodes] == list(range(8))
    assert [episode.digest for episode in episodes] == [task.run().digest for task in tasks]
    assert all(episode.validity == "valid" for episode in episodes)
    assert not store.execution.here


def test_episodes_in_threads_are_those_of_one_after_the_other() -> None:
    lifts = Runner(lift_library, recorded=True, end_when_decided=True)
    names = "shaft/biased", "shaft/up"
    tasks = [lifts.task(lifts.case(name), run) for name in names for run in range(3)]
    with EpisodeThreads(6) as threads:
        futures = [threads.submit(task.run) for task in tasks]
        there = [future.result(60.0) for future in futures]
    here = [task.run() for task in tasks]
    assert [episode.digest for episode in there] == [episode.digest for episode in here]
    assert [episode.drawn for episode in there] == [episode.drawn for episode in here]


def test_an_episode_that_asks_no_model_stays_in_the_main_thread(store) -> None:
    ran: list[str] = []

    class Tells(Controller):
        def reset(self, context: Any) -> None:
            super().reset(context)
            ran.append(threading.current_thread().name)

    for params in ({}, ASKS):  # one that is a bare instance does so too
        generator = replace(RoleSpec.of(Tells()), params=params)
        store.get(EpisodeTask(room(1, {"generator": generator})))
    assert ran == [threading.main_thread().name] * 2


def spins() -> None:
    while True:
        pass


def waits() -> None:
    for _ in range(1000):
        time.sleep(0.01)


def sleeps() -> None:
    time.sleep(20.0)  # a thread cannot be woken


CAUSE = "it did not come back within 0.6 s of wall-clock time"


@pytest.mark.of_guest
@pytest.mark.parametrize(
    "block, failure",
    [
        (spins, f"infrastructure: safety_monitor at tick 3 (t = 0.3 s): {CAUSE}"),
        (waits, f"infrastructure: safety_monitor at tick 3 (t = 0.3 s): {CAUSE}"),
        (sleeps, f"infrastructure: safety_monitor: {CAUSE}"),
    ],
)
def test_a_role_that_blocks_is_named_and_the_other_episodes_are_there(
    store, monkeypatch, block, failure
) -> None:
    monkeypatch.setattr(Stuck, "blocks", block)
    monkeypatch.setattr(Stuck, "seeds", (1, 2, 3, 4))  # as many as there are threads
    tasks = [asking(seed, Stuck) for seed in range(1, 8)]
    begun = time.monotonic()
    episodes = [store.get(task, tasks[number + 1 :]) for number, task in enumerate(tasks)]
    assert time.monotonic() - begun < 15.0
    assert [episode.failure for episode in episodes] == [failure] * 4 + [None] * 3
    assert {episode.validity for episode in episodes[:4]} == {"missing"}


class Busy(HeatMonitor):
    """A monitor whose calls together take longer than one of them may."""

    def run(self, view: Any) -> Assessment:
        time.sleep(LIMIT / 6)
        return super().run(view)


def test_many_short_calls_in_a_thread_are_not_one_long_one(store) -> None:
    task = asking(1, Busy)
    short = replace(task, spec=replace(task.spec, termination=Termination(2.0)))
    assert store.get(short).validity == "valid"


def test_at_the_end_no_call_is_between_the_queue_and_its_thread() -> None:
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)  # so that threads are interrupted anywhere
    try:
        for _ in range(20):
            threads = EpisodeThreads(3)
            futures = [threads.submit(time.sleep, 0.05) for _ in range(4 * IN_FLIGHT)]
            threads.shutdown(wait=False, cancel_futures=True)
            for future in futures:
                assert future.cancelled() or isinstance(future.exception(0), CallFailedError)
    finally:
        sys.setswitchinterval(before)


def test_the_end_of_the_executor_waits_for_no_thread_that_goes_on() -> None:
    threads, entered, released = EpisodeThreads(1), threading.Event(), threading.Event()

    def blocked() -> str:
        entered.set()
        released.wait(30.0)
        return "late"

    running, *_, queued = [threads.submit(blocked) for _ in range(IN_FLIGHT + 1)]
    assert entered.wait(10.0)
    begun = time.monotonic()
    threads.shutdown(wait=False, cancel_futures=True)
    assert time.monotonic() - begun < 5.0
    assert isinstance(running.exception(0), CallFailedError)
    assert queued.cancelled()
    released.set()
    with pytest.raises(RuntimeError):
        threads.submit(blocked)


def test_what_a_call_raises_is_raised_where_its_result_is_taken() -> None:
    with EpisodeThreads(2) as threads:
        assert threads.submit(divmod, 7, 2).result(10.0) == (3, 1)
        with pytest.raises(ZeroDivisionError):
            threads.submit(divmod, 7, 0).result(10.0)


def test_reports_and_draws_of_a_thread_are_of_its_own_episode() -> None:
    error = ComponentEnvironmentError("cassette", "it has no such answer")
    ready = threading.Barrier(2)

    def episode(*, fails: bool) -> tuple[list[Any], bool]:
        with environment_errors() as errors, recording_draws() as draws:
            ready.wait(10.0)
            if fails:
                report_environment_error(error)
                # As a time limit does it: in a thread with a copy of the context.
                context = contextvars.copy_context()
                helper = threading.Thread(
                    target=context.run, args=(report_environment_error, error)
                )
                helper.start()
                helper.join()
                stream(1, "noise").normal()
            ready.wait(10.0)
        return errors, draws.any

    with EpisodeThreads(2) as threads:
        futures = [threads.submit(episode, fails=fails) for fails in (True, False)]
        results = [future.result(20.0) for future in futures]
    assert results == [([error, error], True), ([], False)]


def test_a_thread_of_nobody_reports_to_every_episode_that_runs() -> None:
    error = ComponentEnvironmentError("cassette", "it has no such answer")
    ready = threading.Barrier(3)

    def episode() -> list[Any]:
        with environment_errors() as errors:
            ready.wait(10.0)
            ready.wait(10.0)
        return errors

    with EpisodeThreads(2) as threads:
        futures = [threads.submit(episode) for _ in range(2)]
        ready.wait(10.0)
        own = threading.Thread(target=report_environment_error, args=(error,))
        own.start()
        own.join()
        ready.wait(10.0)
        assert [future.result(10.0) for future in futures] == [[error], [error]]
