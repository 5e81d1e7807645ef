"""The address of an episode: equal for equal ones, and whatever changes is named."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace

import pytest
from thermostat import Controller

from pytest_dura.core import EpisodeSpec, Fault, Policy, RoleSpec, Termination
from pytest_dura.core.clock import Clock
from pytest_dura.execution import EpisodeTask, address_of
from pytest_dura.execution.address import reason_unaddressed
from pytest_dura.library import LocalRole
from pytest_dura.requirements import Requirement

GENERATOR, MONITOR = "thermostat:Controller", "thermostat:SwitchOff"


def task(**changes):
    spec = {
        "case": "a/b", "run": 1, "seed": 5,
        "simulator": RoleSpec("thermostat:Thermostat", {"gain": 1.0}),
        "roles": {"generator": RoleSpec(GENERATOR, {"x": 1}), "safety_monitor": RoleSpec(MONITOR)},
        "scenario": {"world": {"wall": 3.0}}, "faults": (Fault("bias", "f", "t"),),
    }  # fmt: skip
    own = {name: changes.pop(name) for name in list(changes) if name in EpisodeTask.__match_args__}
    return EpisodeTask(EpisodeSpec(**{**spec, **changes}), **own)


def changed(other, **before):
    """The parts that tell a task from the usual one."""
    first, second = address_of(task(**before)), address_of(other)
    assert (first.name == second.name) == (first.parts == second.parts)
    return first.changed(second.parts)


def test_an_equal_task_has_an_equal_address_in_any_process():
    script = f"""
import json, sys
sys.path[:0] = json.loads(sys.argv[1])
from pytest_dura.execution import EpisodeTask, address_of
print(address_of(EpisodeTask.from_json(json.loads({json.dumps(task().to_json())!r}))).name)
"""
    names = set()
    for seed in ("1", "2"):
        environment = {**os.environ, "PYTHONHASHSEED": seed}
        told = subprocess.run(
            [sys.executable, "-c", script, json.dumps(sys.path)],
            env=environment, cwd="/", capture_output=True, text=True, check=True,
        )  # fmt: skip
        names.add(told.stdout.strip())
    assert names == {address_of(task()).name}


def test_nothing_changes_what_is_the_same():
    assert changed(task()) == []
    assert changed(task(role_timeout=1.0)) == []
    one, two = {"x": 1, "y": 2}, {"y": 2, "x": 1}
    assert changed(task(scenario={"world": two}), scenario={"world": one}) == []


INPUTS = {
    "case": {"case": "a/c"},
    "run": {"run": 2},
    "seed": {"seed": 6},
    "scenario": {"scenario": {"world": {"wall": 3.5}}},
    "faults": {"faults": ()},
    "kept for viewers": {"recorded": True},
    "repetition": {"again": 1},
    "recorded timeouts": {"timeouts": (3,)},
    "clock and latency": {"clock": Clock(kind="wall")},
}
ROLES = "roles and their parameters"
GROUP = "policy, end, time step and budget"


@pytest.mark.parametrize("part", INPUTS)
def test_each_input_changes_the_part_that_names_it(part):
    assert changed(task(**INPUTS[part])) == [part]


@pytest.mark.parametrize(
    "change",
    [
        {"policy": Policy.parse("halt")},
        {"termination": Termination(3.0)},
        {"time_step": 0.2},
        {"time_budget": 1.0},
    ],
)
def test_how_an_episode_is_run_is_one_part(change):
    assert changed(task(**change)) == [GROUP]


def test_parameters_of_roles_and_of_the_simulator_count():
    roles = task().spec.roles
    other = {**roles, "generator": RoleSpec(GENERATOR, {"x": 2})}
    assert changed(task(roles=other)) == [ROLES]
    assert changed(task(simulator=RoleSpec("thermostat:Thermostat", {"gain": 2.0}))) == [ROLES]


def test_a_role_that_is_left_out_or_another_one_is_named():
    left = {"generator": task().spec.roles["generator"]}
    assert changed(task(roles=left)) == [ROLES]


def peak(_):
    return 1.0


def test_metrics_count_by_their_names():
    assert changed(task(metrics={"peak": peak})) == ["metrics"]
    assert changed(task(metrics={"peak": peak}), metrics={"top": peak}) == ["metrics"]


def test_requirements_count_where_they_end_the_episode_and_for_what_ends_it():
    judging = (Requirement("R", "Text.", check="always (x > 0)"),)
    assert changed(task(judging=judging)) == ["requirements that end it"]
    reworded = (replace(judging[0], text="Other text.", at_most=0.1),)
    assert changed(task(judging=reworded), judging=judging) == []
    stricter = (replace(judging[0], check="always (x > 1)"),)
    assert changed(task(judging=stricter), judging=judging) == ["requirements that end it"]


class Nowhere(Controller):
    """Of a module without a file, once its name says so."""


def test_what_cannot_be_compared_has_no_address_and_a_reason(monkeypatch):
    def inner():
        class Local(Controller):
            pass

        return Local

    roles = task().spec.roles
    monkeypatch.setattr(Nowhere, "__module__", "of_no_file")
    monkeypatch.setitem(sys.modules, "of_no_file", type(sys)("of_no_file"))
    within = "stands within a function or class"
    reasons = {
        f"the metric m is a lambda, or {within}": task(metrics={"m": lambda _: 1.0}),
        "its safety_monitor is a bare instance": RoleSpec.of(Controller()),
        f"the class of its safety_monitor {within}": LocalRole("conftest.py:Local", inner()),
        "the class of its safety_monitor is in no file": LocalRole("conftest.py:N", Nowhere),
    }
    for reason, part in reasons.items():
        given = (
            part if isinstance(part, EpisodeTask) else task(roles={**roles, "safety_monitor": part})
        )
        assert address_of(given) is None
        assert reason_unaddressed(given) == reason
    assert reason_unaddressed(task()) == ""
