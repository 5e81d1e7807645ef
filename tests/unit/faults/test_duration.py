"""Duration: at which ticks a fault acts once it has begun."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from injecting import Bench, fault

from pytest_dura.core import stream


def runs(ticks: Sequence[int]) -> list[int]:
    """Lengths of the stretches of consecutive ticks."""
    return [len(part) for part in np.split(ticks, np.flatnonzero(np.diff(ticks) > 1) + 1)]


@pytest.mark.parametrize(
    "duration, ticks",
    [
        ("once", 1),
        (0.1, 1),
        (0.04, 1),  # less than a tick is one
        (0.3, 3),
        (0.7, 7),
        (0.35, 4),
        ({"min": 0.5, "max": 0.5}, 5),
        (None, 25),
        (99.0, 25),
    ],
)
def test_it_acts_for_its_duration(duration: Any, ticks: int) -> None:
    bench = Bench(fault(at=0.5, duration=duration)).ticks(30)
    assert bench.when() == list(range(5, 5 + ticks))
    assert bench.ended == ([(5 + ticks, "f")] if 5 + ticks < 30 else [])


def test_a_sampled_duration_is_drawn_anew_for_each_activation() -> None:
    planned = fault(at=0.0, every=2.0, duration={"min": 0.3, "max": 1.5})
    lengths = runs(Bench(planned).ticks(200).when())
    drawn = [float(stream(3, f"fault:duration:{count}:f").uniform(0.3, 1.5)) for count in range(10)]
    assert lengths == [int(np.ceil(one / 0.1 - 1e-9)) for one in drawn]
    assert len(set(lengths)) > 3
    assert all(3 <= one <= 15 for one in lengths)


def test_it_lasts_until_a_condition_holds_without_any_fault() -> None:
    def channels(index: int) -> dict[str, Any]:
        return {"gauge": 10.0, "clock": {"ticks": index}}

    planned = fault(at=0.5, duration={"until": "clock.ticks >= 9"})
    bench = Bench(planned, channels=channels).ticks(20)
    assert bench.when() == [5, 6, 7, 8]
    assert bench.ended == [(9, "f")]
    hidden = fault("other", at=0.0, target="clock.ticks", duration=None, parameters={"amount": 99})
    assert Bench(hidden, planned, channels=channels).ticks(20).when() == [5, 6, 7, 8]


def test_until_a_condition_holds_or_its_time_is_up() -> None:
    planned = fault(at=0.5, duration={"until": "clock.ticks >= 9", "at_most": 0.2})
    assert Bench(planned).ticks(20).when() == [5, 6]


def test_until_a_condition_that_holds_already_is_one_tick() -> None:
    assert Bench(fault(at=0.5, duration={"until": "time >= 0"})).ticks(20).when() == [5]


@pytest.mark.parametrize(
    "duration, acts",
    [
        ({"on": 0.2, "off": 0.3}, [5, 6, 10, 11, 15, 16, 20, 21, 25, 26]),
        ({"on": 0.2, "off": 0.3, "lasting": 1.1}, [5, 6, 10, 11, 15]),
        ({"on": 0.1, "off": 0.1, "lasting": 0.6}, [5, 7, 9]),
        ({"on": 0.3, "off": 5.0}, [5, 6, 7]),
        ({"on": 0.7, "off": 0.1, "lasting": 1.0}, [5, 6, 7, 8, 9, 10, 11, 13, 14]),
    ],
)
def test_an_intermittent_fault_acts_by_turns(duration: dict[str, float], acts: list[int]) -> None:
    bench = Bench(fault(at=0.5, duration=duration)).ticks(30)
    assert bench.when() == acts
    assert bench.activated == [(5, "f")], "its turns are one activation"
    lasting = duration.get("lasting")
    assert bench.ended == ([] if lasting is None else [(5 + round(lasting * 10), "f")])


@pytest.mark.parametrize("on, off", [(0.2, 0.3), (0.7, 0.3), (0.1, 0.9), (0.4, 0.4)])
def test_in_whole_ticks_the_share_of_the_turns_is_the_duty_cycle(on: float, off: float) -> None:
    bench = Bench(fault(at=0.0, duration={"on": on, "off": off})).ticks(5000)
    assert len(bench.when()) / 5000 == pytest.approx(on / (on + off), abs=0.001)


def test_what_it_remembers_ends_with_it() -> None:
    def rising(index: int) -> dict[str, Any]:
        return {"gauge": float(index)}

    again = fault(type="freeze", at=0.5, every=1.0)
    bench = Bench(again, channels=rising).ticks(20)
    assert [one["gauge"] for one in bench.seen[5:8]] == [5.0] * 3
    assert [one["gauge"] for one in bench.seen[15:18]] == [15.0] * 3
