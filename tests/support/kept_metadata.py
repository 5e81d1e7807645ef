"""What sessions read of installed distributions: plugins, versions and modules."""

from __future__ import annotations

import importlib.metadata
import sys
from types import ModuleType
from typing import Any


def kept_metadata() -> list[tuple[type, str, property]]:
    """Properties that read once of each distribution, with the classes and names they replace.

    Each session asks for them, which takes a fifth of a short one.
    """
    # Dask imports the backport, which takes the place of the standard library's.
    backport = sys.modules.get("importlib_metadata")
    return [
        (module.PathDistribution, name, _kept(module, name))
        for module in (importlib.metadata, *filter(None, [backport]))
        for name in ("entry_points", "files", "metadata")
    ]


def _kept(module: ModuleType, name: str) -> property:
    read = getattr(module.Distribution, name).fget
    known: dict[str, Any] = {}

    def get(distribution: Any) -> Any:
        path = str(distribution._path)
        if path not in known:
            known[path] = read(distribution)
        return known[path]

    return property(get)
