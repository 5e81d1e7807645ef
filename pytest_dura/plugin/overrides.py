"""Which conftest files override a role's fixture, known before any fixture is set up."""

from __future__ import annotations

import ast
import os
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

OVERRIDABLE = (
    "simulator",
    "generator",
    "safety_monitor",
    "security_assessor",
    "performance_oracle",
    "fault_injector",
    "recovery_planner",
)


def root_conftest_with(config: pytest.Config, role: str) -> str | None:
    """The root conftest's file name, if it defines the fixture of this role."""
    root = config.rootpath / "conftest.py"
    return root.name if (root, role) in _overrides(config) else None


def overrides_deeper_down(config: pytest.Config) -> list[tuple[str, str]]:
    """``(file, role)`` of overrides that scenario items do not see, relative to the root."""
    root = config.rootpath
    return [
        (os.path.relpath(file, root), role)
        for file, role in _overrides(config)
        if file.parent != root and root in file.parents
    ]


def none_in_root_conftest(config: pytest.Config) -> list[tuple[str, str]]:
    """``(file, role)`` of fixtures of the root conftest that plainly return ``None``."""
    root = config.rootpath / "conftest.py"
    roles = [role for file, role in _overrides(config) if file == root]
    if not roles:
        return []
    tree = ast.parse(root.read_bytes())
    functions = {one.name: one for one in tree.body if isinstance(one, ast.FunctionDef)}
    return [(root.name, role) for role in roles if _returns_none(functions.get(role))]


def _returns_none(function: ast.FunctionDef | None) -> bool:
    if function is None:
        return False
    nodes = list(ast.walk(function))
    values = [one.value for one in nodes if isinstance(one, ast.Return) and one.value is not None]
    generates = any(isinstance(one, (ast.Yield, ast.YieldFrom)) for one in nodes)
    return not generates and all(isinstance(v, ast.Constant) and v.value is None for v in values)


def conftest_defining(config: pytest.Config, value: object) -> str | None:
    """The ``conftest.py`` at whose top level a class or function is defined, if it is in one.

    pytest may have loaded several modules of the name ``conftest``, of which ``sys.modules`` holds
    one; so the class itself does not tell.
    """
    name = getattr(value, "__qualname__", None)
    for file, module in _conftests(config):
        own = getattr(value, "__module__", None) == module.__name__
        if name is not None and own and vars(module).get(name) is value:
            return Path(os.path.relpath(file, config.rootpath)).as_posix()
    return None


def defined_in_conftest(config: pytest.Config, file: str, name: str) -> Any:
    """What :func:`conftest_defining` was asked about; ``None`` if that file is not loaded."""
    wanted = config.rootpath / file
    return next((vars(m).get(name) for path, m in _conftests(config) if path == wanted), None)


def _overrides(config: pytest.Config) -> list[tuple[Path, str]]:
    return [
        (file, role)
        for file, module in _conftests(config)
        for role in OVERRIDABLE
        if _is_fixture(module, role)
    ]


def _conftests(config: pytest.Config) -> list[tuple[Path, ModuleType]]:
    found = []
    for plugin in config.pluginmanager.get_plugins():
        file = getattr(plugin, "__file__", None)
        if isinstance(plugin, ModuleType) and file and Path(file).name == "conftest.py":
            found.append((Path(file), plugin))
    return sorted(found, key=lambda one: one[0])


def _is_fixture(module: ModuleType, name: str) -> bool:
    """Whether the module defines a fixture of this name, by what pytest 8 and 9 make of one."""
    value = vars(module).get(name)
    made_of = type(value).__name__
    return made_of == "FixtureFunctionDefinition" or hasattr(value, "_pytestfixturefunction")
