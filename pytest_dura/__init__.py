"""Dependability testing of AI-enabled cyber-physical systems, as a pytest plugin.

The public names are those of ``__init__.pyi``. They are read and imported when they are first used,
so that loading the plugin stays cheap.

PYTEST_DONT_REWRITE
"""

from __future__ import annotations

from typing import Any

__version__ = "0.2.0.dev0"


def __getattr__(name: str) -> Any:
    # Python asks for many names that no module has, such as those of its parts.
    if name.startswith("__") and name != "__all__":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import lazy_loader

    public_name, _, names = lazy_loader.attach_stub(__name__, __file__)
    if name == "__all__":
        globals()["__all__"] = [*names, "__version__"]
        return globals()["__all__"]
    if name not in names:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return public_name(name)


def __dir__() -> list[str]:
    names: list[str] = __getattr__("__all__")
    return sorted(names)
