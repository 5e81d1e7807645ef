"""Whatever the component does wrong is an event on it; recovery acts and the episode goes on."""

from __future__ import annotations

import os
import signal
import threading
import time
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from loops import Says, run_loop, spec_of
from thermostat import Controller, HeatMonitor, SwitchOff, Thermostat

from pytest_dura import Episode, Generator, Orchestrator, Proposal
from pytest_dura.core.errors import LONGEST_TEXT

TIGHT = {"time_budget": 0.05}


def failures(episode: Episode) -> list[tuple[int, str]]:
    return [(e.tick, e.detail) for e in episode.events if e.kind == "component_failure"]


def explode(view: Any) -> Proposal:
    raise ValueError("no idea")


class UnreadableError(Exception):
    def __str__(self) -> str:
        raise RuntimeError("not even this")


def raise_unreadable(view: Any) -> Proposal:
    raise UnreadableError


def leave(view: Any) -> Proposal:
    raise SystemExit(3)


class Odd:
    """Has the default repr, which holds a memory address."""


def raise_odd(view: Any) -> Proposal:
    raise ValueError(f"cannot handle {Odd()}")


@pytest.mark.parametrize(
    "answer, detail",
    [
        (explode, "raised ValueError: no idea (test_component_failures.py:"),
        (raise_unreadable, "raised UnreadableError: (its message cannot be read)"),
        (leave, "raised SystemExit: 3 (test_component_failures.py:"),
        (raise_odd, "Odd object at 0x…>"),
        (lambda view: None, "returned NoneType, not a Proposal"),
        (lambda view: 1.0, "returned float, not a Proposal"),
        (lambda view: Proposal(None), "no valid action: None is not a heating power"),
        (lambda view: Proposal(float("nan")), "no valid action: nan is not a heating power"),
        (lambda view: Proposal(float("inf")), "no valid action: inf"),
        (lambda view: Proposal("full"), "no valid action: 'full'"),
        (lambda view: Proposal(1.0, explanation=None), "explanation that is NoneType, not str"),  # type: ignore[arg-type]
        (lambda view: Proposal(1.0, latency=6.0), "answered after 6 s; its budget is 5 s"),
        (lambda view: Proposal(1.0, latency=float("nan")), "latency of nan, which is not a dur"),
        (lambda view: Proposal(1.0, latency=-1.0), "latency of -1.0, which is not a duration"),
        (lambda view: Proposal(1.0, latency="soon"), "latency of 'soon', which is not a dur"),  # type: ignore[arg-type]
        (lambda view: Proposal(view.percept["sonar"]), "no sensor channel 'sonar'; there are: "),
        (lambda view: Proposal(view.truth), "has no attribute 'truth'"),
    ],
)
def test_a_failing_component_is_recovered_from_and_judged(answer: Any, detail: str) -> None:
    episode = run_loop(answer, safety_monitor=HeatMonitor(), recovery_planner=SwitchOff())
    assert episode.failure is None
    assert episode.validity == "valid"
    assert episode.ticks == 11
    assert set(episode.decisions["source"]) == {"recovery"}
    assert set(episode.decisions["proposed"]) == {""}
    # The same failure at every tick is one event, and ten violations.
    ((tick, found),) = failures(episode)
    assert tick == 0
    assert detail in found
    assert episode.metrics.violations["component"] == 10
    assert (episode.metrics.proposals, episode.metrics.valid_proposals) == (10, 0)
    assert episode.flagged


def test_without_recovery_the_plant_does_what_it_does_when_nobody_commands_it() -> None:
    for policy in ("recover", "log_only"):
        episode = run_loop(explode, policy=policy, safety_monitor=HeatMonitor())
        assert set(episode.decisions["source"]) == {"fallback"}
        assert set(episode.decisions["executed"]) == {"0%"}


def test_a_failure_is_an_event_where_it_begins_changes_and_ends() -> None:
    def answer(view: Any) -> Any:
        return {2: None, 3: None, 4: 7}.get(view.index, Proposal(1.0))

    episode = run_loop(answer)
    found = [(e.tick, e.kind, e.detail) for e in episode.events if "component" in e.kind]
    assert found == [
        (2, "component_failure", "returned NoneType, not a Proposal"),
        (4, "component_failure", "returned int, not a Proposal"),
        (5, "component_failure_ended", ""),
    ]
    assert episode.metrics.violations["component"] == 3


def test_numpy_numbers_are_good_latencies() -> None:
    episode = run_loop(lambda view: Proposal(1.0, latency=np.float32(0.25)))
    assert failures(episode) == []


def test_a_latency_within_the_budget_or_without_one_is_fine() -> None:
    assert failures(run_loop(lambda view: Proposal(1.0, latency=5.0))) == []
    unlimited = run_loop(lambda view: Proposal(1.0, latency=99.0), spec={"time_budget": None})
    assert failures(unlimited) == []


class FailsInReset(Generator):
    asked = 0

    def reset(self, context: Any) -> None:
        raise OSError("no model file")

    def propose(self, view: Any) -> Proposal:
        type(self).asked += 1
        return Proposal(1.0)


def test_a_component_that_fails_in_reset_is_not_called_and_said_to_have_failed_there() -> None:
    episode = run_loop(FailsInReset(), recovery_planner=SwitchOff())
    assert FailsInReset.asked == 0
    assert episode.failure is None
    first, second = failures(episode)
    assert first[1].startswith("reset raised OSError: no model file (test_component_failures.py:")
    assert second == (0, "not called: its reset failed")
    assert episode.timeouts == ()
    assert episode.metrics.violations["component"] == 10


def spin(view: Any) -> Proposal:
    while True:
        pass


def sleep(view: Any) -> Proposal:
    time.sleep(60)
    return Proposal(1.0)


def shrug_off(view: Any) -> Proposal:
    try:
        time.sleep(60)
    except BaseException:
        return Proposal(1.0)
    return Proposal(0.5)


@pytest.mark.parametrize("hang", [spin, sleep, shrug_off])
def test_a_component_that_hangs_overruns_its_budget_and_is_given_up_in_the_end(hang: Any) -> None:
    hanging = Says(hang)
    started = time.monotonic()
    episode = run_loop(hanging, recovery_planner=SwitchOff(), spec=TIGHT)
    assert time.monotonic() - started < 20.0
    assert len(hanging.views) == 3
    assert episode.timeouts == (0, 1, 2)
    assert failures(episode) == [
        (0, "overran its wall-clock time budget"),
        (3, "not called: it overran its time budget 3 times"),
    ]
    assert set(episode.decisions["source"]) == {"recovery"}
    assert episode.failure is None


def off_the_main_thread(call: Any) -> Any:
    results: list[Any] = []
    thread = threading.Thread(target=lambda: results.append(call()))
    thread.start()
    thread.join(20)
    assert results, "the thread did not come back"
    return results[0]


def test_a_busy_component_is_stopped_off_the_main_thread_too() -> None:
    episode = off_the_main_thread(lambda: run_loop(spin, recovery_planner=SwitchOff(), spec=TIGHT))
    assert episode.timeouts == (0, 1, 2)
    assert episode.failure is None


def test_a_sleeping_component_is_left_behind_off_the_main_thread() -> None:
    release = threading.Event()

    def wait(view: Any) -> Proposal:
        # Waiting for a lock in C is what a thread cannot be woken from.
        release.wait(30)
        return Proposal(1.0)

    hanging = Says(wait)
    try:
        episode = off_the_main_thread(
            lambda: run_loop(hanging, recovery_planner=SwitchOff(), spec=TIGHT)
        )
    finally:
        release.set()
    assert len(hanging.views) == 1
    assert episode.timeouts == (0, 0, 0)
    assert failures(episode)[1] == (1, "not called: an earlier call has not come back")
    replayed = run_loop(
        lambda view: Proposal(1.0),
        recovery_planner=SwitchOff(),
        spec={**TIGHT, "timeouts": episode.timeouts},
    )
    assert failures(replayed) == failures(episode)


class SleepsInReset(Generator):
    def reset(self, context: Any) -> None:
        time.sleep(60)

    def propose(self, view: Any) -> Proposal:
        return Proposal(1.0)


def test_a_reset_that_hangs_is_recorded_and_replayed() -> None:
    episode = run_loop(SleepsInReset(), recovery_planner=SwitchOff(), spec=TIGHT)
    assert episode.timeouts == (-1,)
    assert failures(episode)[0] == (0, "reset overran its wall-clock time budget")
    replayed = run_loop(
        SleepsInReset(), recovery_planner=SwitchOff(), spec={**TIGHT, "timeouts": (-1,)}
    )
    assert failures(replayed) == failures(episode)


@pytest.mark.parametrize("policy", ["recover", "refine(2)"])
def test_a_replay_applies_the_recorded_timeouts_and_not_the_clock(policy: str) -> None:
    class SlowAtTwo(Generator):
        def propose(self, view: Any) -> Proposal:
            if view.index == 2 and not view.feedback:
                time.sleep(60)
            # The second proposal of a tick is the one that counts under refine.
            return Proposal(0.5 if view.feedback else 1.0)

    hot = {"scenario": {"world": {"start": 40.0}}, **TIGHT}
    parts = {
        "generator": SlowAtTwo(),
        "safety_monitor": HeatMonitor(),
        "recovery_planner": SwitchOff(),
    }
    spec = spec_of(parts, seconds=0.6, policy=policy, **hot)
    loop = Orchestrator(Thermostat(), parts)
    recorded = loop.run(spec)
    assert len(recorded.timeouts) == 1
    started = time.monotonic()
    replayed = loop.run(replace(spec, timeouts=recorded.timeouts))
    assert time.monotonic() - started < 10.0
    assert replayed.digest == recorded.digest
    assert replayed.timeouts == recorded.timeouts


def test_a_replay_without_timeouts_does_not_look_at_the_clock() -> None:
    def slow(view: Any) -> Proposal:
        time.sleep(0.02)
        return Proposal(1.0)

    episode = run_loop(slow, seconds=0.3, spec={"time_budget": 0.001, "timeouts": ()})
    assert failures(episode) == []


def test_the_alarm_of_the_time_budget_is_gone_afterwards() -> None:
    import signal

    before = signal.getsignal(signal.SIGALRM)
    run_loop(spin, recovery_planner=SwitchOff(), spec=TIGHT)
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)
    assert signal.getsignal(signal.SIGALRM) is before


def test_an_alarm_of_somebody_else_is_left_alone() -> None:
    import signal

    rung: list[int] = []
    before = signal.signal(signal.SIGALRM, lambda number, frame: rung.append(number))
    signal.setitimer(signal.ITIMER_REAL, 30.0)
    try:
        episode = run_loop(spin, recovery_planner=SwitchOff(), spec=TIGHT)
        assert episode.timeouts == (0, 1, 2)
        assert 0.0 < signal.getitimer(signal.ITIMER_REAL)[0] <= 30.0
        os.kill(os.getpid(), signal.SIGALRM)
        assert rung == [signal.SIGALRM]
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


@pytest.mark.usefixtures("hears_keys")
def test_control_c_is_not_a_failure_of_the_component() -> None:
    def interrupt(view: Any) -> Proposal:
        signal.raise_signal(signal.SIGINT)
        return Proposal(1.0)

    def swallow(view: Any) -> Proposal:
        with suppress(BaseException):
            interrupt(view)
        return Proposal(1.0)

    for component in (interrupt, swallow):
        with pytest.raises(KeyboardInterrupt):
            run_loop(component)
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_component_cannot_hide_things_from_the_monitor_by_writing_into_the_percept() -> None:
    def tamper(view: Any) -> Proposal:
        view.percept["thermometer"] = 0.0
        return Proposal(1.0)

    hot = {"scenario": {"world": {"start": 40.0}}}
    episode = run_loop(tamper, safety_monitor=HeatMonitor(), spec=hot)
    assert "does not support item assignment" in failures(episode)[0][1]


def test_the_controller_itself_is_fine() -> None:
    assert failures(run_loop(Controller(), recovery_planner=SwitchOff())) == []


class ChainedError(Exception):
    def __str__(self) -> str:
        raise RuntimeError("a traceback runs no code of the error")


def deep(levels: int) -> None:
    if not levels:
        raise KeyError("no plan", 7)
    deep(levels - 1)


def raise_deep(view: Any) -> Proposal:
    try:
        deep(200)
    except KeyError as error:
        raise ChainedError("x" * 30_000) from error
    raise AssertionError


def test_the_whole_traceback_is_kept_and_no_part_of_the_digest() -> None:
    episode = run_loop(explode)
    (failure,) = [event for event in episode.events if event.kind == "component_failure"]
    lines = failure.traceback.splitlines()
    assert lines[0] == "Traceback (most recent call last):"
    assert lines[-2:] == ['    raise ValueError("no idea")', "ValueError: no idea"]
    assert "test_component_failures.py" in lines[-3]
    assert lines[-3].endswith(", in explode")
    assert "pytest_dura/core" not in failure.traceback  # the user's frames come first
    # Paths and lines differ from machine to machine.
    again = run_loop(explode)
    moved = replace(failure, traceback="elsewhere")
    again.events = tuple(moved if event == failure else event for event in again.events)
    assert again.digest == episode.digest


def test_a_traceback_is_bounded_and_says_what_led_to_it() -> None:
    (failure, *_) = run_loop(raise_deep).events
    text = failure.traceback
    assert len(text) <= 2 * LONGEST_TEXT
    assert text.rpartition("ChainedError: ")[2].startswith("x" * 1000)
    short = run_loop(lambda view: deep(200)).events[0].traceback  # type: ignore[func-returns-value]
    assert short.endswith("KeyError: no plan, 7")
    assert "frames are left out)" in short
    assert short.count("in deep") < 40


def test_tracebacks_of_an_episode_are_few() -> None:
    def differs(view: Any) -> Proposal:
        raise ValueError(f"no {view.index}")

    events = [each for each in run_loop(differs).events if each.kind == "component_failure"]
    assert len(events) > 4
    assert [bool(each.traceback) for each in events][:6] == [True] * 4 + [False] * (
        min(len(events), 6) - 4
    )
