"""The pytest plugin's entrance, which every pytest run loads where the package is installed.

What a session needs is imported once an option, a setting, an argument or a test asks for it.

PYTEST_DONT_REWRITE
"""

from __future__ import annotations

import sys
from importlib.abc import MetaPathFinder
from importlib.machinery import PathFinder
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence
    from importlib.machinery import ModuleSpec
    from types import ModuleType


class OrdinaryLoading(MetaPathFinder):
    """Finder that lets Python load the package's other modules as it loads any package.

    pytest rewrites the asserts of all modules of a plugin, also where it then leaves them as they
    are, and cannot keep the result where packages are read-only: there each session would compile
    the package anew, whose ordinary bytecode lies beside it.
    """

    @staticmethod
    def find_spec(
        name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Find a module of the package, and no other."""
        if not name.startswith("pytest_dura."):
            return None
        return PathFinder.find_spec(name, path, target)


if not any(isinstance(finder, OrdinaryLoading) for finder in sys.meta_path):
    sys.meta_path.insert(0, OrdinaryLoading())

from pytest_dura.plugin.waiting import (  # noqa: E402 - loaded by that finder
    pytest_addhooks,
    pytest_addoption,
    pytest_cmdline_main,
    pytest_configure,
)

__all__ = ["pytest_addhooks", "pytest_addoption", "pytest_cmdline_main", "pytest_configure"]
