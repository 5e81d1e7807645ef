"""The codec: what is written is read back as it was, and nothing else is read."""

from __future__ import annotations

import copy
import json
import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from enum import Enum
from typing import Annotated, Any, Literal

import numpy as np
import pytest
from drawn_values import values_of
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from typing_extensions import Self

from pytest_dura.core.codec import (
    LEFT_OUT,
    Amount,
    Confidence,
    Count,
    Limit,
    NotDataError,
    Number,
    Sha256,
    decode,
    defaults_of,
    encode,
    fields_of,
)
from pytest_dura.core.mismatches import Mismatch, MismatchError, pointer
from pytest_dura.evidence.schema import recorded_classes

lawful = settings(
    derandomize=True,
    deadline=None,
    max_examples=40,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)


@dataclass(frozen=True, slots=True)
class Leaf:
    margin: float
    note: str = "-"


@dataclass(frozen=True)
class Twig:
    leaves: tuple[Leaf, ...]
    within: Twig | None = None


class Title(str):
    """Refuses a text itself."""

    __slots__ = ()

    def __new__(cls, text: str) -> Self:
        if text == "X":
            raise ValueError("there is no such title")
        return super().__new__(cls, text)


@dataclass(frozen=True, kw_only=True)
class Tree:
    """Has a field of each form that the codec reads."""

    count: Count
    number: Number | None
    share: Annotated[float, Limit(ge=0, le=1)]
    level: Confidence
    digest: Sha256 | None
    word: Literal["a", "b", 3] | None
    switch: bool | float | None
    whole: int | None
    part: Leaf | Twig | str | None
    twigs: list[Twig]
    place: tuple[float, int]
    limits: Mapping[str, Amount | None]
    files: dict[Sha256, dict[str, bool]]
    some: Annotated[list[int], Limit(min_items=1)]
    either: list[int] | list[str]
    anything: Any
    free: dict[str, Any]
    title: Annotated[Title, Limit(pattern="^[A-W]$")]
    length: int = 7
    rare: bool = field(default=False, metadata=LEFT_OUT)
    absent: float | None = field(default=None, metadata=LEFT_OUT)


TYPES = [Tree, Twig, *recorded_classes()]
"""Types for the codec itself, and those that the record is made of."""


def read(type_, value):
    return decode(type_, json.loads(json.dumps(value)))


def instances(value, path=()):
    """Each dataclass in a value that is written, with its path."""
    if is_dataclass(value):
        yield path, value
        value = {
            field.name: getattr(value, field.name)
            for field in fields(value)
            if field.init
            and not (field.metadata == LEFT_OUT and getattr(value, field.name) == field.default)
        }
    if isinstance(value, (list, tuple, Mapping)):
        pairs = value.items() if isinstance(value, Mapping) else enumerate(value)
        for key, part in pairs:
            yield from instances(part, (*path, key))


def at(data, path):
    for key in path:
        data = data[key]
    return data


def refusal(type_, data):
    with pytest.raises(MismatchError) as refused:
        read(type_, data)
    return [(mismatch.pointer, mismatch.found) for mismatch in refused.value.mismatches]


def reads_back(type_, value):
    written = json.dumps(encode(value), allow_nan=False)
    again = decode(type_, json.loads(written))
    assert again == value
    assert json.dumps(encode(again)) == written


def refuses_a_key_more_or_less(type_, value, data):
    plain = encode(value)
    path, part = data.draw(st.sampled_from(list(instances(value))))
    more, less = copy.deepcopy(plain), copy.deepcopy(plain)
    at(more, path)["nobody knows"] = 1
    assert refusal(type_, more) == [(pointer(path), 'unknown key "nobody knows"')]
    needed = [name for name in fields_of(type(part)) if name not in defaults_of(type(part))]
    name = data.draw(st.sampled_from(needed))
    del at(less, path)[name]
    assert refusal(type_, less) == [(pointer(path), f'missing key "{name}"')]


def refuses_another_json_type(type_, value, data):
    path, part = data.draw(st.sampled_from(list(instances(value))))
    name, shape = data.draw(st.sampled_from(list(fields_of(type(part)).items())))
    others = [None, True, 7, 7.5, "no value", {}, []]
    others = [
        other
        for other in others
        if type(other) not in shape.accepts or (other == "no value" and shape.kinds == ("number",))
    ]
    for other in others:
        changed = encode(value)
        at(changed, path)[name] = other
        assert [where for where, _ in refusal(type_, changed)] == [pointer((*path, name))]


@pytest.mark.parametrize("type_", TYPES)
@lawful
@given(data=st.data())
def test_a_type_reads_what_it_wrote_and_nothing_else(type_, data):
    """Where another value or key stands, it is refused at its place."""
    value = data.draw(values_of(type_))
    reads_back(type_, value)
    refuses_a_key_more_or_less(type_, value, data)
    refuses_another_json_type(type_, value, data)


def test_every_form_was_drawn():
    met: Counter[str] = Counter()

    @settings(lawful, max_examples=150)
    @given(values_of(Tree))
    def count(tree):
        met[f"part {type(tree.part).__name__}"] += 1
        met[f"switch {type(tree.switch).__name__}"] += 1
        met["infinite"] += isinstance(tree.place[0], float) and math.isinf(tree.place[0])
        met["surrogate"] += "\ud800" in json.dumps(encode(tree), ensure_ascii=False)

    count()
    assert len(met) == 10
    assert min(met.values()) > 0, met


class Colour(str, Enum):
    RED = "red"


@pytest.mark.parametrize(
    "value, written",
    [
        (math.inf, "Infinity"),
        ((1, [-math.inf]), [1, ["-Infinity"]]),
        (np.float64(2.5), 2.5),
        ({"x": np.int64(3), "y": np.bool_(True)}, {"x": 3, "y": True}),
        (np.float32(0.5), 0.5),
        (Colour.RED, "red"),
        (Leaf(1), {"margin": 1, "note": "-"}),
    ],
)
def test_values_as_they_are_written(value, written):
    plain = encode(value)
    assert plain == written
    assert repr(plain) == repr(written)


CIRCLE: list[Any] = []
CIRCLE.append(CIRCLE)


@pytest.mark.parametrize(
    "value, message",
    [
        (Twig((Leaf(1.0), Leaf(math.nan))), "/leaves/1/margin: NaN is not data"),
        ({"a/b": [{1}]}, "/a~1b/0: set is not data"),
        ({"a": {1: 2}}, "/a: the key 1 is not a text"),
        (np.zeros(2), "/: ndarray is not data"),
        (b"x", "/: bytes is not data"),
        (CIRCLE, "/: nested too deeply, or in itself"),
    ],
)
def test_what_is_not_data_is_refused_with_its_place(value, message):
    with pytest.raises(NotDataError) as refused:
        encode(value)
    assert str(refused.value) == message


SHA256 = '"^[0-9a-f]{64}$"'
SOME = Annotated[list[Any], Limit(min_items=1)]
LEAF = {"margin": 1.5, "note": ""}


@pytest.mark.parametrize(
    "type_, data, mismatches",
    [
        (Leaf, {**LEAF, "margin": math.nan}, ["/margin: found NaN, expected number"]),
        (Leaf, {**LEAF, "margin": math.inf}, ["/margin: found Infinity, expected number"]),
        (Leaf, {**LEAF, "margin": "infinity"}, ["/margin: found string, expected number"]),
        (Amount, "Infinity", ["/: found string, expected number"]),
        (Amount, -1, ["/: found -1, expected at least 0"]),
        (Confidence, 1, ["/: found 1, expected below 1"]),
        (Sha256, "0" * 64 + "\n", [f'/: found "{"0" * 56}..., expected a text like {SHA256}']),
        (Count, True, ["/: found true, expected integer"]),
        (Count, 1.0, ["/: found number, expected integer"]),
        (Literal[1, "a"], True, ["/: found true, expected integer or string"]),
        (Literal[1, "a"], "b", ['/: found "b", expected 1 or "a"']),
        (Literal[1, False], True, ["/: found true, expected 1 or false"]),
        (Mapping[Sha256, Any], {"x": 1}, [f'/x: found "x", expected a text like {SHA256}']),
        (Title, "X", ["/: there is no such title"]),
        (Title, 3, ["/: found integer, expected string"]),
        (Leaf | Twig | None, 3, ["/: found integer, expected object or null"]),
        (SOME, [], ["/: found [], expected entries, at least 1"]),
        (tuple[int, int], [1], ["/: found 1 entries, expected 2 entries"]),
        (Any, [{"x": math.inf}], ["/0/x: found Infinity, expected JSON"]),
        (Leaf, {"x": 1, "note": 2}, ['/: unknown key "x"', '/: missing key "margin"',
                                     "/note: found integer, expected string"]),
    ],
)  # fmt: skip
def test_mismatches_in_words(type_, data, mismatches):
    with pytest.raises(MismatchError) as refused:
        decode(type_, data)
    assert [str(mismatch) for mismatch in refused.value.mismatches] == mismatches


def test_a_whole_number_stays_one_where_a_float_is_declared():
    leaf = decode(Leaf, {"margin": 1, "note": ""})
    assert json.dumps(encode(leaf)) == '{"margin": 1, "note": ""}'


def test_mismatches_are_bounded():
    with pytest.raises(MismatchError) as refused:
        decode(list[Leaf], [{}] * 99, most=3)
    assert refused.value.mismatches == tuple(
        Mismatch(f"/{index}", 'missing key "margin", "note"') for index in range(3)
    )


def test_what_a_class_refuses_itself_is_a_mismatch():
    @dataclass(frozen=True)
    class Even:
        number: int

        def __post_init__(self):
            if self.number % 2:
                raise ValueError("it is odd")

    with pytest.raises(MismatchError, match=r"^/0: it is odd$"):
        decode(tuple[Even, ...], [{"number": 1}])


def test_data_that_is_nested_too_deeply_is_a_mismatch():
    data: dict[str, Any] = {"leaves": [], "within": None}
    for _ in range(5000):
        data = {"leaves": [], "within": data}
    with pytest.raises(MismatchError, match="nested too deeply"):
        decode(Twig, data)
    deep: list[Any] = []
    for _ in range(5000):
        deep = [deep]
    assert decode(Any, deep) is deep


@dataclass(frozen=True)
class OtherLeaf:
    note: str
    margin: int


@pytest.mark.parametrize(
    "type_",
    [float | str, Leaf | OtherLeaf, dict[int, str], set[int], bytes, object, dict[Leaf, int]],
)
def test_types_that_json_cannot_tell_apart_are_refused(type_):
    with pytest.raises(TypeError):
        decode(type_, {})
