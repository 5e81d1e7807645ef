"""Laws of shrinking, with violations that are told from the case without simulating it."""

from __future__ import annotations

import itertools
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shrinkable import crossing, fault, found, ids

from pytest_dura.library import SearchedCase
from pytest_dura.search import changes_of, count_parameters, minimise, shrink, simpler_values

CASE = crossing()
NUMBERS = st.floats(-1e6, 1e6).map(lambda one: round(one, 3)) | st.integers(-1000, 1000)
SPEEDS = st.floats(6.0, 8.5).map(lambda one: round(one, 3))
KINDS = {"delay": "odometry", "bias": "odometry.speed", "freeze": "odometry"}


@st.composite
def starts(draw: st.DrawFn) -> SearchedCase:
    names = draw(st.lists(st.sampled_from(["LEADER", "WEST", "X", "Y"]), unique=True))
    arms = {"LEADER": "south"}
    vehicles = [
        {"id": name, "arm": arms.get(name, "west"), "distance": draw(st.floats(20.0, 90.0))}
        for name in names
    ]
    planned = [
        fault(kind, KINDS[kind], activation__at=draw(st.floats(0.0, 15.0)))
        for kind in draw(st.lists(st.sampled_from(sorted(KINDS)), unique=True, max_size=2))
    ]
    world = {"ego": {"distance": 50.0, "speed": draw(SPEEDS)}, "vehicles": vehicles}
    return found(CASE, world, planned, draw(st.integers(0, 5)))


@st.composite
def violations(draw: st.DrawFn) -> tuple[SearchedCase, Any]:
    """A case, and a property of cases that it has."""
    start = draw(starts())
    needed = {name for name in ids(start) if draw(st.booleans())}
    faults = {one.type for one in start.faults if draw(st.booleans())}
    slowest = draw(st.sampled_from([0.0, start.scenario.world["ego"]["speed"] - 0.05]))

    def violates(one: SearchedCase) -> bool:
        there = {each.type for each in one.faults}
        return (
            needed <= ids(one)
            and faults <= there
            and one.scenario.world["ego"]["speed"] >= slowest
            and (not slowest or one.scenario.world["ego"]["speed"] <= slowest + 1.0)
        )

    return start, violates


@pytest.mark.of_guest
@given(violation=violations(), budget=st.sampled_from([3, 20, 400]))
@settings(derandomize=True, deadline=None, max_examples=8)
def test_a_shrunk_case_violates_with_no_more_parameters_and_within_the_budget(
    violation: tuple[SearchedCase, Any], budget: int
) -> None:
    start, violates = violation
    calls: list[SearchedCase] = []

    def counted(one: SearchedCase) -> bool:
        calls.append(one)
        return bool(violates(one))

    shrunk = shrink(CASE, start, counted, budget=budget)
    assert violates(shrunk.case)
    assert len(calls) == shrunk.shrinking.simulations <= budget
    assert shrunk.shrinking.finished or shrunk.shrinking.simulations == budget
    assert shrunk.shrinking.before == count_parameters(changes_of(CASE, start))
    assert shrunk.shrinking.after == count_parameters(shrunk.changes) <= shrunk.shrinking.before
    assert shrunk.changes == changes_of(CASE, shrunk.case)


@pytest.mark.of_guest
@given(violation=violations())
@settings(derandomize=True, deadline=None, max_examples=5)
def test_a_shrunk_case_is_shrunk_to_itself(violation: tuple[SearchedCase, Any]) -> None:
    start, violates = violation
    once = shrink(CASE, start, violates, budget=500)
    assert once.shrinking.finished
    again = shrink(CASE, once.case, violates, budget=500)
    assert again.case.data == once.case.data
    assert again.shrinking.finished
    assert again.shrinking.before == again.shrinking.after == once.shrinking.after
    assert shrink(CASE, start, violates, budget=500).case == once.case


@given(value=NUMBERS, nominal=NUMBERS)
@settings(derandomize=True, deadline=None, max_examples=60)
def test_replacing_a_number_by_simpler_ones_comes_to_an_end(value: float, nominal: float) -> None:
    seen = {value}
    while True:
        values = simpler_values(value, nominal)
        assert (values[0], values[-1]) == (nominal, value)
        assert len(set(values)) == len(values)
        if len(values) < 3:
            return
        # The worst choice: the least simple of them.
        value = values[-2]
        assert value not in seen
        seen.add(value)


@given(data=st.data())
@settings(derandomize=True, deadline=None, max_examples=12)
def test_the_least_numbers_are_found_where_each_needs_its_own(data: st.DataObject) -> None:
    start = tuple(data.draw(st.lists(st.integers(1, 20), min_size=1, max_size=12)))
    least = tuple(data.draw(st.integers(0, one)) for one in start)

    def enough(places: tuple[int, ...]) -> bool:
        return all(one >= needed for one, needed in zip(places, least, strict=True))

    assert minimise(start, enough) == least


@given(data=st.data())
@settings(derandomize=True, deadline=None, max_examples=40)
def test_no_part_of_the_result_can_be_simpler_whatever_violates(data: st.DataObject) -> None:
    start = tuple(data.draw(st.lists(st.integers(0, 4), min_size=1, max_size=4)))
    candidates = [*itertools.product(*(range(level + 1) for level in start))]
    violating = {start, *data.draw(st.sets(st.sampled_from(candidates)))}
    accepted = [start]

    def violates(levels: tuple[int, ...]) -> bool:
        if levels in violating:
            accepted.append(levels)
        return levels in violating

    least = minimise(start, violates)
    assert least == accepted[-1]
    assert least in violating
    assert accepted == sorted(set(accepted), reverse=True)
    for part, level in enumerate(least):
        for lower in {0, level - 1} if level else ():
            assert (*least[:part], lower, *least[part + 1 :]) not in violating
