"""Old public names that work for one minor version, with a warning."""

from __future__ import annotations

import warnings
from typing import Any


def renamed(old: str, new: str) -> Any:
    """A read-only attribute under its old name, which warns and gives the new one.

    Args:
        old: The name that goes.
        new: The attribute or method that has it now.
    """

    def read(self: Any) -> Any:
        warnings.warn(
            f"{type(self).__name__}.{old} is now {new}; the old name goes with the next minor"
            " version",
            DeprecationWarning,
            stacklevel=2,
        )
        return getattr(self, new)

    return property(read, doc=f"Deprecated name of `{new}`.")
