"""Values of the types that the codec reads, drawn by Hypothesis to be hostile."""

from __future__ import annotations

import dataclasses
import re
import types
from collections.abc import Mapping
from functools import cache
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from hypothesis import reject
from hypothesis import strategies as st

from pytest_dura.core.codec import Limit, fields_of
from pytest_dura.core.episode import EpisodeSpec
from pytest_dura.core.errors import ConfigurationError

_NASTY = ("", "\x00", "\ud800", "\udfff\ud800", "Infinity", "NaN", "a/b~c", "::error::", "\u2028",
          "__class__", "null", "\x1b[2J", "\U0001f600", "[" * 99)  # fmt: skip
TEXTS = st.sampled_from(_NASTY) | st.text(st.characters(exclude_categories=()), max_size=9)
WHOLE = st.integers() | st.sampled_from([0, -1, 2**53 + 1, -(2**63), 10**400])
FINITE = st.floats(allow_nan=False, allow_infinity=False) | WHOLE
JSON = st.recursive(
    st.none() | st.booleans() | FINITE | TEXTS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXTS, inner, max_size=3),
    max_leaves=6,
)


def _nested(inner: Any, depth: int) -> Any:
    for level in range(depth):
        inner = [inner] if level % 2 else {"": inner}
    return inner


DEEP = st.builds(_nested, JSON, st.sampled_from([0, 0, 1, 90]))


@cache
def values_of(type_: Any) -> st.SearchStrategy[Any]:
    """Values of a type, as the codec reads them."""
    origin, arguments = get_origin(type_), get_args(type_)
    if type_ in _SIMPLE:
        return _SIMPLE[type_]
    if dataclasses.is_dataclass(type_):
        return st.deferred(lambda: _instances(type_))
    return _MADE_BY[origin](*arguments)


_SIMPLE = {
    Any: DEEP, str: TEXTS, int: WHOLE, bool: st.booleans(), None: st.none(), type(None): st.none(),
    float: FINITE | st.sampled_from([float("inf"), -float("inf")]),
    dict: st.dictionaries(TEXTS, DEEP, max_size=3), list: st.lists(DEEP, max_size=3),
}  # fmt: skip


@st.composite
def _instances(draw: st.DrawFn, kind: type) -> Any:
    """An instance; values that its class does not take together are drawn anew."""
    hints = get_type_hints(kind, include_extras=True)
    values = {name: draw(values_of(hints[name])) for name in fields_of(kind)}
    if kind is EpisodeSpec:
        values["scenario"] = {"world": values["scenario"]}  # other keys would have to be known
    try:
        return kind(**values)
    except ConfigurationError:
        reject()


def _limited(type_: Any, *marks: Any) -> st.SearchStrategy[Any]:
    (limit,) = (mark for mark in marks if isinstance(mark, Limit))
    if limit.pattern is not None:
        texts = st.from_regex(re.sub(r"\$$", r"\\Z", limit.pattern))
        return texts.map(type_) if isinstance(type_, type) else texts
    if limit.min_items is not None:
        return st.lists(values_of(*get_args(type_)), min_size=limit.min_items, max_size=3)
    least, greatest = (
        next((end for end in ends if end is not None), None)
        for ends in ((limit.ge, limit.gt), (limit.le, limit.lt))
    )
    numbers = st.floats(
        least,
        greatest,
        exclude_min=limit.gt is not None,
        exclude_max=limit.lt is not None,
        allow_nan=False,
        allow_infinity=False,
    )
    whole = st.integers(
        None if least is None else least + (limit.gt is not None),
        None if greatest is None else greatest,
    )
    if type_ is int:
        return whole
    return numbers if limit.lt is not None else numbers | whole


def _tuple(*entries: Any) -> st.SearchStrategy[Any]:
    if entries[1:] == (...,):
        return st.lists(values_of(entries[0]), max_size=3).map(tuple)
    return st.tuples(*map(values_of, entries))


def _mapping(key: Any, value: Any) -> st.SearchStrategy[Any]:
    return st.dictionaries(values_of(key), values_of(value), max_size=3)


_MADE_BY = {
    Annotated: _limited,
    Literal: lambda *choices: st.sampled_from(choices),
    Union: lambda *types: st.one_of(*map(values_of, types)),
    types.UnionType: lambda *types: st.one_of(*map(values_of, types)),
    list: lambda entry: st.lists(values_of(entry), max_size=3),
    tuple: _tuple,
    dict: _mapping,
    Mapping: _mapping,
}
