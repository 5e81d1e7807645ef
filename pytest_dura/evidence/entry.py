"""Entry: base of the models of the evidence record, and the types of their fields.

The models are the single description of ``evidence.json``: its JSON Schema and the tables of
``docs/record.md`` are generated from them, with the docstrings of fields as descriptions.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, is_dataclass
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import CoreSchema, core_schema

from pytest_dura.core.codec import decode, encode

if TYPE_CHECKING:
    from typing_extensions import Self

JsonObject = dict[str, Any]


class Entry(BaseModel):
    """Base of all entries. A value of another type, NaN and unknown keys are refused."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", strict=True, allow_inf_nan=False, defer_build=True
    )

    def to_json(
        self, *, include: set[str] | None = None, exclude: set[str] | None = None
    ) -> JsonObject:
        """Convert to plain data, in the order of the fields; what is absent stays absent.

        Args:
            include: Fields to convert; default: all.
            exclude: Fields to leave out.
        """
        return self.model_dump(include=include, exclude=exclude, exclude_unset=True)

    def replace(self, **changes: Any) -> Self:
        """Copy with other values, which are validated."""
        present = {name: self.__dict__[name] for name in self.model_fields_set & vars(self).keys()}
        return self.model_validate({**present, **(self.model_extra or {}), **changes})


class OpenEntry(Entry):
    """Base of entries that may have further keys, which depend on the domain."""

    model_config = ConfigDict(extra="allow")


@dataclass(frozen=True)
class _Finite:
    """Marks a number: finite, and an integer stays one, so that it is written as it was read."""

    ge: float | None = None
    gt: float | None = None
    le: float | None = None
    lt: float | None = None

    def __get_pydantic_core_schema__(self, _: Any, __: GetCoreSchemaHandler) -> CoreSchema:
        limits: dict[str, Any] = dict(vars(self))
        return core_schema.union_schema(
            [
                core_schema.int_schema(strict=True, **limits),
                core_schema.float_schema(strict=True, allow_inf_nan=False, **limits),
            ],
            mode="left_to_right",
            serialization=core_schema.simple_ser_schema("any"),
        )

    def __get_pydantic_json_schema__(
        self, _: CoreSchema, __: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        names = {"minimum": self.ge, "exclusiveMinimum": self.gt, "maximum": self.le,
                 "exclusiveMaximum": self.lt}  # fmt: skip
        return {"type": "number"} | {key: at for key, at in names.items() if at is not None}


class _NotNull:
    """Marks a key that may be absent, which ``None`` stands for, and is never null."""

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        schema = handler(source)
        return schema["schema"] if schema["type"] == "nullable" else schema


CODED = "coded"
"""Key of a schema that stands for that of a dataclass, which :mod:`.schema` writes in its place."""


class _Coded:
    """Marks a field that holds a dataclass of the domain, which the codec reads and writes."""

    def __get_pydantic_core_schema__(self, source: Any, _: GetCoreSchemaHandler) -> CoreSchema:
        def read(value: Any) -> Any:
            return value if isinstance(value, source) else decode(source, value)

        return core_schema.no_info_plain_validator_function(
            read,
            serialization=core_schema.plain_serializer_function_ser_schema(encode),
            metadata={CODED: source},
        )

    def __get_pydantic_json_schema__(self, schema: Any, _: GetJsonSchemaHandler) -> dict[str, Any]:
        return {CODED: schema["metadata"][CODED]}


_T = TypeVar("_T")
Coded = Annotated[_T, _Coded()]
Absent = Annotated[_T | None, _NotNull()]
Count = Annotated[int, Field(ge=0)]
Positive = Annotated[int, Field(ge=1)]
Number = Annotated[float, _Finite()]
Amount = Annotated[float, _Finite(ge=0)]
PositiveNumber = Annotated[float, _Finite(gt=0)]
Share = Annotated[float, _Finite(ge=0, le=1)]
Confidence = Annotated[float, _Finite(gt=0, lt=1)]
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


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
    if isinstance(value, Entry) or is_dataclass(value):
        return value.to_json() if isinstance(value, Entry) else encode(value)
    if isinstance(value, Mapping):
        return {str(key): plain_data(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain_data(entry) for entry in value]
    if hasattr(value, "tolist"):  # numpy's scalars and arrays
        return plain_data(value.tolist())
    raise TypeError(f"{type(value).__name__} is not plain data")
