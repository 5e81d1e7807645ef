"""Turns a YAML document into a model, and pydantic's errors into messages with file and line."""

from __future__ import annotations

import types
from collections.abc import Iterator, Mapping
from typing import Any, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError

from pytest_dura.campaign.problems import combine, did_you_mean
from pytest_dura.campaign.yaml_source import Document
from pytest_dura.core.errors import ConfigurationError

Model = TypeVar("Model", bound=BaseModel)


def validate(model: type[Model], document: Document, data: object = None, at: str = "") -> Model:
    """An instance of the model from a document's data, or from the part of it that stands at a key.

    Raises:
        ConfigurationError: One for all that is wrong, with file, lines, keys and remedies.
    """
    try:
        return model.model_validate(document.data if data is None else data)
    except ValidationError as error:
        raise translate(error, model, document, at) from None


def translate(
    error: ValidationError, model: type[BaseModel], document: Document, at: str = ""
) -> ConfigurationError:
    """One message for all that pydantic found in a document, or in its part at a key."""
    found = [_translate(model, document, at, problem) for problem in error.errors()]
    return combine(sorted(found, key=lambda one: (one.line or 0, one.key or "")))


def _translate(
    model: type[BaseModel], document: Document, at: str, problem: Any
) -> ConfigurationError:
    parts = [str(part) for part in problem["loc"] if not _is_tag(part)]
    key = ".".join([at, *parts] if at else parts)
    kind, found = problem["type"], problem["input"]
    holder = _model_at(model, parts[:-1])
    name = parts[-1] if parts else ""
    expected: str | None
    if kind == "extra_forbidden":
        text, expected = f"unknown key {name!r}", "one of " + ", ".join(holder.model_fields)
        found, remedy = name, did_you_mean(name, holder.model_fields)
    elif kind == "missing":
        text, expected, found = f"the key {name!r} is missing", _meaning(holder, name), None
        remedy = f"add `{name}: ...`"
    elif kind == "value_error":
        text = str(problem["ctx"]["error"])
        expected, remedy = _meaning(holder, name) or None, "correct the value"
    else:
        message = problem["msg"]
        wanted = message.removeprefix("Input should be ")
        text = f"{name!r} must be {wanted}" if wanted != message else f"{name!r}: {message}"
        meaning = _meaning(holder, name)
        expected, remedy = f"{wanted} ({meaning})" if meaning else wanted, "correct the value"
    return ConfigurationError(
        text,
        file=document.file or None,
        line=document.line_of(key) or (1 if document.file else None),
        key=key or None,
        found=found if not isinstance(found, Mapping) else None,
        expected=expected,
        remedy=remedy,
    )


def _is_tag(part: object) -> bool:
    return isinstance(part, str) and part.startswith("<") and part.endswith(">")


def _meaning(holder: type[BaseModel], name: str) -> str:
    field = holder.model_fields.get(name)
    return (field.description or "").rstrip(".") if field is not None else ""


def _model_at(model: type[BaseModel], parts: list[str]) -> type[BaseModel]:
    """The model whose fields stand under a path; the nearest one above for free mappings."""
    annotation: Any = model
    found = model
    for part in parts:
        options = list(_models(annotation))
        owner = next((option for option in options if part in option.model_fields), None)
        if owner is not None:
            annotation = owner.model_fields[part].annotation
        candidates = list(_models(annotation))
        found = candidates[0] if candidates else found
    return found


def _models(annotation: Any) -> Iterator[type[BaseModel]]:
    """The models that an annotation mentions."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    elif get_origin(annotation) in (Union, types.UnionType) or get_args(annotation):
        for inner in get_args(annotation):
            yield from _models(inner)
