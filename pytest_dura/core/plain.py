"""Plain data: mappings, lists, tuples, texts and numbers, and copies of exactly these types.

What a component hands over may be of classes whose methods do anything: raise, block, answer
differently each time. So the loop works with copies whose types are Python's and NumPy's own. They
are made by the methods of those types, without calling what a subclass overrides.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

DEEPEST = 32
"""Containers within each other in a value that is copied to exact types."""

EXACT = frozenset({type(None), bool, int, float, complex, str, bytes})
"""Types of values that hold nothing else, and cannot be changed."""
_dtype_of: Any = vars(np.ndarray)["dtype"].__get__


def plain_copy(value: Any) -> Any:
    """A copy of plain data, down to the last container."""
    if isinstance(value, Mapping):
        return {key: plain_copy(item) for key, item in value.items()}
    if isinstance(value, list):
        return [plain_copy(item) for item in value]
    return tuple(plain_copy(item) for item in value) if isinstance(value, tuple) else value


def exact_copy(value: Any) -> tuple[Any, bool]:
    """A copy of exact types, and whether it is plain throughout.

    Numbers, texts, lists, dictionaries and NumPy arrays of numbers become ``int``, ``float``,
    ``str``, ``list``, ``dict`` and ``ndarray``, whatever subclass they are of; so does the value of
    an enumeration of texts or numbers. An object of any other class, such as a named tuple or a
    dataclass, is handed on as it is: then the copy is not plain.

    Raises:
        ValueError: For containers that are nested too deeply, or in themselves.
    """
    if type(value) in EXACT:
        return value, True
    if _base_of(type(value)) is None:
        return value, False
    copier = _Copier()
    copied = copier.copy(value, 0)
    return copied, copier.is_plain


class _Copier:
    """Copies one value, and notes what it left as it is."""

    __slots__ = ("is_plain",)

    def __init__(self) -> None:
        self.is_plain = True

    def copy(self, value: Any, above: int) -> Any:
        kind = type(value)
        if kind in EXACT:
            return value
        if above > DEEPEST:
            raise ValueError(f"it holds more than {DEEPEST} containers within each other")
        base = _base_of(kind)
        if base is dict:
            items = value.items() if kind is MappingProxyType else dict.items(value)
            return {self.copy(key, above + 1): self.copy(item, above + 1) for key, item in items}
        if base is list:
            return [self.copy(item, above + 1) for item in list.__iter__(value)]
        if base is tuple:
            return tuple([self.copy(item, above + 1) for item in value])
        if base is np.ndarray and not _dtype_of(value).hasobject:
            return np.array(value, copy=True, subok=False)
        if base is not None and base is not np.ndarray:
            value = _EXACTLY[base](value)
        self.is_plain &= type(value) in EXACT
        return value


_EXACTLY: dict[Any, Any] = {
    str: str.__str__,
    float: float.__float__,
    int: int.__int__,
    bytes: lambda value: bytes.__getitem__(value, slice(None)),
    np.generic: np.generic.item,
}


def _base_of(kind: type[Any]) -> type[Any] | None:
    """The class as whose instance a value is copied; ``None`` where it is left as it is."""
    known = _KNOWN.get(id(kind))
    if known is None:
        found = next((base for base in _BASES if issubclass(kind, base)), None)
        if kind is tuple or kind is MappingProxyType:
            found = tuple if kind is tuple else dict
        # By identity: to look up a class is to call its metaclass, which may be anybody's.
        known = _KNOWN[id(kind)] = kind, found
    return known[1]


_BASES: tuple[type[Any], ...] = (dict, list, np.ndarray, *_EXACTLY)
_KNOWN: dict[int, tuple[type[Any], type[Any] | None]] = {}
