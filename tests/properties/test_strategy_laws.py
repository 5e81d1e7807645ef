"""Laws of the strategies: what they draw can be run, and what fails shrinks in the stated order.

The failures are planted by predicates on the case, so that nothing is simulated.
"""

from __future__ import annotations

from collections.abc import Callable
from random import Random
from typing import Any

import pytest
from hypothesis import HealthCheck, Phase, find, given, settings

from pytest_dura import strategies
from pytest_dura.core import Fault
from pytest_dura.faults import parse_fault
from pytest_dura.library import SearchedCase, current_library

pytestmark = pytest.mark.of_guest

NAME = "intersection/congested"
law = settings(derandomize=True, deadline=None, max_examples=40)
NAMED = ["delay", "gnss-jump", "object-miss"]


def shrunk(predicate: Callable[[Any], bool], strategy: Any, seed: int = 0) -> Any:
    """The simplest failing example, from where the search for it happens to begin."""
    given_up = settings(
        database=None,
        deadline=None,
        max_examples=5000,
        phases=[Phase.generate, Phase.shrink],
        suppress_health_check=list(HealthCheck),
    )
    return find(strategy, predicate, settings=given_up, random=Random(seed))


def speed(case: SearchedCase) -> float:
    return case.scenario.world["ego"]["speed"]


def fault(case: SearchedCase, kind: str) -> Fault | None:
    return next((one for one in case.faults if one.type == kind), None)


@law
@given(strategies.cases("intersection/*", ["catalogue"], at_most=3))
def test_every_case_can_be_run(case: SearchedCase) -> None:
    spec = case.spec(0, 0)
    assert spec.seed == case.scenario.seed
    assert not case.scenario.variation
    assert spec == case.spec(3, 99) or spec.run != 3, "nothing is left to another run"
    assert spec.scenario["world"] == case.spec(0, 99).scenario["world"]


@law
@given(strategies.cases(NAME, ["catalogue"], at_most=2))
def test_what_is_drawn_lies_in_the_declared_ranges(case: SearchedCase) -> None:
    scenario = current_library().scenarios[NAME]
    world = case.scenario.world
    for path, spread in scenario.variation.items():
        value: Any = {"world": world}
        for key in path.split("."):
            if isinstance(value, list) and int(key) >= len(value):
                value = None
            elif value is not None:
                value = value[int(key)] if isinstance(value, list) else value[key]
        if value is not None and hasattr(spread, "min"):
            assert spread.min <= value <= spread.max
        elif value is not None:
            assert value in spread.choice
    assert len(case.faults) <= 2
    assert len({one.id for one in case.faults}) == len(case.faults)
    for one in case.faults:
        assert 0.0 <= one.activation["at"] <= scenario.duration - scenario.time_step


@pytest.mark.parametrize("seed", range(2))
def test_a_planted_failure_shrinks_to_the_simplest_case(seed: int) -> None:
    """Fails from 8.3 m/s on under a delay: nothing else matters, and nothing else is left."""
    found = shrunk(
        lambda case: speed(case) >= 8.3 and fault(case, "delay") is not None,
        strategies.cases(NAME, NAMED, at_most=3),
        seed,
    )
    (only,) = found.faults
    assert only.type == "delay"
    assert (only.activation["at"], only.duration) == (89.9, 0.1)
    assert only.parameters == {"s": 0.0}
    world = found.scenario.world
    assert speed(found) == 8.3
    assert (world["ego"]["distance"], world["ego"]["turn"]) == (50.0, "straight")
    assert (world["vehicles"], world["pedestrians"], world["traffic"]) == ([], [], None)
    assert found.scenario.seed == 0


def test_times_and_magnitudes_shrink_to_round_numbers_next_to_the_threshold() -> None:
    def fails(case: SearchedCase) -> bool:
        one = fault(case, "gnss-jump")
        return (
            one is not None
            and one.parameters["along"] <= -3.217
            and one.activation["at"] <= 41.55
            and one.duration >= 2.34
        )

    (one,) = shrunk(fails, strategies.cases(NAME, NAMED)).faults
    assert one.activation["at"] == 41.0
    assert one.duration == 3.0
    assert one.parameters == {"east": 0.0, "north": 0.0, "along": -4.0, "across": 0.0}


def test_where_no_coarse_number_fails_one_digit_more_is_found() -> None:
    found = shrunk(lambda case: 8.314 <= speed(case) <= 8.345, strategies.cases(NAME))
    assert speed(found) == 8.32


def test_a_vehicle_stays_where_it_is_needed_and_what_it_varies_is_nominal() -> None:
    found = shrunk(lambda case: len(case.scenario.world["vehicles"]) == 1, strategies.cases(NAME))
    assert found.scenario.world["vehicles"] == [
        {"id": "LEADER", "arm": "south", "turn": "straight", "distance": 25.0, "speed": 8.0}
    ]
    assert found.scenario.world["traffic"] is None


def test_an_activation_is_late_before_a_magnitude_is_small() -> None:
    def fails(case: SearchedCase) -> bool:
        one = fault(case, "delay")
        # The later it begins, the more it takes: 1 s at 50 s, 2 s at 80 s.
        return one is not None and one.parameters["s"] >= (one.activation["at"] - 20.0) / 30.0

    (one,) = shrunk(fails, strategies.cases(NAME, ["delay"])).faults
    assert one.activation["at"] == 89.9
    assert one.parameters["s"] == pytest.approx(2.4)


@law
@given(strategies.scenarios("intersection/*"))
def test_scenarios_are_plain_ones_without_variation(scenario: Any) -> None:
    assert scenario.name in current_library().scenarios
    assert not scenario.variation
    again = type(scenario).model_validate(scenario.plain())
    assert again == scenario


@law
@given(strategies.faults("gnss-*", "delay", scenario=NAME))
def test_faults_are_data_that_the_catalogue_loads(one: dict[str, Any]) -> None:
    assert parse_fault(one).type == one["type"]
    assert one["type"] == "delay" or one["type"].startswith("gnss-")


@law
@given(strategies.fault_campaigns(NAME, "catalogue", at_least=1, at_most=3))
def test_fault_campaigns_hold_as_many_as_they_are_told(several: list[dict[str, Any]]) -> None:
    assert 1 <= len(several) <= 3
    assert len({one["id"] for one in several}) == len(several)


def test_parts_are_left_out_seldom_while_cases_are_drawn() -> None:
    there: list[bool] = []

    @settings(law, max_examples=300)
    @given(strategies.cases(NAME))
    def draw(case: SearchedCase) -> None:
        there.append(bool(case.scenario.world["vehicles"]))

    draw()
    # Once in eight times; Hypothesis copies choices, and tries the simplest ones a little more.
    assert 0.05 < 1.0 - sum(there) / len(there) < 0.4
