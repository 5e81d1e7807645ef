"""Any value, flattened to its leaves: to compare two bit by bit and say where they differ."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from enum import Enum
from typing import Any

import numpy as np

from pytest_dura.core.state import Lazy

_HIDDEN = ("__dict__", "__weakref__")
_PLAIN = (str, bytes, int, float, complex, type(None))
_bytes_of = struct.Struct("d").pack


def leaves(value: Any) -> dict[str, Any]:
    """Path to leaf, for every leaf of a value; leaves are immutable, so this is a copy as well.

    Floats and arrays are kept as bytes: NaN equals NaN, and 0.0 differs from -0.0. Lazy values
    stay unmade. What has neither items nor attributes counts by its type alone.
    """
    found: dict[str, Any] = {}
    _gather(value, "", (), found)
    return found


def first_difference(one: Mapping[str, Any], other: Mapping[str, Any]) -> str | None:
    """The first path at which two results of :func:`leaves` differ, or ``None``."""
    for path in [*one, *(path for path in other if path not in one)]:
        if path not in one or path not in other or one[path] != other[path]:
            return path or "the value"
    return None


def mutable_parts(value: Any) -> list[str]:
    """Where a value could be changed in place, each as ``path (what it is)``."""
    return [f"{path or 'the value'} ({kind})" for path, kind in _mutable(value, "", ())]


def _gather(value: Any, path: str, above: tuple[int, ...], found: dict[str, Any]) -> None:
    # Most leaves are plain; the order of all other questions matters.
    kind = type(value)
    if kind is float or (isinstance(value, float) and not isinstance(value, Enum)):
        found[path] = _bytes_of(value)
    elif kind is bool:
        found[path] = (kind.__name__, value)  # False would equal 0
    elif kind in _PLAIN:
        found[path] = value
    elif isinstance(value, Enum):
        found[path] = (kind.__name__, value.name)
    elif isinstance(value, (np.ndarray, np.generic)) and value.dtype != object:
        found[path] = (value.dtype.str, value.shape, value.tobytes())
    elif isinstance(value, _PLAIN):
        found[path] = value
    elif isinstance(value, Lazy) or id(value) in above:
        found[path] = kind.__name__
    else:
        found[f"{path}<type>"] = kind.__qualname__
        above = (*above, id(value))
        for name, part in _parts(value):
            _gather(part, path + name, above, found)


def _mutable(value: Any, path: str, above: tuple[int, ...]) -> Iterator[tuple[str, str]]:
    if isinstance(value, (Enum, *_PLAIN, np.generic, Lazy)) or id(value) in above:
        return
    if isinstance(value, np.ndarray):
        if value.flags.writeable:
            yield path, "a writeable array"
        return
    if isinstance(value, (list, dict, set, bytearray)):
        yield path, f"a {type(value).__name__}"
        return
    for name, part in _parts(value):
        yield from _mutable(part, path + name, (*above, id(value)))


def _parts(value: Any) -> Iterator[tuple[str, Any]]:
    """The named parts of a container or object."""
    if isinstance(value, Mapping):
        # Reading a lazy channel through a percept would make it.
        items = getattr(value, "_channels", value)
        return ((f"[{key!r}]", items[key]) for key in sorted(value, key=repr))
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        return ((f".{name}", getattr(value, name)) for name in value._fields)
    if isinstance(value, (list, tuple)):
        return ((f"[{index}]", item) for index, item in enumerate(value))
    if isinstance(value, np.ndarray):
        return ((f"[{index}]", item) for index, item in enumerate(value.ravel().tolist()))
    if isinstance(value, (set, frozenset)):
        return ((f"{{{index}}}", item) for index, item in enumerate(sorted(value, key=repr)))
    names = [] if callable(value) else _attributes(value)
    return ((f".{name}", getattr(value, name)) for name in names)


def _is_hidden(name: str) -> bool:
    """Whether an attribute is no part of a value: what it has made of itself, to give it again."""
    return name in _HIDDEN or name.startswith("_made")


def _attributes(value: Any) -> list[str]:
    names: list[str] = []
    for base in reversed(type(value).__mro__):
        slots = vars(base).get("__slots__", ())
        names += (slots,) if isinstance(slots, str) else slots
    names += getattr(value, "__dict__", ())
    return [name for name in names if not _is_hidden(name) and hasattr(value, name)]
