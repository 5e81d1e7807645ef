"""Leaves: every value flattened, so that equal means equal to the bit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pytest

from pytest_dura import Assessed, Lazy, Percept
from pytest_dura.core import first_difference, leaves, mutable_parts


class Point(NamedTuple):
    x: Any
    y: Any


@dataclass(frozen=True)
class Body:
    name: str
    position: Any


@dataclass
class Loose:
    name: str


class Plain:
    def __init__(self, value: Any) -> None:
        self.value = value


@pytest.mark.parametrize(
    "one, other, path",
    [
        (float("nan"), float("nan"), None),
        (0.0, -0.0, "the value"),
        (1, 1.0, "the value"),
        (0, False, "the value"),
        (True, True, None),
        (np.zeros(2), np.zeros(2), None),
        (np.zeros(2), np.zeros(2, dtype=int), "the value"),
        (np.zeros(2), np.zeros((2, 1)), "the value"),
        (np.array([None, 1], dtype=object), np.array([None, 2], dtype=object), "[1]"),
        ([], (), "<type>"),
        ({}, [], "<type>"),
        ({"a": 1}, {"a": 1, "b": 2}, "['b']"),
        ({"a": 1, "b": 2}, {"b": 2, "a": 1}, None),
        ({1, 2}, {2, 1}, None),
        (Point(1, 2), Point(1, 3), ".y"),
        (Body("V1", [1.0]), Body("V1", [1.0]), None),
        (Body("V1", [1.0]), Body("V1", [2.0]), ".position[0]"),
        (Plain(Body("a", 1)), Plain(Body("a", 2)), ".value.position"),
        (Assessed.SAFE, Assessed.WARNING, "the value"),
        (Lazy(lambda: 1), Lazy(lambda: 2), None),
        (Percept({"a": 1}), Percept({"a": 2}), "['a']"),
    ],
)
def test_values_differ_where_they_differ(one: Any, other: Any, path: str | None) -> None:
    assert first_difference(leaves(one), leaves(other)) == path


def test_what_contains_itself_has_leaves_too() -> None:
    loop: list[Any] = [1]
    loop.append(loop)
    assert leaves(loop)["[1]"] == "list"
    assert mutable_parts((loop,)) == ["[0] (a list)"]


def test_leaves_are_a_copy() -> None:
    array = np.zeros(2)
    before = leaves({"a": array})
    array[1] = 3.0
    assert first_difference(before, leaves({"a": array})) == "['a']"


def test_a_lazy_value_in_a_percept_is_not_made() -> None:
    made: list[int] = []
    leaves(Percept({"camera": Lazy(lambda: made.append(1))}))
    assert made == []


def test_mutable_parts_are_found_in_depth() -> None:
    frozen = np.zeros(1)
    frozen.flags.writeable = False
    value = (1, Body("V1", (np.zeros(1), frozen)), {"a": 1}, Point({1}, "text"), Loose("a"))
    assert mutable_parts(value) == [
        "[1].position[0] (a writeable array)",
        "[2] (a dict)",
        "[3].x (a set)",
        "[4] (a dataclass that is not frozen)",
    ]
    assert mutable_parts((1, "a", frozen, None, Assessed.SAFE)) == []
