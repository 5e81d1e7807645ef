"""Targets and conditions: what is read, what is written, and what is told when it is not there."""

from __future__ import annotations

from collections import namedtuple
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import pytest
from fault_runs import check_place

from pytest_dura.core import ConfigurationError, Lazy
from pytest_dura.driving import CHANNELS
from pytest_dura.faults import (
    Channel,
    RefusedError,
    check_condition_targets,
    fault_class,
    parse_condition,
    parse_fault,
    possible_targets,
)
from pytest_dura.faults.injector import is_same_value
from pytest_dura.faults.parts import AbsentRowError, Target, part_of, with_part


class Point(NamedTuple):
    x: float
    y: float


@dataclass(frozen=True, slots=True)
class Plain:
    speed: float
    where: Point
    rows: Any = field(default_factory=lambda: np.array([[1.0, 2.0], [3.0, 4.0]]))


def read_only(*numbers: Any) -> Any:
    array = np.array(numbers)
    array.flags.writeable = False
    return array


VALUES: list[tuple[Any, str, Any, Any]] = [
    (Point(1.0, 2.0), "y", 2.0, Point(1.0, 9.0)),
    (Point(1.0, 2.0), "1", 2.0, Point(1.0, 9.0)),
    (namedtuple("Old", "a b")(1.0, 2.0), "b", 2.0, (1.0, 9.0)),  # noqa: PYI024 - those exist, too
    (Plain(1.0, Point(2.0, 3.0)), "speed", 1.0, Plain(9.0, Point(2.0, 3.0))),
    (Plain(1.0, Point(2.0, 3.0)), "where.x", 2.0, Plain(1.0, Point(9.0, 3.0))),
    ({"a": 1.0, "b": 2.0}, "a", 1.0, {"a": 9.0, "b": 2.0}),
    (MappingProxyType({"a": {"b": [1.0, 2.0]}}), "a.b.1", 2.0, {"a": {"b": [1.0, 9.0]}}),
    ([1.0, 2.0], "0", 1.0, [9.0, 2.0]),
    ((1.0, (2.0, 3.0)), "1.0", 2.0, (1.0, (9.0, 3.0))),
    (read_only(1.0, 2.0), "1", 2.0, np.array([1.0, 9.0])),
    (read_only([1.0, 2.0], [3.0, 4.0]), "1.0", 3.0, np.array([[1.0, 2.0], [9.0, 4.0]])),
    (Lazy(lambda: {"a": 1.0}), "a", 1.0, {"a": 9.0}),
    ({"a": Lazy(lambda: Point(1.0, 2.0))}, "a.x", 1.0, {"a": Point(9.0, 2.0)}),
]


@pytest.mark.parametrize("value, path, part, changed", VALUES)
def test_a_part_is_read_and_written_into_a_copy(
    value: Any, path: str, part: Any, changed: Any
) -> None:
    assert part_of(value, path) == part
    before = repr(value.get() if isinstance(value, Lazy) else value)
    new = with_part(value, path, 9.0)
    assert is_same_value(new, changed) or (type(new) is not type(changed) and tuple(new) == changed)
    assert repr(value.get() if isinstance(value, Lazy) else value) == before
    assert part_of(new, path) == 9.0


def test_types_are_kept() -> None:
    new = with_part(Plain(1.0, Point(2.0, 3.0)), "rows.1.0", 9.0)
    assert isinstance(new, Plain)
    assert isinstance(new.where, Point)
    assert new.rows.tolist() == [[1.0, 2.0], [9.0, 4.0]]
    assert not new.rows.flags.writeable
    assert with_part(np.array([1, 2], dtype=np.uint8), "0", 7).dtype == np.uint8
    assert with_part(np.array([1, 2], dtype=np.float32), "0", 7.5).dtype == np.float32


def test_a_fraction_in_an_array_of_whole_numbers_is_not_cut_off() -> None:
    assert with_part(np.array([1, 2]), "0", 1.5).tolist() == [1.5, 2.0]


@pytest.mark.parametrize("value", [[1.0], (1.0,), np.array([1.0]), np.empty((0, 3))])
def test_a_row_beyond_the_end_is_absent(value: Any) -> None:
    with pytest.raises(AbsentRowError, match=f"no row 4 now, only {len(value)}"):
        part_of(value, "4.0")
    with pytest.raises(AbsentRowError):
        with_part(value, "4", 1.0)


@pytest.mark.parametrize(
    "value, path, told",
    [
        (Point(1.0, 2.0), "z", ["no 'z'", "type Point", "one of x, y"]),
        (Point(1.0, 2.0), "x.y", ["no 'y'", "type float", "the channel as a whole"]),
        ({"speed": 1.0}, "sped", ["no 'sped'", "one of speed", "did you mean 'speed'?"]),
        (np.zeros(2), "x", ["no 'x'", "the rows, counted from 0"]),
        (np.zeros(2), "-1", ["no '-1'"]),
        (3.0, "x", ["type float", "the channel as a whole"]),
    ],
)
def test_what_is_not_there_is_told_with_what_there_is(
    value: Any, path: str, told: list[str]
) -> None:
    for call in (lambda: part_of(value, path), lambda: with_part(value, path, 1.0)):
        with pytest.raises(ConfigurationError) as caught:
            call()
        assert not isinstance(caught.value, AbsentRowError)
        for part in told:
            assert part in str(caught.value)


def test_a_channel_that_is_not_there_is_told_with_those_that_are() -> None:
    with pytest.raises(ConfigurationError, match="no channel 'gyro'") as caught:
        Target.parse("gyro.x").read({"imu": 1.0})
    assert "one of imu, command" in str(caught.value)


NAN = float("nan")


@pytest.mark.parametrize(
    "one, other, expected",
    [
        (1.0, 1.0, True),
        (1, 1.0, True),
        (np.float32(0.5), 0.5, True),
        (0.0, -0.0, True),
        (1.0, 1.0 + 1e-15, False),
        (NAN, float("nan"), True),
        (np.float64("nan"), NAN, True),
        (NAN, 0.0, False),
        ("a", "a", True),
        ("1", 1, False),
        (None, 0, False),
        ([1.0], (1.0,), False),
        ([1.0, NAN], [1.0, float("nan")], True),
        ([1.0], [1.0, 2.0], False),
        (np.array([1.0, NAN]), np.array([1.0, NAN]), True),
        (np.array([1.0]), np.array([1]), False),
        (np.array([1.0]), np.array([[1.0]]), False),
        (np.array(["a"]), np.array(["a"]), True),
        (np.array([np.zeros(2), None], object), np.array([np.zeros(2), None], object), True),
        ([np.zeros(2)], [np.zeros(2)], True),
        ([np.zeros(2)], [np.ones(2)], False),
        ({"a": np.zeros(2)}, {"a": np.zeros(2)}, True),
        ({"a": 1.0}, {"b": 1.0}, False),
        (Point(1.0, NAN), Point(1.0, float("nan")), True),
        (Point(1.0, 2.0), (1.0, 2.0), False),
        (Plain(1.0, Point(1.0, 2.0)), Plain(1.0, Point(1.0, 2.0)), True),
        (Plain(1.0, Point(1.0, 2.0)), Plain(1.0, Point(1.0, 2.0), np.zeros((2, 2))), False),
        (object(), object(), False),
    ],
)
def test_what_counts_as_unchanged(one: Any, other: Any, expected: bool) -> None:
    assert is_same_value(one, other) is expected
    assert is_same_value(other, one) is expected
    assert is_same_value(one, one)


def test_two_lazy_values_are_not_made_to_be_compared() -> None:
    def never() -> Any:
        raise AssertionError

    lazy = Lazy(never)
    assert is_same_value(lazy, lazy)
    assert not is_same_value(lazy, Lazy(never))


CONDITIONS = {
    "a": {"x": 3.0, "y": -2.0, "name": "n", "count": 7.0},
    "list": [1, 2, 3],
    "lazy": Lazy(lambda: {"x": 1.0}),
    "rows": np.array([[5.0, NAN]]),
}


@pytest.mark.parametrize(
    "text, expected",
    [
        ("a.x > 2", True),
        ("a.x>3", False),
        ("a.x >= 3", True),
        ("a.x <= 2.9", False),
        ("a.x < 3.5e0", True),
        ("a.y < -1.5", True),
        ("abs(a.y) > 1.5", True),
        ("abs( a.y ) <= .5", False),
        ("time >= 4", True),
        ("time < 4", False),
        ("a.x > 2 and a.y < 0 and time > 1", True),
        ("a.x > 2 and a.y > 0", False),
        ("list.count >= 3", True),
        ("list.count > 3", False),
        ("a.count == 7".replace("==", ">="), True),  # a field of that name goes before
        ("lazy.x > 0", True),
        ("rows.0.0 > 4", True),
        ("rows.0.1 > 4", False),  # NaN
        ("rows.0.1 < 4", False),
        ("rows.7.0 > 4", False),
        ("rows.count <= 1", True),
    ],
)
def test_conditions(text: str, expected: bool) -> None:
    assert parse_condition(text).holds(CONDITIONS, 4.0) is expected


@pytest.mark.parametrize(
    "text, told",
    [
        ("", "'' is not a comparison"),
        ("a.x", "'a.x' is not a comparison such as 'odometry.speed > 5'"),
        ("a.x == 3", "'a.x == 3' is not a comparison"),
        ("a.x > b.x", "'a.x > b.x' is not a comparison"),
        ("3 < a.x", "'3 < a.x' is not a comparison"),
        ("a.x > 3 or a.y > 2", "'a.x > 3 or a.y > 2' is not"),
        ("a.x > 3 and", "'' is not a comparison"),
        ("a.x > 3 and b", "'b' is not a comparison"),
        ("abs(a.x > 3", "is not a comparison"),
        ("max(a.x) > 3", "is not a comparison"),
        ("a > 3", "'a' is no number"),
        ("time.x > 3", "'time.x' is no number"),
        ("a.x > 1e999", "1e999 in 'a.x > 1e999' is not a finite number"),
        ("a.x > nan", "is not a comparison"),
    ],
)
def test_what_is_no_condition(text: str, told: str) -> None:
    with pytest.raises(RefusedError) as caught:
        parse_condition(text)
    assert told in str(caught.value)
    assert caught.value.expected
    assert caught.value.remedy


@pytest.mark.parametrize(
    "text, told",
    [
        ("b.x > 1", "there is no channel 'b'"),
        ("a.z > 1", "there is no 'z'"),
        ("a.name > 1", "cannot read 'a.name', which is not a number"),
        ("list.x > 1", "there is no 'x'"),
        ("a.x.count > 1", "there is no 'count'"),
        ("rows.0 > 1", "cannot read 'rows.0', which is not a number"),
    ],
)
def test_what_a_condition_cannot_read(text: str, told: str) -> None:
    # The first part does not hold: the second one is looked at all the same.
    condition = parse_condition(f"time > 99 and {text}")
    with pytest.raises(ConfigurationError, match=told):
        condition.check(CONDITIONS)
    assert not condition.holds(CONDITIONS, 0.0)


def planned(kind: str, target: str) -> Any:
    return parse_fault(
        {"type": kind, "id": "f", "target": target, "activation": {"at": 1.0}, "duration": 1.0}
    )


@pytest.mark.parametrize(
    "kind, target",
    [
        ("bias", "odometry.speed"),
        ("bias", "localisation.x"),
        ("bias", "command.acceleration"),
        ("bias", "radar.0.2"),
        ("freeze", "radar.0"),
        ("freeze", "radar.0.2"),
        ("freeze", "camera_front"),
        ("freeze", "map"),
        ("freeze", "command"),
        ("ghost-obstacle", "lidar"),
        ("gnss-jam", "localisation"),
    ],
)
def test_possible_targets_are_accepted(kind: str, target: str) -> None:
    check_place(planned(kind, target), CHANNELS)


@pytest.mark.parametrize(
    "kind, target, told",
    [
        ("bias", "odometer.speed", ["no channel 'odometer'", "did you mean 'odometry.speed'?"]),
        ("bias", "odometry.sped", ["no part 'sped'", "did you mean 'odometry.speed'?"]),
        ("bias", "odometry", ["it acts on a number", "did you mean 'odometry.speed'?"]),
        ("bias", "lidar", ["it acts on a number", "radar.<row>.<0 to 2>"]),
        ("bias", "radar.0", ["it acts on a number"]),
        ("bias", "radar.0.3", ["it acts on a number", "radar.<row>.<0 to 2>"]),
        ("bias", "radar.x.1", ["it acts on a number"]),
        ("bias", "camera_front.0", ["no part '0'"]),
        ("freeze", "radar.0.1.2", ["any value"]),
        ("ghost-obstacle", "radar", ["it acts on a list of objects", "expected: one of lidar"]),
        ("ghost-obstacle", "lidr", ["no channel 'lidr'", "did you mean 'lidar'?"]),
        ("gnss-jam", "imu", ["it acts on a pose", "one of localisation"]),
    ],
)
def test_impossible_targets_are_refused(kind: str, target: str, told: list[str]) -> None:
    with pytest.raises(ConfigurationError) as caught:
        check_place(planned(kind, target), CHANNELS)
    assert caught.value.key == "target"
    assert caught.value.found == target
    for part in told:
        assert part in str(caught.value)


def test_where_nothing_suits_a_type_the_message_says_so() -> None:
    with pytest.raises(ConfigurationError, match="another type of fault") as caught:
        check_place(planned("ghost-obstacle", "a"), {"a": Channel("numbers", ("x",))})
    assert caught.value.remedy == "choose another type: no channel here holds a list of objects"


@pytest.mark.parametrize(
    "text",
    ["odometry.speed > 1", "lidar.count > 1", "radar.0.1 > 2", "radar.count < 1 and time > 2"],
)
def test_possible_conditions_are_accepted(text: str) -> None:
    check_condition_targets(parse_condition(text).targets, CHANNELS, "activation.when")


@pytest.mark.parametrize(
    "text, told",
    [
        ("odometry.sped > 1", "did you mean 'odometry.speed'?"),
        ("odometry.count > 1", "cannot read 'odometry.count'"),
        ("camera_front.count > 1", "cannot read 'camera_front.count'"),
        ("lidr.count > 1", "did you mean 'lidar.count'?"),
        ("radar.0 > 1", "radar.<row>.<0 to 2>"),
        ("radar.0.9 > 1", "radar.<row>.<0 to 2>"),
        ("command.acceleration > 1", "cannot read 'command.acceleration'"),
    ],
)
def test_impossible_conditions_are_refused(text: str, told: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        check_condition_targets(parse_condition(text).targets, CHANNELS, "activation.when")
    assert caught.value.key == "activation.when"
    assert told in str(caught.value)
    assert "time" in str(caught.value.expected)


def test_all_that_is_listed_as_possible_is_possible() -> None:
    for kind in ("bias", "freeze", "ghost-obstacle", "gnss-jam"):
        for target in possible_targets(fault_class(kind).acts_on, CHANNELS):
            check_place(planned(kind, target), CHANNELS)
