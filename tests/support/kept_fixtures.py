"""Plugins of pytest in which a session looks for fixtures, and which have none."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from _pytest.fixtures import FixtureFunctionDefinition

PACKAGES = Path(pytest.__file__).parents[1]


def look_once(parse: Callable[..., None]) -> Callable[..., None]:
    """As ``FixtureManager.parsefactories``, which reads each attribute of each plugin.

    Modules of installed packages and of this one, and instances of their classes, that have no
    fixture are read once a process: they are most of what a session registers.
    """
    without: set[object] = set()

    def parsed(manager: Any, *args: Any, **given: Any) -> None:
        plugin = given.get("holder")
        key = plugin if isinstance(plugin, (ModuleType, type)) else type(plugin)
        if key in without:
            return
        parse(manager, *args, **given)
        if plugin is not None and _is_installed(key) and not _has_fixtures(key):
            without.add(key)

    return parsed


def _is_installed(key: Any) -> bool:
    name = key.__name__ if isinstance(key, ModuleType) else key.__module__
    file = getattr(sys.modules.get(name), "__file__", None) or "/"
    return name.startswith("pytest_dura.") or PACKAGES in Path(file).parents


def _has_fixtures(key: Any) -> bool:
    return any(type(getattr(key, name, None)) is FixtureFunctionDefinition for name in dir(key))
