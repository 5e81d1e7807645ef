"""What thinking costs: latencies in simulated time, and the clock on the wall."""

from __future__ import annotations

import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from handmade import SPEC

from pytest_dura import (
    ConfigurationError,
    EpisodeSpec,
    Fault,
    Generator,
    Orchestrator,
    Proposal,
    RoleSpec,
    Simulator,
    Termination,
    Tick,
)
from pytest_dura.core.clock import Clock, timeliness
from pytest_dura.core.episode import Policy

STEP = 0.1
REAL = 0.25
"""The step where time is real: half of it is what a busy machine may add to a call."""


class Counter(Simulator):
    """Its sensor counts the ticks; it notes what it is commanded."""

    commands: list[float]

    def reset(self, scenario, seed):
        self.index, type(self).commands = 0, []
        return self._tick()

    def step(self, action):
        self.commands.append(action)
        self.index += 1
        return self._tick()

    def check_action(self, action):
        return float(action)

    def fallback_action(self):
        return -1.0

    def signals(self, ticks):
        return {"count": np.array([tick.truth["count"] for tick in ticks], dtype=float)}

    def _tick(self):
        time_now = self.index * self.time_step
        return Tick(self.index, time_now, {"count": self.index}, {"count": self.index})


class Echo(Generator):
    """Commands what it perceived, after so many seconds: declared, or slept through."""

    def __init__(self, declared=None, sleeps=0.0, sleeps_at=None, raises_at=None):
        self.declared, self.sleeps, self.sleeps_at = declared, sleeps, sleeps_at
        self.raises_at = raises_at

    def propose(self, view):
        perceived = view.percept["count"]
        if self.sleeps_at is None or view.index in self.sleeps_at:
            time.sleep(self.sleeps)
        if view.index == self.raises_at:
            raise RuntimeError("overcurrent")
        return Proposal(perceived, latency=self.declared)


class ReadsLate(Echo):
    def propose(self, view):
        time.sleep(REAL / 2)  # the loop is past its own look by then
        return super().propose(view)


def spec(clock, *, ticks=8, policy="log_only", faults=(), **params):
    step = STEP if clock.kind == "simulated" and clock.latency != "measured" else REAL
    roles = {"generator": RoleSpec.of(Echo, params)}
    if faults:
        roles["fault_injector"] = RoleSpec("pytest_dura.faults.injector:CampaignInjector")
    return EpisodeSpec(
        "case", 0, 1, RoleSpec.of(Counter), roles,
        policy=Policy(policy), termination=Termination(time_limit=ticks * step),
        time_step=step, clock=clock, faults=faults,
    )  # fmt: skip


def run(*args, **params):
    each = spec(*args, **params)
    episode = Orchestrator.build(each).run(each)
    assert episode.validity == "valid", episode.failure
    return episode


def test_a_world_that_waits_is_as_it_was() -> None:
    episode = run(Clock(), declared=0.3)
    assert Counter.commands == [0, 1, 2, 3, 4, 5, 6, 7]
    assert "loop.late" not in episode.signals
    # As before there were clocks: what determines an episode has the key that it had.
    assert SPEC.key == "00cbfe917fdf76915bd3a3d737af713c45a6cf33f462fb0bbb309692131e6d02"
    assert "clock" not in spec(Clock()).to_json()
    timed = spec(Clock(latency="declared"))
    assert timed.key != spec(Clock()).key
    assert replace(timed, policy=Policy("recover")).clock == Clock(latency="declared")


@pytest.mark.parametrize(
    "latency, commands, late",
    [
        (None, [0, 1, 2, 3, 4, 5, 6, 7], []),
        (0.0, [0, 1, 2, 3, 4, 5, 6, 7], []),
        (0.05, [0, 0, 1, 2, 3, 4, 5, 6], []),
        (0.1, [0, 0, 1, 2, 3, 4, 5, 6], []),
        (0.11, [0, 0, 0, 1, 1, 3, 3, 5], [2, 4, 6]),
        (0.3, [0, 0, 0, 0, 1, 1, 1, 4], [2, 3, 5, 6]),
    ],
)
def test_a_declared_latency_delays_the_command_to_the_tick_at_which_it_is_there(
    latency, commands, late
) -> None:
    episode = run(Clock(latency="declared"), declared=latency)
    assert Counter.commands == commands
    assert np.flatnonzero(episode.signals["loop.late"][:-1]).tolist() == late
    assert not episode.events
    again = run(Clock(latency="declared"), declared=latency)
    assert again.digest == episode.digest


def test_a_late_component_keeps_its_command_for_the_declared_time_and_then_the_fallback() -> None:
    episode = run(Clock(latency="declared", hold=0.2), declared=0.5)
    assert Counter.commands == [0, 0, -1, -1, -1, -1, 1, 1]
    assert [event.tick for event in episode.events if event.kind == "component_failure"] == [2]
    first = episode.events[0]
    assert "late: its command of 0 s has been in force for 0.2 s" in first.detail
    assert np.flatnonzero(episode.signals["loop.expired"][:-1]).tolist() == [2, 3, 4, 5]


def test_a_measured_latency_is_that_of_the_call() -> None:
    episode = run(Clock(latency="measured"), sleeps=1.2 * REAL)
    assert Counter.commands == [0, 0, 0, 1, 1, 3, 3, 5]
    assert episode.metrics.processing_ns["generator"][1][3] > REAL * 1e9


def test_by_the_wall_clock_ticks_come_when_they_are_due() -> None:
    began = time.monotonic()
    episode = run(Clock(kind="wall"))
    assert time.monotonic() - began >= 8 * REAL
    assert Counter.commands == [0, 0, 1, 2, 3, 4, 5, 6]
    periods = episode.signals["loop.period"]
    assert len(periods) == 9
    assert periods[1:].sum() == pytest.approx(8 * REAL, abs=0.9 * REAL)


def test_by_the_wall_clock_the_world_goes_on_while_the_component_thinks() -> None:
    episode = run(Clock(kind="wall", hold=2 * REAL), sleeps=4.5 * REAL, sleeps_at=[2])
    assert Counter.commands == [0, 0, 1, 1, -1, -1, -1, 2]
    assert np.flatnonzero(episode.signals["loop.late"][:-1]).tolist() == [3, 4, 5, 6]
    kept = timeliness(episode.spec.clock, REAL, episode.signals, 8)
    assert (kept.late, kept.longest, kept.expired) == (4, pytest.approx(4 * REAL), 3)
    assert 0 <= kept.jitter <= kept.worst


def test_what_a_late_component_raises_is_its_failure_at_the_tick_at_which_it_is_there() -> None:
    episode = run(Clock(kind="wall"), raises_at=2)
    failure = next(event for event in episode.events if event.kind == "component_failure")
    assert failure.tick == 3
    assert failure.detail.startswith("raised RuntimeError: overcurrent")
    assert "in propose" in failure.traceback
    assert Counter.commands[3:5] == [-1, 3]


def test_a_fault_that_a_late_component_reads_has_manifested() -> None:
    fault = Fault("bias", "f", "count", {"at": 2.5 * REAL}, parameters={"offset": 10.0})
    each = spec(Clock(kind="wall"), faults=(fault,))
    each = replace(each, roles={**each.roles, "generator": RoleSpec.of(ReadsLate)})
    episode = Orchestrator.build(each).run(each)
    assert episode.validity == "valid", episode.invalid_reason
    assert Counter.commands[4] == 13.0


def test_no_thread_outlives_its_episode() -> None:
    run(Clock(kind="wall"), sleeps=3 * REAL, sleeps_at=[7])
    assert not [each for each in threading.enumerate() if each.name == "dura-component"]


@pytest.mark.parametrize(
    "make, words",
    [
        (lambda: Clock(kind="wall", latency="declared"), "latencies are what they are"),
        (lambda: Clock(hold=0.0), "positive"),
        (lambda: spec(Clock(kind="wall"), policy="refine(2)"), "cannot propose anew"),
    ],
)
def test_what_does_not_go_together_is_refused(make, words) -> None:
    with pytest.raises(ConfigurationError, match=words):
        make()


def test_a_spec_comes_back_from_its_data() -> None:
    each = replace(spec(Clock(kind="wall", hold=0.3)), roles={}, simulator=RoleSpec("a:B"))
    assert EpisodeSpec.from_json(each.to_json()) == each
