"""Shrinking of counterexamples: what is made simple first, what it costs, what is told of it."""

from __future__ import annotations

from typing import Any

import pytest
from shrinkable import crossing, fault, found, ids

from pytest_dura import ConfigurationError, Orchestrator, RoleSpec
from pytest_dura.search import changes_of, count_parameters, minimise, shrink, simpler_values
from pytest_dura.search.simplification import rounded_values

DELAY = fault("delay", "odometry", activation__at=3.21, duration=7.31)
BIAS = fault("bias", "odometry.speed", activation__at=1.23, parameters__offset=-3.7)


def offsets(searched: Any) -> list[float]:
    return [one.parameters["offset"] for one in searched.faults if one.type == "bias"]


@pytest.mark.parametrize(
    "value, nominal, expected",
    [
        (57.3, 50.0, (50.0, 55.0, 56.0, 57.0, 58.0, 57.1, 57.2, 57.3)),
        (-30.0, 0.0, (0.0, -5.0, -10.0, -15.0, -20.0, -25.0, -30.0)),
        (6.7312, 7.0, (7.0, 6.9, 6.8, 6.7, 6.79, 6.78, 6.77, 6.76, 6.75, 6.74, 6.73, 6.7312)),
        (12, 3, (3, 5, 10, 11, 12)),
        (True, False, (False, True)),
        ("left", "straight", ("straight", "left")),
        (None, 2.0, (2.0, None)),
        (2.0, 2.0, (2.0,)),
    ],
)
def test_nearer_to_the_nominal_value_is_simpler(value: Any, nominal: Any, expected: Any) -> None:
    assert simpler_values(value, nominal) == expected


def test_rounding_past_the_found_value_stays_within_the_limits() -> None:
    assert 58.0 not in simpler_values(57.3, 50.0, (50.0, 57.5))


def test_a_number_without_a_nominal_value_is_rounded() -> None:
    assert rounded_values(37.4291) == (40.0, 37.0, 37.4, 37.4291)
    assert rounded_values("east") == ("east",)


@pytest.mark.of_guest
def test_what_does_not_matter_is_left_out_or_as_the_scenario_has_it() -> None:
    case = crossing()
    vehicles = [*case.scenario.world["vehicles"], {"id": "X", "arm": "east", "distance": 33.3}]
    world = {"ego": {"distance": 57.31, "speed": 7.12}, "vehicles": vehicles}
    shrunk = shrink(
        case, found(case, world, [DELAY, BIAS], 12), lambda one: "X" in ids(one), budget=500
    )
    assert shrunk.shrinking.finished
    assert ids(shrunk.case) == {"X"}
    assert shrunk.case.faults == ()
    assert shrunk.case.scenario.seed == 0
    assert {change.path: change.value for change in shrunk.changes} == {
        "world.vehicles.LEADER": None,
        "world.vehicles.WEST": None,
        "world.vehicles.X": {"id": "X", "arm": "east", "distance": 30.0},
    }
    assert (shrunk.shrinking.before, shrunk.shrinking.after) == (12, 2)


@pytest.mark.of_guest
def test_a_fault_is_made_later_shorter_and_milder() -> None:
    case = crossing()
    shrunk = shrink(
        case,
        found(case, faults=[DELAY, BIAS]),
        lambda one: any(
            each.type == "delay"
            and each.activation["at"] <= 6.0
            and each.duration >= 2.0
            and each.parameters["s"] >= 0.5
            for each in one.faults
        ),
        budget=500,
    )
    assert {change.path: change.value for change in shrunk.changes if change.value} == {
        "faults.delay": "delay",
        "faults.delay.activation.at": 5.0,
        "faults.delay.duration": 2.0,
    }


@pytest.mark.of_guest
def test_fewer_faults_are_preferred_to_fewer_vehicles() -> None:
    case = crossing()
    shrunk = shrink(
        case,
        found(case, faults=[BIAS]),
        lambda one: bool(one.faults) or len(ids(one)) == 2,
        budget=500,
    )
    assert shrunk.case.faults == ()
    assert ids(shrunk.case) == {"LEADER", "WEST"}


@pytest.mark.of_guest
def test_random_traffic_is_written_out_so_that_one_car_of_it_can_be_left() -> None:
    case = crossing(world={"traffic": {"headway": 5.0}})
    seen: list[set[str]] = []

    def violates(one: Any) -> bool:
        seen.append(ids(one))
        return one.scenario.world["traffic"] is None and "V4" in ids(one)

    shrunk = shrink(case, found(case, seed=3), violates, budget=500)
    assert len(seen[0]) > 8
    assert ids(shrunk.case) == {"V4"}
    assert shrunk.shrinking.after < shrunk.shrinking.before
    assert shrunk.shrinking.finished


@pytest.mark.of_guest
def test_random_traffic_stays_where_only_it_violates() -> None:
    case = crossing(world={"traffic": {"headway": 5.0}})
    shrunk = shrink(
        case,
        found(case, {"traffic": {"headway": 4.0}}, seed=3),
        lambda one: one.scenario.world["traffic"] is not None and one.scenario.seed == 3,
        budget=500,
    )
    assert [(change.path, change.value) for change in shrunk.changes] == [("seed", 3)]


@pytest.mark.of_guest
def test_the_scenarios_own_fault_is_led_back_to_what_it_was() -> None:
    own = {"type": "bias", "target": "odometry.speed", "activation": {"at": 2.0}, "duration": 1.0}
    case = crossing(faults=[{**own, "parameters": {"offset": 1.0}}])
    other = {**case.faults[0].plain(), "duration": 3.3, "parameters": {"offset": 2.2}}
    shrunk = shrink(
        case, found(case, faults=[other]), lambda one: any(o > 1.5 for o in offsets(one)), budget=99
    )
    kept = [change for change in shrunk.changes if change.path.startswith("faults")]
    assert [(change.path, change.value, change.nominal) for change in kept] == [
        ("faults.bias.parameters.offset", 2.0, 1.0)
    ]
    assert shrink(case, shrunk.case, lambda _: True, budget=99).changes[-1].value is None


@pytest.mark.of_guest
@pytest.mark.parametrize("budget", [0, 1, 7])
def test_the_budget_is_kept_to_the_simulation(budget: int) -> None:
    case, calls = crossing(), []

    def violates(one: Any) -> bool:
        calls.append(one.id)
        return bool(offsets(one)) and offsets(one)[0] <= -2.0

    shrunk = shrink(case, found(case, faults=[DELAY, BIAS], seed=4), violates, budget=budget)
    assert len(calls) == shrunk.shrinking.simulations == budget
    assert not shrunk.shrinking.finished
    assert offsets(shrunk.case)


@pytest.mark.of_guest
def test_equal_cases_are_simulated_once() -> None:
    case, calls = crossing(), []

    def violates(one: Any) -> bool:
        calls.append(one.id)
        return bool(offsets(one))

    shrunk = shrink(case, found(case, faults=[DELAY, BIAS], seed=4), violates, budget=500)
    assert shrunk.shrinking.finished
    assert len(set(calls)) == len(calls) == shrunk.shrinking.simulations


@pytest.mark.of_guest
def test_a_case_that_contradicts_itself_costs_nothing() -> None:
    case, refused = crossing(), []

    def violates(one: Any) -> bool:
        if "WEST" not in ids(one):
            refused.append(one)
            raise ConfigurationError("no case without it")
        return True

    shrunk = shrink(case, found(case), violates, budget=500)
    assert refused
    assert shrunk.shrinking.simulations == 1
    assert ids(shrunk.case) == {"WEST"}


@pytest.mark.of_guest
def test_an_error_of_a_simulation_is_raised_and_not_shrunk() -> None:
    case, calls = crossing(), []

    def violates(one: Any) -> bool:
        calls.append(one)
        raise OSError("no disk")

    with pytest.raises(OSError, match="no disk"):
        shrink(case, found(case, faults=[BIAS]), violates, budget=500)
    assert len(calls) == 1


@pytest.mark.of_guest
def test_an_added_entry_tells_what_is_not_at_its_default() -> None:
    case = crossing()
    added = {"id": "X", "arm": "east", "distance": 33.3, "speed": 7.0, "turn": "straight"}
    world = {**case.scenario.world, "vehicles": [added]}
    changes = changes_of(case, found(case, world, [DELAY], 5))
    told = {change.path: change.value for change in changes}
    assert told == {
        "world.vehicles.X": {"id": "X", "arm": "east", "distance": 33.3, "speed": 7.0},
        "world.vehicles.LEADER": None,
        "world.vehicles.WEST": None,
        "faults.delay": "delay",
        "faults.delay.target": "odometry",
        "faults.delay.activation.at": 3.21,
        "faults.delay.duration": 7.31,
        "seed": 5,
    }
    assert count_parameters(changes) == 3 + 4 + 1


def test_an_input_over_time_is_simplified_piece_by_piece() -> None:
    case = crossing(
        world={"inputs": [0.0, 0.0, 0.0]},
        simulator="thermostat:Thermostat",
        roles={"generator": "thermostat:Controller"},
        variation={"world.inputs": {"min": 0.0, "max": 1.0, "pieces": 3}},
    )
    shrunk = shrink(
        case,
        found(case, {"inputs": [0.3, 0.77, 1.0]}),
        lambda one: one.scenario.world["inputs"][1] > 0.42,
        budget=99,
    )
    assert shrunk.case.scenario.world["inputs"] == [0.0, 0.45, 0.0]


def test_no_level_grows_again_and_no_candidate_is_the_one_before() -> None:
    least, asked = (1, 5, 9, 9), []

    def violates(levels: tuple[int, ...]) -> bool:
        nonlocal least
        asked.append((levels, least))
        if sum(levels) >= 11:
            least = levels
            return True
        return False

    assert sum(minimise(least, violates)) == 11
    for levels, most in asked:
        assert levels != most
        assert all(one <= limit for one, limit in zip(levels, most, strict=True))


def test_what_was_needed_before_is_tried_again() -> None:
    def violates(levels: tuple[int, ...]) -> bool:
        # The first is needed as long as the last is there.
        return bool(levels[0] or not levels[2]) and levels[1] >= 2 and levels != (0, 4, 0)

    assert minimise((1, 4, 3), violates) == (0, 2, 0)


def test_one_needed_part_of_many_takes_the_logarithm_of_tries() -> None:
    asked: list[tuple[int, ...]] = []

    def violates(levels: tuple[int, ...]) -> bool:
        asked.append(levels)
        return levels[37] >= 700

    assert minimise([1] * 37 + [1000] + [1] * 90, violates) == (0,) * 37 + (700,) + (0,) * 90
    assert len(set(asked)) < 28


@pytest.mark.of_guest
def test_a_collision_among_random_traffic_comes_down_to_one_car() -> None:
    case = crossing(
        world={"traffic": {"headway": 10.0}},
        duration=14.0,
        roles={"recovery_planner": None},
        policy="log_only",
    )

    def collides(one: Any) -> bool:
        spec = one.spec(0, 0, {"generator": RoleSpec("aggressive")})
        return Orchestrator.build(spec).run(spec).collided

    start = found(case, seed=4)
    assert collides(start)
    shrunk = shrink(case, start, collides, budget=200)
    assert shrunk.shrinking.finished
    assert collides(shrunk.case)
    assert len(ids(shrunk.case)) == 1
    assert shrunk.shrinking.after < shrunk.shrinking.before


def test_what_the_scenario_varies_stays_within_what_it_declares() -> None:
    world = {
        "ego": {"distance": 50.0, "speed": 4.0},
        "weather": {"fog": 0.1, "rain": 0.1},
        "vehicles": [],
    }
    weathers = [{"fog": 0.9, "rain": 0.2}, {"fog": 0.2, "rain": 0.9}]
    spread = {
        "world.ego.speed": {"min": 6.0, "max": 8.5},
        "world.ego.distance": {"choice": [30.0, 50.0, 41.0, 60.0]},
        "world.weather": {"choice": weathers},
    }
    case = crossing(world=world, variation=spread, simulator="thermostat:Thermostat")
    tried: list[Any] = []

    def violates(one: Any) -> bool:
        tried.append(one.scenario.world)
        return bool(one.scenario.world["ego"]["distance"] > 55.0)

    start = {"ego": {"distance": 60.0, "speed": 8.31}, "weather": weathers[1], "vehicles": []}
    shrunk = shrink(case, found(case, start), violates, budget=500)
    assert len(tried) > 3
    for one in tried:
        assert 6.0 <= one["ego"]["speed"] <= 8.5
        assert one["ego"]["distance"] in (30.0, 50.0, 41.0, 60.0)
        assert one["weather"] in weathers
    assert shrunk.case.scenario.world == {
        "ego": {"distance": 60.0, "speed": 6.0},
        "weather": weathers[0],
        "vehicles": [],
    }


def test_a_fault_is_made_simpler_where_its_type_has_no_target_by_default() -> None:
    case = crossing(simulator="thermostat:Thermostat", duration=2.0)
    bias = fault("bias", "sensor.temperature", activation__at=1.23, parameters__offset=-3.7)
    shrunk = shrink(case, found(case, faults=[bias]), lambda one: bool(one.faults), budget=200)
    (simplest,) = shrunk.case.faults
    assert simplest.target == "sensor.temperature"
    assert "faults.bias" in {change.path for change in shrunk.changes}
