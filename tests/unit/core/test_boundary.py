"""The boundary around code that is not ours: whose an exception is, exact copies, sealed arrays."""

from __future__ import annotations

import copy
import heapq
import os
import signal
import threading
from collections import OrderedDict
from dataclasses import dataclass, field, replace
from enum import Enum, IntEnum
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple

import numpy as np
import pytest
from loops import doing, run_loop
from thermostat import Thermostat

from pytest_dura import ActionError, Assessment, Lazy, Proposal, SafetyMonitor, Simulator, sealed
from pytest_dura.core import Boundary, lasting_guard, let_pass
from pytest_dura.core.component import exact_copy


class PluginError(BaseException):
    """As pytest-timeout raises in a handler of SIGALRM."""


def test_an_exception_of_another_handler_is_not_the_components() -> None:
    def ring(number: int, frame: object) -> None:
        raise PluginError

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, 60.0)  # the alarm is somebody else's
    try:
        for budget in (None, 5.0):
            with pytest.raises(PluginError):
                run_loop(
                    lambda view: os.kill(os.getpid(), signal.SIGALRM) or Proposal(1.0),
                    spec={"time_budget": budget},
                )
        assert signal.getsignal(signal.SIGALRM) is ring
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def test_the_same_exception_raised_by_the_component_is_its_own() -> None:
    def raises(view: Any) -> Proposal:
        raise PluginError

    episode = run_loop(raises)
    assert [event.detail[:18] for event in episode.events] == ["raised PluginError"]


def test_an_interrupt_off_the_main_thread_is_taken_for_the_users() -> None:
    raised: list[BaseException] = []

    def run() -> None:
        try:
            with Boundary() as boundary:
                boundary.let_pass(KeyboardInterrupt())
        except BaseException as error:
            raised.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert [type(error) for error in raised] == [KeyboardInterrupt]
    with pytest.raises(KeyboardInterrupt):
        let_pass(KeyboardInterrupt())
    let_pass(PluginError())


def test_the_process_is_only_guarded_as_long_as_a_session_runs() -> None:
    real = os._exit
    with lasting_guard(print):
        assert os._exit is not real
        with Boundary():
            pass
        assert os._exit is not real
    assert os._exit is real


class Own(str):
    """A text with a hash of its own."""

    __slots__ = ()

    def __hash__(self) -> int:
        raise RuntimeError

    __eq__ = __str__ = __repr__ = __len__ = __hash__  # type: ignore[assignment]


class Lying(dict):  # type: ignore[type-arg]
    """Says that it is empty."""

    def items(self) -> Any:
        return ()

    __iter__ = keys = items


class Word(str, Enum):
    GO = "go"


class Number(IntEnum):
    ONE = 1


class Columns(np.ndarray):  # type: ignore[type-arg]
    """An array of a class of its own."""


class Pair(NamedTuple):
    x: Any
    y: Any


@pytest.mark.parametrize(
    "value, copied",
    [
        ([Own("go")], ["go"]),
        (Word.GO, "go"),
        (Number.ONE, 1),
        (np.float64(0.5), 0.5),
        (np.int8(3), 3),
        (np.bool_(True), True),
        (Lying(a=[Own("go")]), {"a": ["go"]}),
        (OrderedDict(a=(np.float32(0.5),)), {"a": (0.5,)}),
        (MappingProxyType({"a": 1}), {"a": 1}),
    ],
)
def test_a_copy_is_of_exact_types(value: Any, copied: Any) -> None:
    found, is_plain = exact_copy(value)
    assert is_plain
    assert (repr(found), type(found)) == (repr(copied), type(copied))


def test_arrays_are_copied_as_arrays_and_other_objects_are_left() -> None:
    array = np.arange(6.0).reshape(2, 3)
    found, is_plain = exact_copy([array, np.ones(2).view(Columns)])
    assert is_plain
    assert [type(one) for one in found] == [np.ndarray, np.ndarray]
    array[0, 0] = 9.0
    assert found[0][0, 0] == 0.0
    for thing in (Pair(1, 2), object(), np.array([object()]), {1, 2}):
        assert exact_copy(thing) == (thing, False) or exact_copy(thing)[1] is False
        assert exact_copy([thing])[1] is False


@pytest.mark.parametrize(
    "action",
    [None, float("nan"), float("inf"), 10**400, [float("nan")], {"a": (np.inf,)}, Pair(1, 2),
     np.array([np.nan]), np.array([object()]), [object()], {object(): 1}],
)  # fmt: skip
def test_the_base_of_simulators_takes_no_action_that_no_plant_could_carry_out(action: Any) -> None:
    with pytest.raises(ActionError):
        Simulator.check_action(Thermostat(), action)


@pytest.mark.parametrize("action", [0, 1.5, True, "go", b"x", [1, 2.0], {"a": (1,)}, np.eye(2)])
def test_the_base_of_simulators_takes_plain_actions(action: Any) -> None:
    assert Simulator.check_action(Thermostat(), action) is action


@dataclass(frozen=True)
class Cloud:
    points: Any
    name: str = "cloud"


CONTAINED = {
    "bare": lambda array: array,
    "list": lambda array: [0.0, array],
    "pair": lambda array: Pair("x", (array,)),
    "dict": lambda array: {"a": {"b": array}},
    "proxy": lambda array: MappingProxyType({"a": array}),
    "dataclass": Cloud,
    "lazy": lambda array: Lazy(lambda: Cloud([array])),
}


def arrays(value: Any) -> list[Any]:
    """All arrays in a value."""
    if isinstance(value, np.ndarray):
        return [value]
    if isinstance(value, Cloud):
        return arrays(value.points)
    if isinstance(value, (dict, MappingProxyType)):
        return [found for item in value.values() for found in arrays(item)]
    return (
        [found for item in value for found in arrays(item)]
        if value != "x" and not isinstance(value, float)
        else []
    )


class Clouds(Thermostat):
    """A room with a channel of arrays, in containers of all kinds."""

    def _tick(self, events: Any) -> Any:
        tick = super()._tick(events)
        self.points = np.ones((2, 3))
        self.points.flags.writeable = False
        made = {name: make(self.points) for name, make in CONTAINED.items()}
        return replace(tick, channels={**tick.channels, **made})


def make_writeable(array: Any) -> int:
    """How many arrays behind it can be written to."""
    done = 0
    while isinstance(array, np.ndarray):
        try:
            array.flags.writeable = True
            array[...] = 0.0
            done += 1
        except ValueError:
            pass
        array = array.base
    return done


def test_no_component_makes_an_array_of_its_percept_writeable() -> None:
    opened: list[int] = []
    seen: list[float] = []
    simulator = Clouds()

    def vandal(view: Any) -> Proposal:
        for name in CONTAINED:
            (array,) = arrays(view.percept[name])
            opened.append(make_writeable(array))
        return Proposal(1.0)

    def look(view: Any) -> Assessment:
        seen.extend(float(arrays(view.percept[name])[0].min()) for name in CONTAINED)
        return Assessment()

    episode = run_loop(vandal, simulator=simulator, safety_monitor=doing(SafetyMonitor, look))
    assert episode.failure is None
    assert set(opened) == {0}
    assert set(seen) == {1.0}
    assert simulator.points.min() == 1.0


class Named(list):
    """A list with a method of its own."""

    def first(self) -> float:
        return self[0]


@dataclass
class Loose:
    level: float = 1.0


def set_level(value: Any) -> None:
    value.level = 0.0


class Tags(set):
    pass


class Refusing(dict):
    """A dictionary that lets itself be changed in no usual way."""

    def __setitem__(self, key: Any, value: Any) -> None:
        raise TypeError("immutable")


@dataclass(frozen=True, slots=True)
class Kind:
    KINDS: ClassVar[list[str]] = ["a"]
    levels: list[float] = field(default_factory=lambda: [1.0])


SHARED: dict[str, tuple[Any, Any]] = {
    "list": ([1.0, 2.0], lambda held: held.__setitem__(0, 0.0)),
    "order": ([2.0, 1.0], lambda held: held.sort()),
    "queue": ([1.0, 2.0], heapq.heappop),
    "dict": ({"level": 1.0}, lambda held: held.update(level=0.0)),
    "set": ({1.0}, lambda held: held.clear()),
    "tags": (Tags({1.0}), lambda held: held.clear()),
    "bytes": (bytearray(b"1"), lambda held: held.clear()),
    "nested": (({"levels": [1.0]},), lambda held: held[0]["levels"].append(0.0)),
    "proxy": (MappingProxyType({"levels": [1.0]}), lambda held: held["levels"].clear()),
    "named": (Named([1.0]), lambda held: held.clear()),
    "ordered": (OrderedDict(level=1.0), lambda held: held.clear()),
    "loose": (Loose(), set_level),
    "kind": (Kind(), lambda held: held.levels.clear()),
    "lazy": (Lazy(lambda: [1.0]), lambda held: held.clear()),
    "refusing": (Refusing(a=(1.0,)), lambda held: None),
}
"""What truth and channels of a simulator share, and what changes it."""
COPIES: dict[str, Any] = {"proxy": lambda value: copy.deepcopy(dict(value)), "refusing": dict}


class Sharing(Thermostat):
    def _tick(self, events: Any) -> Any:
        tick = super()._tick(events)
        shared = {name: value for name, (value, _) in SHARED.items()}
        return replace(tick, truth={**tick.truth, **shared}, channels={**tick.channels, **shared})


@pytest.mark.parametrize("name", SHARED)
def test_what_a_component_does_to_its_percept_changes_neither_truth_nor_what_others_see(name):
    value, change = SHARED[name]
    is_lazy = isinstance(value, Lazy)
    before = [1.0] if is_lazy else COPIES.get(name, copy.deepcopy)(value)
    seen: list[Any] = []

    def vandal(view: Any) -> Proposal:
        change(view.percept[name])
        return Proposal(1.0)

    def look(view: Any) -> Assessment:
        seen.append(view.percept[name])
        change(view.percept[name])
        seen.extend(percept[name] for percept in view.percepts)
        return Assessment()

    episode = run_loop(vandal, simulator=Sharing(), safety_monitor=doing(SafetyMonitor, look))
    assert episode.failure is None
    assert not [event for event in episode.events if event.kind == "component_failure"]
    assert is_lazy or value == before
    assert len(seen) > 10
    assert all(held == before for held in seen)
    assert is_lazy or {*map(type, seen)} == {type(value)}


@pytest.mark.parametrize("shape", [(0, 3), (4,), (2, 3, 2), ()])
def test_sealing_keeps_an_array_and_seals_it_once(shape: tuple[int, ...]) -> None:
    array = np.arange(int(np.prod(shape)), dtype=np.float32).reshape(shape)
    found = sealed(array)
    assert (found.shape, found.dtype) == (array.shape, array.dtype)
    assert np.array_equal(found, array)
    assert make_writeable(found) == 0
    assert sealed(found) is found
    assert sealed(found[...]).base is not None


@pytest.mark.of_guest
@pytest.mark.parametrize("channel", ["lidar", "radar", "camera_front"])
def test_what_the_intersection_perceives_is_sealed(channel: str) -> None:
    from pytest_dura.driving import HighwaySimulator

    simulator = HighwaySimulator()
    tick = simulator.reset({"route": {"origin": "south", "turn": "left"}, "traffic": {}}, 3)
    value = tick.channels[channel]
    value = value.get() if isinstance(value, Lazy) else value
    assert make_writeable(getattr(value, "data", value)) == 0
