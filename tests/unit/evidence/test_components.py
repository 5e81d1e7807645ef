"""Components of a record: what has one name and is not the same is all described."""

from __future__ import annotations

import itertools

import pytest

from pytest_dura.evidence.gather import Components


def described(name, path, **params):
    return {"name": name, "path": path, "params": params}


@pytest.mark.parametrize("order", [*itertools.permutations(range(3))])
def test_one_class_with_other_parameters_is_described_again_in_any_order(order):
    known = [described("A", "m:A"), described("B", "m:B", k=1), described("B", "m:B", k=2)]
    components = Components()
    for at in (*order, *order):
        components.add(known[at])
    told = components.to_json()
    assert told == {**known[0], "others": known[1:]}
    assert sorted(components.names) == ["A", "B"]
    assert list(components.problems()) == []


def test_classes_of_one_name_are_a_problem():
    components = Components()
    for path in ("m:A", "n:A", "m:B"):
        components.add(described(path[-1], path))
    (problem,) = components.problems()
    assert problem.startswith("infrastructure: several components are called A, ")
    assert ": m:A, n:A; rename" in problem


def test_none_is_told_as_none():
    assert Components().to_json() == {"name": None, "version": None}
