"""Any value, flattened to its leaves: to compare two bit by bit and say where they differ."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from typing import Any

import numpy as np

from pytest_dura.core.state import Lazy

_PLAIN = (str, bytes, int, float, complex, type(None))


def leaves(value: Any) -> dict[str, Any]:
    """Path to leaf, for every leaf of a value; leaves are immutable, so this is a copy as well.

    Floats and arrays are kept as bytes: NaN equals NaN, and 0.0 differs from -0.0. Lazy values
    stay unmade. What has neither items nor attributes counts by its type alone.
    """
    return dict(_walk(value, "", ()))


def first_difference(one: Mapping[str, Any], other: Mapping[str, Any]) -> str | None:
    """The first path at which two results of :func:`leaves` differ, or ``None``."""
    for path in [*one, *(path for path in other if path not in one)]:
        if path not in one or path not in other or one[path] != other[path]:
            return path or "the value"
    return None


def mutable_parts(value: Any) -> list[str]:
    """Where a value could be changed in place, each as ``path (what it is)``."""
    return [f"{path or 'the value'} ({kind})" for path, kind in _mutable(value, "", ())]


def _walk(value: Any, path: str, above: tuple[int, ...]) -> Iterator[tuple[str, Any]]:
    if isinstance(value, Enum):
        yield path, (type(value).__name__, value.name)
    elif isinstance(value, float):
        yield path, np.float64(value).tobytes()
    elif isinstance(value, (np.ndarray, np.generic)) and value.dtype != object:
        yield path, (value.dtype.str, value.shape, value.tobytes())
    elif isinstance(value, _PLAIN):
        yield path, value
    elif isinstance(value, Lazy) or id(value) in above:
        yield path, type(value).__name__
    else:
        yield f"{path}<type>", type(value).__qualname__
        for name, part in _parts(value):
            yield from _walk(part, path + name, (*above, id(value)))


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
        for key in sorted(value, key=repr):
            # Reading a lazy channel through a percept would make it.
            channels = getattr(value, "_channels", value)
            yield f"[{key!r}]", channels[key]
    elif isinstance(value, tuple) and hasattr(value, "_fields"):
        for name in value._fields:
            yield f".{name}", getattr(value, name)
    elif isinstance(value, (list, tuple)):
        for index, item in enumerate(value):
            yield f"[{index}]", item
    elif isinstance(value, np.ndarray):
        for index, item in enumerate(value.ravel().tolist()):
            yield f"[{index}]", item
    elif isinstance(value, (set, frozenset)):
        for index, item in enumerate(sorted(value, key=repr)):
            yield f"{{{index}}}", item
    elif is_dataclass(value) and not isinstance(value, type):
        for field in fields(value):
            yield f".{field.name}", getattr(value, field.name)
    elif not callable(value):
        for name in _attributes(value):
            yield f".{name}", getattr(value, name)


def _attributes(value: Any) -> list[str]:
    names = set(getattr(value, "__dict__", ()))
    for base in type(value).__mro__:
        slots = getattr(base, "__slots__", ())
        names.update((slots,) if isinstance(slots, str) else slots)
    names -= {"__dict__", "__weakref__"}
    return sorted(name for name in names if hasattr(value, name))
