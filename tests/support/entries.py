"""Factory of entries of the record: a test states what it is about, the rest is neutral."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from pytest_dura.core.codec import decode, encode

_E = TypeVar("_E")
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

    A field of a dataclass that has a default keeps it.

    Mappings that stand for entries may state a part of their keys as well.
    """
    hints = get_type_hints(model, include_extras=True)
    made = {
        field.name: _whole(hints[field.name], [], values[field.name])
        if field.name in values
        else _neutral(hints[field.name], [])
        for field in fields(model)
        if field.name in values or (field.default is MISSING and field.default_factory is MISSING)
    }
    return decode(model, encode(model(**{**values, **made})))


def _whole(kind: Any, metadata: list[Any], value: Any) -> Any:
    """Complete mappings that stand for entries."""
    origin, arguments = get_origin(kind), get_args(kind)
    whole = value
    if is_dataclass(value) or value is None:
        whole = value
    elif origin is Annotated:
        whole = _whole(arguments[0], list(arguments[1:]), value)
    elif _is_model(kind) and isinstance(value, dict):
        whole = make(kind, **value)
    elif origin in (Union, UnionType) and isinstance(value, (dict, list)):
        kinds = [each for each in arguments if each is not NoneType]
        whole = _whole(max(kinds, key=lambda each: _keys_of(each, value)), [], value)
    elif origin in (list, tuple) and isinstance(value, (list, tuple)):
        whole = [_whole(arguments[0], [], each) for each in value]
    elif origin in (dict, Mapping) and isinstance(value, dict):
        whole = {key: _whole(arguments[1], [], each) for key, each in value.items()}
    return whole


def _is_model(kind: Any) -> bool:
    return isinstance(kind, type) and is_dataclass(kind)


def _keys_of(kind: Any, value: Any) -> int:
    """How many keys of a value an alternative knows."""
    kind = get_args(kind)[0] if get_origin(kind) is Annotated else kind
    names = getattr(kind, "__dataclass_fields__", ())
    return len(set(names) & set(value) if type(value) is dict else ())


def _neutral(kind: Any, metadata: list[Any]) -> Any:
    origin, arguments = get_origin(kind), get_args(kind)
    if origin is Annotated:
        return _neutral(arguments[0], list(arguments[1:]))
    if kind is Any or NoneType in arguments:
        return None
    if origin in (Union, UnionType, Literal):
        return arguments[0] if origin is Literal else _neutral(arguments[0], [])
    if _is_model(kind):
        return make(kind)
    if origin is Mapping:
        return {}
    marks = [each for mark in metadata for each in (mark, *getattr(mark, "metadata", ()))]
    return next(filter(None, map(_marked, marks)), (origin or kind)())


def _marked(mark: Any) -> Any:
    """A value that a mark of a type accepts, if it has limits."""
    if getattr(mark, "pattern", None):
        return _PATTERNS[mark.pattern]
    if getattr(mark, "min_items", None):
        return [None] * mark.min_items
    above = getattr(mark, "gt", None)
    return getattr(mark, "ge", None) if above is None else above + 0.5
