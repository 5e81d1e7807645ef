"""Faults do not shift each other, and the injector's early exit skips nothing that is due."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from injecting import Bench, Drawing, fault
from roads import run, spec_of_drive

from pytest_dura import Episode
from pytest_dura.core import Fault, RoleSpec
from pytest_dura.driving import Aggressive
from pytest_dura.faults import CampaignInjector
from pytest_dura.faults.activation import NOW

TICKS = 60
NAMES = ("a", "b", "c", "d", "e")
TARGETS = ("gauge", "clock.ticks", "rows.1.0", "command")

times = st.integers(0, 70).map(lambda tick: tick / 10) | st.floats(0.0, 7.0)
spans = st.integers(1, 30).map(lambda tick: tick / 10) | st.floats(0.01, 3.0)
conditions = st.builds(
    "{} {} {:.3f}".format,
    st.sampled_from(["gauge.level", "clock.ticks", "rows.1.0", "rows.count", "time"]),
    st.sampled_from([">", "<", ">=", "<="]),
    st.floats(-1.0, 8.0),
)
windows = st.fixed_dictionaries({}, optional={"not_before": times}) | st.builds(
    lambda first, length: {"not_before": first, "not_after": first + length}, times, spans
)
numbers = st.fixed_dictionaries({}, optional={"times": st.integers(1, 4)})


def joined(*parts: st.SearchStrategy[dict[str, Any]]) -> st.SearchStrategy[dict[str, Any]]:
    return st.tuples(*parts).map(lambda found: {k: v for one in found for k, v in one.items()})


def activations(others: Sequence[str]) -> st.SearchStrategy[dict[str, Any]]:
    planned = [
        times.map(lambda at: {"at": at}),
        joined(st.fixed_dictionaries({"at": times, "every": spans}), numbers),
        joined(conditions.map(lambda text: {"when": text}), windows, numbers),
        joined(st.floats(0, 1).map(lambda p: {"probability": p}), windows, numbers),
        joined(st.floats(0.01, 20).map(lambda rate: {"rate": rate}), windows, numbers),
        st.just({"by": "security_assessor"}),
    ]
    if others:
        events = st.sampled_from(["activated", "manifested", "deactivated"])
        after = st.fixed_dictionaries(
            {"fault": st.sampled_from(others), "event": events}, optional={"delay": times}
        )
        planned += [joined(after.map(lambda one: {"after": one}), numbers)] * 3
    return st.one_of(planned)


durations = st.one_of(
    st.just("once"),
    st.none(),
    spans,
    st.tuples(spans, spans).map(lambda two: {"min": min(two), "max": max(two)}),
    conditions.map(lambda text: {"until": text}),
    st.builds(lambda text, most: {"until": text, "at_most": most}, conditions, spans),
    st.fixed_dictionaries({"on": spans, "off": spans}, optional={"lasting": spans}),
)
types = st.sampled_from(["injecting:Drawing", "injecting:Drawing", "injecting:Recall"])


@st.composite
def plans(draw: st.DrawFn) -> list[Fault]:
    """Some faults, of which later ones may follow earlier ones."""
    planned: list[Fault] = []
    for name in NAMES[: draw(st.integers(2, 5))]:
        # Whether a recalled value differs rests on the faults before it: manifestation is theirs.
        followed = [one.id for one in planned if one.type != "injecting:Recall"]
        parts = {"type": draw(types), "target": draw(st.sampled_from(TARGETS))}
        activation = draw(activations(followed))
        planned.append(fault(name, **parts, duration=draw(durations), **activation))
    return planned


directives = st.dictionaries(st.integers(0, TICKS - 1), st.sampled_from(NAMES), max_size=8)


def world(index: int) -> dict[str, Any]:
    """Channels that move, with rows that come and go."""
    level = 4.0 + 4.0 * float(np.sin(index / 5.0))
    rows = np.full((index // 7 % 3, 2), level)
    return {"gauge": Level(level), "clock": {"ticks": index % 9}, "rows": rows}


class Level(float):
    """A number that has a field, so that a condition can read it."""

    _fields = ("level",)

    @property
    def level(self) -> float:
        """The number itself."""
        return float(self)


class Sleepless(CampaignInjector):
    """Looks at every fault at every tick."""

    def _next(self) -> float:
        for life in self._lives.values():
            life.wake = NOW
        return NOW


def ran(
    faults: Sequence[Fault],
    directed: dict[int, str],
    seed: int,
    injector: type[CampaignInjector] = CampaignInjector,
) -> tuple[Bench, list[tuple[str, int, float]]]:
    """A run of all ticks, and what was drawn in it."""
    Drawing.noted.clear()
    names = {one.id for one in faults}
    bench = Bench(*faults, channels=world, seed=seed, injector=injector)
    for tick in range(TICKS):
        name = directed.get(tick)
        bench.tick(*([name] if name in names else []), action=float(tick % 5))
    return bench, list(Drawing.noted)


def of(found: Sequence[tuple[Any, ...]], names: set[str], place: int) -> list[tuple[Any, ...]]:
    return sorted(one for one in found if one[place] in names)


@given(plans(), directives, st.integers(0, 2**32), st.integers(0, 4))
@settings(derandomize=True, deadline=None, max_examples=60)
def test_without_one_fault_the_others_begin_draw_and_end_the_same(
    faults: list[Fault], directed: dict[int, str], seed: int, which: int
) -> None:
    left_out = faults[which % len(faults)].id
    followed = {one.activation["after"]["fault"] for one in faults if one.activation["after"]}
    assume(left_out not in followed)
    fewer = [one for one in faults if one.id != left_out]
    names = {one.id for one in fewer}
    (many, drawn), (few, drawn_then) = ran(faults, directed, seed), ran(fewer, directed, seed)
    assert of(many.activated, names, 1) == of(few.activated, names, 1)
    assert of(many.ended, names, 1) == of(few.ended, names, 1)
    assert of(drawn, names, 0) == of(drawn_then, names, 0)


@given(plans(), directives, st.integers(0, 2**32))
@settings(derandomize=True, deadline=None, max_examples=30)
def test_their_order_changes_no_draw(
    faults: list[Fault], directed: dict[int, str], seed: int
) -> None:
    (one, drawn), (other, drawn_then) = (
        ran(faults, directed, seed),
        ran(faults[::-1], directed, seed),
    )
    assert sorted(one.activated) == sorted(other.activated)
    assert sorted(one.ended) == sorted(other.ended)
    assert sorted(drawn) == sorted(drawn_then)


@given(plans(), directives, st.integers(0, 2**32))
@settings(derandomize=True, deadline=None, max_examples=70)
def test_the_early_exit_skips_nothing_that_is_due(
    faults: list[Fault], directed: dict[int, str], seed: int
) -> None:
    quick, drawn = ran(faults, directed, seed)
    slow, drawn_then = ran(faults, directed, seed, Sleepless)
    assert quick.activated == slow.activated
    assert quick.ended == slow.ended
    assert quick.acted == slow.acted
    assert drawn == drawn_then
    assert quick.sent == slow.sent
    for one, other in zip(quick.seen, slow.seen, strict=True):
        assert one["gauge"] == other["gauge"]
        assert one["clock"] == other["clock"]
        assert one["rows"].tobytes() == other["rows"].tobytes()


WORLD: dict[str, Any] = {
    "ego": {"distance": 50.0, "speed": 8.0},
    "traffic": {"headway": 8.0},
    "vehicles": [{"id": "E", "arm": "east", "distance": 70.0}],
}
NOISE = {
    "type": "noise",
    "id": "noise",
    "target": "odometry.speed",
    "activation": {"probability": 0.2},
    "duration": {"min": 0.2, "max": 1.0},
}
GHOST = {
    "type": "ghost-obstacle",
    "target": "lidar",
    "activation": {"at": 1.5},
    "duration": 2.0,
}
ADDED: list[dict[str, Any]] = [
    {"type": "bias", "target": "localisation.x", "activation": {"at": 2.2}},
    {"type": "loss-of-effectiveness", "target": "command.acceleration", "activation": {"at": 1.1}},
    {"type": "freeze", "target": "lidar", "activation": {"when": "odometry.speed < 7.5"}},
    {"type": "object-miss", "target": "lidar", "activation": {"rate": 0.4}, "duration": 1.0},
    {"type": "delay", "target": "radar", "activation": {"at": 2.0}, "duration": 1.0},
]


class Watchful(Aggressive):
    """Reads all that is cheap, and drives the same whatever it is shown."""

    def propose(self, view: Any) -> Any:
        """Read, and ignore."""
        for name in view.percept:
            if not name.startswith("camera"):
                _ = view.percept[name]
        return super().propose(view)


def driven(*faults: dict[str, Any], seed: int, **options: Any) -> Episode:
    found = run(spec_of_drive(WORLD, faults=faults, seed=seed, duration=6.0, **options))
    assert found.failure is None
    return found


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("added", ADDED, ids=lambda one: one["type"])
def test_until_a_fault_begins_the_truth_is_the_same_bit_by_bit(
    added: dict[str, Any], seed: int
) -> None:
    options: dict[str, Any] = {"generator": "reactive", "policy": "recover", "seed": seed}
    without, with_it = driven(NOISE, GHOST, **options), driven(NOISE, GHOST, added, **options)
    record = next(one for one in with_it.faults if one.id == added["type"])
    begun = with_it.ticks if record.activated_at is None else round(record.activated_at * 10)
    assert begun > 1
    for name, column in without.signals.items():
        # What begins at a tick is in its percept, and in the truth of the next one.
        last = begun if name.startswith("percept.") else begun + 1
        assert column[:last].tobytes() == with_it.signals[name][:last].tobytes()
    for before, after in zip(without.faults, with_it.faults, strict=False):
        if before.activated_at is not None and before.activated_at < begun / 10 - 1e-9:
            assert before.activated_at == after.activated_at


@pytest.mark.parametrize("added", [ADDED[0], ADDED[4]], ids=lambda one: one["type"])
def test_a_fault_on_another_channel_leaves_the_first_ones_whole_course_as_it_is(
    added: dict[str, Any],
) -> None:
    options = {"generator": RoleSpec("test_fault_independence:Watchful"), "seed": 3}
    without, with_it = driven(NOISE, GHOST, **options), driven(NOISE, GHOST, added, **options)
    assert without.faults[0].activations > 3

    def course(found: Episode) -> list[tuple[int, str, str]]:
        first = [(e.tick, e.kind, e.subject) for e in found.events if e.kind.startswith("fault")]
        return [one for one in first if one[2] != added["type"]]

    assert course(without) == course(with_it)
    for name in without.signals:
        if not name.startswith("percept.") or name == "percept.speed":
            assert without.signals[name].tobytes() == with_it.signals[name].tobytes()
