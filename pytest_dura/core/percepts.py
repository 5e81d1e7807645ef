"""What roles perceive: sealed channels, and views of them that note what is read."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import fields
from functools import lru_cache
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T")


class _Nothing(Mapping[str, Any]):
    """Empty mapping that, unlike an empty ``MappingProxyType``, can be pickled and hashed."""

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
"""Empty, read-only mapping: the default where a mapping is optional."""


class Lazy:
    """Channel value that is made when it is first read (a camera frame).

    Who reads it gets a copy of what can be changed, see :func:`sealed_parts`.
    """

    __slots__ = ("_make", "_value")

    def __init__(self, make: Callable[[], Any]) -> None:
        self._make: Callable[[], Any] | None = make
        self._value: Any = None

    def get(self) -> Any:
        """Return the value, made at the first call and kept; each caller has what it may change."""
        if self._make is not None:
            self._value, self._make = sealed_parts(self._make()), None
        return sealed_parts(self._value)


class Changeable:
    """Channel value that a role could change: each reading is a copy."""

    __slots__ = ("_value",)

    def __init__(self, value: Any) -> None:
        self._value = value

    def get(self) -> Any:
        """Return a copy."""
        return sealed_parts(self._value)


_ON_READING = {Lazy, Changeable}


def sealed(array: NDArray[Any]) -> NDArray[Any]:
    """Copy an array to one that cannot be made writeable; returns a sealed array itself.

    ``flags.writeable = False`` alone can be taken back by any holder of the array, so the numbers
    lie in ``bytes``. An array of objects is returned as it is.
    """
    base: Any = array.base
    while type(base) is np.ndarray:
        base = base.base
    if type(base) is bytes or array.dtype.hasobject:
        return array
    ndarray: NDArray[Any] = np.ndarray(array.shape, array.dtype, array.tobytes())
    return ndarray


def perceived(value: Any) -> Any:
    """Return what percepts hold of a channel's value, so that no role changes what others read."""
    own = sealed_parts(value)
    if own is value:
        return own
    is_changeable = type(own) in _CHANGEABLE or sealed_parts(own) is not own
    return Changeable(own) if is_changeable else own


def sealed_parts(value: Any) -> Any:
    """Copy what can be changed of a value; returns the value itself if there is no such part.

    Arrays are sealed. Lists, dictionaries, sets, byte arrays, their subclasses and dataclasses that
    are not frozen are copied. It looks into tuples, mapping proxies and dataclasses. An object of
    another class, or of one that cannot be copied, is as changeable as its class made it.
    """
    kind: Any = type(value)
    sealer = _sealer_of(kind)
    return value if sealer is None else sealer(value)


@lru_cache(maxsize=1024)  # a scene has thousands of values of few classes, at each tick
def _sealer_of(kind: Any) -> Callable[[Any], Any] | None:
    if kind in _SEALERS:
        return _SEALERS[kind]
    if issubclass(kind, tuple):
        return _sealed_tuple
    if issubclass(kind, (list, dict)):
        return _copied_container
    if issubclass(kind, (set, bytearray)):  # which hold nothing that could be changed
        return _copied
    return _sealed_fields if hasattr(kind, "__dataclass_fields__") else None


ATOMS = frozenset({type(None), bool, int, float, complex, str, bytes})
"""Types of values that hold nothing else, and cannot be changed."""
_CHANGEABLE = frozenset({list, dict, set, bytearray})


def _copied_list(value: list[Any]) -> list[Any]:
    if ATOMS.issuperset(map(type, value)):  # without a call for each part
        return value.copy()
    return list(map(sealed_parts, value))


def _copied_dict(value: dict[Any, Any]) -> dict[Any, Any]:
    if ATOMS.issuperset(map(type, value.values())):
        return value.copy()
    return {key: sealed_parts(part) for key, part in value.items()}


def _copied_container(value: Any) -> Any:
    """Copy a container of a class of its own, if that lets itself be copied."""
    pairs = value.items() if isinstance(value, dict) else enumerate(value)
    parts = [(place, part, sealed_parts(part)) for place, part in pairs]
    try:
        copied = copy(value)
        for place, part, own in parts:
            if own is not part:
                copied[place] = own
    except Exception:  # a class of the simulator's own may refuse a copy in any way of its own
        return value
    return copied


def _copied(value: Any) -> Any:
    try:
        return copy(value)
    except Exception:  # as in _copied_container
        return value


def _sealed_tuple(value: Any) -> Any:
    if ATOMS.issuperset(map(type, value)):  # the usual case
        return value
    for part in value:
        if sealed_parts(part) is not part:
            break
    else:
        return value
    parts = list(map(sealed_parts, value))
    kind = type(value)
    return kind._make(parts) if hasattr(kind, "_make") else kind(parts)


def _sealed_mapping(value: Any) -> Any:
    parts = {key: sealed_parts(part) for key, part in value.items()}
    if all(map(operator.is_, parts.values(), value.values())):
        return value
    return type(value)(parts)


_SEALERS: dict[type, Callable[[Any], Any]] = {
    np.ndarray: sealed,
    list: _copied_list,
    dict: _copied_dict,
    MappingProxyType: _sealed_mapping,
    set: set,
    bytearray: bytearray,
}
"""What seals or copies the values of a class."""


def _sealed_fields(value: Any) -> Any:
    parts = [(each.name, getattr(value, each.name, None)) for each in fields(value)]
    changed = [(name, own) for name, part in parts if (own := sealed_parts(part)) is not part]
    parameters = getattr(type(value), "__dataclass_params__", None)
    if not changed and getattr(parameters, "frozen", False):
        return value
    try:
        copied = copy(value)
        for name, own in changed:
            object.__setattr__(copied, name, own)
    except Exception:  # as in _copied_container
        return value
    return copied


class Percept(Mapping[str, Any]):
    """Channels as the sensors report them after faults; lazy values are made on reading.

    ``tampered`` maps a channel to the ids of the faults that changed its value at this tick, for
    the loop alone: views do not show it to roles. ``aliases`` are second names of channels, see
    :attr:`pytest_dura.Simulator.channel_aliases`: both names read the channel, and iteration
    yields its own name alone.
    """

    __slots__ = ("_channels", "_made", "aliases", "tampered")

    def __init__(
        self,
        channels: Mapping[str, Any],
        tampered: Mapping[str, tuple[str, ...]] = NOTHING,
        aliases: Mapping[str, str] = NOTHING,
    ) -> None:
        self._channels = channels
        self._made: dict[Any, Any] | None = None
        self.tampered = tampered
        self.aliases = aliases

    def __getitem__(self, name: str) -> Any:
        try:
            value = self._channels[name]
        except KeyError:
            return self._by_alias(name)
        return value.get() if type(value) in _ON_READING else value

    def __contains__(self, name: object) -> bool:
        if name in self._channels:
            return True
        return isinstance(name, str) and self.aliases.get(name) in self._channels

    def __iter__(self) -> Iterator[str]:
        return iter(self._channels)

    def __len__(self) -> int:
        return len(self._channels)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(self._channels)})"

    def once(self, make: Callable[[Percept], T]) -> T:
        """Call ``make`` with this percept, once; later calls with it return the same result.

        Roles that see the same percept share results, such as where on its route the ego is.

        Args:
            make: A function of the percept alone. Its result must be immutable, since it is
                shared. An exception is raised, and nothing is kept.
        """
        made = self._made
        if made is None:
            made = self._made = {}
        if make not in made:
            made[make] = make(self)
        result: T = made[make]
        return result

    def _by_alias(self, name: str) -> Any:
        """Read a channel by its second name.

        Raises:
            KeyError: If it has none, or is not there at this tick.
        """
        channel = self.aliases.get(name, name)
        if channel in self._channels:
            return self[channel]
        known = ", ".join(sorted(self._channels))
        raise KeyError(f"no sensor channel {name!r}; there are: {known}") from None


class TamperedReads:
    """Notes which faults changed what is read of one percept; it takes the names of channels.

    Args:
        tampered: Ids of the faults that changed a channel, by channel.
        faults: Where the ids go.
    """

    __slots__ = ("_tampered", "faults")

    def __init__(self, tampered: Mapping[str, tuple[str, ...]], faults: set[str]) -> None:
        self._tampered, self.faults = tampered, faults

    def add(self, name: str) -> None:
        """Note the faults of a channel that is read."""
        self.faults.update(self._tampered.get(name, ()))


class PerceptView(Percept):
    """Percept for a role: without ``tampered``, and with a record of the channels read."""

    __slots__ = ("_made_from", "_reads")

    def __init__(
        self,
        channels: Mapping[str, Any],
        reads: set[str] | TamperedReads,
        aliases: Mapping[str, str] = NOTHING,
    ) -> None:
        # Not by the base's __init__: views are made twice at each tick.
        self._channels, self._made, self.tampered = channels, None, NOTHING
        self.aliases = aliases
        self._reads = reads
        self._made_from: dict[Any, set[str]] | None = None
        if type(reads) is TamperedReads:
            self._made_from = {}

    def __getitem__(self, name: str) -> Any:
        # Not by the base's method: its call would double the cost, many times a tick.
        try:
            value = self._channels[name]
        except KeyError:
            self._reads.add(self.aliases.get(name, name))
            return self._by_alias(name)
        self._reads.add(name)
        return value.get() if type(value) in _ON_READING else value

    def __contains__(self, name: object) -> bool:
        # Faults change whether a channel is there, too.
        if isinstance(name, str):
            if name not in self._channels:
                name = self.aliases.get(name, name)
            self._reads.add(name)
        return name in self._channels

    def once(self, make: Callable[[Percept], T]) -> T:
        """See the base. Who takes a result has read the channels that it was made from."""
        made_from = self._made_from
        if made_from is None:
            return super().once(make)
        reads = self._reads
        names = made_from.get(make, set())
        if make not in made_from:
            self._reads = names
            try:
                super().once(make)
                made_from[make] = names
            finally:
                self._reads = reads
                for name in names:
                    reads.add(name)
        else:
            for name in names:
                reads.add(name)
        return super().once(make)


def shared(make: Callable[[Any], T], percept: Mapping[str, Any]) -> T:
    """``percept.once(make)``; of channels that are no percept, ``make(percept)``."""
    if type(percept) is PerceptView or isinstance(percept, Percept):
        return percept.once(make)
    return make(percept)


class History(Sequence[Any]):
    """Read-only view of a list that grows.

    Args:
        entries: The list.
        make: Makes what is read of an entry, where that is something else.
    """

    __slots__ = ("_entries", "_make")

    def __init__(self, entries: list[Any], make: Callable[[Any], Any] | None = None) -> None:
        self._entries, self._make = entries, make

    def __getitem__(self, index: Any) -> Any:
        entries, make = self._entries[index], self._make
        if make is None:
            return entries
        return [make(entry) for entry in entries] if isinstance(index, slice) else make(entries)

    def __len__(self) -> int:
        return len(self._entries)
