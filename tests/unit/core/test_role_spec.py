"""RoleSpec: how parts are named, built and built again elsewhere."""

from __future__ import annotations

import functools
import sys
from types import ModuleType
from typing import Any

import pytest
import thermostat
from thermostat import Controller

from pytest_dura import ConfigurationError, EpisodeSpec, Orchestrator, RoleSpec, factory
from pytest_dura.core.codec import decode, encode


@factory
def make_controller(target: float = 21.0) -> Controller:
    return Controller(target)


class Fussy(Controller):
    def __init__(self, level: int) -> None:
        if level > 3:
            raise ValueError(f"level {level} is too high")
        super().__init__()


def message_of(call: Any) -> str:
    with pytest.raises(ConfigurationError) as caught:
        call()
    return str(caught.value)


def test_classes_factories_paths_and_specs_build_fresh_objects() -> None:
    for value, params in (
        (Controller, {"target": 22.0}),
        ("thermostat:Controller", {"target": 22.0}),
        (make_controller, {"target": 22.0}),
        (RoleSpec("thermostat:Controller", {"target": 22.0}), None),
    ):
        spec = RoleSpec.of(value, params)
        one, other = spec.create(), spec.create()
        assert one is not other
        assert one.target == 22.0
        assert not spec.opaque
        assert decode(RoleSpec, encode(spec)) == spec


def test_the_label_is_the_last_part_of_the_path() -> None:
    assert RoleSpec.of(Controller).label == "Controller"
    assert RoleSpec("a.b:Outer.Inner").label == "Outer.Inner"


def test_a_bare_instance_is_opaque_and_cannot_be_rebuilt() -> None:
    controller = Controller()
    spec = RoleSpec.of(controller)
    assert spec.opaque
    assert spec.create() is controller
    assert spec.path == "thermostat:Controller"
    text = message_of(decode(RoleSpec, encode(spec)).create)
    assert "bare instance" in text
    assert "remedy" in text


def test_what_cannot_be_found_by_name_is_refused() -> None:
    class Local(Controller):
        pass

    assert "importable by name" in message_of(lambda: RoleSpec.of(Local))
    assert "importable by name" in message_of(lambda: RoleSpec.of(lambda: Controller(20.0)))


def test_a_class_that_another_one_of_its_name_shadows_is_refused() -> None:
    shadowed = type("Controller", (Controller,), {"__module__": "thermostat"})
    assert "thermostat:Controller" in message_of(lambda: RoleSpec.of(shadowed))


@pytest.mark.parametrize(
    "path, problem",
    [
        ("thermostat.Controller", "has the form package.module:Name"),
        (":Controller", "has the form"),
        ("thermostat:", "has the form"),
        ("no_such_module:X", "No module named 'no_such_module'"),
        ("thermostat:Controler", "has no attribute 'Controler'"),
        ("thermostat:LIMIT", "is neither a class nor a factory"),
    ],
)
def test_a_path_that_leads_nowhere_is_told(path: str, problem: str) -> None:
    text = message_of(lambda: RoleSpec(path).create())
    assert problem in text
    assert path in text


def test_a_module_that_fails_when_it_is_imported_is_told(
    tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "broken_planner.py").write_text("raise RuntimeError('no licence')\n")
    monkeypatch.syspath_prepend(tmp_path)
    text = message_of(lambda: RoleSpec("broken_planner:Planner").create())
    assert "RuntimeError: no licence (broken_planner.py:1)" in text


def test_wrong_parameters_are_told_with_the_signature() -> None:
    text = message_of(lambda: RoleSpec.of(Controller, {"tarqet": 1}).create())
    assert "unexpected keyword argument 'tarqet'" in text
    assert "Controller(target: " in text


def test_a_constructor_that_refuses_its_values_is_told() -> None:
    text = message_of(lambda: RoleSpec.of(Fussy, {"level": 9}).create())
    assert "Fussy cannot be built: ValueError: level 9 is too high (test_role_spec.py:" in text
    assert "'level': 9" in text


def test_an_abstract_role_is_told() -> None:
    text = message_of(lambda: RoleSpec("pytest_dura.core.roles:SafetyMonitor").create())
    assert "abstract" in text


def test_a_factory_that_returns_something_else_is_told_by_the_loop() -> None:
    spec = EpisodeSpec("a/b", 0, 0, RoleSpec("thermostat:Controller"), {})
    assert "is not a simulator" in message_of(lambda: Orchestrator.build(spec))
    partial = RoleSpec.of(functools.partial(Controller, 20.0))
    spec = EpisodeSpec("a/b", 0, 0, RoleSpec("thermostat:Thermostat"), {"generator": partial})
    text = message_of(lambda: Orchestrator.build(spec))
    assert "'generator' must be a Generator" in text
    assert "partial" in text


def test_a_module_that_is_not_loaded_does_not_matter_to_a_class() -> None:
    module = ModuleType("a_home_of_its_own")
    kind = type("Lonely", (Controller,), {"__module__": module.__name__})
    assert module.__name__ not in sys.modules
    assert RoleSpec.of(kind).path == "a_home_of_its_own:Lonely"
    assert thermostat.Controller is Controller
