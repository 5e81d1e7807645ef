"""Factory of entries of the record: a test states what it is about, the rest is neutral."""

from __future__ import annotations

from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

from pytest_dura.evidence.entry import Entry

_E = TypeVar("_E", bound=Entry)
_PATTERNS = {
    "^[0-9a-f]{64}$": "0" * 64,
    "^[0-9a-f]{32}$": "0" * 32,
    "^[0-9a-f]{40,64}$": "0" * 40,
    "@": "a@0",
    "^episodes/[^/\\\\]+\\.mcap$": "episodes/a.mcap",
    "^(recover|halt|log_only|refine\\([1-9][0-9]*\\))$": "recover",
}


def make(model: type[_E], /, **values: Any) -> _E:
    """Make an entry. What is not given is null, 0, empty, or the first of its alternatives.

    Mappings that stand for entries may state a part of their keys as well.
    """
    made = {
        name: _whole(field.annotation, field.metadata, values[name])
        if name in values
        else _neutral(field.annotation, field.metadata)
        for name, field in model.model_fields.items()
        if name in values or field.is_required()
    }
    return model.model_validate(values | made)


def _whole(kind: Any, metadata: list[Any], value: Any) -> Any:
    """Complete mappings that stand for entries."""
    origin, arguments = get_origin(kind), get_args(kind)
    whole = value
    if isinstance(value, Entry) or value is None:
        whole = value
    elif origin is Annotated:
        whole = _whole(arguments[0], list(arguments[1:]), value)
    elif isinstance(kind, type) and issubclass(kind, Entry) and isinstance(value, dict):
        whole = make(kind, **value)
    elif origin in (Union, UnionType) and isinstance(value, (dict, list)):
        kinds = [each for each in arguments if each is not NoneType]
        whole = _whole(max(kinds, key=lambda each: _keys_of(each, value)), [], value)
    elif origin is list and isinstance(value, list):
        whole = [_whole(arguments[0], [], each) for each in value]
    elif origin is dict and isinstance(value, dict):
        whole = {key: _whole(arguments[1], [], each) for key, each in value.items()}
    return whole


def _keys_of(kind: Any, value: Any) -> int:
    """How many keys of a value an alternative knows."""
    kind = get_args(kind)[0] if get_origin(kind) is Annotated else kind
    return len(set(getattr(kind, "model_fields", ())) & set(value) if type(value) is dict else ())


def _neutral(kind: Any, metadata: list[Any]) -> Any:
    origin, arguments = get_origin(kind), get_args(kind)
    if origin is Annotated:
        return _neutral(arguments[0], list(arguments[1:]))
    if kind is Any or NoneType in arguments:
        return None
    if origin in (Union, UnionType, Literal):
        return arguments[0] if origin is Literal else _neutral(arguments[0], [])
    if isinstance(kind, type) and issubclass(kind, Entry):
        return make(kind)
    marks = [each for mark in metadata for each in (mark, *getattr(mark, "metadata", ()))]
    return next(filter(None, map(_marked, marks)), (origin or kind)())


def _marked(mark: Any) -> Any:
    """A value that a mark of a type accepts, if it has limits."""
    if getattr(mark, "pattern", None):
        return _PATTERNS[mark.pattern]
    if getattr(mark, "min_length", None):
        return "a" * mark.min_length
    above = getattr(mark, "gt", None)
    return getattr(mark, "ge", None) if above is None else above + 0.5
