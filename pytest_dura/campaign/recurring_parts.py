"""Parts that many faults of a grid have in common, each read once."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pytest_dura.faults.catalogue import FAULT_TYPES
from pytest_dura.faults.parts import FaultPart

if TYPE_CHECKING:
    from pytest_dura.faults.model import Fault


@dataclass(frozen=True, slots=True)
class Part:
    """A part of a fault, such as its activation.

    Args:
        data: The very object that was read. Held, since it is known by its identity.
        read: What the catalogue made of it.
        plain: That in plain data, with all defaults.
    """

    data: Any
    read: FaultPart
    plain: Any


class RecurringParts:
    """What has been read of faults, by the type of the fault, the key, and the very object.

    A grid of two keys with a hundred values each has ten thousand faults, and two hundred parts.
    Only types of the catalogue share their parts: one of the user's own may look at how they
    are written.
    """

    def __init__(self) -> None:
        self._known: dict[tuple[str, str, int], Part] = {}

    def among(self, data: Mapping[str, Any], keys: Collection[str]) -> dict[str, Part]:
        """Those parts of a fault that are known."""
        kind = data.get("type")
        if not isinstance(kind, str):
            return {}
        found = {}
        for key in keys:
            part = self._known.get((kind, key, id(data.get(key))))
            if part is not None:
                found[key] = part
        return found

    def remember(
        self, data: Mapping[str, Any], key: str, fault: Fault, plain: Mapping[str, Any]
    ) -> None:
        """Remember what a fault has under a key, if that is a part of it at all."""
        read = getattr(fault, key, None)
        if fault.type in FAULT_TYPES and key in data and isinstance(read, FaultPart):
            given = data[key]
            self._known[fault.type, key, id(given)] = Part(given, read, plain[key])
