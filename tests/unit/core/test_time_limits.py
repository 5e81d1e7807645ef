"""call_within: ends what runs too long, and nothing else."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextvars import ContextVar
from typing import Any

import pytest

from pytest_dura.core import TimeBudgetExceeded, call_within
from pytest_dura.core.time_limits import CallNotStopped

context: ContextVar[str] = ContextVar("context", default="none")


def here(call: Callable[[], Any]) -> Any:
    return call()


def in_a_thread(call: Callable[[], Any]) -> Any:
    results: list[Any] = []

    def work() -> None:
        try:
            results.append(call())
        except BaseException as error:
            results.append(error)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join(10)
    if isinstance(results[0], BaseException):
        raise results[0]
    return results[0]


everywhere = pytest.mark.parametrize("run", [here, in_a_thread])


@everywhere
@pytest.mark.parametrize("seconds", [None, 5.0])
def test_a_call_in_time_gives_its_result(run: Any, seconds: float | None) -> None:
    assert run(lambda: call_within(seconds, divmod, 7, 2)) == (3, 1)


@everywhere
def test_an_error_of_the_call_is_its_own(run: Any) -> None:
    def work() -> None:
        raise LookupError("mine")

    with pytest.raises(LookupError, match="mine"):
        run(lambda: call_within(5.0, work))


@everywhere
def test_a_busy_call_is_ended(run: Any) -> None:
    ended: list[bool] = []

    def work() -> None:
        try:
            while True:
                pass
        finally:
            ended.append(True)

    started = time.monotonic()
    with pytest.raises(TimeBudgetExceeded):
        run(lambda: call_within(0.05, work))
    assert time.monotonic() - started < 10.0
    assert ended == [True]


def test_a_sleeping_call_is_ended_in_the_main_thread() -> None:
    started = time.monotonic()
    with pytest.raises(TimeBudgetExceeded):
        call_within(0.05, time.sleep, 30)
    assert time.monotonic() - started < 10.0


def test_a_sleeping_call_is_left_behind_elsewhere() -> None:
    release = threading.Event()
    started = time.monotonic()
    try:
        with pytest.raises(CallNotStopped):
            in_a_thread(lambda: call_within(0.05, release.wait, 30))
    finally:
        release.set()
    assert time.monotonic() - started < 10.0


def test_one_that_swallows_every_interruption_is_ended_all_the_same() -> None:
    interrupted: list[float] = []

    def retries() -> int:
        for _ in range(3):
            try:
                time.sleep(30)
            except BaseException:  # noqa: PERF203 - what a component might do
                interrupted.append(time.monotonic())
        return 5

    with pytest.raises(TimeBudgetExceeded):
        call_within(0.05, retries)
    assert len(interrupted) == 3


def test_a_limit_within_a_limit() -> None:
    def outer() -> str:
        with pytest.raises(TimeBudgetExceeded):
            call_within(0.05, lambda: [None for _ in iter(int, 1)])
        return "went on"

    assert call_within(5.0, outer) == "went on"


@everywhere
def test_the_call_sees_the_context_of_its_caller(run: Any) -> None:
    def work() -> str:
        context.set("mine")
        return call_within(5.0, context.get)

    assert run(work) == "mine"
    context.set("none")
