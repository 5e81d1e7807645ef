"""What strategies draw a case by: scales, parts that may be left out, names, the profile."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest
import rooms
from hypothesis import Phase, find, given, settings
from hypothesis.vendor.pretty import pretty

from pytest_dura import strategies
from pytest_dura.core import ConfigurationError
from pytest_dura.faults import FAULT_TYPES
from pytest_dura.library import (
    Case,
    Library,
    Scenario,
    SearchedCase,
    current_library,
    expand_cases,
    load_library,
    use_library,
)
from pytest_dura.search import CaseDrawing, SearchSpace, on_grid
from pytest_dura.search.drawing import (
    OMISSION_ODDS,
    SEEDS,
    ChoiceScale,
    NumberScale,
    omissions,
    scaled,
    without_omissions,
)
from pytest_dura.search.space import Interval, OneOf

ROOM = f"{rooms.__name__}:Room"
simplest = settings(database=None, derandomize=True, deadline=None, max_examples=20)


@pytest.fixture(scope="module")
def library() -> Library:
    return load_library([])


def case(library: Library, name: str = "intersection/congested") -> Case:
    return expand_cases([library.scenarios[name]])[0]


def room(**keys: Any) -> Case:
    data = {"name": "room/one", "simulator": ROOM, "duration": 5.0, "world": {"start": 15.0}}
    return expand_cases([Scenario.model_validate(data | keys)])[0]


def one_library(*scenarios: Scenario) -> Library:
    return Library({one.name: one for one in scenarios}, {})


# Scales


def everything(scale: NumberScale) -> list[float]:
    return [
        scale.value(i, j, k)
        for i in range(scale.count())
        for j in range(scale.count(i))
        for k in range(scale.count(i, j))
    ]


@pytest.mark.parametrize(
    "low, high, nominal",
    [(7.0, 9.0, 8.0), (0.0, 1.0, 0.0), (-20.0, 20.0, 0.0), (0.1, 89.9, 89.9), (0.0, 3000.0, 0.0)],
)
def test_a_scale_holds_each_value_of_the_grid_once(low, high, nominal) -> None:
    found = everything(NumberScale(low, high, nominal))
    assert len(found) == len(set(found)) > 1000
    steps = 40_000
    grid = {on_grid(low + i / steps * (high - low), low, high) for i in range(steps + 1)}
    assert set(found) == grid


def test_cells_come_from_the_nominal_value_outwards_and_digits_from_round_to_odd() -> None:
    scale = NumberScale(7.0, 9.0, 8.0)
    coarse = [scale.value(cell, 0, 0) for cell in range(scale.count())]
    assert coarse[:5] == [8.0, 8.1, 7.9, 8.2, 7.8]
    assert sorted(coarse[-2:]) == [7.0, 9.0]
    finer = [scale.value(3, part, 0) for part in range(scale.count(3))]
    assert finer == [8.2, 8.11, 8.12, 8.13, 8.14, 8.15, 8.16, 8.17, 8.18, 8.19]
    finest = [scale.value(3, 2, part) for part in range(scale.count(3, 2))]
    assert finest[:3] == [8.12, 8.111, 8.112]
    below = [scale.value(4, part, 0) for part in range(scale.count(4))]
    assert below[:3] == [7.8, 7.89, 7.88]


def test_the_nominal_value_is_the_given_one_where_the_interval_holds_it() -> None:
    assert NumberScale(0.0, 10.0, 3.14159).value(0, 0, 0) == 3.14159
    assert type(NumberScale(0.0, 10.0, 3).value(0, 0, 0)) is int
    assert NumberScale(0.0, 10.0, 12.0).value(0, 0, 0) == 10.0
    assert everything(NumberScale(2.0, 2.0, 5.0)) == [2.0]


def test_words_begin_with_the_nominal_one() -> None:
    scale = ChoiceScale(("a", "b", "c"), "b")
    assert [scale.value(one, 0, 0) for one in range(scale.count())] == ["b", "a", "c"]
    assert scale.count(1) == scale.count(1, 0) == 1
    assert ChoiceScale(("a", "b"), "z").value(0, 0, 0) == "a"


def test_a_list_of_numbers_has_a_scale_for_each() -> None:
    one = scaled(Interval("world.x", 0.0, 1.0, 0.0, pieces=3))
    assert one.value([(0, 0, 0), (1, 0, 0), (2, 0, 0)]) == [0.0, 0.1, 0.2]
    two = scaled(Interval("world.x", 0.0, 1.0, [0.5, 0.25], pieces=2))
    assert two.value([(0, 0, 0), (0, 0, 0)]) == [0.5, 0.25]
    assert scaled(OneOf("world.x", (1, 2), 2)).value([(0, 0, 0)]) == 2


# What may be left out


@pytest.mark.of_guest
def test_vehicles_pedestrians_traffic_and_faults_may_be_left_out(library: Library) -> None:
    found = {
        name: [one.path for one in omissions(one_case, one_case_world(one_case))]
        for name in library.scenarios
        for one_case in [case(library, name)]
    }
    assert found["intersection/congested"] == ["world.traffic", "world.vehicles.0"]
    assert found["intersection/pedestrian-crossing"] == ["world.traffic", "world.pedestrians.0"]
    assert found["intersection/ghost-obstacle"] == ["faults.ghost-obstacle", "world.traffic"]


def one_case_world(one: Case) -> Any:
    return SearchSpace.of(one, ["delay"]).world


def test_what_the_simulator_does_not_check_is_not_left_out() -> None:
    unchecked = room(simulator="thermostat:Thermostat", world={"people": [{"heat": 1.0}]})
    assert omissions(unchecked, unchecked.scenario.world) == ()
    checked = room(world={"start": 1.0})
    assert omissions(checked, checked.scenario.world) == ()


def test_a_part_that_comes_back_by_itself_is_not_left_out(monkeypatch) -> None:
    def filled(_: type, world: Any) -> dict[str, Any]:
        return {"lamp": None, **world, "heater": world.get("heater") or {"power": 1.0}}

    monkeypatch.setattr(rooms.Room, "check_scenario", classmethod(filled))
    one = room(world={"lamp": {"power": 1.0}, "heater": {"power": 2.0}})
    assert [part.path for part in omissions(one, one.scenario.world)] == ["world.lamp"]


def test_entries_are_left_out_by_the_places_that_they_have_in_the_whole() -> None:
    world = {"cars": [{"n": n} for n in range(12)], "light": {"lamp": {"w": 1}}}
    places = [("cars", 2), ("cars", 10), ("light", "lamp")]
    found = without_omissions(world, places)
    assert [one["n"] for one in found["cars"]] == [0, 1, 3, 4, 5, 6, 7, 8, 9, 11]
    assert found["light"] == {"lamp": None}
    assert len(world["cars"]) == 12, "the world itself stays as it is"


# Drawing a case


class Picks:
    """Choices that are given beforehand; then the greatest ones, or the simplest."""

    def __init__(self, *given: int, rest: str = "simplest") -> None:
        self.given, self.rest, self.counts = list(given), rest, []

    def __call__(self, count: int) -> int:
        assert count >= 1
        self.counts.append(count)
        number = self.given.pop(0) if self.given else (count - 1) * (self.rest == "greatest")
        return min(number, count - 1)


@pytest.mark.of_guest
def test_every_case_takes_as_many_choices(library: Library) -> None:
    drawing = CaseDrawing.of(case(library), ["catalogue"], at_most=2)
    simple = Picks()
    drawing.draw(simple)
    for kind in range(len(FAULT_TYPES)):
        odd = Picks(1, 0, 0, 1, kind, rest="greatest")
        drawing.draw(odd)
        assert len(simple.counts) == len(odd.counts)


@pytest.mark.of_guest
def test_the_simplest_choices_make_the_simplest_case(library: Library) -> None:
    drawing = CaseDrawing.of(case(library), ["delay"], at_most=2)
    picks = Picks()
    found = drawing.draw(picks)
    assert found.faults == ()
    assert found.scenario.world["vehicles"] == []
    assert found.scenario.world["traffic"] is None
    assert found.scenario.world["ego"] == {"distance": 50.0, "speed": 8.0, "turn": "straight"}
    assert found.scenario.seed == 0
    assert not found.scenario.variation
    assert picks.counts[:4] == [2, 2, OMISSION_ODDS, OMISSION_ODDS]
    assert picks.counts[-1] == SEEDS


@pytest.mark.of_guest
def test_with_nothing_left_out_and_all_nominal_the_world_is_that_of_the_scenario(
    library: Library,
) -> None:
    original = case(library)
    drawing = CaseDrawing.of(original, leave_out=False)
    found = drawing.draw(Picks())
    assert found.scenario.world == drawing.space.world
    assert found.requirements == original.requirements


@pytest.mark.of_guest
def test_a_fault_begins_late_and_is_short_and_mild_at_first(library: Library) -> None:
    drawing = CaseDrawing.of(case(library), ["delay"])
    (fault,) = drawing.draw(Picks(1)).faults
    assert fault.activation["at"] == 89.9
    assert fault.duration == 0.1
    assert fault.parameters == {"s": 0.0}


@pytest.mark.of_guest
def test_the_parameters_of_what_is_left_out_are_not_drawn(library: Library) -> None:
    original = case(library)
    for left_out, names in ((0, set()), (1, {"LEADER"})):
        drawing = CaseDrawing.of(original)
        world = drawing.draw(Picks(1, left_out, rest="greatest")).scenario.world
        assert {one["id"] for one in world["vehicles"]} == names
        assert world["traffic"] is not None
    assert original.scenario.world["vehicles"], "the scenario itself stays as it is"


@pytest.mark.of_guest
def test_the_scenario_s_own_fault_may_be_left_out_or_stays(library: Library) -> None:
    original = case(library, "intersection/ghost-obstacle")
    assert CaseDrawing.of(original).draw(Picks(0)).faults == ()
    (kept,) = CaseDrawing.of(original).draw(Picks(1)).faults
    assert kept.id == "ghost-obstacle"
    (kept,) = CaseDrawing.of(original, leave_out=False).draw(Picks(0)).faults
    assert kept.id == "ghost-obstacle"


def test_a_scenario_that_varies_nothing_differs_by_its_seed() -> None:
    drawing = CaseDrawing.of(room())
    assert [drawing.draw(Picks(seed)).scenario.seed for seed in (0, 7)] == [0, 7]


@pytest.mark.of_guest
def test_the_order_of_the_choices_is_the_order_of_simplicity(library: Library) -> None:
    """Each choice by itself, made odd, changes what is later in the order or as late."""
    drawing = CaseDrawing.of(case(library), ["delay", "gnss-jump"], at_most=2)
    # Both faults are there, both parts of the world are, and no number is at its simplest.
    odd = [1] * 6 + [2] * 400
    plain, counts = drawing.draw(Picks(*odd)), Picks(*odd)
    drawing.draw(counts)
    told = []
    for number, count in enumerate(counts.counts):
        if count > 1:
            given = [*odd[:number], 0, *odd[number + 1 :]]
            found = what_differs(plain, drawing.draw(Picks(*given)))
            if found:
                told.append(found)
    order = [one for one, before in zip(told, ["", *told], strict=False) if one != before]
    first = ["presence", "left out", "type", "activation", "duration", "parameters", "world"]
    assert order == [*first, *2 * first[3:], "seed"]


def what_differs(one: SearchedCase, other: SearchedCase) -> str:
    world, changed = (each.scenario.world for each in (one, other))
    pairs = list(zip(one.faults, other.faults, strict=False))
    if len(one.faults) != len(other.faults):
        return "presence"
    if len(world["vehicles"]) != len(changed["vehicles"]):
        return "left out"
    if (world["traffic"] is None) != (changed["traffic"] is None):
        return "left out"
    for key in ("type", "activation", "duration", "parameters"):
        if any(getattr(fault, key) != getattr(now, key) for fault, now in pairs):
            return key
    if world != changed:
        return "world"
    return "seed" if one.scenario.seed != other.scenario.seed else ""


@pytest.mark.of_guest
def test_faults_that_must_be_there_are_no_choice(library: Library) -> None:
    drawing = CaseDrawing.of(case(library), ["delay"], at_least=1, at_most=2)
    picks = Picks()
    assert len(drawing.draw(picks).faults) == 1
    assert picks.counts[:2] == [1, 2]


def test_worlds_that_contradict_themselves_are_not_drawn() -> None:
    cold = room(variation={"world.start": {"min": -5.0, "max": 5.0}})
    with pytest.raises(ConfigurationError, match="not that cold"):
        CaseDrawing.of(cold).draw(Picks(rest="greatest"))
    starts: list[float] = []

    @settings(simplest, max_examples=60)
    @given(strategies.cases("room/one"))
    def draw(one: SearchedCase) -> None:
        starts.append(one.scenario.world["start"])

    with use_library(lambda: one_library(cold.scenario)):
        draw()
    assert min(starts) >= 0.0
    assert max(starts) > 1.0


@pytest.mark.of_guest
def test_a_case_is_shown_by_what_was_chosen(library: Library) -> None:
    found = CaseDrawing.of(case(library), ["delay"]).draw(Picks(1))
    told = repr(found)
    assert told.startswith(f"SearchedCase({found.id!r}, seed=0, world={{'ego': ")
    assert "'activation': {'at': 89.9, 'not_before': 0.0, 'by': 'fault_injector'}" in told
    assert "None}" not in told.partition("faults=")[2]
    assert "requirements" not in told
    assert pretty(found) == told, "as Hypothesis shows it"


@pytest.mark.parametrize("at_least, at_most", [(2, 1), (-1, 1), (1, 1)])
def test_more_faults_than_there_are_cannot_be_drawn(at_least: int, at_most: int) -> None:
    with pytest.raises(ConfigurationError, match="cannot be drawn"):
        CaseDrawing.of(room(), at_least=at_least, at_most=at_most)


# Names


@pytest.mark.of_guest
def test_names_are_looked_up_in_the_library_at_hand() -> None:
    mine = one_library(room(name="room/mine").scenario)
    with use_library(lambda: mine):
        assert current_library() is mine
        with ThreadPoolExecutor(1) as thread:
            assert thread.submit(current_library).result() is mine
        found = find(strategies.cases("room/*"), lambda _: True, settings=simplest)
        assert found.scenario.name == "room/mine"
        with use_library(lambda: one_library(room(name="room/inner").scenario)):
            assert list(current_library().scenarios) == ["room/inner"]
        assert current_library() is mine
    assert "intersection/congested" in current_library().scenarios
    assert current_library() is current_library()


@pytest.mark.of_guest
def test_the_name_of_a_scenario_draws_all_its_cases(library: Library) -> None:
    ghost = library.scenarios["intersection/ghost-obstacle"]
    both = ghost.model_copy(update={"campaigns": ("none", ghost.faults[0].name)})
    assert ghost.name in [each.id for each in expand_cases([both])], "the id of one of them"
    drawn: set[int] = set()

    @settings(simplest, max_examples=30)
    @given(strategies.cases(ghost.name, leave_out=False))
    def draw(one: SearchedCase) -> None:
        drawn.add(len(one.faults))

    with use_library(lambda: one_library(both)):
        draw()
    assert drawn == {0, 1}


def test_a_strategy_follows_the_library() -> None:
    strategy = strategies.cases("room/*")
    for name in ("room/a", "room/b"):
        with use_library(lambda name=name: one_library(room(name=name).scenario)):
            assert find(strategy, lambda _: True, settings=simplest).scenario.name == name


@pytest.mark.of_guest
@pytest.mark.parametrize(
    "strategy, found",
    [
        (strategies.cases("intersection/congestd"), "intersection/congestd"),
        (strategies.cases("intersection/congested", ["dely"]), "dely"),
        (strategies.scenarios("nowhere/*"), "nowhere/*"),
        (strategies.faults("dely", scenario="intersection/congested"), "dely"),
        (strategies.fault_campaigns("nowhere"), "nowhere"),
    ],
)
def test_what_is_not_known_is_one_error_at_first_use(strategy, found) -> None:
    with pytest.raises(ConfigurationError) as error:
        find(strategy, lambda _: True, settings=simplest)
    assert error.value.found == found
    assert error.value.remedy


# The profile

SHOW = """
import json
from hypothesis import Phase, settings
{before}
import pytest_dura.strategies
{after}
default = settings.default
print(json.dumps({{
    "profile": settings.get_current_profile_name(),
    "deadline": default.deadline and default.deadline.total_seconds(),
    "derandomize": default.derandomize,
    "database": default.database is not None,
    "print_blob": default.print_blob,
    "max_examples": default.max_examples,
    "phases": [one.name for one in default.phases],
    "suppressed": [one.name for one in default.suppress_health_check],
}}))
"""


def shown(before: str = "", after: str = "", **environment: str) -> dict[str, Any]:
    kept = {name: one for name, one in os.environ.items() if name not in ("CI", "TF_BUILD")}
    found = subprocess.run(
        [sys.executable, "-c", SHOW.format(before=before, after=after)],
        capture_output=True,
        text=True,
        check=True,
        env=kept | environment,
    )
    return json.loads(found.stdout)


def test_the_profile_takes_the_place_of_the_default_one() -> None:
    assert shown() == {
        "profile": "dura",
        "deadline": None,
        "derandomize": False,
        "database": True,
        "print_blob": True,
        "max_examples": 100,
        "phases": [one.name for one in Phase if one is not Phase.explain],
        "suppressed": ["too_slow"],
    }


def test_under_ci_the_profile_draws_the_same_each_time_and_keeps_nothing() -> None:
    found = shown(CI="true")
    assert found["profile"] == "dura"
    assert found["derandomize"]
    assert not found["database"]
    assert found["deadline"] is None


def test_a_profile_of_one_s_own_stays() -> None:
    own = "settings.register_profile('own', deadline=5); settings.load_profile('own')"
    found = shown(before=own)
    assert (found["profile"], found["deadline"]) == ("own", 0.005)
    own = "settings.register_profile('dura', max_examples=7)"
    found = shown(before=own)
    assert (found["profile"], found["max_examples"]) == ("dura", 7)


def test_a_profile_of_one_s_own_can_be_made_of_it() -> None:
    own = (
        "settings.register_profile('own', settings.get_profile('dura'), max_examples=9);"
        "settings.load_profile('own')"
    )
    found = shown(after=own)
    assert (found["profile"], found["max_examples"], found["deadline"]) == ("own", 9, None)


def test_settings_within_which_it_is_imported_stay() -> None:
    """Registering a profile there is deprecated, and so an error for some."""
    before = (
        "import warnings; warnings.simplefilter('error')\n"
        "from hypothesis import given, strategies as st\n"
        "@settings(max_examples=1, deadline=77, database=None)\n"
        "@given(st.none())\n"
        "def test(_):\n"
        "    import pytest_dura.strategies\n"
        "    assert settings.get_current_profile_name() != 'dura'\n"
        "test()\n"
    )
    assert shown(before=before)["profile"] in ("default", "ci")


def test_importing_the_strategies_imports_nothing_else_that_is_heavy() -> None:
    script = (
        "import sys; import pytest_dura.strategies;"
        "print([one for one in ('numpy', 'pydantic', 'yaml', 'scipy', 'pytest') "
        "if one in sys.modules])"
    )
    found = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert found.stdout.strip() == "[]"
