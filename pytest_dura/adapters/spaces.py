"""Actions of a Gymnasium space: checked, described, and one to fall back to."""

from __future__ import annotations

from numbers import Integral
from typing import TYPE_CHECKING, Any

import numpy as np

from pytest_dura.core.errors import ActionError, shorten

if TYPE_CHECKING:
    import gymnasium


def to_action(space: gymnasium.Space[Any], action: Any) -> Any:
    """The action as an element of the space.

    Raises:
        ActionError: If it is none, with what is expected.
    """
    from gymnasium.spaces import Box, Discrete

    if action is None:
        raise ActionError(f"the proposal holds no action (None); expected {space}")
    if isinstance(space, Discrete):
        return _choice(int(space.start), int(space.n), action)
    if isinstance(space, Box):
        return _vector(space, action)
    if not space.contains(action):
        raise ActionError(f"{shorten(action)} is not an element of {space}")
    return action


def default_action(space: gymnasium.Space[Any]) -> Any:
    """The first choice of a discrete space, the zero of a box (or what is nearest to it).

    ``None``, which is no action, for any other space.
    """
    from gymnasium.spaces import Box, Discrete

    if isinstance(space, Discrete):
        return int(space.start)
    if isinstance(space, Box):
        return np.clip(np.zeros(space.shape, dtype=space.dtype), space.low, space.high)
    return None


def describe(action: Any) -> str:
    """The action's numbers, the same text in every process."""
    if isinstance(action, np.ndarray):
        return "[" + ", ".join(f"{value:.6g}" for value in action.ravel().tolist()) + "]"
    return str(action)


def _choice(start: int, count: int, action: Any) -> int:
    whole = isinstance(action, Integral) and not isinstance(action, (bool, np.bool_))
    if not whole or not start <= int(action) < start + count:
        raise ActionError(
            f"{shorten(action)} is not an action; expected a whole number"
            f" from {start} to {start + count - 1}"
        )
    return int(action)


def _vector(space: Any, action: Any) -> Any:
    expected = f"{space.shape} numbers from {_bounds(space.low)} to {_bounds(space.high)}"
    try:
        vector = np.array(action, dtype=space.dtype)
    except (TypeError, ValueError):
        raise ActionError(f"{shorten(action)} is not an action; expected {expected}") from None
    if vector.shape != space.shape:
        raise ActionError(f"the action has the shape {vector.shape}; expected {expected}")
    if np.isnan(vector).any():
        raise ActionError(f"the action holds NaN; expected {expected}")
    if (vector < space.low).any() or (vector > space.high).any():
        raise ActionError(f"{describe(vector)} is out of bounds; expected {expected}")
    vector.flags.writeable = False
    return vector


def _bounds(values: Any) -> str:
    first = values.ravel()[0] if values.size else 0
    return f"{first:g}" if (values == first).all() else describe(values)
