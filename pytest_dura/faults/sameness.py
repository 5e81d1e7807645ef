"""Whether a fault left a value as it was."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


def same(before: Any, after: Any) -> bool:
    """Whether two values are the same, by identity or by value.

    NaN is the same as NaN. Types must be the same, but for numbers. Lazy values, which would have
    to be made to be compared, are the same only if they are one object.
    """
    if before is after:
        return True
    if isinstance(before, _NUMBER) and isinstance(after, _NUMBER):
        return bool(before == after) or bool(np.isnan(before) and np.isnan(after))
    return type(before) is type(after) and _same_of_type(before, after)


_NUMBER = (int, float, np.number)


def _same_of_type(before: Any, after: Any) -> bool:
    if isinstance(before, np.ndarray):
        return before.dtype == after.dtype and _same_arrays(before, after)
    if isinstance(before, (list, tuple)):
        return len(before) == len(after) and all(map(same, before, after))
    if isinstance(before, Mapping):
        return before.keys() == after.keys() and all(same(before[k], after[k]) for k in before)
    if is_dataclass(before) and "__eq__" in vars(type(before)):
        names = (one.name for one in fields(before) if one.compare)
        return all(same(getattr(before, name), getattr(after, name)) for name in names)
    try:
        return bool(before == after)
    except (TypeError, ValueError):  # of a foreign type that holds arrays: taken as changed
        return False


def _same_arrays(before: NDArray[Any], after: NDArray[Any]) -> bool:
    if before.dtype.kind == "O":
        return before.shape == after.shape and all(map(same, before.flat, after.flat))
    return np.array_equal(before, after, equal_nan=before.dtype.kind in "fc")
