"""The order of roles follows from `after`, whatever the order of declaration."""

from __future__ import annotations

from itertools import permutations
from typing import Any

import pytest
from loops import doing
from thermostat import (
    Bias,
    Controller,
    HeatMonitor,
    JumpWatch,
    Meter,
    NightWatch,
    SwitchOff,
    Thermostat,
)

from pytest_dura import ConfigurationError, Generator, Orchestrator, Role, SafetyMonitor
from pytest_dura.core.roles import schedule


def user_role(*after: str) -> Any:
    return doing(Role, lambda view: None, after=after)


def all_six() -> dict[str, Role]:
    return {
        "generator": Controller(),
        "safety_monitor": HeatMonitor(),
        "security_assessor": JumpWatch(),
        "fault_injector": Bias(),
        "performance_oracle": Meter(),
        "recovery_planner": SwitchOff(),
    }


def test_standard_roles_run_in_the_order_of_the_paper() -> None:
    assert schedule(all_six()) == [
        "safety_monitor",
        "security_assessor",
        "fault_injector",
        "performance_oracle",
    ]


def test_a_users_role_runs_after_those_it_names() -> None:
    roles = all_six() | {"first": user_role(), "last": user_role("performance_oracle", "first")}
    order = schedule(roles)
    assert order.index("last") > order.index("performance_oracle")
    assert order.index("last") > order.index("first")


def test_order_does_not_depend_on_the_order_of_declaration() -> None:
    roles = {
        "c": user_role("a"),
        "a": user_role(),
        "b": user_role("safety_monitor"),
        "safety_monitor": HeatMonitor(),
        "performance_oracle": Meter(),
    }
    orders = {tuple(schedule(dict(items))) for items in permutations(roles.items())}
    assert len(orders) == 1


def test_a_role_that_is_switched_off_may_be_named() -> None:
    roles = {"generator": Controller(), "mine": user_role("safety_monitor", "generator")}
    assert schedule(roles) == ["mine"]


def test_an_unknown_name_is_an_error_that_lists_the_known_ones() -> None:
    with pytest.raises(ConfigurationError) as caught:
        schedule(all_six() | {"mine": user_role("safty_monitor")})
    message = str(caught.value)
    assert "'mine' runs after 'safty_monitor'" in message
    assert "mine.after" in message
    assert "safety_monitor" in message


@pytest.mark.parametrize("names", [("a", "b"), ("a",)])
def test_a_cycle_is_an_error_that_shows_it(names: tuple[str, ...]) -> None:
    following = dict(zip(names, (*names[1:], names[0]), strict=True))
    with pytest.raises(ConfigurationError, match="in a circle") as caught:
        schedule({name: user_role(after) for name, after in following.items()})
    assert " -> " in str(caught.value)


def test_after_recovery_is_an_error() -> None:
    with pytest.raises(ConfigurationError, match="run before recovery"):
        schedule({"recovery_planner": SwitchOff(), "mine": user_role("recovery_planner")})


@pytest.mark.parametrize(
    "name, role, message",
    [
        ("safety_monitor", NightWatch(), "must be a SafetyMonitor"),
        ("mine", object(), "must be a Role"),
        ("second_injector", Bias(), "FaultInjector cannot be the role 'second_injector'"),
        ("second_generator", Controller(), "Generator cannot be the role 'second_generator'"),
        ("my_recovery", SwitchOff(), "RecoveryPlanner cannot be the role 'my_recovery'"),
    ],
)
def test_a_role_of_the_wrong_kind_is_an_error(name: str, role: Any, message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        Orchestrator(Thermostat(), {"generator": Controller(), name: role})


def test_a_second_monitor_under_a_name_of_its_own_is_welcome() -> None:
    loop = Orchestrator(Thermostat(), {"generator": Controller(), "second_monitor": HeatMonitor()})
    assert [name for name, *_ in loop.assessors] == ["second_monitor"]


def test_a_loop_needs_a_generator() -> None:
    with pytest.raises(ConfigurationError, match="'generator' must be a Generator"):
        Orchestrator(Thermostat(), {})


def test_bases_are_abstract() -> None:
    for base in (Generator, SafetyMonitor, Role):
        with pytest.raises(TypeError, match="abstract"):
            base()
