"""Catalogue of faults: types by name, faults from files with errors that name the key, effects."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache, cached_property
from typing import Any, ClassVar, get_args

from pydantic import BaseModel, Field, ValidationError, create_model

from pytest_dura.core.classes import is_subclass
from pytest_dura.core.errors import ConfigurationError, corrected
from pytest_dura.core.fault import Fault
from pytest_dura.core.percepts import NOTHING
from pytest_dura.core.registry import Registry
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.faults.activation import DURATIONS, TRIGGERS, Activation, Duration
from pytest_dura.faults.model import FaultEffect
from pytest_dura.faults.parts import PARAMETERS, FaultPart, RefusedError

_PREFIX = "Input should be "
_OF_ANOTHER_TYPE = ("float_type", "literal_error", "model_type", "model_attributes_type")
_TAGGED = 2
"""Parts of the place of a duration as a whole: its key, and the tag of its form."""


def _fault_error(
    kind: type[BaseModel], data: Mapping[str, Any], error: ValidationError
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


def _described(kind: type[BaseModel], error: Any, name: str) -> tuple[str, str | None, str]:
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
        return f"{name!r} is no duration", DURATIONS, corrected(error["input"])
    if sort in ("model_type", "model_attributes_type"):
        below = _holder(kind, path)
        required = "a mapping with keys of " + ", ".join(below.model_fields if below else ())
    else:
        required = error["msg"].removeprefix(_PREFIX)
    meaning = _meaning(holder, name)
    expected = f"{required} ({meaning})" if meaning else required
    return f"{name!r} must be {required}", expected, corrected(error["input"])


def _missing(
    kind: type[BaseModel], path: Sequence[Any], name: str, meaning: str
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
    if is_subclass(annotation, BaseModel):
        yield annotation
    for inner in get_args(annotation):
        yield from _models(inner)


FAULT_TYPES: Registry[type[FaultEffect]] = Registry(
    "pytest_dura.faults",
    "fault",
    lambda value: is_subclass(value, FaultEffect),
    "a subclass of pytest_dura.FaultEffect",
    reserved=("none", "catalogue"),
)

BY_CHANCE = "by_chance"
"""Key of a fault's plain data that says whether chance decides its effect; derived, not given."""


def fault_class(name: str) -> type[FaultEffect]:
    """Import the class of a fault type: a registered name, or ``package.module:Class``.

    Raises:
        ConfigurationError: For an unknown type, and for a class that is not a type of fault.
    """
    if not isinstance(name, str) or ":" not in name:
        if name not in FAULT_TYPES:
            raise FAULT_TYPES.unknown(name, key="type", also="package.module:Class")
        return FAULT_TYPES[name]
    kind = RoleSpec(name).resolve()
    if not FAULT_TYPES.fits(kind):
        raise ConfigurationError(
            f"{name} is not a fault",
            key="type",
            found=name,
            expected=FAULT_TYPES.expected,
        )
    fault_type: type[FaultEffect] = kind
    return fault_type


class FaultForm(FaultPart):
    """Form of a fault in a file, in its types; that of a type of fault adds its ``parameters``."""

    type: str
    id: str = Field(min_length=1)
    target: str = Field(description="A channel, a field such as `odometry.speed`, or `command`.")
    activation: Activation
    duration: Duration | None = Field(
        None,
        description="In s; `once` (one tick); {min, max} (drawn); {until, at_most};"
        " {on, off, lasting} (intermittent); null for permanent.",
    )

    effect_class: ClassVar[Callable[..., FaultEffect]]

    @cached_property
    def effect(self) -> FaultEffect:
        """What it does while it acts."""
        given = {PARAMETERS: getattr(self, PARAMETERS)} if hasattr(self, PARAMETERS) else {}
        return self.effect_class(**given)

    @property
    def fault(self) -> Fault:
        """The fault as plain data, in which its type has a name that other processes know."""
        by_chance = self.activation.by_chance or self.effect.hits_by_chance
        plain = {**self.model_dump(mode="json"), "type": FAULT_TYPES.portable(self.type)}
        return Fault(**plain, by_chance=by_chance)


@cache
def form_of(kind: type[FaultEffect]) -> type[FaultForm]:
    """Make the form of a type's faults, with the name of the type's class."""
    fields: Any = {name: (field.annotation, field) for name, field in kind.model_fields.items()}
    form = create_model(kind.__name__, __base__=FaultForm, **fields)
    form.effect_class = kind
    return form


def fault_form(
    data: Mapping[str, Any] | Fault,
    targets: Mapping[str, str] = NOTHING,
    class_of: Callable[[str], type[FaultEffect]] = fault_class,
) -> FaultForm:
    """Validate a fault, with defaults for ``id`` (the type) and ``target``.

    Args:
        data: As in a scenario file; or a fault.
        targets: Default target of each kind that a type can act on.
        class_of: Returns the class of a type, as :func:`fault_class` does.

    Raises:
        ConfigurationError: For an unknown type or key, or a value out of range; ``key`` is the
            dotted path within the fault.
    """
    given = data.plain() if isinstance(data, Fault) else data
    kind = class_of(given.get("type", ""))
    filled = {"id": given["type"], **given}
    if ":" in given["type"]:  # an import path may be that of a registered type
        filled["type"] = FAULT_TYPES.name_of(given["type"]) or given["type"]
    filled.pop(BY_CHANCE, None)
    target = targets.get(kind.acts_on, kind.default_target)
    if target is not None:
        filled.setdefault("target", target)
    form = form_of(kind)
    try:
        return form.model_validate(filled)
    except ValidationError as error:
        raise _fault_error(form, filled, error) from None


def parse_fault(data: Mapping[str, Any], targets: Mapping[str, str] = NOTHING) -> Fault:
    """Read a fault of a file, defaults filled in; see :func:`fault_form`."""
    return fault_form(data, targets).fault


def fault_effect(fault: Fault) -> FaultEffect:
    """Make the effect of a fault, which its type's class says.

    Raises:
        ConfigurationError: See :func:`fault_form`.
    """
    return fault_form(fault).effect


def default_fault(name: str, targets: Mapping[str, str] = NOTHING) -> Fault:
    """Make a fault of a type of the catalogue, with its default activation and parameters."""
    return parse_fault({"type": name, **fault_class(name).example()}, targets)
