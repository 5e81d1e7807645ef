"""Delta debugging over the faults of an episode, on episodes whose outcome is known."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from handmade import handmade
from hypothesis import given, settings
from hypothesis import strategies as st

from pytest_dura import Episode, EpisodeSpec, Fault, RoleSpec
from pytest_dura.requirements import Requirement
from pytest_dura.search import Reduction, reduce_faults
from pytest_dura.search.shrinking import with_faults

FREE = Requirement("SAF-1", check="always (gap > 0)")
NAMES = tuple("abcdefgh")


def planned(name: str, after: str | None = None) -> dict[str, Any]:
    waits = None if after is None else {"fault": after, "event": "activated", "delay": 0.0}
    return Fault("bias", name, "lidar", {"at": 1.0, "after": waits})


def spec(*faults: dict[str, Any]) -> EpisodeSpec:
    simulator = RoleSpec("nowhere:Simulator")
    return EpisodeSpec("road/free+all", 3, 7, simulator, {}, faults=faults)


def episode(one: EpisodeSpec, *, gap: float) -> Episode:
    return handmade(2, spec=one, gap=[1.0, gap])


def reduced(
    violates: Callable[[frozenset[str]], bool],
    *faults: dict[str, Any],
    budget: int = 200,
) -> tuple[Reduction, list[frozenset[str]]]:
    tried = []

    def run(one: EpisodeSpec) -> Episode:
        ids = frozenset(fault.id for fault in one.faults)
        tried.append(ids)
        return episode(one, gap=-1.0 if violates(ids) else 1.0)

    return reduce_faults(spec(*faults), [FREE], run, budget=budget), tried


@settings(derandomize=True, deadline=None, max_examples=60)
@given(st.sets(st.frozensets(st.sampled_from(NAMES[:6]), min_size=1), min_size=1, max_size=4))
def test_the_smallest_set_is_found_whatever_the_causes(causes: set[frozenset[str]]) -> None:
    faults = [planned(name) for name in NAMES[:6]]
    found, _ = reduced(lambda ids: any(cause <= ids for cause in causes), *faults, budget=1000)
    assert found.smallest
    assert len(found.faults) == min(map(len, causes))
    assert any(cause == frozenset(found.faults) for cause in causes)
    assert found.violated == ("SAF-1",)
    assert found.episode is not None
    assert {fault.id for fault in found.episode.spec.faults} == set(found.faults)


def test_not_even_monotone_causes_lead_it_astray() -> None:
    # Three faults together, or exactly `e` alone: the way down from all eight passes `e` by.
    def violates(ids: frozenset[str]) -> bool:
        return {"a", "d", "g"} <= ids or ids == {"e"}

    found, _ = reduced(violates, *map(planned, NAMES), budget=1000)
    assert found.faults == ("e",)
    assert found.smallest


def test_a_violation_without_any_fault_is_told() -> None:
    found, _ = reduced(lambda _: True, planned("a"), planned("b"))
    assert (found.faults, found.smallest, found.reproduced) == ((), True, True)
    assert found.episode is not None
    assert found.episode.spec.case == "road/free+none"


def test_what_does_not_happen_again_is_not_reduced() -> None:
    found, tried = reduced(lambda _: False, planned("a"), planned("b"))
    assert not found.reproduced
    assert found.episode is None
    assert set(tried) == {frozenset("ab")}


def test_a_budget_ends_with_the_smallest_set_so_far() -> None:
    def violates(ids: frozenset[str]) -> bool:
        return {"a", "h"} <= ids

    full, _ = reduced(violates, *map(planned, NAMES))
    assert full.faults == ("a", "h")
    lengths = []
    for budget in range(2, full.runs):
        found, tried = reduced(violates, *map(planned, NAMES), budget=budget)
        assert len(tried) == found.runs <= budget
        assert {"a", "h"} <= set(found.faults)
        assert not found.smallest
        if found.one_minimal:
            assert found.faults == ("a", "h")
        lengths.append(len(found.faults))
    assert lengths == sorted(lengths, reverse=True)
    assert lengths[0] == 8


def test_two_equal_runs_stand_for_all() -> None:
    _, tried = reduced(lambda ids: "a" in ids, planned("a"), planned("b"))
    assert tried.count(frozenset("ab")) == 2


@pytest.mark.parametrize("hits, violating", [(2, False), (3, True)])
def test_most_runs_of_an_erratic_component_decide(hits: int, violating: bool) -> None:
    outcomes = iter([True] * hits + [False] * (5 - hits))
    numbers = itertools.count()

    def run(one: EpisodeSpec) -> Episode:
        bad = next(outcomes, False)
        found = episode(one, gap=-1.0 if bad else 1.0)
        found.signals["noise"] = np.array([0.0, float(next(numbers))])
        return found

    found = reduce_faults(spec(planned("a")), [FREE], run, budget=100)
    assert found.reproduced is violating


def test_faults_that_wait_for_one_that_is_left_out_go_with_it() -> None:
    faults = planned("a"), planned("b", after="a"), planned("c", after="b"), planned("d")
    found, tried = reduced(lambda ids: "c" in ids, *faults)
    assert found.faults == ("a", "b", "c")
    assert all("b" not in ids or "a" in ids for ids in tried)
    assert all("c" not in ids or "b" in ids for ids in tried)


def test_only_the_faults_change() -> None:
    whole = replace(spec(planned("a"), planned("b")), timeouts=(3,))
    part = with_faults(whole, ("b",))
    assert part.case == "road/free+b"
    assert part.faults == (planned("b"),)
    assert replace(part, case=whole.case, faults=whole.faults, timeouts=(3,)) == whole
    assert with_faults(whole, ("a", "b")) == replace(whole, timeouts=None)


@pytest.mark.parametrize("budget", [0, 1])
def test_a_budget_too_small_for_the_whole_set_leaves_it_open(budget: int) -> None:
    found, tried = reduced(lambda _: True, planned("a"), planned("b"), budget=budget)
    assert found.reproduced is None
    assert (found.episode, found.runs, len(tried)) == (None, budget, budget)


def test_one_violation_by_chance_before_the_budget_ends_is_no_smaller_set() -> None:
    numbers = itertools.count()

    def run(one: EpisodeSpec) -> Episode:
        number = next(numbers)
        found = episode(one, gap=-1.0)  # whole: twice; without faults: never; then one by chance
        if not one.faults:
            found = episode(one, gap=1.0)
        if len(one.faults) == 1:
            found.signals["noise"] = np.array([0.0, float(number)])
        return found

    found = reduce_faults(spec(planned("a"), planned("b")), [FREE], run, budget=5)
    assert found.faults == ("a", "b")
    assert not found.one_minimal


def test_a_run_that_failed_proves_no_set_the_smallest() -> None:
    def run(one: EpisodeSpec) -> Episode:
        found = episode(one, gap=-1.0)
        return found if len(one.faults) == 2 else replace(found, signals={}, failure="gone")

    found = reduce_faults(spec(planned("a"), planned("b")), [FREE], run)
    assert (found.faults, found.reproduced) == (("a", "b"), True)
    assert (found.smallest, found.one_minimal) == (False, False)
    assert found.missing == found.runs - 2 > 0
