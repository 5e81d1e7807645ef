"""Codec: frozen dataclasses as plain JSON data, and strictly back.

Reading what was written gives an equal object. What is not exactly a value of the type is refused,
with its place: a wrong JSON type, an unknown or missing key, a truth value for a number, NaN.
It is written by hand since no library was found that keeps all of that over standard dataclasses:
pydantic reads an infinite float as null and lets unknown keys of dataclasses pass, and others
convert types or stop at the first mismatch.

Types are dataclasses, ``str`` and classes of texts, ``int``, ``float``, ``bool``, ``None``, ``Any``
(any JSON), ``Literal``, unions, tuples, ``list[T]``, ``dict[str, T]`` or ``Mapping[str, T]``, and
``Annotated`` of them with a :class:`Limit`. Limits of what is null are those of what it is
otherwise.
"""

from __future__ import annotations

import dataclasses
import math
import re
import types
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from typing import (
    Annotated,
    Any,
    Literal,
    NamedTuple,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
    overload,
)

from pytest_dura.core.classes import is_subclass
from pytest_dura.core.errors import DuraError
from pytest_dura.core.mismatches import (
    KINDS,
    MAX_MISMATCHES,
    EnoughError,
    Mismatch,
    MismatchError,
    Mismatches,
    Place,
    key_list,
    kind_of,
    pointer_of,
    shown,
)

JsonObject = dict[str, Any]
INFINITIES = {"Infinity": math.inf, "-Infinity": -math.inf}
"""Texts that stand for what JSON has no number for."""
_T = TypeVar("_T")


@dataclass(frozen=True)
class Limit:
    """Limits of a value, in ``Annotated``. A float with limits is finite.

    Args:
        ge: Least value.
        gt: Value that it is above.
        le: Greatest value.
        lt: Value that it is below.
        pattern: Regular expression that a text contains.
        min_items: Least number of entries.
    """

    ge: float | None = None
    gt: float | None = None
    le: float | None = None
    lt: float | None = None
    pattern: str | None = None
    min_items: int | None = None

    def schema(self) -> JsonObject:
        """Write the limits as keywords of JSON Schema."""
        limits = zip(_LIMITS, vars(self).values(), strict=True)
        return {keyword: limit for keyword, limit in limits if limit is not None}


@cache
def _pattern(text: str) -> re.Pattern[str]:
    # In Python alone "$" also stands before a last line break.
    return re.compile(re.sub(r"\$$", r"\\Z", text))


_LIMITS: dict[str, tuple[str, Callable[[Any, Any], bool]]] = {
    "minimum": ("at least ", lambda value, limit: value >= limit),
    "exclusiveMinimum": ("above ", lambda value, limit: value > limit),
    "maximum": ("at most ", lambda value, limit: value <= limit),
    "exclusiveMaximum": ("below ", lambda value, limit: value < limit),
    "pattern": ("a text like ", lambda value, limit: _pattern(limit).search(value) is not None),
    "minItems": ("entries, at least ", lambda value, limit: len(value) >= limit),
}
"""Keywords of JSON Schema in the order of :class:`Limit`, their words, and what they accept."""


Count = Annotated[int, Limit(ge=0)]
Positive = Annotated[int, Limit(ge=1)]
Number = Annotated[float, Limit()]
Amount = Annotated[float, Limit(ge=0)]
PositiveNumber = Annotated[float, Limit(gt=0)]
Share = Annotated[float, Limit(ge=0, le=1)]
Confidence = Annotated[float, Limit(gt=0, lt=1)]
Sha256 = Annotated[str, Limit(pattern=r"^[0-9a-f]{64}$")]


LEFT_OUT = {"left_out": True}
"""Metadata of a field that is left out of the data as long as it has its default."""


NOT_DATA = {"not_data": True}
"""Metadata of a field that is no part of the data: read back, it has its default."""


class NotDataError(TypeError):
    """A value that cannot be written as data; the message says where and why."""


def encode(value: Any) -> Any:
    """Convert a value to plain JSON data.

    A dataclass becomes an object of all its fields that its constructor takes, in their order, but
    for those of :data:`LEFT_OUT`. An infinite number becomes a text of :data:`INFINITIES`, which
    only a ``float`` reads as a number.

    Raises:
        NotDataError: For what cannot be read back: NaN, keys that are not texts, other objects.
    """
    try:
        return _fast_encoded(value)
    except (_DiffersError, RecursionError):
        pass  # which place it is, says the function below
    try:
        return _encoded(value, None)
    except RecursionError:
        raise NotDataError("/: nested too deeply, or in itself") from None


def _fast_encoded(value: Any) -> Any:
    """Convert what most values are; anything else has to be converted with its place."""
    kind: Any = type(value)
    if kind in _PLAIN or (kind is float and math.isfinite(value)):
        return value
    if kind is list or kind is tuple:
        return [part if type(part) in _PLAIN else _fast_encoded(part) for part in value]
    if kind is dict:
        for key in value:
            if type(key) is not str:
                raise _DiffersError
        return {
            key: part if type(part) in _PLAIN else _fast_encoded(part)
            for key, part in value.items()
        }
    if _field_names(kind) is not None:
        return _encoder_of(kind)(value)
    if isinstance(value, str):
        return str.__str__(value)
    if not isinstance(value, Mapping):
        raise _DiffersError
    return _fast_encoded(dict(value))


@cache
def _encoder_of(kind: Any) -> Callable[[Any], JsonObject]:
    """Write a function that converts a dataclass, as source."""
    optional = defaults_of(kind)
    names: dict[str, Any] = {"P": _PLAIN, "E": _fast_encoded, "I": math.inf}
    plain = "type(v := o.{0}) in P or (type(v) is float and -I < v < I)"
    value = f"(v if {plain} else E(v))"
    lines: list[str] = []
    entries: list[str] = []
    for number, name in enumerate(_field_names(kind) or ()):
        if name in optional:
            names[f"N{number}"] = optional[name]
            written = f"d[{name!r}] = {value.format(name)}"
            lines += [f"d |= {{{', '.join(entries)}}}", f"if o.{name} != N{number}: {written}"]
            entries = []
        else:
            entries.append(f"{name!r}: {value.format(name)}")
    lines = ["d = {}", *lines, f"d |= {{{', '.join(entries)}}}"]
    exec("def encoder(o):\n  " + "\n  ".join([*lines, "return d"]), names)  # noqa: S102
    encoder: Callable[[Any], JsonObject] = names["encoder"]
    return encoder


_PLAIN = frozenset({str, int, bool, type(None)})
"""Types that are data as they are; most values are, and are not looked at further."""


def _encoded(value: Any, place: Place) -> Any:
    kind: Any = type(value)
    if kind in _PLAIN:
        return value
    if isinstance(value, float):  # numpy's doubles are such
        return _encoded_float(float(value), place)
    if _field_names(kind) is not None:
        value = fields_as_data(value)
    if isinstance(value, (list, tuple)):
        return [
            part if type(part) in _PLAIN else _encoded(part, (place, index))
            for index, part in enumerate(value)
        ]
    if not isinstance(value, Mapping):
        return _encoded_scalar(value, place)
    for key in value:
        if not isinstance(key, str):
            raise NotDataError(f"{pointer_of(place)}: the key {shown(key)} is not a text")
    return {
        str.__str__(key): part if type(part) in _PLAIN else _encoded(part, (place, key))
        for key, part in value.items()
    }


def _encoded_float(value: float, place: Place) -> float | str:
    if math.isfinite(value):
        return value
    if math.isnan(value):
        raise NotDataError(f"{pointer_of(place)}: NaN is not data")
    return "Infinity" if value > 0 else "-Infinity"


def _encoded_scalar(value: Any, place: Place) -> Any:
    """Convert numpy's scalars, and enumerations that are texts or whole numbers."""
    if isinstance(value, str):
        return str.__str__(value)
    if isinstance(value, int):
        return int(value)
    plain = value.item() if getattr(value, "ndim", None) == 0 else value
    if type(plain) is type(value):
        raise NotDataError(f"{pointer_of(place)}: {type(value).__name__} is not data")
    return _encoded(plain, place)


@cache
def _field_names(kind: type) -> tuple[str, ...] | None:
    if not dataclasses.is_dataclass(kind):
        return None
    return tuple(
        field.name
        for field in dataclasses.fields(kind)
        if field.init and not field.metadata.get("not_data")
    )


@cache
def defaults_of(kind: type) -> dict[str, Any]:
    """Collect the fields of a dataclass that may be left out of its data, with their defaults."""
    return {
        field.name: field.default
        for field in dataclasses.fields(kind)
        if field.metadata.get("left_out")
    }


def fields_as_data(value: Any) -> JsonObject:
    """Return the fields of a dataclass as data has them, the values as they are."""
    kind: Any = type(value)
    data = {name: getattr(value, name) for name in _field_names(kind) or ()}
    for name, default in defaults_of(kind).items():
        if data[name] is default or data[name] == default:
            del data[name]
    return data


@overload
def decode(type_: type[_T], data: Any, most: int = ...) -> _T: ...
@overload
def decode(type_: Any, data: Any, most: int = ...) -> Any: ...
def decode(type_: Any, data: Any, most: int = MAX_MISMATCHES) -> Any:
    """Make a value of a type of plain JSON data.

    Args:
        type_: Such as a dataclass.
        data: As :func:`json.loads` returns it.
        most: Mismatches to report.

    Raises:
        MismatchError: If the data is not exactly a value of the type.
        TypeError: If the type is not one of those that can be read.
    """
    shape = shape_of(type_)
    try:
        return shape.fast(data)
    except (_DiffersError, KeyError, ValueError, TypeError, DuraError, RecursionError):
        pass  # which place it is, and all others, say the readers below
    mismatches = Mismatches(most)
    try:
        value = shape.read(data, None, mismatches)
    except EnoughError:
        pass
    except RecursionError:
        mismatches.append(Mismatch("/", "nested too deeply"))
    if mismatches:
        raise MismatchError(mismatches) from None
    return value


_Read = Callable[[Any, Place, Mismatches], Any]
_Fast = Callable[[Any], Any]


class _DiffersError(Exception):
    """Data is not of the type; raised by readers that keep no places, and so are fast."""


class Shape(NamedTuple):
    """A type as it looks in JSON.

    Args:
        kinds: What it is called in messages: ``integer``, ``null``, ``object``, ...
        accepts: Types of JSON data that it may be.
        read: Reader of a value; where it does not agree, it says so and returns ``None``.
        fast: Reader without places: what it does not take at once, ``read`` has to read.
        schema: Its JSON Schema, in which classes are references to ``#/$defs/NAME``.
        classes: The dataclasses to which the schema refers.
        test: Expression in Python on ``{v}`` that holds for its data, where that is read as it is;
            empty otherwise.
    """

    kinds: tuple[str, ...]
    accepts: frozenset[type]
    read: _Read
    fast: _Fast
    schema: JsonObject
    classes: tuple[type, ...] = ()
    test: str = ""


@cache
def shape_of(type_: Any) -> Shape:
    """Compile a type.

    Raises:
        TypeError: If it is not one of those that can be read.
    """
    if isinstance(type_, type) and dataclasses.is_dataclass(type_):
        reference = {"$ref": f"#/$defs/{type_.__name__}"}
        read, fast = _object_reader(type_), _fast_object_reader(type_)
        return Shape(("object",), frozenset({dict}), read, fast, reference, (type_,))
    known = {Any: _ANY, float: _FLOAT, None: _NULL, type(None): _NULL, str: _TEXT, int: _INTEGER,
             bool: _TRUTH}.get(type_)  # fmt: skip
    if known is not None:
        return known
    made_by = _MADE_BY.get(get_origin(type_) or type_)
    if made_by is None and is_subclass(type_, str):
        return _text_class(type_)
    if made_by is None:
        raise TypeError(f"a codec cannot read values of the type {type_!r}")
    return made_by(*get_args(type_))


def fields_of(kind: type) -> dict[str, Shape]:
    """Compile the fields of a dataclass that its constructor takes, in their order."""
    hints = get_type_hints(kind, include_extras=True)
    return {name: shape_of(hints[name]) for name in _field_names(kind) or ()}


def _object_reader(kind: type) -> _Read:
    readers: dict[str, _Read] = {}  # filled at the first value: a class may hold itself

    def read(data: Any, place: Place, mismatches: Mismatches) -> Any:
        if not readers:
            readers.update((name, shape.read) for name, shape in fields_of(kind).items())
        if type(data) is not dict:
            return mismatches.add(place, kind_of(data), "object")
        before = len(mismatches)
        if data.keys() != readers.keys():
            optional = defaults_of(kind)
            needed = [name for name in readers if name not in optional]
            for words, keys in (
                ("unknown key", [key for key in data if key not in readers]),
                ("missing key", [name for name in needed if name not in data]),
            ):
                if keys:
                    mismatches.add(place, f"{words} {key_list(keys)}")
        values = {
            name: reader(data[name], (place, name), mismatches)
            for name, reader in readers.items()
            if name in data
        }
        if len(mismatches) > before:
            return None
        try:
            return kind(**values)
        except (ValueError, TypeError, DuraError) as error:  # of the class itself
            return mismatches.add(place, str(error))

    return read


def _fast_object_reader(kind: type) -> _Fast:
    """Write a reader of a dataclass as source: most of a record's bytes are read by such."""

    def made() -> _Fast:
        names: dict[str, Any] = {"K": kind, "D": _DiffersError, "I": math.inf}
        lines, needed = [], 0
        for number, (name, shape) in enumerate(fields_of(kind).items()):
            names[f"F{number}"] = shape.fast
            given = f"d[{name!r}]"
            if shape.test:
                test = shape.test.replace("{v}", f"v{number}")
                read = [f"v{number} = {given}", f"if not ({test}): raise D"]
            else:
                read = [f"v{number} = F{number}({given})"]
            if name in defaults_of(kind):
                names[f"N{number}"] = defaults_of(kind)[name]
                lines += [f"v{number} = N{number}", f"if {name!r} in d:", "  n += 1"]
                read = [f"  {line}" for line in read]
            else:
                needed += 1
            lines += read
        body = ["if type(d) is not dict: raise D", f"n = {needed}", *lines]
        values = (f"{name}=v{number}" for number, name in enumerate(fields_of(kind)))
        body += ["if len(d) != n: raise D", f"return K({', '.join(values)})"]
        exec("def fast(d):\n" + "\n".join(f"  {line}" for line in body), names)  # noqa: S102
        fast: _Fast = names["fast"]
        return fast

    readers: list[_Fast] = []  # made at the first value: a class may hold itself

    def read(data: Any) -> Any:
        if not readers:
            readers.append(made())
        return readers[0](data)

    return read


def _primitive(kind: type) -> Shape:
    name = KINDS[kind]

    def read(data: Any, place: Place, mismatches: Mismatches) -> Any:
        return data if type(data) is kind else mismatches.add(place, kind_of(data), name)

    def fast(data: Any) -> Any:
        if type(data) is not kind:
            raise _DiffersError
        return data

    test = "{v} is None" if kind is type(None) else f"type({{v}}) is {kind.__name__}"
    return Shape((name,), frozenset({kind}), read, fast, {"type": name}, test=test)


def _text_class(kind: type) -> Shape:
    """Compile a class of texts, which refuses other texts itself."""

    def read(data: Any, place: Place, mismatches: Mismatches) -> Any:
        text = _TEXT.read(data, place, mismatches)
        try:
            return text if text is None else kind(text)
        except (ValueError, DuraError) as error:
            return mismatches.add(place, str(error))

    return _TEXT._replace(read=read, fast=lambda data: kind(_TEXT.fast(data)), test="")


_NULL, _TRUTH, _INTEGER, _TEXT = map(_primitive, (type(None), bool, int, str))


def _read_finite(data: Any, place: Place, mismatches: Mismatches) -> Any:
    if type(data) is int or (type(data) is float and math.isfinite(data)):
        return data  # a whole number stays one, so that it is written as it was read
    return mismatches.add(place, kind_of(data), "number")


def _fast_finite(data: Any) -> Any:
    if type(data) is int or (type(data) is float and math.isfinite(data)):
        return data
    raise _DiffersError


def _fast_float(data: Any) -> Any:
    return INFINITIES[data] if type(data) is str else _fast_finite(data)


def _read_float(data: Any, place: Place, mismatches: Mismatches) -> Any:
    if type(data) is str and data in INFINITIES:
        return INFINITIES[data]
    return _read_finite(data, place, mismatches)


_FINITE = Shape(
    ("number",),
    frozenset({int, float}),
    _read_finite,
    _fast_finite,
    {"type": "number"},
    test="(type({v}) is int or (type({v}) is float and -I < {v} < I))",
)
_FLOAT = Shape(
    ("number",),
    frozenset({int, float, str}),
    _read_float,
    _fast_float,
    {"anyOf": [{"type": "number"}, {"enum": list(INFINITIES), "type": "string"}]},
)


def _read_any(data: Any, place: Place, mismatches: Mismatches) -> Any:
    """Look into any JSON, without recursion: it may be nested as deeply as it was read."""
    pending: list[tuple[Any, Place]] = [(data, place)]
    while pending:
        part, at = pending.pop()
        if type(part) is dict:
            for key, entry in part.items():
                if type(key) is not str:
                    mismatches.add(at, f"the key {shown(key)}", "a text")
                pending.append((entry, (at, key)))
        elif type(part) is list:
            pending += ((entry, (at, index)) for index, entry in enumerate(part))
        elif type(part) not in KINDS or (type(part) is float and not math.isfinite(part)):
            mismatches.add(at, kind_of(part), "JSON")
    return data


def _fast_any(data: Any) -> Any:
    kind = type(data)
    if kind is dict:
        for key, part in data.items():
            if type(key) is not str:
                raise _DiffersError
            if type(part) not in _PLAIN:
                _fast_any(part)
    elif kind is list:
        for part in data:
            if type(part) not in _PLAIN:
                _fast_any(part)
    elif kind not in _PLAIN:
        _fast_finite(data)
    return data


_ANY = Shape(tuple(KINDS.values()), frozenset(KINDS), _read_any, _fast_any, {})


def _annotated(type_: Any, *marks: Any) -> Shape:
    limits = [mark for mark in marks if isinstance(mark, Limit)]
    shape = _FINITE if type_ is float and limits else shape_of(type_)
    for limit in limits:
        shape = _limited(shape, limit)
    return shape


def _limited(shape: Shape, limit: Limit) -> Shape:
    checks = [(*_LIMITS[keyword], value) for keyword, value in limit.schema().items()]
    inner = shape.read

    def read(data: Any, place: Place, mismatches: Mismatches) -> Any:
        value = inner(data, place, mismatches)
        if value is not None:
            for words, accepts, expected in checks:
                if not accepts(value, expected):
                    return mismatches.add(place, shown(data), f"{words}{shown(expected)}")
        return value

    quick = shape.fast

    def fast(data: Any) -> Any:
        value = quick(data)
        if value is not None:
            for _, accepts, expected in checks:
                if not accepts(value, expected):
                    raise _DiffersError
        return value

    if not checks:
        return shape
    test = ""
    quicker = _fast_least(quick, limit.ge) if limit == Limit(ge=limit.ge) else fast
    if limit == Limit(ge=limit.ge) and shape.test and "null" not in shape.kinds:
        test = f"{shape.test} and {{v}} >= {limit.ge!r}"
    return shape._replace(
        read=read, fast=quicker, test=test, schema={**shape.schema, **limit.schema()}
    )


def _fast_least(quick: _Fast, least: Any) -> _Fast:
    """Read what has a least value alone, as most numbers do."""

    def fast(data: Any) -> Any:
        value = quick(data)
        if value is not None and value < least:
            raise _DiffersError
        return value

    return fast


def _literal(*choices: Any) -> Shape:
    kinds = tuple(dict.fromkeys(KINDS[type(choice)] for choice in choices))
    accepts = frozenset(map(type, choices))
    known = {(type(choice), choice) for choice in choices}

    def read(data: Any, place: Place, mismatches: Mismatches) -> Any:
        if type(data) not in accepts:
            return mismatches.add(place, kind_of(data), " or ".join(kinds))
        if (type(data), data) not in known:
            return mismatches.add(place, shown(data), " or ".join(map(shown, choices)))
        return data

    def fast(data: Any) -> Any:
        if (type(data), data) not in known:
            raise _DiffersError
        return data

    values: JsonObject = {"enum": [*choices]} if len(choices) > 1 else {"const": choices[0]}
    return Shape(
        kinds, accepts, read, fast, {**values, "type": kinds[0] if len(kinds) == 1 else kinds}
    )


def _array(entry: Shape, made: Callable[[Iterable[Any]], Any]) -> Shape:
    inner = entry.read

    def read(data: Any, place: Place, mismatches: Mismatches) -> Any:
        if type(data) is not list:
            return mismatches.add(place, kind_of(data), "array")
        return made([inner(part, (place, index), mismatches) for index, part in enumerate(data)])

    quick = entry.fast

    def fast(data: Any) -> Any:
        if type(data) is not list:
            raise _DiffersError
        return made([quick(part) for part in data])

    schema = {"items": entry.schema, "type": "array"}
    return Shape(("array",), frozenset({list}), read, fast, schema, entry.classes)


def _list(entry: Any = Any) -> Shape:
    return _array(shape_of(entry), list)


def _tuple(*entries: Any) -> Shape:
    if not entries or entries[1:] == (...,):
        return _array(shape_of(entries[0] if entries else Any), tuple)
    shapes = [shape_of(entry) for entry in entries]
    size = len(shapes)

    def read(data: Any, place: Place, mismatches: Mismatches) -> Any:
        if type(data) is not list:
            return mismatches.add(place, kind_of(data), "array")
        if len(data) != size:
            return mismatches.add(place, f"{len(data)} entries", f"{size} entries")
        parts = enumerate(zip(shapes, data, strict=True))
        return tuple(shape.read(part, (place, index), mismatches) for index, (shape, part) in parts)

    def fast(data: Any) -> Any:
        if type(data) is not list or len(data) != size:
            raise _DiffersError
        return tuple([shape.fast(part) for shape, part in zip(shapes, data, strict=True)])

    parts = [shape.schema for shape in shapes]
    schema = {"prefixItems": parts, "minItems": size, "maxItems": size, "type": "array"}
    classes = tuple(each for shape in shapes for each in shape.classes)
    return Shape(("array",), frozenset({list}), read, fast, schema, classes)


def _mapping(key_type: Any = str, value_type: Any = Any) -> Shape:
    key, value = shape_of(key_type), shape_of(value_type)
    if key.accepts != _TEXT.accepts:
        raise TypeError(f"keys of JSON are texts, and not {key_type!r}")
    is_limited, read_key, inner = key.schema != {"type": "string"}, key.read, value.read

    def read(data: Any, place: Place, mismatches: Mismatches) -> Any:
        if type(data) is not dict:
            return mismatches.add(place, kind_of(data), "object")
        for name in data if is_limited else ():
            read_key(name, (place, name), mismatches)
        return {name: inner(part, (place, name), mismatches) for name, part in data.items()}

    quick_key, quick = key.fast, value.fast

    def fast(data: Any) -> Any:
        if type(data) is not dict:
            raise _DiffersError
        for name in data if is_limited else ():
            quick_key(name)
        return {name: quick(part) for name, part in data.items()}

    schema = {"additionalProperties": value.schema or True, "type": "object"}
    if is_limited:
        schema["propertyNames"] = {k: part for k, part in key.schema.items() if k != "type"}
    return Shape(("object",), frozenset({dict}), read, fast, schema, value.classes)


def _union(*alternatives: Any) -> Shape:
    """Compile alternatives: distinguished by their JSON type, and dataclasses by their keys.

    Raises:
        TypeError: If some value of two of them looks the same.
    """
    shapes = [shape_of(each) for each in alternatives]
    if _ANY in shapes:
        return _ANY
    is_any_text = any(
        shape.kinds == ("string",) and not {"enum", "const"} & shape.schema.keys()
        for shape in shapes
    )
    keys = [_keys(shape) for shape in shapes if "$ref" in shape.schema]
    if (_FLOAT in shapes and is_any_text) or len(set(keys)) < len(keys):
        raise TypeError(f"JSON does not tell apart the alternatives {alternatives}")
    kinds = tuple(dict.fromkeys(kind for shape in shapes for kind in shape.kinds))
    accepts = frozenset(each for shape in shapes for each in shape.accepts)
    readers = {
        each: _chooser([shape for shape in shapes if each in shape.accepts]) for each in accepts
    }
    expected = " or ".join(kinds)

    def read(data: Any, place: Place, mismatches: Mismatches) -> Any:
        reader = readers.get(type(data))
        if reader is None:
            return mismatches.add(place, kind_of(data), expected)
        return reader(data, place, mismatches)

    alone = {
        each: fitting[0].fast
        for each in accepts
        if len(fitting := [shape for shape in shapes if each in shape.accepts]) == 1
    }

    objects = [(_keys(shape), shape.fast) for shape in shapes if "$ref" in shape.schema]
    if len(objects) > 1 and len(objects) == sum(dict in shape.accepts for shape in shapes):
        alone[dict] = lambda data: max(
            objects, key=lambda each: (len(each[0] & data.keys()), -len(each[0]))
        )[1](data)

    def fast(data: Any) -> Any:
        quick = alone.get(type(data))
        if quick is None:
            raise _DiffersError
        return quick(data)

    schema = _union_schema([shape.schema for shape in shapes])
    classes = tuple(dict.fromkeys(each for shape in shapes for each in shape.classes))
    tests = [shape.test for shape in shapes]
    test = " or ".join(f"({each})" for each in tests) if all(tests) else ""
    return Shape(kinds, accepts, read, fast, schema, classes, test)


def _keys(shape: Shape) -> frozenset[str]:
    return frozenset(_field_names(shape.classes[0]) or ())


def _chooser(shapes: Sequence[Shape]) -> _Read:
    """Make the reader of data of one JSON type that several alternatives accept."""
    if len(shapes) == 1:
        return shapes[0].read
    objects = {shape.read: _keys(shape) for shape in shapes if "$ref" in shape.schema}

    def read(data: Any, place: Place, mismatches: Mismatches) -> Any:
        if len(objects) == len(shapes):
            likeness = {
                reader: (len(keys & data.keys()), -len(keys)) for reader, keys in objects.items()
            }
            return max(objects, key=likeness.__getitem__)(data, place, mismatches)
        for shape in shapes:
            with suppress(EnoughError):
                return shape.read(data, place, Mismatches(1))
        return shapes[-1].read(data, place, mismatches)

    return read


def _union_schema(schemas: Sequence[JsonObject]) -> JsonObject:
    """Write alternatives: a nullable simple type as a list of types."""
    others = [schema for schema in schemas if schema != {"type": "null"}]
    if len(others) == 1 and len(schemas) == 2 and isinstance(others[0].get("type"), str):
        schema = {**others[0], "type": [others[0]["type"], "null"]}
        if "const" in schema:
            schema["enum"] = [schema.pop("const")]
        return schema | ({"enum": [*schema["enum"], None]} if "enum" in schema else {})
    flat = [part for schema in schemas for part in schema.get("anyOf", [schema])]
    return {"anyOf": flat}


_MADE_BY: dict[Any, Callable[..., Shape]] = {
    Annotated: _annotated, Literal: _literal, Union: _union, types.UnionType: _union,
    tuple: _tuple, list: _list, dict: _mapping, Mapping: _mapping,
}  # fmt: skip
"""Compilers of types that have arguments, by their origin."""
