"""The search space of a case, the cases in it, and the types that no rate takes."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pytest_dura import ConfigurationError, Requirement, Runner, SearchedCase, SearchedEpisode
from pytest_dura.campaign import EpisodeUsed, Limits, SearchEnded
from pytest_dura.library import (
    Case,
    Library,
    Scenario,
    case_with_faults,
    expand_cases,
    load_library,
)
from pytest_dura.requirements import CampaignJudge, SearchVerdict, judge_episode, judge_searched
from pytest_dura.search import Group, Layout, Objective, SearchSpace, on_grid
from pytest_dura.search.falsify import falsify
from pytest_dura.search.portfolio import parameter_report
from pytest_dura.search.space import CoverageCount, FaultSlot, input_unit

WARM = Requirement("WARM", check="always (temperature > 10)")


def room(**more: Any) -> Scenario:
    data = {
        "name": "room",
        "simulator": "thermostat:Thermostat",
        "duration": 4.0,
        "world": {"start": 18.0},
        "roles": {"generator": "thermostat:Controller"},
        "variation": {"world.start": {"min": 15.0, "max": 20.0}},
    }
    return Scenario.model_validate(data | more)


def case(**more: Any) -> Case:
    return case_with_faults(room(**more), "none")


BIAS = {
    "type": "bias",
    "target": "sensor.temperature",
    "activation": {"at": 1.0},
    "duration": 1.0,
}


def test_a_point_becomes_readable_values_within_the_ranges() -> None:
    space = SearchSpace.of(case(), [BIAS])
    assert [group.name for group in space.layout.groups][:2] == ["world.start", "faults.search-1"]
    for point in np.random.default_rng(1).random((50, space.layout.size)):
        values = space.values(point)
        assert 15.0 <= values["world.start"] <= 20.0
        assert values["world.start"] == round(values["world.start"], 3)
    low = space.values([0.0] * space.layout.size)
    high = space.values([1.0] * space.layout.size)
    assert (low["world.start"], high["world.start"]) == (15.0, 20.0)
    assert low["faults.search-1"] is None
    assert high["faults.search-1"]["type"] == "bias"


def test_what_a_fault_is_given_stays_and_the_rest_is_searched() -> None:
    space = SearchSpace.of(case(), [BIAS])
    (slot,) = [one for one in space.parameters if one.path == "faults.search-1"]
    (choice,) = slot.choices
    assert [one.path for one in choice.inner] == ["parameters.offset", "parameters.percent"]
    by_name = SearchSpace.of(case(), [{"type": "bias", "target": "sensor.temperature"} | BIAS])
    assert by_name.layout == space.layout


@pytest.mark.parametrize("added", ["off", {"type": "bias", "target": "sensor.temperature"}])
def test_faults_begin_while_there_is_a_road_user_to_meet(added) -> None:
    space = SearchSpace.of(case(faults=[BIAS | {"id": "off"}]), [added], begin_within=2.0)
    point = [1.0] * space.layout.size
    fault = space.values(point)["faults.search-1"]
    assert fault["activation"]["at"] == pytest.approx(2.0 - 0.1)
    assert fault["duration"] == pytest.approx(1.0)


def test_inputs_over_time_are_lists() -> None:
    spread = {"world.heat": {"min": 0.0, "max": 2.0, "pieces": 4}}
    space = SearchSpace.of(case(variation=spread, world={"heat": [0.0] * 4}))
    assert space.layout.groups == (Group("world.heat", 4),)
    assert space.values([0.0, 0.5, 0.25, 1.0]) == {"world.heat": [0.0, 1.0, 0.5, 2.0]}


def test_a_searched_case_is_fixed_whatever_the_sessions_seed() -> None:
    space = SearchSpace.of(case())
    made = space.case_with({"world.start": 16.5}, 7)
    assert isinstance(made, SearchedCase)
    specs = [made.spec(0, base) for base in (0, 99)]
    assert [spec.seed for spec in specs] == [7, 7]
    assert specs[0].scenario["world"]["start"] == 16.5
    assert made.scenario.variation == {}
    assert made.id != space.case_with({"world.start": 16.6}, 7).id
    assert made.id == space.case_with({"world.start": 16.5}, 7).id


def test_two_added_faults_of_one_kind_have_ids_of_their_own() -> None:
    space = SearchSpace.of(case(), [BIAS], at_most=2)
    made = space.case_with(space.values([1.0] * space.layout.size), 1)
    assert [fault.id for fault in made.faults] == ["bias", "bias-2"]


@pytest.mark.of_guest
def test_faults_of_a_type_of_the_users_own_may_be_added_twice(monkeypatch) -> None:
    path = Path(__file__).parents[2] / "plugin/project"
    monkeypatch.syspath_prepend(str(path))
    drizzle = {
        "type": "oddities:Drizzle",
        "target": "sensor.temperature",
        "activation": {"at": 1.0},
    }
    try:
        space = SearchSpace.of(case(), [drizzle], at_most=2)
        made = space.case_with(space.values([1.0] * space.layout.size), 1)
        assert [one.id for one in made.faults] == ["oddities:Drizzle", "oddities-Drizzle-2"]
        (again,) = expand_cases([made.scenario])
        assert again.faults == made.faults
    finally:  # other tests of this process have modules of these names
        for name in ("oddities", "corridor"):
            sys.modules.pop(name, None)


def test_faults_of_one_kind_that_differ_may_each_be_added() -> None:
    mild, strong = ({**BIAS, "parameters": {"offset": offset}} for offset in (0.0, 20.0))
    space = SearchSpace.of(case(), [mild, strong, dict(mild)])
    (slot,) = [one for one in space.parameters if one.path == "faults.search-1"]
    told = [(one.fault.id, one.fault.parameters["offset"]) for one in slot.choices]
    assert told == [("bias", 0.0), ("bias-2", 20.0)]


def test_a_fault_of_the_scenario_may_be_called_as_room_for_one_is() -> None:
    spread = {"faults.search-1.duration": {"min": 0.5, "max": 1.5}}
    scenario = room(faults=[BIAS | {"id": "search-1"}], variation=spread)
    space = SearchSpace.of(case_with_faults(scenario, ["search-1"]))
    made = space.case_with(space.values([1.0]), 1)
    assert [(one.id, one.duration) for one in made.faults] == [("search-1", 1.5)]


def test_a_case_in_which_nothing_differs_cannot_be_searched() -> None:
    with pytest.raises(ConfigurationError, match="there is nothing to search"):
        SearchSpace.of(case(variation={}))


def test_parameters_of_another_form_are_refused_with_their_key() -> None:
    wrong = {"type": "bias", "target": "sensor.temperature", "parameters": [1]}
    with pytest.raises(ConfigurationError) as caught:
        SearchSpace.of(case(), [wrong])
    assert caught.value.remedy


def test_faults_that_act_together_are_no_entry() -> None:
    with pytest.raises(ConfigurationError, match="one by one"):
        SearchSpace.of(case(), [[BIAS, BIAS | {"id": "other"}]])


def test_no_rate_is_made_of_what_a_search_chose() -> None:
    library = Library({"room": room()}, {"WARM": WARM})
    bench = Runner(lambda: library)
    used: list[object] = []
    bench.events.subscribe(EpisodeUsed, used.append)
    made = SearchSpace.of(case()).case_with({"world.start": 16.5}, 7)
    episode = bench.episode(made)
    assert isinstance(episode, SearchedEpisode)
    assert used == []
    with pytest.raises(ConfigurationError, match="no rate can be made of it"):
        bench.campaign(made)
    with pytest.raises(ConfigurationError, match="is no sample of anything"):
        judge_episode(WARM, episode)
    verdict = judge_searched(WARM, episode)
    assert isinstance(verdict, SearchVerdict)
    assert (verdict.status, verdict.margin) == ("satisfied", episode.robustness(WARM.check))
    judge = CampaignJudge(WARM, "room", planned=1)
    with pytest.raises(ConfigurationError, match="rests on verdicts on its own episodes"):
        judge.add(verdict)  # type: ignore[arg-type]
    assert judge.verdicts == []


def test_coverage_of_pairs_is_the_mean_over_tables_of_any_size() -> None:
    layout = Layout((Group("a", 2), Group("b", options=3), Group("c", options=7)))
    points = np.random.default_rng(5).random((9, layout.size))
    count, parts = CoverageCount(layout), np.array([5, 5, 3, 7])
    for point in points:
        count.add(point)
    cells = (points * parts).astype(int)
    shares = [
        len({(row[i], row[j]) for row in cells}) / (parts[i] * parts[j])
        for i in range(4)
        for j in range(i)
    ]
    assert count.coverage().pairs == pytest.approx(np.mean(shares))


def test_coverage_counts_parts_of_each_coordinate_and_of_pairs() -> None:
    count = CoverageCount(Layout((Group("a"), Group("b", options=2))))
    for a in (0.05, 0.06, 0.55, 1.0):
        count.add(np.array([a, 0.2]))
    told = count.coverage()
    assert told.parameters == {"a": pytest.approx(0.3), "b": 0.5}
    assert told.pairs == pytest.approx(3 / 10)


@pytest.mark.parametrize(
    "value,low,high,expected",
    [
        (3.14159265, 0.0, 10.0, 3.14),
        (0.0314159265, 0.0, 0.1, 0.0314),
        (31415.9, 0.0, 100000.0, 31400.0),
        (9.99999, 0.0, 9.9999, 9.9999),
        (5.0, 5.0, 5.0, 5.0),
    ],
)
def test_numbers_lie_on_a_grid_and_within_their_range(value, low, high, expected) -> None:
    assert on_grid(value, low, high) == pytest.approx(expected, abs=1e-12)
    assert low <= on_grid(value, low, high) <= high


def test_a_violation_that_only_a_baseline_met_is_confirmed_and_claimed() -> None:
    ends = Requirement("ENDS", check="always[0:0] (temperature < 19.9)")
    middle = Requirement("MIDDLE", check="always[0:0] (temperature < 16 or temperature > 19)")
    library = Library({"room": room()}, {})
    bench = Runner(lambda: library)
    told: list[object] = []
    bench.events.subscribe(SearchEnded, told.append)
    found = falsify(bench, case(), [Objective(ends), Objective(middle)], limits=Limits(2, shrink=0))
    by_end, by_middle = found.outcomes
    assert (by_end.status, by_middle.status) == ("falsified", "falsified")
    assert by_end.searcher in {one.name for one in found.searchers}
    assert all(one.first["MIDDLE"] is None for one in found.searchers)
    met = {one.name: one.first["MIDDLE"] for one in found.baselines}
    assert by_middle.simulations == met[by_middle.searcher or ""]
    assert by_middle.counterexample is not None
    assert by_middle.counterexample.repeats.confirmed
    assert told == [SearchEnded(case(), found)]


@pytest.mark.of_guest
def test_inputs_have_the_unit_that_scenario_domain_or_fault_declares() -> None:
    own = room(variation={"world.start": {"min": 15.0, "max": 20.0, "unit": "degC"}})
    space = SearchSpace.of(case_with_faults(own, "none"), [BIAS])
    start, slot = map(parameter_report, space.parameters)
    assert (start.path, start.unit) == ("world.start", "degC")
    assert slot.faults is not None
    assert {each.path: each.unit for each in slot.faults["bias"]}.get("parameters.offset") == ""
    driving = load_library([]).scenarios["intersection/congested"]
    assert input_unit(driving, "world.vehicles.CAR1.distance") == "m"
    assert input_unit(driving, "world.ego.speed") == "m/s"
    assert input_unit(driving, "world.vehicles.0.turn") == ""
    (ghost,) = SearchSpace.of(case_with_faults(driving, "none"), ["ghost-obstacle"]).parameters[-1:]
    assert isinstance(ghost, FaultSlot)
    units = {each.path: getattr(each, "unit", "") for each in ghost.choices[0].inner}
    assert (units["activation.at"], units["parameters.ahead"]) == ("s", "m")
