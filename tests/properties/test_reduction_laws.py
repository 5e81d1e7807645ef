"""Laws of reduction: what is left of an episode's faults still violates, and nothing less does."""

from __future__ import annotations

import random
from typing import Any

import numpy as np
import pytest
from handmade import handmade
from hypothesis import given, settings
from hypothesis import strategies as st

from pytest_dura import Episode, EpisodeSpec, Fault, Requirement, RoleSpec
from pytest_dura.search import reduce_faults

lawful = settings(derandomize=True, deadline=None, max_examples=60)
FREE = Requirement("SAF-1", check="always (gap > 0)")
NAMES = tuple("abcde")
BUDGET = 10_000

waiting = st.lists(st.none() | st.sampled_from(NAMES), min_size=5, max_size=5)
orders = st.permutations(NAMES)
sets = st.sets(st.frozensets(st.sampled_from(NAMES), min_size=1), min_size=1, max_size=3)


def spec(names: list[str], waits: dict[str, str | None]) -> EpisodeSpec:
    """An episode with these faults, some of which wait for another to become active."""
    faults = []
    for name in names:
        after = waits.get(name) and {"fault": waits[name], "event": "activated", "delay": 0.0}
        activation: dict[str, Any] = {"at": 1.0, "after": after}
        faults.append(Fault("bias", name, "lidar", activation))
    return EpisodeSpec("road/free+all", 3, 7, RoleSpec("a:Simulator"), {}, faults=tuple(faults))


def ids(spec: EpisodeSpec) -> frozenset[str]:
    return frozenset(fault.id for fault in spec.faults)


def can_begin(names: frozenset[str], waits: dict[str, str | None]) -> bool:
    """Whether each of them waits for nothing, or for one that is there and can begin itself."""
    return all(waits[name] is None or waits[name] in names for name in names)


@lawful
@given(orders, waiting, sets)
def test_only_faults_that_can_begin_are_tried_and_the_smallest_violating_set_is_left(
    names: list[str], after: list[str | None], causes: set[frozenset[str]]
) -> None:
    # Each waits for one of those that stand after it in the alphabet, or for none.
    waits = {
        name: other if other and other > name else None
        for name, other in zip(NAMES, after, strict=True)
    }
    tried: list[frozenset[str]] = []

    def violates(there: frozenset[str]) -> bool:
        return any(cause <= there for cause in causes)

    def run(spec: EpisodeSpec) -> Episode:
        tried.append(ids(spec))
        return handmade(2, spec=spec, gap=[1.0, -1.0 if violates(ids(spec)) else 1.0])

    reduction = reduce_faults(spec(names, waits), [FREE], run, budget=BUDGET)
    assert all(can_begin(there, waits) for there in tried)
    left = frozenset(reduction.faults)
    assert reduction.reproduced
    assert reduction.smallest
    assert violates(left)
    assert can_begin(left, waits)
    smaller = [there for there in subsets() if can_begin(there, waits) and violates(there)]
    assert len(left) == min(map(len, smaller))


def subsets() -> list[frozenset[str]]:
    return [
        frozenset(name for place, name in enumerate(NAMES) if bits >> place & 1)
        for bits in range(2 ** len(NAMES))
    ]


@pytest.mark.parametrize("hits", range(6))
@pytest.mark.parametrize("shuffle", range(4))
def test_most_of_five_different_runs_decide_whether_a_set_violates(hits: int, shuffle: int) -> None:
    outcomes = [True] * hits + [False] * (5 - hits)
    random.Random(shuffle).shuffle(outcomes)
    noise = iter(range(1000))
    runs = iter(outcomes)

    def run(spec: EpisodeSpec) -> Episode:
        bad = next(runs) if spec.faults else False
        noisy = np.array([0.0, float(next(noise))])
        return handmade(2, spec=spec, gap=[1.0, -1.0 if bad else 1.0], noise=noisy)

    reduction = reduce_faults(spec(["a"], {}), [FREE], run, budget=BUDGET)
    assert reduction.reproduced == (hits >= 3)
    assert reduction.faults == ("a",)
    assert (reduction.episode is not None) == (hits >= 3)
