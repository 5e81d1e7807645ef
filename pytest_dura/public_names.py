"""Public names of packages of which every pytest run loads a part: imported at their first use."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


def imported_on_use(
    package: str, file: str
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Make the ``__getattr__`` and the ``__dir__`` of a package.

    Args:
        package: Its name.
        file: Its ``__file__``, beside whose stub ``__init__.pyi`` the public names are declared.
    """

    def public_name(name: str) -> Any:
        # Python asks for many names that no module has, such as those of its parts.
        if name.startswith("__") and name != "__all__":
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        import lazy_loader  # type: ignore[import-untyped]

        find, _, names = lazy_loader.attach_stub(package, file)
        return names if name == "__all__" else find(name)

    return public_name, lambda: sorted(public_name("__all__"))
