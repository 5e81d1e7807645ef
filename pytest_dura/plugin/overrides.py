"""Which conftest files override a role's fixture, known before any fixture is set up."""

from __future__ import annotations

import os
from pathlib import Path
from types import ModuleType

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


def _overrides(config: pytest.Config) -> list[tuple[Path, str]]:
    found = []
    for plugin in config.pluginmanager.get_plugins():
        file = getattr(plugin, "__file__", None)
        if isinstance(plugin, ModuleType) and file and Path(file).name == "conftest.py":
            found += [(Path(file), role) for role in OVERRIDABLE if _is_fixture(plugin, role)]
    return sorted(found)


def _is_fixture(module: ModuleType, name: str) -> bool:
    """Whether the module defines a fixture of this name, by what pytest 8 and 9 make of one."""
    value = vars(module).get(name)
    made_of = type(value).__name__
    return made_of == "FixtureFunctionDefinition" or hasattr(value, "_pytestfixturefunction")
