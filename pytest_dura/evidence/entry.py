"""Entry: base of the entries of the evidence record, and the types of their fields.

The entries are the single description of ``evidence.json``: its JSON Schema and the tables of
``docs/record.md`` are generated from them, with the docstrings of fields as descriptions.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, is_dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar, get_type_hints

from pytest_dura.core.codec import LEFT_OUT, decode, encode

if TYPE_CHECKING:
    from typing_extensions import Self, dataclass_transform
else:  # what type checkers have to know

    def dataclass_transform(**_: Any) -> Any:
        """Mark nothing: a class makes dataclasses of those that derive from it by itself."""
        return lambda base: base


JsonObject = dict[str, Any]
_T = TypeVar("_T")

if TYPE_CHECKING:
    Absent: TypeAlias = _T | None
else:

    class Absent:
        """Type of a key that may be absent, which ``None`` stands for, and is never null."""

        def __class_getitem__(cls, kind: Any) -> Any:
            return kind


@dataclass_transform(frozen_default=True, kw_only_default=True)
@dataclass(frozen=True, kw_only=True)
class Entry:
    """Base of all entries, frozen dataclasses that the codec reads and writes."""

    def __init_subclass__(cls) -> None:
        for name, kind in cls.__annotations__.items():
            if str(kind).startswith("Absent["):
                setattr(cls, name, field(default=None, metadata=LEFT_OUT))
        dataclass(frozen=True, kw_only=True)(cls)

    def to_json(
        self, *, include: Collection[str] = (), exclude: Collection[str] = ()
    ) -> JsonObject:
        """Convert to plain data, in the order of the fields; what is absent stays absent.

        Args:
            include: Fields to convert; default: all.
            exclude: Fields to leave out.
        """
        data: JsonObject = encode(self)
        return {
            key: value
            for key, value in data.items()
            if (not include or key in include) and key not in exclude
        }

    @classmethod
    def from_data(cls, data: Mapping[str, Any]) -> Self:
        """Make it of plain data, in which entries may stand as they are.

        Raises:
            MismatchError: If the data does not agree with the fields.
        """
        if not any(map(_is_typed, data.values())):
            return decode(cls, plain_data(data))
        return cls(**_typed(cls, data))

    def replace(self, **changes: Any) -> Self:
        """Copy with other values, as plain data or entries."""
        return replace(self, **_typed(type(self), changes))


def _typed(kind: type[Entry], values: Mapping[str, Any]) -> JsonObject:
    hints = _hints(kind)  # type: ignore[arg-type]  # classes can be hashed
    return {
        name: value if _is_typed(value) else decode(hints[name], plain_data(value))
        for name, value in values.items()
    }


@cache
def _hints(kind: type[Any]) -> dict[str, Any]:
    return get_type_hints(kind, include_extras=True)


def _is_typed(value: Any) -> bool:
    """Whether a value is an entry, or a list of entries alone."""
    several = value if isinstance(value, list) else ()
    return is_dataclass(value) or (bool(several) and all(map(is_dataclass, several)))


def plain_data(value: Any) -> Any:
    """Convert a value to builtins; tuples become lists, numbers that are not finite ``None``.

    Dataclasses are those of the codec, which writes them.

    Raises:
        TypeError: For an object that is no data.
    """
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, float):  # numpy's doubles are such; before the slower questions
        return float(value) if math.isfinite(value) else None
    if is_dataclass(value):
        return encode(value)
    if isinstance(value, (list, tuple)):
        return [plain_data(entry) for entry in value]
    if type(value) is dict or isinstance(value, Mapping):
        return {str(key): plain_data(entry) for key, entry in value.items()}
    if hasattr(value, "tolist"):  # numpy's scalars and arrays
        return plain_data(value.tolist())
    raise TypeError(f"{type(value).__name__} is not plain data")
