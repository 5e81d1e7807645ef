"""Several faults, histories and pictures: what the injector makes of them at one tick."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from injecting import Bench, Drawing, fault

from pytest_dura.core import ConfigurationError, Lazy


def add(name: str, amount: float = 0.0, factor: float = 1.0, **fields: Any) -> dict[str, Any]:
    return fault(name, at=0.2, parameters={"amount": amount, "factor": factor}, **fields)


def test_faults_of_one_target_act_in_declared_order() -> None:
    one, two = add("one", amount=1.0), add("two", factor=2.0)
    first, other = Bench(one, two).ticks(6), Bench(two, one).ticks(6)
    assert [seen["gauge"] for seen in first.seen] == [10, 10, 22, 22, 22, 10]
    assert [seen["gauge"] for seen in other.seen] == [10, 10, 21, 21, 21, 10]
    assert first.acted[2] == ("one", "two")
    assert other.acted[2] == ("two", "one")


def test_commands_compose_in_declared_order_too() -> None:
    one, two = add("one", amount=1.0, target="command"), add("two", factor=2.0, target="command")
    assert Bench(one, two).ticks(4).sent == [0.0, 0.0, 2.0, 2.0]
    assert Bench(two, one).ticks(4).sent == [0.0, 0.0, 1.0, 1.0]


def test_faults_that_cancel_each_other_change_nothing() -> None:
    for target in ("gauge", "command"):
        bench = Bench(add("up", 1.0, target=target), add("down", -1.0, target=target)).ticks(6)
        assert bench.activated == [(2, "up"), (2, "down")]
        assert bench.acted == [()] * 6
        assert all(seen["gauge"] == 10.0 for seen in bench.seen)
        assert set(bench.sent) == {0.0}
    three = Bench(add("up", 1.0), add("down", -1.0), add("more", 5.0)).ticks(3)
    assert three.acted[2] == ("up", "down", "more")


def test_a_fault_of_no_effect_leaves_the_very_objects() -> None:
    raw = {"gauge": 10.0, "list": [1.0]}
    bench = Bench(add("idle"), channels=lambda _: raw).ticks(6)
    assert all(seen is raw for seen in bench.seen)
    assert bench.acted == [()] * 6
    assert bench.activated == [(2, "idle")]


def test_only_the_channel_that_was_changed_is_another_one() -> None:
    raw = {"gauge": {"value": 1.0}, "list": [1.0]}
    bench = Bench(add("f", 1.0, target="gauge.value"), channels=lambda _: raw).ticks(3)
    assert bench.seen[2]["list"] is raw["list"]
    assert raw["gauge"] == {"value": 1.0}
    assert bench.seen[2]["gauge"] == {"value": 2.0}


def test_two_faults_of_one_kind_draw_different_numbers() -> None:
    Drawing.noted.clear()
    planned = {"type": "injecting:Drawing", "at": 0.0, "duration": None}
    Bench(fault("one", **planned), fault("two", **planned, target="clock.ticks")).ticks(20)
    drawn = [number for _, _, number in Drawing.noted]
    # Each draws once when it begins and once at each tick, always anew.
    assert len(drawn) == len(set(drawn)) == 42


def test_a_row_that_is_not_there_is_left_alone() -> None:
    def rows(index: int) -> dict[str, Any]:
        return {"rows": np.ones((2 if index in (3, 5) else 1, 2))}

    bench = Bench(add("f", 1.0, target="rows.1.0", duration=None), channels=rows).ticks(8)
    assert bench.when() == [3, 5]
    assert bench.seen[3]["rows"].tolist() == [[1.0, 1.0], [2.0, 1.0]]


def test_the_history_is_what_stood_there_before_the_fault() -> None:
    def rising(index: int) -> dict[str, Any]:
        return {"gauge": float(index)}

    recall = fault("r", type="injecting:Recall", at=1.0, duration=0.4)
    bench = Bench(recall, channels=rising).ticks(20)
    assert [seen["gauge"] for seen in bench.seen[9:15]] == [9, 5, 6, 7, 8, 14]
    early = fault("r", type="injecting:Recall", at=0.2, duration=0.4)
    assert [s["gauge"] for s in Bench(early, channels=rising).ticks(6).seen] == [0, 1, 0, 0, 0, 0]


def test_a_fault_before_it_in_order_is_in_the_history_and_one_behind_it_is_not() -> None:
    recall = fault("r", type="injecting:Recall", at=1.0, duration=0.1)
    shift = fault("s", at=0.5, duration=0.1, parameters={"amount": 7.0})
    assert Bench(shift, recall).ticks(11).seen[10]["gauge"] == 17.0
    assert Bench(recall, shift).ticks(11).seen[10]["gauge"] == 10.0


def test_a_history_of_a_command() -> None:
    recall = fault("r", type="injecting:Recall", target="command", at=1.0, duration=0.2)
    bench = Bench(recall)
    for index in range(14):
        bench.tick(action=float(index))
    assert bench.sent[9:13] == [9.0, 5.0, 6.0, 12.0]


def test_a_lazy_picture_stays_lazy_while_nobody_needs_it() -> None:
    made: list[int] = []

    def channels(index: int) -> dict[str, Any]:
        def make() -> Any:
            made.append(index)
            return np.full((2, 2, 3), index, dtype=np.uint8)

        return {"gauge": 10.0, "camera": Lazy(make)}

    bright = fault("b", type="brightness", target="camera", at=0.2, duration=0.2)
    bench = Bench(bright, add("f", 1.0), channels=channels).ticks(6)
    assert bench.when("b") == [2, 3]
    assert made == [2], "one is looked at where the fault begins, lest its reader be blamed"
    assert isinstance(bench.seen[3]["camera"], Lazy)
    assert (bench.seen[3]["camera"].get() > 3).all()
    assert made == [2, 3]


def test_a_lazy_picture_that_is_recalled_is_one_of_then() -> None:
    world = {"now": 0}

    def channels(index: int) -> dict[str, Any]:
        world["now"] = index
        return {"camera": Lazy(lambda: np.array([world["now"]]))}

    recall = fault("r", type="injecting:Recall", target="camera", at=1.0, duration=0.3)
    bench = Bench(recall, channels=channels).ticks(13)
    world["now"] = 99
    assert [np.asarray(seen["camera"]).tolist() for seen in bench.seen[10:13]] == [[5], [6], [7]]


def test_draws_at_a_tick_are_the_fault_s_own_and_new_at_each() -> None:
    noisy = {"parameters": {"amount": 0.0, "sigma": 1.0}, "duration": None}
    one = fault("one", at=0.3, **noisy)
    alone = Bench(one).ticks(9)
    drawn = [seen["gauge"] for seen in alone.seen[3:]]
    assert len(set(drawn)) == len(drawn)
    late = Bench(fault("one", at=0.6, **noisy)).ticks(9)
    assert [seen["gauge"] for seen in late.seen[6:]] == drawn[3:], "when it began shifts nothing"
    other = Bench(fault("other", at=0.0, **noisy, target="clock.ticks"), one).ticks(9)
    assert [seen["gauge"] for seen in other.seen[3:]] == drawn
    assert Bench(one, seed=4).ticks(9).seen[3]["gauge"] != drawn[0]


@pytest.mark.parametrize(
    "change, place, told",
    [
        ({"target": "gage"}, "target", "there is no channel 'gage'"),
        ({"target": "clock.tick"}, "target", "there is no 'tick'"),
        ({"when": "gage.x > 1"}, "activation.when", "there is no channel 'gage'"),
        ({"when": "time > 9 and clock.x > 1"}, "activation.when", "there is no 'x'"),
        ({"at": 1.0, "duration": {"until": "clock.x > 1"}}, "duration.until", "there is no 'x'"),
    ],
)
def test_what_no_domain_knows_beforehand_shows_at_the_first_tick(
    change: dict[str, Any], place: str, told: str
) -> None:
    data = {"at": 99.0, **change}
    if "when" in change:
        del data["at"]
    with pytest.raises(ConfigurationError, match=told) as caught:
        Bench(fault("f", **data)).tick()
    assert caught.value.key == place
    assert "the fault 'f' cannot be used" in caught.value.problem
    assert caught.value.remedy


def test_a_row_that_is_not_there_at_the_first_tick_is_no_mistake() -> None:
    def rows(index: int) -> dict[str, Any]:
        return {"rows": np.ones((index, 2))}

    planned = fault("f", target="rows.3.0", when="rows.2.1 > 0", duration=None)
    assert Bench(planned, channels=rows).ticks(7).when() == [4, 5, 6]
