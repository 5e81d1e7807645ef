"""Faults of messages: where numbers are found in them, and what is forged."""

from __future__ import annotations

import enum
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import pytest
from fault_runs import CHANNEL, commanded, fault, through

from pytest_dura.core import ConfigurationError, Lazy, RoleContext
from pytest_dura.driving import Body, BodyList, Command, Maneuver
from pytest_dura.faults import CampaignInjector
from pytest_dura.faults.types.base import count_numbers, flip_bits, with_changed_number


class Level(enum.IntEnum):
    LOW = 1


class Imu(NamedTuple):
    acceleration: float
    turning: bool
    rate: float


@dataclass(frozen=True, slots=True)
class Slotted:
    name: str
    speed: float
    level: Level = Level.LOW
    derived: float = field(init=False, default=1.0)


@dataclass
class Nested:
    parts: tuple[Any, ...]


class Cloud:
    """Points as some library has them."""

    def __init__(self, data: Any) -> None:
        self.data = data
        self.frame = "base"


def array(*values: float, dtype: type = float) -> Any:
    found = np.array(values, dtype)
    found.flags.writeable = False
    return found


BODIES = BodyList.of([Body("V1", 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0)])
MESSAGES: list[tuple[Any, int]] = [
    (3.5, 1),
    (7, 1),
    (np.float32(2.0), 1),
    (Imu(1.0, True, 2.0), 2),
    (Slotted("a", 3.0), 1),
    (Nested((Imu(1.0, False, 2.0), [4, 5.0])), 4),
    ({"a": 1.0, "b": {"c": 2, "d": "text"}}, 2),
    (MappingProxyType({"a": 1.0}), 1),
    ([1.0, "x", None, 2], 2),
    (array(1.0, 2.0, 3.0), 3),
    (array(1, 2, 3, dtype=np.uint8), 3),
    (array(1, 2, dtype=np.int32), 2),
    (array(1.0, 2.0, dtype=np.float32), 2),
    (array(1, 0, dtype=bool), 0),
    (BODIES, 7),
    (Cloud(array(1.0, 2.0)), 2),
    (Command(Maneuver.PROCEED, 1.5), 1),
    ("text", 0),
    (None, 0),
    (True, 0),
    (Level.LOW, 0),
    ((), 0),
    (2**70, 1),
]


def flat(message: Any) -> list[Any]:
    """All that is in a message, in order: an independent way to look into one."""
    parts = opened(message)
    return [message] if parts is None else [one for part in parts for one in flat(part)]


def opened(message: Any) -> list[Any] | None:
    if isinstance(message, np.ndarray):
        return [message.dtype.str, len(message), *message.ravel().tolist()]
    if isinstance(message, BodyList):
        return [str(message.ids), message.data]
    if isinstance(message, (dict, MappingProxyType)):
        return [*message, *message.values()]
    if isinstance(message, (tuple, list)):
        return list(message)
    return list(vars(message).values()) if isinstance(message, (Cloud, Nested)) else slots(message)


def slots(message: Any) -> list[Any] | None:
    names = getattr(message, "__dataclass_fields__", None)
    return None if names is None else [getattr(message, name) for name in names]


@pytest.mark.parametrize("message, count", MESSAGES, ids=lambda value: str(value)[:30])
def test_numbers_are_found_wherever_a_message_keeps_them(message: Any, count: int) -> None:
    assert count_numbers(message) == count
    before = flat(message)
    for index in range(count):
        changed = with_changed_number(message, index, lambda one: one + type(one)(1))
        differing = [
            i for i, (a, b) in enumerate(zip(before, flat(changed), strict=True)) if a != b
        ]
        assert len(differing) == 1
        assert flat(message) == before, "the message itself stays"
        if not isinstance(message, MappingProxyType):
            assert type(changed) is type(message)
    changes = [flat(with_changed_number(message, i, lambda one: one + 1)) for i in range(count)]
    assert len({str(one) for one in changes}) == count, "each has an index of its own"
    with pytest.raises(IndexError):
        with_changed_number((message,), count, lambda one: one)


@pytest.mark.parametrize("message, count", MESSAGES, ids=lambda value: str(value)[:30])
def test_corruption_changes_one_number_of_any_message(message: Any, count: int) -> None:
    found = through([message] * 20, fault("corruption", p=1.0))
    before = flat(message)
    for one in found:
        if not count or (type(message) is int and message == 2**70):
            assert one is message
            continue
        differing = [(a, b) for a, b in zip(before, flat(one), strict=True) if a != b]
        assert len(differing) == 1
        assert np.isfinite(differing[0][1])
    assert flat(message) == before


def test_corruption_reaches_every_number_of_an_object_list() -> None:
    found = through([BODIES] * 200, fault("corruption", p=1.0))
    assert {int(np.flatnonzero(one.data[0] != BODIES.data[0])[0]) for one in found} == set(range(7))
    assert all(type(one) is BodyList and one.ids == ("V1",) for one in found)
    assert not found[0].data.flags.writeable


def test_corruption_of_an_object_list_reaches_who_reads_its_bodies() -> None:
    """The list that the simulator made has its plain numbers at hand."""
    assert BODIES.numbers
    (found,) = through([BODIES], fault("corruption", p=1.0))
    assert list(found) != list(BODIES)
    assert [[*body[1:]] for body in found] == found.data.tolist()


def test_corruption_of_a_lazy_picture_makes_it_when_it_is_read() -> None:
    made: list[int] = []
    picture = np.zeros((4, 4, 3), np.uint8)

    def make() -> Any:
        made.append(1)
        return picture

    (found,) = through([Lazy(make)], fault("corruption", p=1.0, bits=3))
    assert (found != picture).sum() == 1
    (eager,) = through([picture], fault("corruption", p=1.0, bits=3))
    assert np.array_equal(found, eager), "whether it was lazy is no matter"
    assert made == [1]
    assert not picture.any()


def test_a_corrupted_command_keeps_its_maneuver() -> None:
    command = Command(Maneuver.PROCEED, 1.5)
    (found,) = commanded([command], fault("corruption", target="command", p=1.0))
    assert found.maneuver is Maneuver.PROCEED
    assert found.acceleration != 1.5


@pytest.mark.parametrize("value", [0, -1, 2**63 - 1, -(2**63)])
def test_flipping_bits_of_an_int_keeps_it_one(value: int) -> None:
    rng = np.random.default_rng(1)
    found = [flip_bits(value, 3, rng) for _ in range(50)]
    assert all(type(one) is int for one in found)
    assert {((one ^ value) & (2**64 - 1)).bit_count() for one in found} == {3}


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.uint8, np.int16])
def test_flipping_more_bits_than_there_are_flips_what_there_is(dtype: Any) -> None:
    rng = np.random.default_rng(1)
    for value in (dtype(0), dtype(1), dtype(100)):
        found = flip_bits(value, 32, rng)
        assert type(found) is dtype
        assert np.isfinite(found)
        assert found != value


def test_a_sequence_of_arrays_can_be_late_and_lost() -> None:
    rows = [array(index, index + 1.0) for index in range(6)]
    late = through(rows, fault("latency", latency_ms=200.0, at=0.2))
    assert [one[0] for one in late] == [0, 1, 1, 1, 2, 3]
    assert all(any(one is row for row in rows) for one in late), (
        "messages are passed on as they are"
    )


def test_lazy_pictures_that_come_late_are_those_of_then() -> None:
    now = [0]
    frames = [Lazy(lambda: now[0]) for _ in range(5)]

    def advancing() -> Any:
        for index, frame in enumerate(frames):
            now[0] = index
            yield frame

    for kind, expected in (
        (fault("delay", s=0.2), [0, 0, 0, 1, 2]),
        (fault("freeze", at=0.1), [0, 1, 1, 1, 1]),
        (fault("slow", hz=5.0), [0, 0, 2, 2, 4]),
        (fault("masquerade", at=0.1), [0, 1, 1, 1, 1]),
    ):
        frames[:] = [Lazy(lambda: now[0]) for _ in range(5)]
        assert through(advancing(), kind) == expected


@pytest.mark.parametrize("kind", ["freeze", "masquerade", "slow", "denial", "replay"])
def test_what_nobody_has_read_is_kept_as_it_was_all_the_same(kind: str) -> None:
    injector, now = CampaignInjector(), [0]
    injector.reset(RoleContext(1, 0.1, {}, (fault(kind, at=0.2),)))
    for index in range(5):
        now[0] = index
        shown = injector.corrupt({CHANNEL: Lazy(lambda: now[0])}, index * 0.1)[0][CHANNEL]
    now[0] = 99
    assert shown in (0, 1, 2)


def test_a_forged_field_that_is_not_there_is_told() -> None:
    for message in ({"speed": 1.0}, Slotted("a", 1.0), Imu(1.0, True, 2.0)):
        with pytest.raises(ConfigurationError, match="no 'sped'"):
            through([message], fault("masquerade", forged={"sped": 2.0}))


def test_a_forged_message_keeps_its_kind() -> None:
    forger = fault("masquerade", forged={"speed": 9.0, "name": "b"})
    assert through([Slotted("a", 1.0)], forger) == [Slotted("b", 9.0)]
