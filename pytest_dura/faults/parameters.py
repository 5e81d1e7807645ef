"""Parameters of faults: strict models, bounded numbers, and the spans that a search may try."""

from __future__ import annotations

import typing
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field
from pydantic.fields import FieldInfo

from pytest_dura.core.errors import ConfigurationError

NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
"""A probability or a share, from 0 to 1."""


class FaultPart(BaseModel):
    """Base of the parts of a fault: unknown keys are errors, values do not change."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class RefusedError(ValueError):
    """A value that a part of a fault refuses, for validators to raise.

    Args:
        problem: What is wrong, in one sentence.
        expected: What would have been accepted.
        remedy: What to do about it.
    """

    def __init__(self, problem: str, expected: str, remedy: str = "correct the value") -> None:
        super().__init__(problem)
        self.expected, self.remedy = expected, remedy


PARAMETERS = "parameters"


@dataclass(frozen=True, slots=True)
class Span:
    """The values of a number that are worth a try, in its unit; it stands in ``Annotated``.

    Args:
        low: Least value.
        high: Greatest value.
        mildest: The value of least effect, between them: 0 of an offset, 1 of a factor.

    Raises:
        ConfigurationError: If they are not in order.
    """

    low: float
    high: float
    mildest: float = 0.0

    def __post_init__(self) -> None:
        """Refuse a span that does not hold its mildest value, or has no width."""
        if not self.low <= self.mildest <= self.high or self.low == self.high:
            raise ConfigurationError(
                "a span is not in order",
                found=f"low {self.low:g}, mildest {self.mildest:g}, high {self.high:g}",
                expected="low <= mildest <= high, and low below high",
            )


@dataclass(frozen=True, slots=True)
class Choices:
    """The values of a parameter that is chosen, the simplest first."""

    values: tuple[Any, ...]


def spans_of(kind: type[BaseModel]) -> Mapping[str, Span | Choices]:
    """The parameters of a type that a search may change, such as ``parameters.offset``.

    Those are the numbers with a :class:`Span` in their annotation, truth values, and words of a
    ``Literal``. Everything else stays at the type's example. Of a whole number there are as many
    values as there are from ``low`` to ``high``.

    Args:
        kind: A type of the catalogue, or a user's own.

    Raises:
        ConfigurationError: If the span of a whole number does not begin and end at one.
    """
    model = parameters_of(kind)
    if model is None:
        return {}
    found = {name: _values(name, model_field) for name, model_field in model.model_fields.items()}
    return {f"{PARAMETERS}.{name}": item for name, item in found.items() if item is not None}


def parameters_of(kind: type[BaseModel]) -> type[BaseModel] | None:
    """The model of a type's parameters; ``None`` for a type of a user's own that has none."""
    field = kind.model_fields.get(PARAMETERS)
    model = None if field is None else field.annotation
    return model if isinstance(model, type) and issubclass(model, BaseModel) else None


def declared_span(field: FieldInfo) -> Span | None:
    """The span in the annotation of a parameter, if it has one."""
    return next((item for item in field.metadata if isinstance(item, Span)), None)


def _values(name: str, field: FieldInfo) -> Span | Choices | None:
    span = declared_span(field)
    if span is not None:
        return _whole(name, span) if field.annotation is int else span
    if field.is_required():
        return None
    words = _choices(field.annotation)
    if words is None or field.default not in words:
        return None
    return Choices((field.default, *(item for item in words if item != field.default)))


def _whole(name: str, span: Span) -> Choices:
    """The whole numbers of a span, the mildest first."""
    ends = span.low, span.high, span.mildest
    if not all(float(end).is_integer() for end in ends):
        raise ConfigurationError(
            "the span of a whole number does not begin and end at one",
            key=f"{PARAMETERS}.{name}",
            found=f"low {span.low:g}, mildest {span.mildest:g}, high {span.high:g}",
            expected="whole numbers",
        )
    low, high, mildest = map(int, ends)
    return Choices(tuple(sorted(range(low, high + 1), key=lambda index: abs(index - mildest))))


def _choices(annotation: Any) -> tuple[Any, ...] | None:
    origin = typing.get_origin(annotation)
    if origin is Literal:
        return typing.get_args(annotation)
    if annotation is bool:
        return (False, True)
    return None
