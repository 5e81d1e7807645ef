"""Percepts: what sensors report, as the loop keeps it and as roles see it."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T")


class _Nothing(Mapping[str, Any]):
    """The empty mapping. Unlike an empty ``MappingProxyType`` it can be pickled and hashed."""

    __slots__ = ()

    def __getitem__(self, name: str) -> Any:
        raise KeyError(name)

    def __iter__(self) -> Iterator[str]:
        return iter(())

    def __len__(self) -> int:
        return 0

    def __hash__(self) -> int:
        return 0

    def __repr__(self) -> str:
        return "{}"

    def __reduce__(self) -> str:
        return "NOTHING"


NOTHING: Mapping[str, Any] = _Nothing()
"""The empty, read-only mapping: the default where a mapping is optional."""


class Lazy:
    """A channel value that is made when somebody first reads it (a camera frame).

    Its arrays are sealed, see :func:`sealed_parts`.
    """

    __slots__ = ("_make", "_value")

    def __init__(self, make: Callable[[], Any]) -> None:
        self._make: Callable[[], Any] | None = make
        self._value: Any = None

    def get(self) -> Any:
        """The value, made at the first call and kept."""
        if self._make is not None:
            self._value, self._make = sealed_parts(self._make()), None
        return self._value


def sealed(array: NDArray[Any]) -> NDArray[Any]:
    """A copy of an array that nobody can write to, nor make writeable; itself if it is one.

    ``flags.writeable = False`` alone can be taken back by whoever gets the array. The numbers lie
    in ``bytes``. An array of objects is returned as it is.
    """
    base: Any = array.base
    while type(base) is np.ndarray:
        base = base.base
    if type(base) is bytes or array.dtype.hasobject:
        return array
    found: NDArray[Any] = np.ndarray(array.shape, array.dtype, array.tobytes())
    return found


def sealed_parts(value: Any) -> Any:
    """A value in which no array can be written to; itself where there is nothing to seal.

    Looks into tuples, lists, dictionaries and dataclasses. An object of another class has to seal
    its arrays itself.
    """
    kind = type(value)
    if kind not in _SEALERS:
        _SEALERS[kind] = _sealer_of(kind)
    sealer = _SEALERS[kind]
    return value if sealer is None else sealer(value)


_SEALERS: dict[type[Any], Callable[[Any], Any] | None] = {}
"""What seals a value of a class; ``None`` for a class whose values are left alone."""


def _sealer_of(kind: type[Any]) -> Callable[[Any], Any] | None:
    if kind is np.ndarray:
        return sealed
    if issubclass(kind, (list, tuple)):
        return _sealed_sequence
    if kind is dict or kind is MappingProxyType:
        return _sealed_mapping
    return _sealed_fields if hasattr(kind, "__dataclass_fields__") else None


def _sealed_sequence(value: Any) -> Any:
    for item in value:
        if type(item) is not float and sealed_parts(item) is not item:
            break
    else:  # the usual case: numbers and texts
        return value
    parts = list(map(sealed_parts, value))
    kind = type(value)
    return kind._make(parts) if hasattr(kind, "_make") else kind(parts)


def _sealed_mapping(value: Any) -> Any:
    parts = {key: sealed_parts(item) for key, item in value.items()}
    if all(map(operator.is_, parts.values(), value.values())):
        return value
    return type(value)(parts)


def _sealed_fields(value: Any) -> Any:
    found = value
    for name in type(value).__dataclass_fields__:
        part = getattr(value, name, None)
        own = sealed_parts(part)
        if own is not part:
            found = copy(value) if found is value else found
            object.__setattr__(found, name, own)
    return found


class Percept(Mapping[str, Any]):
    """What the sensors report after faults: channel name to value. Lazy values resolve on reading.

    ``tampered`` maps a channel to the ids of the faults that changed its value at this tick.
    It is for the loop's own bookkeeping; views hand it to no role.
    """

    __slots__ = ("_channels", "_made", "tampered")

    def __init__(
        self, channels: Mapping[str, Any], tampered: Mapping[str, tuple[str, ...]] = NOTHING
    ) -> None:
        self._channels = channels
        self._made: dict[Any, Any] | None = None
        self.tampered = tampered

    def __getitem__(self, name: str) -> Any:
        try:
            value = self._channels[name]
        except KeyError:
            raise self._unknown(name) from None
        return value.get() if type(value) is Lazy else value

    def __contains__(self, name: object) -> bool:
        return name in self._channels

    def __iter__(self) -> Iterator[str]:
        return iter(self._channels)

    def __len__(self) -> int:
        return len(self._channels)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(self._channels)})"

    def once(self, make: Callable[[Percept], T]) -> T:
        """What ``make`` makes of this percept; later calls with the same function get it again.

        Roles that see one percept share what it comes to, such as where on its route the ego is.

        Args:
            make: A function of the percept alone. What it returns must be immutable: nobody may
                change what others get. What it raises is raised, and nothing is kept.
        """
        made = self._made
        if made is None:
            made = self._made = {}
        if make not in made:
            made[make] = make(self)
        found: T = made[make]
        return found

    def _unknown(self, name: str) -> KeyError:
        known = ", ".join(sorted(self._channels))
        return KeyError(f"no sensor channel {name!r}; there are: {known}")


class PerceptView(Percept):
    """A percept as a role sees it: without ``tampered``; it notes which channels were read."""

    __slots__ = ("_reads",)

    def __init__(self, channels: Mapping[str, Any], reads: set[str]) -> None:
        # As the base has it, whose own would be called twice at each tick.
        self._channels, self._made, self.tampered = channels, None, NOTHING
        self._reads = reads

    def __getitem__(self, name: str) -> Any:
        self._reads.add(name)
        # As the base has it; a call to it would cost as much again, many times a tick.
        try:
            value = self._channels[name]
        except KeyError:
            raise self._unknown(name) from None
        return value.get() if type(value) is Lazy else value

    def __contains__(self, name: object) -> bool:
        # Whether a channel is there at all is something that faults change, too.
        if isinstance(name, str):
            self._reads.add(name)
        return name in self._channels


def shared(make: Callable[[Any], T], percept: Mapping[str, Any]) -> T:
    """``percept.once(make)``, and for channels that are no percept ``make`` of them."""
    if type(percept) is PerceptView or isinstance(percept, Percept):
        return percept.once(make)
    return make(percept)


class History(Sequence[Any]):
    """A read-only window on a list that grows."""

    __slots__ = ("_items",)

    def __init__(self, items: list[Any]) -> None:
        self._items = items

    def __getitem__(self, index: Any) -> Any:
        return self._items[index]

    def __len__(self) -> int:
        return len(self._items)
