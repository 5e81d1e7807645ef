"""Dependability testing of AI-enabled cyber-physical systems, as a pytest plugin.

The public names are those of ``__init__.pyi``. They are imported when they are first used, so that
loading the plugin stays cheap.
"""

from __future__ import annotations

import warnings
from typing import Any

import lazy_loader

__version__ = "0.1.0"
_public_name, _, _names = lazy_loader.attach_stub(__name__, __file__)
__all__ = [*_names, "__version__"]  # noqa: PLE0604 - all are texts

RENAMED = {"Bench": "Runner"}
"""Public names of version 0.1 and what they are now; they go with version 0.3."""


def __getattr__(name: str) -> Any:
    new = RENAMED.get(name, name)
    if new != name:
        text = f"pytest_dura.{name} has been renamed to pytest_dura.{new}"
        warnings.warn(text, DeprecationWarning, stacklevel=2)
    elif name not in _names:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return _public_name(new)


def __dir__() -> list[str]:
    return sorted(__all__)
