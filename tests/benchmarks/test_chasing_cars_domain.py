"""The chasing cars in the loop: the same margins as the fast model, and a space to search."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from pytest_dura import ConfigurationError, Runner
from pytest_dura.campaign import Limits
from pytest_dura.library import case_with_faults, load_library
from pytest_dura.requirements import parse, robustness
from pytest_dura.search import Group, Objective, SearchSpace
from pytest_dura.search.falsify import falsify

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def cars(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    import falsification.chasing_cars

    yield falsification.chasing_cars
    for name in [name for name in sys.modules if name.partition(".")[0] == "falsification"]:
        del sys.modules[name]


@pytest.fixture
def library(cars):
    return load_library([BENCHMARKS / "falsification" / "scenarios"], builtin=False)


@pytest.fixture
def bench(library):
    return Runner(lambda: library)


@pytest.fixture
def space(library):
    return SearchSpace.of(case_with_faults(library.scenarios["chasing_cars"], "none"))


def test_its_inputs_over_time_are_what_is_searched(space) -> None:
    assert space.layout.groups == (Group("world.throttle", 20), Group("world.brake", 20))


def test_the_requirements_are_those_of_the_fast_model(cars, library) -> None:
    checks = {name: one.check for name, one in library.requirements.items()}
    assert checks == cars.FORMULAS


@pytest.mark.parametrize("seed", [0, 1])
def test_the_margins_in_the_loop_are_those_of_the_fast_model(cars, space, bench, seed) -> None:
    values = space.values(np.random.default_rng(seed).random(space.layout.size))
    episode = bench.episode(space.case_with(values, 1))
    point = np.array(values["world.throttle"] + values["world.brake"])
    signals = cars.simulate(point[None], step=0.1)
    assert episode.ticks == 1001
    for name, column in signals.items():
        assert np.allclose(episode.signals[name], column[0], rtol=0, atol=1e-8), name
    for formula in cars.FORMULAS.values():
        columns = {name: column[0] for name, column in signals.items()}
        expected = robustness(parse(formula), columns, 0.1)[0]
        assert episode.robustness(formula) == pytest.approx(expected, abs=1e-8)


def test_the_first_car_moves_as_in_the_fast_model_whatever_its_brake(cars, bench, space) -> None:
    brake = np.array([0.0, 0.0005, 0.001, 0.002, 0.5] * 4)
    throttle = np.linspace(0.0, 1.0, 20)
    case = space.case_with({"world.throttle": throttle.tolist(), "world.brake": brake.tolist()}, 1)
    episode = bench.episode(case)
    found = sum(episode.signals[name] for name in ("d21", "d32", "d43", "d54"))
    last = cars.simulate(np.concatenate([throttle, brake])[None], step=0.1)
    assert np.allclose(found, sum(column[0] for column in last.values()), rtol=0, atol=1e-8)


def test_a_search_in_the_loop_finds_and_confirms_a_violation(library, bench) -> None:
    case = case_with_faults(library.scenarios["chasing_cars"], "none")
    asked = [Objective(library.requirements["CC3"])]
    found = falsify(bench, case, asked, limits=Limits(budget=40, baselines=False), seed=0)
    (outcome,) = found.outcomes
    assert outcome.status == "falsified"
    assert outcome.counterexample.repeats.confirmed
    assert outcome.counterexample.margin < 0


@pytest.mark.parametrize(
    "world, key",
    [
        ({"speed": 1.0}, "world.speed"),
        ({"throttle": [0.5] * 19}, "world.throttle"),
        ({"brake": [1.5] * 20}, "world.brake"),
    ],
)
def test_an_input_that_cannot_be_is_refused(cars, world, key) -> None:
    from falsification.chasing_cars_domain import ChasingCars

    with pytest.raises(ConfigurationError, match=key):
        ChasingCars.check_scenario(world)
