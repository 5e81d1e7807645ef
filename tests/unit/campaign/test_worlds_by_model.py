"""Worlds of a simulator without checks of its own: the domain's model has the say."""

from __future__ import annotations

from typing import Any

import pytest
from clockwork import Clockwork
from pydantic import BaseModel, ConfigDict, Field

from pytest_dura import Domain, RoleSpec
from pytest_dura.core import ConfigurationError
from pytest_dura.library.cases import expand_cases
from pytest_dura.library.checks import scenario_problems
from pytest_dura.library.documents import parse_yaml
from pytest_dura.library.scenario import Scenario


class World(BaseModel):
    goal: int = Field(7, ge=1)


class OpenWorld(World):
    model_config = ConfigDict(extra="allow")


class Checking(Clockwork):
    @classmethod
    def check_scenario(cls, world: Any) -> dict[str, Any]:
        return {"own": True, **world}


CLOCKS = Domain(name="clocks", world=World)
OPEN_CLOCKS = Domain(name="open-clocks", world=OpenWorld)


def scenario(
    more: str = "", simulator: str = "clockwork:Clockwork", domain: str = "CLOCKS"
) -> Scenario:
    text = f"name: a\nsimulator: {simulator}\ndomain: {__name__}:{domain}\nduration: 1\n{more}"
    return Scenario.from_document(parse_yaml(text, "clocks.yaml"))


def world_of(given: Scenario) -> Any:
    (case,) = expand_cases([given])
    return case.spec(0, 0, {"generator": RoleSpec("thermostat:Controller")}).scenario["world"]


def problem_of(given: Scenario) -> ConfigurationError:
    (problem,) = scenario_problems(given)
    return problem


def test_it_gives_the_defaults_which_may_then_vary() -> None:
    assert world_of(scenario()) == {"goal": 7}
    assert world_of(scenario("variation: {world.goal: {choice: [3]}}\n")) == {"goal": 3}


def test_an_unknown_key_is_refused_at_its_place() -> None:
    problem = problem_of(scenario("world: {gaol: 3}\n"))
    assert (problem.file, problem.line, problem.key) == ("clocks.yaml", 5, "world.gaol")
    assert (problem.found, problem.expected) == ("gaol", "one of goal")
    assert problem.remedy == "did you mean 'goal'?"
    varied = problem_of(scenario("variation: {world.gaol: {choice: [3]}}\n"))
    assert "unknown key 'gaol' of the world" in str(varied)


def test_a_wrong_value_is_refused_and_a_model_that_allows_more_keys_does() -> None:
    assert problem_of(scenario("world: {goal: 0}\n")).key == "world.goal"
    more = scenario("world: {gaol: 3}\n", domain="OPEN_CLOCKS")
    assert world_of(more) == {"goal": 7, "gaol": 3}


def test_the_check_of_the_simulator_comes_before_it() -> None:
    own = scenario("world: {gaol: 3}\n", simulator=f"{__name__}:Checking")
    assert world_of(own) == {"own": True, "gaol": 3}


@pytest.mark.parametrize(
    "text,remedy",
    [
        ("8h", "write it in seconds: 28800"),
        ("5 min", "write it in seconds: 300"),
        ("200ms", "write it in seconds: 0.2"),
        ("long", "correct the value"),
    ],
)
def test_a_time_with_a_unit_is_refused_with_its_seconds(text: str, remedy: str) -> None:
    text = f"name: a\nsimulator: clockwork:Clockwork\nduration: {text}\n"
    with pytest.raises(ConfigurationError) as caught:
        Scenario.from_document(parse_yaml(text, "clocks.yaml"))
    assert (caught.value.line, caught.value.remedy) == (3, remedy)


def test_nothing_can_vary_where_no_key_has_a_value() -> None:
    given = {"name": "a", "simulator": "clockwork:Clockwork", "duration": 1}
    bare = Scenario.model_validate({**given, "variation": {"world.goal": {"choice": [3]}}})
    assert "nothing has one here" in str(problem_of(bare))
