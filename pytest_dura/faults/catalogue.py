"""Catalogue of faults: types by name, and faults from plain data, with errors that name the key."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.core.state import NOTHING
from pytest_dura.faults.activation import DURATIONS, TRIGGERS
from pytest_dura.faults.model import Fault
from pytest_dura.faults.parts import RefusedError

_PREFIX = "Input should be "
_OF_ANOTHER_TYPE = ("float_type", "literal_error", "model_type", "model_attributes_type")
_TAGGED = 2
"""Parts of the place of a duration as a whole: its key, and the tag of its form."""


def _fault_error(
    kind: type[Fault], data: Mapping[str, Any], error: ValidationError
) -> ConfigurationError:
    """Convert the most helpful of pydantic's errors; ``key`` is the path within the fault."""
    errors = error.errors()
    # A misspelt key is also a missing one; the misspelling helps more.
    first = next((entry for entry in errors if entry["type"] == "extra_forbidden"), errors[0])
    place = _place(data, first)
    # A value that may be of several types has an error for each; the one that is not about the
    # type is of the type that fits.
    same_place = [entry for entry in errors if _place(data, entry) == place]
    first = next((entry for entry in same_place if not entry["type"].endswith("_type")), first)
    problem, expected, remedy = _described(kind, first, place[-1] if place else "")
    value = first["input"]
    is_shown = first["type"] != "missing" and not isinstance(value, Mapping)
    return ConfigurationError(
        f"the fault {data['id']!r} cannot be used: {problem}",
        key=".".join(place) or None,
        found=value if is_shown else None,
        expected=expected,
        remedy=remedy,
    )


def _place(data: Any, error: Any) -> list[str]:
    """Keys that lead to an error, without the names that pydantic gives to types."""
    place, value = [], data
    for part in error["loc"]:
        if _has_part(value, part):
            value = value[part]
        elif not (error["type"] == "missing" and part == error["loc"][-1]):
            continue
        place.append(str(part))
    return place


def _has_part(value: Any, part: object) -> bool:
    if isinstance(value, Mapping):
        return part in value
    return isinstance(value, (list, tuple)) and isinstance(part, int) and part < len(value)


def _described(kind: type[Fault], error: Any, name: str) -> tuple[str, str | None, str]:
    """Problem, expected values, and remedy."""
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
        required = "a mapping with keys of " + ", ".join(below.model_fields if below else ())
    else:
        required = error["msg"].removeprefix(_PREFIX)
    meaning = _meaning(holder, name)
    expected = f"{required} ({meaning})" if meaning else required
    return f"{name!r} must be {required}", expected, "correct the value"


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
    """Whether a part of a place is pydantic's tag of the form of a duration."""
    return isinstance(part, str) and part.startswith("<")


def _meaning(holder: type[BaseModel] | None, name: str) -> str:
    field = holder.model_fields.get(name) if holder is not None else None
    return (field.description or "").rstrip(".") if field is not None else ""


def _holder(kind: type[BaseModel], path: Sequence[Any]) -> type[BaseModel] | None:
    """Model whose keys stand at a path; ``None`` without any."""
    options = [kind]
    for part in path:
        if _is_tag(part):
            options = [option for option in options if f"<{option.__name__.lower()}>" == part]
        elif isinstance(part, str):
            fields = [
                option.model_fields[part] for option in options if part in option.model_fields
            ]
            options = list(_models(fields[0].annotation)) if fields else []
    return options[0] if options else None


def _models(annotation: Any) -> Iterator[type[BaseModel]]:
    """Models that an annotation mentions."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in get_args(annotation):
        yield from _models(inner)


FAULT_TYPES: dict[str, str] = {
    "bias": "pytest_dura.faults.types.scalar:Bias",
    "drift": "pytest_dura.faults.types.scalar:Drift",
    "noise": "pytest_dura.faults.types.scalar:Noise",
    "gain": "pytest_dura.faults.types.scalar:Gain",
    "stuck-at": "pytest_dura.faults.types.scalar:StuckAt",
    "bit-flip": "pytest_dura.faults.types.scalar:BitFlip",
    "out-of-range": "pytest_dura.faults.types.scalar:OutOfRange",
    "freeze": "pytest_dura.faults.types.timing:Freeze",
    "omission": "pytest_dura.faults.types.timing:Omission",
    "delay": "pytest_dura.faults.types.timing:Delay",
    "slow": "pytest_dura.faults.types.timing:Slow",
    "intermittent": "pytest_dura.faults.types.timing:Intermittent",
    "latency": "pytest_dura.faults.types.communication:Latency",
    "loss": "pytest_dura.faults.types.communication:Loss",
    "reorder": "pytest_dura.faults.types.communication:Reorder",
    "duplicate": "pytest_dura.faults.types.communication:Duplicate",
    "corruption": "pytest_dura.faults.types.communication:Corruption",
    "denial": "pytest_dura.faults.types.communication:Denial",
    "replay": "pytest_dura.faults.types.communication:Replay",
    "masquerade": "pytest_dura.faults.types.communication:Masquerade",
    "loss-of-effectiveness": "pytest_dura.faults.types.scalar:LossOfEffectiveness",
    "lag": "pytest_dura.faults.types.scalar:Lag",
    "stuck-command": "pytest_dura.faults.types.scalar:StuckCommand",
    "inversion": "pytest_dura.faults.types.scalar:Inversion",
    "brightness": "pytest_dura.faults.types.image:Brightness",
    "salt-and-pepper": "pytest_dura.faults.types.image:SaltAndPepper",
    "patch": "pytest_dura.faults.types.image:Patch",
    "perturbation": "pytest_dura.faults.types.perturbation:Perturbation",
    "ghost-obstacle": "pytest_dura.driving.object_faults:GhostObstacle",
    "trajectory-spoof": "pytest_dura.driving.object_faults:TrajectorySpoof",
    "object-miss": "pytest_dura.driving.object_faults:ObjectMiss",
    "position-noise": "pytest_dura.driving.object_faults:PositionNoise",
    "range-cut": "pytest_dura.driving.object_faults:RangeCut",
    "class-change": "pytest_dura.driving.object_faults:ClassChange",
    "id-switch": "pytest_dura.driving.object_faults:IdSwitch",
    "moved-obstacle": "pytest_dura.driving.object_faults:MovedObstacle",
    "gnss-jump": "pytest_dura.driving.channel_faults:GnssJump",
    "gnss-drag-off": "pytest_dura.driving.channel_faults:GnssDragOff",
    "gnss-jam": "pytest_dura.driving.channel_faults:GnssJam",
    "prompt-text": "pytest_dura.driving.channel_faults:PromptText",
    "prompt-drop": "pytest_dura.llm.faults:PromptDrop",
    "prompt-reorder": "pytest_dura.llm.faults:PromptReorder",
    "prompt-paraphrase": "pytest_dura.llm.faults:PromptParaphrase",
    "model-failure": "pytest_dura.llm.faults:ModelFailure",
    "model-delay": "pytest_dura.llm.faults:ModelDelay",
}
"""Type name to import path; a type is imported when it is used."""

BY_CHANCE = "by_chance"
"""Key of a fault's plain data that says whether chance decides its effect; derived, not given."""


def fault_class(name: str) -> type[Fault]:
    """Import the class of a fault type: a name of the catalogue, or ``package.module:Class``.

    Raises:
        ConfigurationError: For an unknown type, and for a class that is no fault.
    """
    if isinstance(name, str) and name in FAULT_TYPES:
        return _import(FAULT_TYPES[name])
    if not isinstance(name, str) or ":" not in name:
        near = difflib.get_close_matches(str(name), FAULT_TYPES, n=1)
        raise ConfigurationError(
            f"unknown fault {name!r}",
            key="type",
            found=name,
            expected="package.module:Class, or one of " + ", ".join(sorted(FAULT_TYPES)),
            remedy=f"did you mean {near[0]!r}?" if near else "choose a type of the catalogue",
        )
    return _import(name)


def _import(path: str) -> type[Fault]:
    kind = RoleSpec(path).resolve()
    if not (isinstance(kind, type) and issubclass(kind, Fault)):
        raise ConfigurationError(
            f"{path} is not a fault",
            key="type",
            found=path,
            expected="a subclass of pytest_dura.faults.model.Fault",
        )
    return kind


def load_fault(data: Mapping[str, Any], targets: Mapping[str, str] = NOTHING) -> Fault:
    """Make a fault of plain data, with defaults for ``id`` (the type) and ``target``.

    Args:
        data: As in a scenario file; or the result of :func:`parse_fault`.
        targets: Default target of each kind that a type can act on.

    Raises:
        ConfigurationError: For an unknown type or key, or a value out of range; ``key`` is the
            dotted path within the fault.
    """
    kind = fault_class(data.get("type", ""))
    filled = {"id": data["type"], **data}
    filled.pop(BY_CHANCE, None)
    target = targets.get(kind.acts_on, kind.default_target)
    if target is not None:
        filled.setdefault("target", target)
    try:
        return kind.model_validate(filled)
    except ValidationError as error:
        raise _fault_error(kind, filled, error) from None


def parse_fault(data: Mapping[str, Any], targets: Mapping[str, str] = NOTHING) -> dict[str, Any]:
    """Fill every default into plain data; see :func:`load_fault`."""
    return plain_fault(load_fault(data, targets))


def plain_fault(fault: Fault) -> dict[str, Any]:
    """Dump a fault as plain data, from which :func:`load_fault` makes an equal one."""
    return {**fault.model_dump(mode="json"), BY_CHANCE: fault.by_chance}


def default_fault(name: str, targets: Mapping[str, str] = NOTHING) -> dict[str, Any]:
    """Plain data of a type of the catalogue, with its default activation and parameters."""
    return parse_fault({"type": name, **fault_class(name).example()}, targets)
