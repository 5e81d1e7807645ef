"""Activation: at which tick a fault begins, whoever or whatever says so."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from injecting import Bench, fault

from pytest_dura.core import ConfigurationError, stream
from pytest_dura.faults import Activation
from pytest_dura.faults.activation import BLOCK, Chance


def ramp(index: int) -> dict[str, Any]:
    """A gauge that goes from 0 to 4.5 and back, again and again."""
    phase = index % 20
    return {"gauge": 0.5 * min(phase, 20 - phase), "rows": np.zeros((index // 10, 2))}


@pytest.mark.parametrize(
    "at, first", [(0.0, 0), (0.1, 1), (0.3, 3), (0.7, 7), (0.55, 6), (1.2000001, 13)]
)
def test_at_is_the_first_tick_at_or_past_it(at: float, first: int) -> None:
    bench = Bench(fault(at=at)).ticks(30)
    assert bench.when() == [first, first + 1, first + 2]
    assert bench.activated == [(first, "f")]
    assert bench.ended == [(first + 3, "f")]


@pytest.mark.parametrize("dt", [0.01, 0.05, 0.1, 0.3, 1 / 3, 0.07])
@pytest.mark.parametrize("step", [0, 1, 29, 57, 58])
def test_at_a_tick_s_own_time_it_is_that_tick_whatever_floats_make_of_it(
    dt: float, step: int
) -> None:
    bench = Bench(fault(at=round(step * dt, 12), duration="once"), dt=dt).ticks(60)
    assert bench.when() == [step]


@pytest.mark.parametrize("dt", [0.01, 0.05, 0.1, 0.3, 0.07])
def test_every_comes_at_each_multiple_also_where_floats_fall_short(dt: float) -> None:
    for step in range(1, 40):
        planned = fault(at=round(step * dt, 12), every=round(7 * dt, 12), duration="once")
        assert Bench(planned, dt=dt).ticks(60).when() == list(range(step, 60, 7))


def test_every_ends_after_the_given_number_of_times() -> None:
    bench = Bench(fault(at=0.2, every=0.5, times=2)).ticks(30)
    assert bench.begun() == [2, 7]


def test_every_that_is_no_multiple_of_the_tick_takes_the_next_one() -> None:
    assert Bench(fault(at=0.0, every=0.25, duration="once")).ticks(11).when() == [0, 3, 5, 8, 10]


def test_a_condition_begins_it_where_it_begins_to_hold() -> None:
    bench = Bench(fault(when="gauge.value > 2", target="gauge.value"), channels=held).ticks(60)
    assert bench.begun() == [5], "once, unless said otherwise"
    again = Bench(
        fault(when="gauge.value > 2", target="gauge.value", times=9), channels=held
    ).ticks(60)
    assert again.begun() == [5, 25, 45]


def held(index: int) -> dict[str, Any]:
    return {"gauge": {"value": ramp(index)["gauge"]}, "rows": ramp(index)["rows"]}


def test_a_condition_that_holds_on_does_not_begin_it_again() -> None:
    planned = fault(when="time >= 0.5", times=9, duration="once")
    assert Bench(planned).ticks(30).begun() == [5]


def test_a_condition_that_begins_to_hold_while_it_is_active_is_lost() -> None:
    planned = fault(when="gauge.value > 2", target="gauge.value", times=9, duration=2.5)
    assert Bench(planned, channels=held).ticks(70).begun() == [5, 45]


def test_a_condition_at_the_very_first_tick() -> None:
    assert Bench(fault(when="time >= 0")).ticks(5).begun() == [0]


def test_a_condition_that_holds_before_its_window_begins_it_with_the_window() -> None:
    planned = fault(when="clock.ticks >= 2", not_before=0.8)
    assert Bench(planned).ticks(20).begun() == [8]


def test_a_condition_that_first_holds_after_its_window_does_not_begin_it() -> None:
    assert Bench(fault(when="clock.ticks >= 9", not_after=0.8)).ticks(20).begun() == []
    assert Bench(fault(when="clock.ticks >= 8", not_after=0.8)).ticks(20).begun() == [8]


def test_a_condition_reads_the_channels_as_they_are_without_any_fault() -> None:
    first = fault("first", at=0.0, duration=None, target="gauge.value", parameters={"amount": 99})
    second = fault("second", when="gauge.value > 2", target="gauge.value")
    assert Bench(first, second, channels=held).ticks(20).begun("second") == [5]


def test_a_condition_on_a_row_that_is_not_there_does_not_hold() -> None:
    planned = fault(when="rows.1.0 < 1", target="gauge.value")
    assert Bench(planned, channels=held).ticks(40).begun() == [20]


def test_probability_is_drawn_at_each_tick_from_the_fault_s_own_stream() -> None:
    bench = Bench(fault(probability=0.3, duration="once")).ticks(2 * BLOCK)
    draws = stream(3, "fault:activation:f").random(2 * BLOCK)
    assert bench.begun() == np.flatnonzero(draws < 0.3).tolist()


def test_probability_while_it_is_active_shifts_nothing() -> None:
    short = Bench(fault(probability=0.3, duration="once")).ticks(200).begun()
    expected, free = [], 0
    for tick in short:
        if tick >= free:
            expected.append(tick)
            free = tick + 4
    assert Bench(fault(probability=0.3, duration=0.4)).ticks(200).begun() == expected


@pytest.mark.parametrize("probability, begun", [(0.0, []), (1.0, list(range(12)))])
def test_the_ends_of_probability(probability: float, begun: list[int]) -> None:
    assert Bench(fault(probability=probability, duration="once")).ticks(12).begun() == begun


def test_probability_and_rate_keep_to_their_window_and_number() -> None:
    for chance in ({"probability": 1.0}, {"rate": 1e6}):
        planned = fault(duration="once", not_before=0.5, not_after=0.9, **chance)
        assert Bench(planned).ticks(20).begun() == [5, 6, 7, 8, 9]
        planned = fault(duration="once", not_before=0.5, times=2, **chance)
        assert Bench(planned).ticks(20).begun() == [5, 6]


def test_a_window_shifts_no_draw() -> None:
    free = Bench(fault(probability=0.2, duration="once")).ticks(400).begun()
    late = Bench(fault(probability=0.2, duration="once", not_before=17.0)).ticks(400).begun()
    assert late == [tick for tick in free if tick >= 170]


def test_a_rate_is_a_poisson_process() -> None:
    # 4000 s at 0.5/s, one tick each: the count is normal around 2000 with sd 44 (of 0.1 s ticks:
    # p = 1 - exp(-0.05)), and the gaps are geometric, whose mean and sd are nearly equal.
    ticks, rate = 40_000, 0.5
    hits = Chance(-np.expm1(-rate * 0.1), stream(3, "poisson"))
    found = np.array([tick for tick in range(ticks) if hits.hits(tick)])
    p = -np.expm1(-rate * 0.1)
    assert abs(len(found) - ticks * p) < 4 * np.sqrt(ticks * p * (1 - p))
    gaps = np.diff(found)
    assert np.mean(gaps) == pytest.approx(1 / p, rel=0.1)
    assert np.std(gaps) == pytest.approx(np.sqrt(1 - p) / p, rel=0.1)
    # What a tick holds says nothing of the next one.
    assert np.corrcoef(gaps[:-1], gaps[1:])[0, 1] == pytest.approx(0.0, abs=0.08)


def test_the_same_rate_at_a_finer_tick_is_the_same_process() -> None:
    def count(dt: float) -> float:
        found = 0
        for seed in range(40):
            planned = fault(rate=0.5, duration="once")
            found += len(Bench(planned, dt=dt, seed=seed).ticks(round(20 / dt)).begun())
        return found / 40 / 20

    assert count(0.1) == pytest.approx(0.5, rel=0.12)  # 400 expected, sd 5 %
    assert count(0.5) == pytest.approx(-np.expm1(-0.25) / 0.5, rel=0.12)


@given(st.floats(0, 1), st.lists(st.integers(0, 3 * BLOCK), max_size=30))
@settings(derandomize=True, deadline=None, max_examples=60)
def test_chance_does_not_depend_on_when_it_is_asked(probability: float, asked: list[int]) -> None:
    draws = stream(1, "x").random(4 * BLOCK) < probability
    chance = Chance(probability, stream(1, "x"))
    for tick in asked:
        assert chance.hits(tick) == draws[tick]
        following = chance.next(tick)
        assert following >= tick
        assert not draws[tick:following].any()
        assert draws[following] or following % BLOCK == 0


FIRST = {"at": 0.5, "duration": 0.4}


@pytest.mark.parametrize(
    "event, delay, begun",
    [
        ("activated", 0.0, 6),
        ("manifested", 0.0, 6),
        ("deactivated", 0.0, 10),
        ("activated", 0.05, 6),  # less than a tick is the tick that follows
        ("activated", 0.1, 6),
        ("activated", 0.25, 8),
        ("deactivated", 1.0, 19),
    ],
)
@pytest.mark.parametrize("follower_first", [True, False])
def test_it_follows_another_fault_s_event(
    event: str, delay: float, begun: int, follower_first: bool
) -> None:
    after = {"fault": "first", "event": event, "delay": delay}
    faults = [fault("first", **FIRST), fault("second", after=after, duration="once")]
    bench = Bench(*(reversed(faults) if follower_first else faults)).ticks(30)
    assert bench.begun("second") == [begun]
    assert bench.when("second") == [begun]


def test_it_follows_once_unless_more_is_asked_for() -> None:
    first = fault("first", at=0.0, every=1.0, duration=0.2)
    after = {"fault": "first", "delay": 0.3}
    assert Bench(first, fault(after=after)).ticks(40).begun() == [3]
    assert Bench(first, fault(after=after, times=3)).ticks(40).begun() == [3, 13, 23]


def test_what_it_follows_while_it_is_active_is_lost() -> None:
    first = fault("first", at=0.0, every=1.0, duration=0.2)
    planned = fault(after={"fault": "first"}, times=3, duration=1.5)
    assert Bench(first, planned).ticks(40).begun() == [1, 21]


def test_a_fault_that_never_manifests_is_not_followed() -> None:
    first = fault("first", at=0.5, parameters={"amount": 0.0})
    after = {"fault": "first", "event": "manifested"}
    assert Bench(first, fault(after=after)).ticks(30).begun() == []


def test_a_chain_of_three() -> None:
    second = fault("b", after={"fault": "a", "event": "deactivated"}, duration=0.2)
    third = fault("c", after={"fault": "b", "event": "manifested", "delay": 0.3})
    bench = Bench(fault("a", at=0.1, duration=0.2), second, third).ticks(20)
    assert bench.activated == [(1, "a"), (4, "b"), (7, "c")]
    assert bench.ended == [(3, "a"), (6, "b"), (10, "c")]


def test_a_directed_sensor_fault_begins_at_the_next_percept() -> None:
    bench = Bench(fault(by="security_assessor")).ticks(4)
    bench.tick("f")
    bench.ticks(6)
    assert bench.activated == [(5, "f")]
    assert bench.when() == [5, 6, 7]


def test_a_directed_command_fault_begins_at_once() -> None:
    bench = Bench(fault(by="security_assessor", target="command")).ticks(4)
    bench.tick("f", action=2.0)
    bench.ticks(6)
    assert bench.activated == [(4, "f")]
    assert bench.when() == [4, 5, 6]
    assert bench.sent[4] == 3.0
    assert bench.ended == [(7, "f")]


def test_what_is_directed_may_be_directed_again_once_it_is_over() -> None:
    for target, delay in (("gauge", 1), ("command", 0)):
        bench = Bench(fault(by="security_assessor", target=target))
        for _ in range(10):
            bench.tick("f")  # while it is active that has no effect
        assert bench.begun()[:3] == [delay, delay + 3, delay + 6]
        assert bench.ended == [], "its end and its beginning anew are no end"


def test_directing_a_planned_fault_uses_its_activation_up() -> None:
    bench = Bench(fault(at=1.0))
    bench.tick("f")
    assert bench.ticks(20).begun() == [1]
    bench = Bench(fault(at=1.0, every=1.0))
    bench.tick("f")
    assert bench.ticks(25).begun() == [1, 10, 20]


def test_what_is_directed_beyond_its_number_of_times_does_not_begin() -> None:
    bench = Bench(fault(by="security_assessor", times=1))
    for _ in range(9):
        bench.tick("f")
    assert bench.begun() == [1]


def test_a_follower_may_be_directed_too() -> None:
    bench = Bench(fault("a", at=5.0), fault("b", after={"fault": "a"}))
    bench.tick("b")
    assert bench.ticks(5).begun("b") == [1]


def test_two_faults_of_one_id_are_refused() -> None:
    with pytest.raises(ConfigurationError, match="two faults have the id 'f'"):
        Bench(fault(at=1.0), fault(at=2.0))


@given(st.floats(0, 5), st.none() | st.floats(0.01, 3), st.sampled_from([0.01, 0.05, 0.1, 0.3]))
@settings(derandomize=True, deadline=None, max_examples=200)
def test_the_next_planned_time_is_where_due_says_so(
    at: float, every: float | None, dt: float
) -> None:
    activation = Activation(at=at, every=every)
    since = -1.0
    for tick in range(60):
        time = tick * dt
        following = activation.next_planned(since)
        assert following > since
        assert activation.due(time, since) == (following <= time + 1e-9)
        since = time
