"""Refusals: what pydantic finds wrong with a fault, as one message that helps."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.faults.activation import TRIGGERS
from pytest_dura.faults.duration import DURATIONS
from pytest_dura.faults.model import Fault
from pytest_dura.faults.parts import RefusedError

_PREFIX = "Input should be "
_OF_ANOTHER_TYPE = ("float_type", "literal_error", "model_type", "model_attributes_type")
_TAGGED = 2
"""Parts of the place of a duration as a whole: its key, and the tag of what it was taken for."""


def refusal(
    kind: type[Fault], data: Mapping[str, Any], error: ValidationError
) -> ConfigurationError:
    """The first thing that is wrong with a fault; ``key`` is the path within it."""
    found = error.errors()
    # A misspelt key is also a missing one; the misspelling is what helps.
    first = next((one for one in found if one["type"] == "extra_forbidden"), found[0])
    place = _place(data, first)
    # Where a value may be of several types, each tells what is wrong; the one that fits has more
    # to say than that its type is another one.
    same_place = [one for one in found if _place(data, one) == place]
    first = next((one for one in same_place if not one["type"].endswith("_type")), first)
    problem, expected, remedy = _told(kind, first, place[-1] if place else "")
    value = first["input"]
    shown = first["type"] != "missing" and not isinstance(value, Mapping)
    return ConfigurationError(
        f"the fault {data['id']!r} cannot be used: {problem}",
        key=".".join(place) or None,
        found=value if shown else None,
        expected=expected,
        remedy=remedy,
    )


def _place(data: Any, error: Any) -> list[str]:
    """The keys that lead to an error, without the names that pydantic gives to types."""
    place, value = [], data
    for part in error["loc"]:
        if _leads_on(value, part):
            value = value[part]
        elif not (error["type"] == "missing" and part == error["loc"][-1]):
            continue
        place.append(str(part))
    return place


def _leads_on(value: Any, part: object) -> bool:
    if isinstance(value, Mapping):
        return part in value
    return isinstance(value, (list, tuple)) and isinstance(part, int) and part < len(value)


def _told(kind: type[Fault], error: Any, name: str) -> tuple[str, str | None, str]:
    """What is wrong, what would have been accepted, and what to do about it."""
    sort, path = error["type"], error["loc"]
    holder = _holder(kind, path[:-1])
    if sort == "extra_forbidden":
        known = sorted(holder.model_fields) if holder is not None else []
        near = difflib.get_close_matches(name, known, n=1)
        expected = "one of " + ", ".join(known) if known else "no key here"
        remedy = f"did you mean {near[0]!r}?" if near else "remove the key"
        return f"unknown key {name!r}", expected, remedy
    if sort == "missing":
        return _missing(kind, path, name, _meaning(holder, name))
    if sort == "value_error":
        cause = error["ctx"]["error"]
        if isinstance(cause, RefusedError):
            return str(cause), cause.expected, cause.remedy
        return str(cause), _meaning(holder, name) or None, "correct the value"
    if path[0] == "duration" and len(path) <= _TAGGED and sort in _OF_ANOTHER_TYPE:
        return f"{name!r} is no duration", DURATIONS, "correct the value"
    if sort in ("model_type", "model_attributes_type"):
        below = _holder(kind, path)
        wanted = "a mapping with keys of " + ", ".join(below.model_fields if below else ())
    else:
        wanted = error["msg"].removeprefix(_PREFIX)
    meaning = _meaning(holder, name)
    expected = f"{wanted} ({meaning})" if meaning else wanted
    return f"{name!r} must be {wanted}", expected, "correct the value"


def _missing(
    kind: type[Fault], path: Sequence[Any], name: str, meaning: str
) -> tuple[str, str | None, str]:
    if list(path) == ["target"]:
        problem = f"it has no target, and nothing says where a fault of type {kind.__name__} acts"
        return problem, meaning, "add `target: <channel>` or `target: <channel>.<field>`"
    if list(path) == ["activation"]:
        expected = f"one of {', '.join(TRIGGERS)}"
        return "nothing activates it", expected, "add `activation: {at: 2.0}`, for example"
    return f"the key {name!r} is missing", meaning or None, f"add `{name}: ...`"


def _is_tag(part: object) -> bool:
    """Whether pydantic put it into a place to say which kind of duration it took."""
    return isinstance(part, str) and part.startswith("<")


def _meaning(holder: type[BaseModel] | None, name: str) -> str:
    field = holder.model_fields.get(name) if holder is not None else None
    return (field.description or "").rstrip(".") if field is not None else ""


def _holder(kind: type[BaseModel], path: Sequence[Any]) -> type[BaseModel] | None:
    """The model whose keys stand at a path; ``None`` where no model says which they are."""
    options = [kind]
    for part in path:
        if _is_tag(part):
            options = [one for one in options if f"<{one.__name__.lower()}>" == part]
        elif isinstance(part, str):
            fields = [one.model_fields[part] for one in options if part in one.model_fields]
            options = list(_models(fields[0].annotation)) if fields else []
    return options[0] if options else None


def _models(annotation: Any) -> Iterator[type[BaseModel]]:
    """The models that an annotation mentions."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in get_args(annotation):
        yield from _models(inner)
