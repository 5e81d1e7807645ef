"""Laws of a fault's plan: at which ticks it begins, acts and ends, and what is left to chance.

A reference counts in whole ticks. The plan states its times in seconds, as a file would, so that
rounding can shift none of them by a tick.
"""

from __future__ import annotations

import math
from collections import Counter
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from injecting import Bench, Drawing, fault

from pytest_dura.core import Fault

STEPS = (0.1, 0.05, 0.02, 1 / 15, 0.3)
TICKS = 40
law = settings(derandomize=True, deadline=None, max_examples=120)
steps = st.sampled_from(STEPS)
lengths = st.integers(1, 7)
moments = st.integers(0, 30)
numbers = st.none() | st.integers(1, 4)


def seconds(ticks: int, dt: float) -> float:
    """A time as somebody would write it down: not the product of floats, but the number meant."""
    return round(ticks * dt, 12)


def run(dt: float, *faults: dict[str, Any]) -> Bench:
    return Bench(*faults, dt=dt).ticks(TICKS)


def activated(due: list[int], lasts: int, most: int | None) -> list[int]:
    """The activations among the ticks at which one falls due: none while it is active."""
    begun: list[int] = []
    for tick in due:
        if tick < TICKS and (not begun or tick >= begun[-1] + lasts):
            begun.append(tick)
    return begun[:most]


def acting(begun: list[int], lasts: int) -> list[int]:
    return sorted({tick + i for tick in begun for i in range(lasts) if tick + i < TICKS})


@law
@given(steps, moments, st.none() | lengths, lengths, numbers)
def test_a_planned_fault_acts_at_the_ticks_that_its_plan_names(
    dt: float, at: int, every: int | None, lasts: int, most: int | None
) -> None:
    plan: dict[str, Any] = {"at": seconds(at, dt), "duration": seconds(lasts, dt)}
    if every is not None:
        plan |= {"every": seconds(every, dt)} | ({} if most is None else {"times": most})
    bench = run(dt, fault(**plan))
    due = [at] if every is None else list(range(at, TICKS, every))
    begun = activated(due, lasts, most if every else 1)
    assert bench.begun() == begun
    assert bench.when() == acting(begun, lasts)
    ends = [tick + lasts for tick in begun if tick + lasts < TICKS]
    # What ends and begins at the same tick goes on.
    assert [tick for tick, _ in bench.ended] == [tick for tick in ends if tick not in begun]


@law
@given(steps, moments, lengths, lengths, st.none() | st.integers(1, 20))
def test_an_intermittent_fault_acts_and_rests_by_turns(
    dt: float, at: int, on: int, off: int, lasting: int | None
) -> None:
    turns = {"on": seconds(on, dt), "off": seconds(off, dt)}
    if lasting is not None:
        turns["lasting"] = seconds(lasting, dt)
    bench = run(dt, fault(at=seconds(at, dt), duration=turns))
    end = TICKS if lasting is None else min(at + lasting, TICKS)
    assert bench.when() == [tick for tick in range(at, end) if (tick - at) % (on + off) < on]


@law
@given(
    steps,
    st.sampled_from(["activated", "manifested", "deactivated"]),
    st.integers(0, 5),
    st.tuples(moments, lengths, lengths),
    st.tuples(lengths, st.integers(1, 4)),
)
def test_a_fault_that_follows_another_begins_after_each_of_its_events(
    dt: float, event: str, delay: int, leads: tuple[int, int, int], follows: tuple[int, int]
) -> None:
    """After its delay, and never at the very tick of the event."""
    (at, every, led), (lasts, most) = leads, follows
    leader = fault(
        "leader",
        at=seconds(at, dt),
        every=seconds(every + led, dt),
        duration=seconds(led, dt),
    )
    after = {"fault": "leader", "event": event, "delay": seconds(delay, dt)}
    target = "clock.ticks"
    follower = fault(target=target, after=after, times=most, duration=seconds(lasts, dt))
    bench = run(dt, leader, follower)
    begun = range(at, TICKS, every + led)
    events = [tick + led if event == "deactivated" else tick for tick in begun]
    due = [tick + max(delay, 1) for tick in events]
    assert bench.begun("leader") == list(begun)
    assert bench.begun() == activated(due, lasts, most)


# Chance

KINDS: dict[str, dict[str, Any]] = {
    "an activation": {"activation": {"probability": 0.0}},
    "omission": {"type": "omission", "parameters": {"p": 0.0}},
    "loss": {"type": "loss", "parameters": {"p": 0.0}},
    "reorder": {"type": "reorder", "parameters": {"p": 0.0}},
    "corruption": {"type": "corruption", "parameters": {"p": 0.0}},
    "corruption of no bits": {"type": "corruption", "parameters": {"p": 0.0, "bits": 0}},
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("p", [0.0, 0.3, 1.0])
def test_a_fault_is_by_chance_exactly_if_seeds_differ_in_whether_it_has_an_effect(
    kind: str, p: float
) -> None:
    """Seen over a few ticks of many seeds: all, none, or some of them."""
    given_by = KINDS[kind]
    if "activation" in given_by:
        planned = fault(probability=p, duration="once")
    else:
        parameters = given_by["parameters"] | {"p": p}
        planned = fault(type=given_by["type"], parameters=parameters, at=0.1, duration=None)

    def world(index: int) -> dict[str, Any]:
        return {"gauge": 1.5 + index, "clock": {"ticks": index}}

    reached = {
        bool(Bench(planned, channels=world, seed=seed).ticks(4).when()) for seed in range(60)
    }
    assert planned.by_chance == (len(reached) == 2)
    if p in (0.0, 1.0):
        assert reached == {p == 1.0 and kind != "corruption of no bits"}


def test_a_rate_is_by_chance() -> None:
    assert fault(rate=0.1).by_chance


@pytest.mark.parametrize("rate, dt", [(0.5, 0.1), (5.0, 0.1), (20.0, 0.1), (5.0, 0.3)])
def test_activations_at_a_rate_are_those_of_a_poisson_process(rate: float, dt: float) -> None:
    """A tick without one is as likely as an exponential waiting time that is longer than it."""
    count = 3000
    hits = len(Bench(fault(rate=rate, duration="once"), dt=dt).ticks(count).begun())
    p = 1.0 - math.exp(-rate * dt)
    assert hits == pytest.approx(count * p, abs=4.0 * math.sqrt(count * p * (1.0 - p)))


# Draws


def drawn(*plans: Fault, ticks: int = 150) -> dict[str, list[Any]]:
    """What each fault came to: its activations, how long each lasted, and the numbers it drew."""
    Drawing.noted.clear()
    bench = Bench(*plans).ticks(ticks)
    came: dict[str, list[Any]] = {}
    for plan in plans:
        name = plan.id
        begun = bench.begun(name)
        ends = [tick for tick, ended in bench.ended if ended == name]
        lasted = [end - start for start, end in zip(begun, ends, strict=False)]
        came[name] = [begun, lasted, [number for of, _, number in Drawing.noted if of == name]]
    return came


BY_CHANCE = {
    "probability": {"probability": 0.2, "duration": {"min": 0.1, "max": 1.5}},
    "rate": {"rate": 2.0, "duration": {"min": 0.1, "max": 1.5}},
}


@pytest.mark.parametrize("kind", BY_CHANCE)
def test_each_fault_draws_numbers_of_its_own_which_adding_another_does_not_shift(kind: str) -> None:
    """Two faults of one plan are no copies of each other, nor is an activation of the last one."""
    plans = [fault(name, type="injecting:Drawing", **BY_CHANCE[kind]) for name in ("a", "b", "c")]
    together = drawn(*plans)
    for plan in plans:
        assert drawn(plan)[plan.id] == together[plan.id], "alone and among others"
    assert drawn(*plans[::-1]) == together, "in any order"
    for i, name in enumerate("ab"):
        for other in "abc"[i + 1 :]:
            assert together[name][0] != together[other][0]
            assert not set(together[name][2]) & set(together[other][2])
    for begun, lasted, numbers in together.values():
        assert len(begun) > 8
        assert len(Counter(lasted)) > 4, "each activation lasts as long as it draws anew"
        assert len(set(numbers)) == len(numbers)
