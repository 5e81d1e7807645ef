"""Columns that cannot be changed: what one requirement looks at, the next one looks at too."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray


class SealedColumns(dict[str, NDArray[Any]]):
    """Columns by name, neither of which can be written; ``dict(columns)`` is a copy that can grow.

    Args:
        columns: The columns. They are sealed in place.
    """

    def __init__(self, columns: Mapping[str, NDArray[Any]]) -> None:
        super().__init__(columns)
        for column in columns.values():
            np.asarray(column).flags.writeable = False

    def __reduce__(self) -> tuple[Any, ...]:
        """Copies and pickles are plain dictionaries."""
        return dict, (dict(self),)

    def _refuse(self, *_: object, **__: object) -> NoReturn:
        raise TypeError("the columns of an episode cannot be changed; take a copy, dict(columns)")

    __setitem__ = __delitem__ = __ior__ = _refuse
    clear = pop = popitem = setdefault = update = _refuse
