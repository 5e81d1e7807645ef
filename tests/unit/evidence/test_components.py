"""Components of a record: what has one name and is not the same is all described."""

from __future__ import annotations

import itertools

import pytest
from entries import make
from item_lines import report
from session_records import HEADER

from pytest_dura.evidence import RecordBuilder
from pytest_dura.evidence.session_model import ComponentEntry


def described(name, path, **params):
    return make(ComponentEntry, name=name, path=path, params=params).to_json()


def recorded(*components):
    """What the record says of the components under test, and which problems there are."""
    made = RecordBuilder(HEADER)
    made.add(report(components=components))
    return made.head("running").component_under_test.to_json(), made.problems


@pytest.mark.parametrize("order", [*itertools.permutations(range(3))])
def test_one_class_with_other_parameters_is_described_again_in_any_order(order):
    known = [described("A", "m:A"), described("B", "m:B", k=1), described("B", "m:B", k=2)]
    told, problems = recorded(*(known[at] for at in (*order, *order)))
    assert told == {**known[0], "others": known[1:]}
    assert problems == []


def test_classes_of_one_name_are_a_problem():
    _, (problem,) = recorded(*(described(path[-1], path) for path in ("m:A", "n:A", "m:B")))
    assert problem.startswith("infrastructure: several components are called A, ")
    assert ": m:A, n:A; rename" in problem


def test_none_is_told_as_none():
    assert not any(recorded()[0].values())
