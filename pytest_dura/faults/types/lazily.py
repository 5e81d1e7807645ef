"""Changing a value that may not have been made yet."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np

from pytest_dura.core.state import Lazy

Change: TypeAlias = Callable[[Any, np.random.Generator], Any]


def later(value: Any, rng: np.random.Generator, change: Change) -> Any:
    """The value after a change; that of a lazy value is made when somebody reads it.

    The change gets random numbers that depend neither on when that is, nor on whether the value
    is lazy, which another fault may have put an end to: their seed is drawn now.
    """
    seed = rng.integers(2**63)
    if type(value) is not Lazy:
        return change(value, np.random.default_rng(seed))
    return Lazy(lambda: change(value.get(), np.random.default_rng(seed)))
