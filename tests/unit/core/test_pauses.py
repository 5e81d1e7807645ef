"""Pauses in a call: they count neither for its limit nor for its time."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import pytest
from loops import run_loop

from pytest_dura import Generator, Proposal
from pytest_dura.core import GeneratorView
from pytest_dura.core.time_limits import (
    TimeBudgetExceeded,
    alarms,
    call_within,
    paused,
    with_pauses,
)

LIMIT = 0.3


def in_main(call: Callable[[], Any]) -> Any:
    with alarms():
        return call()


def in_thread(call: Callable[[], Any]) -> Any:
    results: list[Any] = []

    def work() -> None:
        try:
            results.append(call())
        except BaseException as error:  # it is raised again
            results.append(error)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    if isinstance(results[0], BaseException):
        raise results[0]
    return results[0]


def pauses_for(seconds: float) -> str:
    with paused():
        time.sleep(seconds)
    return "back"


def works_after_a_pause(seconds: float) -> str:
    pauses_for(2 * LIMIT)
    time.sleep(seconds)
    return "back"


@pytest.mark.parametrize("run", [in_main, in_thread])
def test_a_pause_is_no_time_of_a_call_with_a_limit(run) -> None:
    def call() -> Any:
        with with_pauses() as pauses:
            result = call_within(LIMIT, pauses_for, 3 * LIMIT)
            return result, pauses.seconds

    result, seconds = run(call)
    assert result == "back"
    assert 3 * LIMIT <= seconds < 3 * LIMIT + 5.0


@pytest.mark.parametrize("run", [in_main, in_thread])
def test_what_a_call_does_after_a_pause_is_held_to_its_limit(run) -> None:
    def call() -> Any:
        with with_pauses():
            return call_within(LIMIT, works_after_a_pause, 10.0)

    begun = time.monotonic()
    with pytest.raises(TimeBudgetExceeded):
        run(call)
    assert 3 * LIMIT <= time.monotonic() - begun < 9.0


def test_where_no_call_is_under_way_a_pause_is_nothing() -> None:
    assert pauses_for(0.0) == "back"
    with with_pauses() as pauses:
        assert pauses.seconds == 0.0


def test_the_time_of_a_call_leaves_out_its_own_pauses_and_no_earlier_ones() -> None:
    class Waits(Generator):
        def propose(self, view: GeneratorView) -> Proposal:
            if view.index == 1:
                pauses_for(LIMIT)
            elif view.index == 2:
                time.sleep(LIMIT)
            return Proposal(0.5)

    episode = run_loop(Waits(), seconds=0.4)
    first, pausing, working, last = episode.metrics.processing_ns["generator"][1]
    assert min(first, pausing, last) > 0
    assert working >= LIMIT * 1e9 > pausing


def test_an_earlier_pause_gives_a_later_call_no_more_time() -> None:
    with alarms(), with_pauses():
        pauses_for(10 * LIMIT)
        begun = time.monotonic()
        with pytest.raises(TimeBudgetExceeded):
            call_within(LIMIT, time.sleep, 10.0)
        assert time.monotonic() - begun < 8 * LIMIT
