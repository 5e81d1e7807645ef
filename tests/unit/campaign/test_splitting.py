"""Multilevel splitting beside plain runs and beside an exact rate."""

from __future__ import annotations

import numpy as np
import pytest

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.simulator import Simulator
from pytest_dura.core.state import Tick
from pytest_dura.requirements.rate_tests import upper_bound
from pytest_dura.search import Splitting

STEPS = 30


class Walk(Simulator):
    """Goes up or down by one with each action."""

    def reset(self, scenario, seed):
        self._place, self._index = 0.0, 0
        return self._tick()

    def step(self, action):
        self._place += action
        self._index += 1
        return self._tick()

    def _tick(self):
        return Tick(self._index, self._index * 0.1, {}, {"place": self._place}, {})

    def signals(self, ticks):
        return {"place": np.array([tick.channels["place"] for tick in ticks])}

    def check_action(self, action):
        return action

    def fallback_action(self):
        return 0.0

    def snapshot(self):
        return self._place, self._index

    def restore(self, snapshot):
        self._place, self._index = snapshot


class Forgetful(Walk):
    def snapshot(self):
        raise NotImplementedError


def up_or_down(tick, rng):
    return 1.0 if rng.random() < 0.5 else -1.0


def to_go(height):
    return lambda tick: height - tick.channels["place"]


def exact_rate(height):
    """Probability that the walk reaches a height within its steps, by its distribution."""
    places = {0: 1.0}
    there = 0.0
    for _ in range(STEPS):
        after: dict[int, float] = {}
        for place, weight in places.items():
            for new in (place - 1, place + 1):
                if new >= height:
                    there += weight / 2
                else:
                    after[new] = after.get(new, 0.0) + weight / 2
        places = after
    return there


def split(height, **given):
    return Splitting(Walk(), {}, up_or_down, to_go(height), STEPS, **given)


@pytest.mark.parametrize("levels", [None, [9.0, 5.0], []])
def test_the_interval_holds_the_exact_rate_whatever_the_levels(levels) -> None:
    height = 8
    rate = split(height, runs=150, seed=3).estimate(12, levels)
    assert rate.low <= exact_rate(height) <= rate.high
    assert len(rate.repetitions) == 12
    assert rate.levels[-1] == 0.0


def test_a_rare_rate_takes_far_fewer_ticks_than_plain_runs_would() -> None:
    height = 26
    exact = exact_rate(height)
    assert exact < 2e-6
    rate = split(height, runs=200, seed=1).estimate(10)
    assert rate.low <= exact <= rate.high
    assert rate.low > 0.0
    # As many ticks of plain runs would show the event so often.
    assert rate.ticks / STEPS * exact < 0.1
    assert min(rate.shares) > 0.05


def test_the_same_seed_gives_the_same_estimate() -> None:
    first, second = (split(8, runs=20, seed=5).estimate(3) for _ in range(2))
    assert first == second
    assert first != split(8, runs=20, seed=6).estimate(3)


def test_an_event_at_the_begin_has_the_rate_one_and_one_out_of_reach_none() -> None:
    assert split(0, runs=5).estimate(2).rate == 1.0
    never = split(STEPS + 1, runs=20).estimate(2)
    assert (never.rate, never.low) == (0.0, 0.0)
    # What was never seen may be all the same.
    assert never.high >= upper_bound(0, 40, 0.975)


def test_a_simulator_without_snapshots_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="Forgetful has no snapshots"):
        Splitting(Forgetful(), {}, up_or_down, to_go(3), STEPS)


@pytest.mark.parametrize("levels", [[1.0, 2.0], [3.0, 3.0], [0.0], [-1.0]])
def test_levels_that_do_not_fall_are_refused(levels) -> None:
    with pytest.raises(ConfigurationError, match="levels are margins that fall"):
        split(8).estimate(2, levels)


def test_one_repetition_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="no spread"):
        split(8).estimate(1)


def test_shares_are_products_of_the_rate() -> None:
    rate = split(8, runs=50, seed=2).estimate(2, [4.0])
    assert len(rate.shares) == 2
    assert np.isclose(np.mean(rate.repetitions), rate.rate)
