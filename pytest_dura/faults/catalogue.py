"""The catalogue: fault types by name, and faults from plain data."""

from __future__ import annotations

import difflib
import importlib
from collections.abc import Mapping
from typing import Any

from pydantic import ValidationError

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.faults.model import Fault

FAULT_TYPES: dict[str, str] = {
    "ghost-obstacle": "pytest_dura.driving.faults:GhostObstacle",
    "trajectory-spoof": "pytest_dura.driving.faults:TrajectorySpoof",
}
"""Type name to import path; a domain's faults are imported when one is used."""


def fault_class(name: str) -> type[Fault]:
    """The class of a fault type.

    Raises:
        ConfigurationError: For an unknown type.
    """
    if name not in FAULT_TYPES:
        near = difflib.get_close_matches(str(name), FAULT_TYPES, n=1)
        raise ConfigurationError(
            f"unknown fault {name!r}",
            key="type",
            found=name,
            expected="one of " + ", ".join(sorted(FAULT_TYPES)),
            remedy=f"did you mean {near[0]!r}?" if near else "choose a type of the catalogue",
        )
    module, _, attribute = FAULT_TYPES[name].partition(":")
    found: type[Fault] = getattr(importlib.import_module(module), attribute)
    return found


def load_fault(data: Mapping[str, Any]) -> Fault:
    """A fault from plain data, with defaults for ``id`` (the type) and ``target``.

    Raises:
        ConfigurationError: For an unknown type or key, or a value out of range; ``key`` is the
            dotted path within the fault.
    """
    kind = fault_class(data.get("type", ""))
    filled = {"id": data["type"], "target": kind.default_target, **data}
    try:
        return kind.model_validate(filled)
    except ValidationError as error:
        # A misspelt key is also a missing one; the misspelling is what helps.
        found = error.errors()
        first = next((one for one in found if one["type"] == "extra_forbidden"), found[0])
        place = ".".join(str(part) for part in first["loc"])
        expected, remedy = first["msg"], None
        if first["type"] == "extra_forbidden":
            known = _keys_at(kind, first["loc"][:-1])
            near = difflib.get_close_matches(str(first["loc"][-1]), known, n=1)
            expected = "one of " + ", ".join(known)
            remedy = f"did you mean {near[0]!r}?" if near else "remove the key"
        raise ConfigurationError(
            f"the fault {filled['id']!r} cannot be used: {first['msg']}",
            key=place,
            found=first["input"],
            expected=expected,
            remedy=remedy or "correct the value",
        ) from None


def parse_fault(data: Mapping[str, Any]) -> dict[str, Any]:
    """Plain data with every default filled in; see :func:`load_fault`."""
    return load_fault(data).model_dump(mode="json")


def default_fault(name: str) -> dict[str, Any]:
    """A fault of the catalogue with its default activation and parameters, by its type's name."""
    return parse_fault({"type": name, **fault_class(name).example()})


def _keys_at(kind: Any, path: tuple[int | str, ...]) -> list[str]:
    fields = kind.model_fields
    for part in path:
        fields = fields[str(part)].annotation.model_fields
    return sorted(fields)
