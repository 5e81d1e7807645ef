"""What roles can see, and what they cannot."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from dataclasses import FrozenInstanceError, fields
from typing import Any

import pytest
from loops import doing, run_loop

from pytest_dura import (
    Event,
    GeneratorView,
    Lazy,
    Percept,
    Proposal,
    Role,
    RoleView,
    SecurityAssessor,
    StateManager,
    Tick,
)
from pytest_dura.core import NOTHING, Alert, SecurityAssessment, shared
from pytest_dura.core.codec import encode
from pytest_dura.core.percepts import History


def state_with(*channels: dict[str, Any]) -> StateManager:
    state = StateManager(dt=0.1)
    for index, values in enumerate(channels):
        tick = Tick(index, index * 0.1, {"secret": 1.0}, values)
        state.update(tick, Percept(values, {"a": ("fault",)}))
    return state


def test_the_generators_view_has_no_ground_truth() -> None:
    names = {field.name for field in fields(GeneratorView)}
    assert names == {"index", "time", "dt", "percept", "feedback", "past", "transmit"}
    view = state_with({"a": 1.0}).generator_view()
    assert not hasattr(view, "truth")
    assert not hasattr(view, "__dict__")
    with pytest.raises(AttributeError):
        _ = view.truth  # type: ignore[attr-defined]


def test_no_view_tells_which_channels_were_tampered_with() -> None:
    state = state_with({"a": 1.0})
    assert state.percept.tampered == {"a": ("fault",)}
    for view in (state.generator_view(), state.role_view()):
        assert view.percept.tampered == {}
    assert not {"truth", "ticks"} & {field.name for field in fields(RoleView)}


def test_views_are_read_only() -> None:
    state = state_with({"a": 1.0})
    for view in (state.generator_view(), state.role_view()):
        with pytest.raises(FrozenInstanceError):
            view.index = 9  # type: ignore[misc]
        with pytest.raises(TypeError, match="item assignment"):
            view.percept["a"] = 2.0  # type: ignore[index]
        with pytest.raises(TypeError):
            del view.percept["a"]  # type: ignore[attr-defined]
    with pytest.raises(TypeError, match="item assignment"):
        state.role_view().outputs["mine"] = 1  # type: ignore[index]
    state.put("mine", 1)
    with pytest.raises(TypeError, match="item assignment"):
        state.role_view().history["mine"] = ()  # type: ignore[index]
    with pytest.raises(TypeError, match="item assignment"):
        state.role_view().history["mine"][0] = (0.0, 2)  # type: ignore[index]
    assert list(state.role_view().history["mine"]) == [(0.0, 1)]


def test_a_view_does_not_change_when_the_simulator_reuses_its_mapping() -> None:
    channels = {"a": 1.0}
    state = state_with(channels)
    view = state.role_view()
    channels["a"] = 2.0
    assert view.percept["a"] == 1.0


def test_history_grows_and_is_read_only() -> None:
    items = [1, 2]
    history = History(items)
    items.append(3)
    assert (len(history), history[-1], list(history), 2 in history) == (3, 3, [1, 2, 3], True)
    with pytest.raises(TypeError, match="item assignment"):
        history[0] = 9  # type: ignore[index]
    history[:].append(4)
    assert items == [1, 2, 3]
    assert not hasattr(history, "append")


def test_roles_see_the_percepts_of_earlier_ticks() -> None:
    view = state_with({"a": 1.0}, {"a": 2.0}).role_view()
    assert [percept["a"] for percept in view.percepts] == [1.0, 2.0]


def test_an_unknown_channel_is_told_with_the_known_ones() -> None:
    with pytest.raises(KeyError, match="no sensor channel 'lidr'; there are: gps, lidar"):
        Percept({"lidar": 1, "gps": 2})["lidr"]


def aliased(channels: dict[str, Any]) -> StateManager:
    state, tick = StateManager(dt=0.1), Tick(0, 0.0, {}, channels)
    state.update(tick, Percept(channels, {"lidar": ("ghost",)}, {"objects": "lidar"}))
    return state


@pytest.mark.parametrize(
    "read",
    [
        lambda percept, name: percept[name],
        lambda percept, name: percept.get(name),
        lambda percept, name: name in percept,
        lambda percept, name: shared(lambda seen: seen[name], percept),
    ],
    ids=["look-up", "get", "in", "shared"],
)
@pytest.mark.parametrize("channels", [{"lidar": ("car",)}, {"lidar": Lazy(lambda: ("car",))}, {}])
def test_both_names_of_a_channel_are_the_same_reading(read: Any, channels: Any) -> None:
    def outcome(percept: Percept, name: str) -> Any:
        try:
            return read(percept, name)
        except KeyError as error:
            return str(error).replace(name, "NAME")

    outcomes = []
    for name in ("lidar", "objects"):
        state = aliased(channels)
        seen = state.generator_view().percept, state.role_view().percept, state.percept
        own = [outcome(percept, name) for percept in seen]
        state.has_read("safety_monitor")
        outcomes.append((own, state.generator_reads, state.readers))
    assert outcomes[0] == outcomes[1]
    assert outcomes[0][1:] == ({"lidar"}, {"ghost": {"safety_monitor"}})


def test_a_second_name_leads_to_the_same_object_and_is_no_further_channel() -> None:
    state = aliased({"lidar": ("car",), "gps": 1.0})
    for percept in (state.generator_view().percept, state.role_view().percept, state.percept):
        assert percept["objects"] is percept["lidar"]
        assert list(percept) == ["lidar", "gps"]
        assert len(percept) == 2
        assert "object" not in percept
        with pytest.raises(TypeError, match="item assignment"):
            percept["objects"] = []


def test_reads_of_the_generator_are_remembered_per_tick() -> None:
    state = state_with({"a": 1.0, "b": 2.0})
    state.generator_view().percept["a"]
    state.role_view().percept["b"]
    assert state.generator_reads == {"a"}
    assert "c" not in state.generator_view().percept
    assert state.generator_reads == {"a", "c"}
    state.update(Tick(1, 0.1, {}, {}), Percept({"a": 1.0}))
    assert state.generator_reads == set()


def test_a_lazy_channel_is_made_once_and_only_when_it_is_read() -> None:
    made: list[int] = []
    state = state_with({"camera": Lazy(lambda: made.append(1) or "frame"), "gps": 1.0})
    view = state.generator_view()
    assert "camera" in view.percept
    assert list(view.percept) == ["camera", "gps"]
    assert repr(view.percept) == "PerceptView(camera, gps)"
    assert made == []
    assert view.percept["camera"] == "frame"
    assert state.role_view().percept["camera"] == "frame"
    assert state.percept["camera"] == "frame"
    assert made == [1]


def test_nothing_is_an_empty_mapping_that_can_be_pickled() -> None:
    assert NOTHING == {}
    assert list(NOTHING) == []
    assert pickle.loads(pickle.dumps(NOTHING)) is NOTHING
    assert copy.deepcopy(NOTHING) is NOTHING
    with pytest.raises(KeyError):
        NOTHING["x"]
    event = Event(1, 0.1, "alert", "V1")
    assert pickle.loads(pickle.dumps(event)) == event
    assert encode(event)["data"] == {}


def test_a_role_sees_all_alerts_that_were_raised_before() -> None:
    alert = Alert("leap", "V1")
    raised = {1: (alert,), 3: (alert, Alert("leap", "V2"))}
    assessor = doing(
        SecurityAssessor, lambda view: SecurityAssessment(alerts=raised.get(view.index, ()))
    )
    seen: list[Any] = []
    watch = doing(
        Role,
        lambda view: seen.append(list(view.alerts)),
        name="watch",
        after=("security_assessor",),
    )
    run_loop(lambda _: Proposal(0.0), security_assessor=assessor, watch=watch, seconds=0.5)
    times = [[(round(time, 6), one.subject) for time, one in found] for found in seen]
    first = [(0.1, "V1")]
    assert times == [[], first, first, [*first, (0.3, "V1"), (0.3, "V2")], times[3]]
    assert state_with({"a": 1.0}).role_view().alerts[:] == []


def test_roles_share_what_a_percept_comes_to_and_the_component_makes_its_own() -> None:
    made = []

    def speed(percept: Percept) -> float:
        made.append(percept)
        return float(percept["a"])

    state = state_with({"a": 1.0}, {"a": 2.0})
    assert [state.role_view().percept.once(speed) for _ in range(3)] == [2.0, 2.0, 2.0]
    assert len(made) == 1
    generator = state.generator_view().percept
    assert generator.once(speed) == 2.0
    assert len(made) == 2
    assert state.generator_reads == {"a"}  # the component has read it, whoever had before
    assert state.role_view().percepts[0].once(speed) == 1.0


def test_what_could_not_be_made_of_a_percept_is_not_kept() -> None:
    view = state_with({"a": 1.0}).role_view()
    for _ in range(2):
        with pytest.raises(KeyError, match="no sensor channel 'b'"):
            view.percept.once(_reads_b)


def _reads_b(percept: Percept) -> Any:
    return percept["b"]


def test_shared_takes_channels_that_are_no_percept_as_they_are() -> None:
    assert shared(_reads_b, {"b": 3}) == 3


def test_values_are_made_by_their_types_and_refuse_any_name() -> None:
    """With slots, a frozen class of Python's own fails otherwise for a name that is no field."""
    tick = Tick[dict[str, float]](0, 0.0, {"level": 1.0}, {})
    proposal = Proposal[float](1.0, "because")
    assert pickle.loads(pickle.dumps(tick)) == tick
    assert pickle.loads(pickle.dumps(proposal)) == proposal == copy.copy(proposal)
    for name in ("index", "other"):
        with pytest.raises(FrozenInstanceError, match=name):
            setattr(tick, name, 2)


CONTAINERS: dict[str, tuple[Any, Callable[[Any], Any]]] = {
    "list": ([1.0, 2.0], lambda value: value.append(3.0)),
    "list of lists": ([[1.0]], lambda value: value[0].append(3.0)),
    "dict": ({"x": 1.0}, lambda value: value.update(x=3.0)),
    "dict of lists": ({"x": [1.0]}, lambda value: value["x"].append(3.0)),
    "set": ({1.0}, lambda value: value.add(3.0)),
    "bytearray": (bytearray(b"a"), lambda value: value.append(3)),
    "tuple of lists": ((1.0, [1.0]), lambda value: value[1].append(3.0)),
}


@pytest.mark.parametrize("kind", CONTAINERS)
def test_who_changes_a_reading_changes_that_of_no_other_reader(kind: str) -> None:
    given, change = CONTAINERS[kind]
    given = copy.deepcopy(given)
    before, state = copy.deepcopy(given), state_with({"a": given})
    percepts = state.generator_view().percept, state.role_view().percept
    for percept in percepts:
        change(percept["a"])
        assert [each["a"] for each in percepts] == [before, before]
    change(given)  # the simulator's own
    assert [each["a"] for each in percepts] == [before, before]
