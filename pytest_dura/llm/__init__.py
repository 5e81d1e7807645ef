"""Language models as the component under test (extra ``llm``).

Every pytest run loads the options in here; the public names are imported when they are first used.
"""

from __future__ import annotations

from typing import Any


def __getattr__(name: str) -> Any:
    # Python asks for many names that no module has, such as those of its parts.
    if name.startswith("__") and name != "__all__":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import lazy_loader

    public_name, _, names = lazy_loader.attach_stub(__name__, __file__)
    return names if name == "__all__" else public_name(name)


def __dir__() -> list[str]:
    return sorted(__getattr__("__all__"))
