"""The loop's own signals: who was in control at each tick, and for how long."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from handmade import decided, handmade

from pytest_dura.core import LOOP_SIGNALS, switching
from pytest_dura.core.loop_signals import loop_signals


def found(sources: str, verdicts: str | None = None, *, dt: float = 0.5) -> dict[str, Any]:
    """One letter per decision: p, r or f."""
    episode = decided(sources, verdicts or "0" * len(sources), dt=dt)
    return {name.removeprefix("loop."): x.tolist() for name, x in loop_signals(episode).items()}


def test_each_tick_tells_who_was_in_control_and_the_last_one_repeats() -> None:
    signals = found("prfr", "0212")
    assert signals["recovering"] == [0, 1, 0, 1, 1]
    assert signals["fallback"] == [0, 0, 1, 0, 0]
    assert signals["unsafe"] == [0, 1, 0, 1, 1]


@pytest.mark.parametrize(
    "sources, seconds",
    [
        ("prrrp", [0, 0, 0.5, 1, 0, 0]),
        ("rrpp", [0, 0.5, 0, 0, 0]),
        ("prprr", [0, 0, 0, 0, 0.5, 1]),  # each takeover begins anew
        ("rpr", [0, 0, 0, 0.5]),
        ("ppp", [0, 0, 0, 0]),
        ("", [0]),
    ],
)
def test_recovery_counts_its_time_from_each_takeover(sources: str, seconds: list[float]) -> None:
    assert found(sources)["recovering_for"] == seconds


@pytest.mark.parametrize(
    "sources, seconds",
    [
        ("prrrp", [0, 0, 0.5, 1, 1.5, 1.5]),
        ("prprr", [0, 0, 0.5, 0.5, 1, 1.5]),  # takeovers add up
        ("rfp", [0, 0.5, 0.5, 0.5]),  # the simulator's fallback is no recovery
        ("ppp", [0, 0, 0, 0]),
        ("", [0]),
    ],
)
def test_the_time_in_which_recovery_was_in_control_adds_up(
    sources: str, seconds: list[float]
) -> None:
    assert found(sources)["recovered_time"] == seconds
    last = switching(decided(sources, "0" * len(sources), dt=0.5)).recovery_time
    assert seconds[-1] == last


def test_a_bound_on_the_time_in_control_holds_up_to_it_whatever_floats_round_to() -> None:
    spent = found("pr" * 40, dt=0.1)["recovered_time"]
    assert spent[60] == 3.0
    assert spent[-1] == 4.0


def test_the_time_since_the_takeover_does_not_depend_on_when_it_was() -> None:
    for before in range(60):
        lasted = found("p" * before + "r" * 101, dt=0.1)["recovering_for"]
        assert lasted[before + 100] == 10.0


def test_an_episode_that_ended_before_its_first_tick_has_signals_without_samples() -> None:
    decisions = {"verdict": np.array([], np.int8), "source": np.array([], np.str_)}
    empty = handmade(0, decisions=decisions, failure="infrastructure: x")
    assert {name: len(x) for name, x in loop_signals(empty).items()} == dict.fromkeys(
        LOOP_SIGNALS, 0
    )
