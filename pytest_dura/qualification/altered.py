"""Altered values: a percept with one change, and an action with other numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any

from pytest_dura.core.percepts import NOTHING, Percept

Change = Callable[[str, Any], Any]
"""Returns the value of a channel as a mutant sees it, of the channel's name and its value."""


class AlteredPercept(Percept):
    """Percept as a mutant sees it; what is read of it counts as read of the percept itself.

    Args:
        percept: As the role got it.
        change: Changes the value of a channel.
    """

    __slots__ = ("_change", "_percept", "_seen")

    def __init__(self, percept: Percept, change: Change) -> None:
        super().__init__({}, NOTHING, percept.aliases)
        self._percept, self._change = percept, change
        self._seen: dict[str, Any] = {}

    def __getitem__(self, name: str) -> Any:
        value = self._percept[name]  # at each read, so that a fault of the channel is noted
        own = self.aliases.get(name, name)
        if own not in self._seen:
            self._seen[own] = self._change(own, value)
        return self._seen[own]

    def __contains__(self, name: object) -> bool:
        return name in self._percept

    def __iter__(self) -> Iterator[str]:
        return iter(self._percept)

    def __len__(self) -> int:
        return len(self._percept)


def with_numbers(action: Any, change: Callable[[float], float]) -> Any:
    """Copy an action with each of its floats changed.

    Whole numbers, truth values and texts name a choice and stay; so does an action without floats.

    Args:
        action: A number, a mapping, a sequence or a dataclass of such.
        change: Returns the new number.
    """
    if isinstance(action, float):
        return change(action)
    if isinstance(action, Mapping):
        return {key: with_numbers(value, change) for key, value in action.items()}
    if is_dataclass(action) and not isinstance(action, type):
        own = {field.name: getattr(action, field.name) for field in fields(action) if field.init}
        return replace(action, **{name: with_numbers(each, change) for name, each in own.items()})
    if isinstance(action, (list, tuple)):
        changed = [with_numbers(each, change) for each in action]
        named = getattr(action, "_make", None)
        return type(action)(changed) if named is None else named(changed)
    if hasattr(action, "dtype") and action.dtype.kind == "f":
        return action.__class__(change(action)) if action.ndim == 0 else _array(action, change)
    return action


def _array(action: Any, change: Callable[[float], float]) -> Any:
    changed = action.copy()
    changed.flat = [change(float(number)) for number in action.flat]
    return changed
