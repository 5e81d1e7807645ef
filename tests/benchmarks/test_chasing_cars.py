"""The chasing cars of benchmarks/falsification: the model against one that takes every step."""

from __future__ import annotations

import itertools
import math
import sys
from pathlib import Path

import numpy as np
import pytest

from pytest_dura.requirements import parse, robustness

PIECES = 20


@pytest.fixture
def cars(monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "benchmarks"))
    import falsification.chasing_cars

    yield falsification.chasing_cars
    for name in [name for name in sys.modules if name.partition(".")[0] == "falsification"]:
        del sys.modules[name]


def stepwise(point: np.ndarray, samples: int) -> np.ndarray:
    """Distances, shape ``(4, samples)``: all cars together, step by step."""
    place, speed, mode = [10.0 * i for i in range(5)], [0.0] * 5, ["keep"] * 5
    seen = []
    for sample in range(samples):
        seen.append([after - before for before, after in itertools.pairwise(place)])
        piece = sample // 500
        push, pull = point[piece], point[PIECES + piece]
        for _ in range(5):
            # Small steps of the second order.
            middle = speed[0] + 0.001 * (-push - pull * speed[0])
            place[0] += 0.002 * middle
            speed[0] += 0.002 * (-push - pull * middle)
        for i in range(1, 5):
            if mode[i] == "keep":
                place[i] += 0.01 * speed[i]
            elif mode[i] == "chase":
                place[i] -= 0.01 * speed[i] + 0.00005
                speed[i] += 0.01
            else:
                place[i] -= speed[i] * (1 - math.exp(-0.01))
                speed[i] *= math.exp(-0.01)
        for i in range(1, 5):
            gap = place[i] - place[i - 1]
            if mode[i] == "keep":
                mode[i] = "chase" if gap >= 15 else "brake" if gap <= 5 else "keep"
            elif mode[i] == "chase":
                mode[i] = "keep" if gap <= 10 else "chase"
            else:
                mode[i] = "chase" if gap >= 20 else "brake"
    return np.array(seen).T


def test_full_throttle_ends_where_it_must(cars) -> None:
    place = cars.leader(np.ones(PIECES), np.zeros(PIECES))
    assert place[-1] == -5000.0
    assert np.allclose(place, -((np.arange(10_001) * 0.01) ** 2) / 2)


def test_the_brake_ends_at_the_speed_that_balances_the_throttle(cars) -> None:
    place = cars.leader(np.full(PIECES, 0.5), np.full(PIECES, 0.25))
    assert (place[-1] - place[-2]) / 0.01 == pytest.approx(-2.0, abs=1e-9)


@pytest.mark.parametrize("pull", [0.0, 1e-7, 0.0199, 0.0201])
def test_weak_brakes_lose_no_digits(cars, pull) -> None:
    place = cars.leader(np.ones(PIECES), np.full(PIECES, pull))
    # Taylor's series of the solution for a weak brake, over the first piece.
    time = 5.0
    expected = -sum((-pull) ** k * time ** (k + 2) / math.factorial(k + 2) for k in range(12))
    assert place[500] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_the_cars_are_where_every_small_step_takes_them(cars, seed) -> None:
    point = np.random.default_rng(seed).random(2 * PIECES)
    expected = stepwise(point, 1500)
    found = cars.simulate(point[None])
    for number, name in enumerate(["d21", "d32", "d43", "d54"]):
        assert np.allclose(found[name][0][:1500], expected[number], atol=2e-3), name
    assert np.ptp(expected[0]) > 1


def test_followers_do_nothing_before_a_gap_says_so(cars) -> None:
    found = cars.simulate(np.zeros((1, 2 * PIECES)))
    assert all(np.all(column == 10.0) for column in found.values())


@pytest.mark.parametrize("name", ["CC1", "CC2", "CC3", "CC4", "CC5", "CCx"])
def test_the_objective_is_the_robustness_of_our_own_evaluation(cars, name) -> None:
    points = np.random.default_rng(5).random((2, 2 * PIECES))
    signals = cars.simulate(points)
    one_by_one = [
        robustness(
            parse(cars.FORMULAS[name]), {key: column[i] for key, column in signals.items()}, 0.01
        )
        for i in range(2)
    ]
    found = cars.CHASING_CARS.objective(name)(points)
    assert found.tolist() == [one[0] for one in one_by_one]


def test_the_first_specification_is_what_numpy_says_of_it(cars) -> None:
    points = np.random.default_rng(6).random((5, 2 * PIECES))
    expected = 40.0 - cars.simulate(points)["d54"].max(axis=1)
    assert np.allclose(cars.CHASING_CARS.objective("CC1")(points), expected)
