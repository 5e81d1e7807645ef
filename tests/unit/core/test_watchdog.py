"""What blocks for ever is ended and named, whoever it is, and costs nobody else anything."""

from __future__ import annotations

import contextlib
import signal
import threading
import time
from typing import Any

import pytest
from thermostat import Controller, HeatMonitor, Thermostat

from pytest_dura import Assessment, Generator, Proposal
from pytest_dura.core import Episode, EpisodeSpec, Orchestrator, RoleSpec, Termination, call_within
from pytest_dura.core.component import ABANDON_AFTER
from pytest_dura.core.time_limits import CallBlocked, CallTimer, TimeBudgetExceeded, alarms

pytestmark = pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="there is no alarm")

LIMIT = 0.2
SPEC = EpisodeSpec(
    "case", 0, 1, RoleSpec("a:Sim"), {"generator": RoleSpec("a:Planner")},
    termination=Termination(1.0), time_budget=5.0,
)  # fmt: skip


def run(
    simulator: Any = None, generator: Any = None, spec: EpisodeSpec = SPEC, **options: Any
) -> Episode:
    roles = {"generator": generator or Controller(), **options.pop("roles", {})}
    options = {"role_timeout": LIMIT, **options}
    made = Orchestrator(simulator or Thermostat(), roles, **options)
    begun = time.monotonic()
    episode = made.run(spec)
    assert time.monotonic() - begun < 20.0
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)
    return episode


def sleeps() -> None:
    time.sleep(60.0)


def spins() -> None:
    while True:
        pass


def waits() -> None:
    threading.Event().wait(60.0)


def swallows() -> None:
    for _ in range(2):
        with contextlib.suppress(BaseException):
            time.sleep(60.0)


@pytest.mark.parametrize("block", [sleeps, spins, waits, swallows])
def test_a_role_that_blocks_is_named_with_its_tick_and_ends_its_episode_alone(block: Any) -> None:
    class Stuck(HeatMonitor):
        def run(self, view: Any) -> Assessment:
            if view.index == 3:
                block()
            return super().run(view)

    episode = run(roles={"safety_monitor": Stuck()})
    assert episode.failure == (
        "infrastructure: safety_monitor at tick 3 (t = 0.3 s): "
        "it did not come back within 0.2 s of wall-clock time"
    )
    assert (episode.validity, episode.termination) == ("missing", "infrastructure")
    assert run(roles={"safety_monitor": HeatMonitor()}).validity == "valid"


@pytest.mark.parametrize(
    "method, tick",
    [("reset", 0), ("step", 0), ("check_action", 0), ("signals", 10), ("percept_signals", 10)],
)
def test_a_simulator_that_blocks_is_named_wherever_it_does(method: str, tick: int) -> None:
    simulator = Thermostat()
    setattr(simulator, method, lambda *_: sleeps())
    episode = run(simulator)
    assert episode.failure is not None
    assert episode.failure.startswith(f"infrastructure: simulator at tick {tick} ")
    assert "did not come back" in episode.failure


def test_a_metric_that_blocks_is_named() -> None:
    episode = run(metrics={"slow": lambda _: sleeps()})
    assert episode.failure is not None
    assert "metric 'slow' at tick 10" in episode.failure


class Slow(Generator):
    """Takes its time in each proposal; within its budget, and longer than others may."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds

    def propose(self, view: Any) -> Proposal:
        if view.index < 2:
            time.sleep(self.seconds)
        return Proposal(0.5)


@pytest.mark.parametrize("budget", [5.0, None])
def test_the_component_has_its_own_budget_and_no_other(budget: float | None) -> None:
    spec = EpisodeSpec(
        "case", 0, 1, SPEC.simulator, SPEC.roles, termination=Termination(0.5), time_budget=budget
    )
    episode = run(generator=Slow(3 * LIMIT), spec=spec)
    assert (episode.validity, episode.timeouts) == ("valid", ())


def test_a_component_over_its_budget_is_no_failure_of_a_role() -> None:
    spec = EpisodeSpec(
        "case", 0, 1, SPEC.simulator, SPEC.roles, termination=Termination(0.5), time_budget=0.3
    )
    episode = run(generator=Slow(30.0), spec=spec)
    assert episode.validity == "valid"
    assert episode.timeouts == (0, 1)
    assert len(episode.timeouts) < ABANDON_AFTER


def test_many_short_calls_are_not_one_long_one() -> None:
    class Busy(HeatMonitor):
        def run(self, view: Any) -> Assessment:
            time.sleep(0.15)
            return super().run(view)

    assert run(roles={"safety_monitor": Busy()}, role_timeout=1.0).validity == "valid"


def test_the_watch_goes_on_after_calls_with_a_limit_of_their_own() -> None:
    watch = CallTimer(LIMIT)
    with alarms(watch):
        for _ in range(3):
            assert call_within(5.0, divmod, 7, 2) == (3, 1)
        assert signal.getitimer(signal.ITIMER_REAL)[1] == pytest.approx(watch.period)
        with pytest.raises(CallBlocked), watch.calling("role"):
            sleeps()
    assert watch.overran == "role"


def test_the_alarm_of_somebody_else_is_left_alone() -> None:
    rung: list[int] = []
    before = signal.signal(signal.SIGALRM, lambda number, _: rung.append(number))
    signal.setitimer(signal.ITIMER_REAL, 0.2)
    try:
        with alarms(CallTimer(LIMIT)):
            time.sleep(0.3)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    assert rung == [signal.SIGALRM]


def test_a_stroke_of_the_watch_that_comes_late_ends_no_call_of_the_component() -> None:
    watch = CallTimer(LIMIT)
    with alarms(watch):
        assert call_within(5.0, signal.raise_signal, signal.SIGALRM) is None


def test_without_a_limit_there_is_no_timer() -> None:
    with alarms(CallTimer(None)):
        assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


def test_short_calls_with_a_limit_share_one_timer(monkeypatch) -> None:
    set_, real = list[float](), signal.setitimer

    def noting(which: int, seconds: float, interval: float = 0.0) -> Any:
        set_.append(seconds)
        return real(which, seconds, interval)

    monkeypatch.setattr(signal, "setitimer", noting)
    with alarms(CallTimer(60.0)):
        before = len(set_)
        for _ in range(50):
            call_within(30.0, divmod, 7, 2)  # the timer of the watch fires before
            call_within(5.0, divmod, 7, 2)
    assert set_[before:] == [5.0, 0.0]


def test_a_timer_that_an_earlier_call_has_left_ends_no_later_call_and_not_the_watch() -> None:
    watch = CallTimer(LIMIT)
    with alarms(watch):
        call_within(0.02, divmod, 7, 2)
        assert call_within(5.0, time.sleep, 0.2) is None
        call_within(5.0, divmod, 7, 2)
        with pytest.raises(TimeBudgetExceeded):
            call_within(0.05, sleeps)
        time.sleep(0.3)  # what the call has left fires in none
        with pytest.raises(CallBlocked), watch.calling("role"):
            sleeps()


@pytest.mark.parametrize("spent", [0.0, 1.5])
def test_a_long_limit_of_a_call_puts_the_watch_of_the_next_one_off_by_no_more_than_a_period(
    spent: float,
) -> None:
    watch = CallTimer(LIMIT)
    with alarms(watch):
        call_within(0.01, divmod, 7, 2)
        call_within(600.0, time.sleep, spent * watch.period)
        assert 0.0 < signal.getitimer(signal.ITIMER_REAL)[0] <= watch.period
        with pytest.raises(CallBlocked), watch.calling("role"):
            time.sleep(5.0)


def test_a_timer_that_the_component_stops_is_set_again() -> None:
    with alarms(CallTimer(60.0)):
        call_within(5.0, signal.setitimer, signal.ITIMER_REAL, 0.0)
        with pytest.raises(TimeBudgetExceeded):
            call_within(0.05, sleeps)
