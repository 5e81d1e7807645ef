"""Parameters of faults: strict models, bounded numbers, and the spans that a search may try."""

from __future__ import annotations

import typing
import warnings
from collections.abc import Mapping
from dataclasses import InitVar, dataclass
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
    """Refusal of a value by a part of a fault, for validators to raise.

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
    """Range of a number that a search tries, in its unit; it stands in ``Annotated``.

    Args:
        low: Least value.
        high: Greatest value.
        neutral: Value of least effect, between them: 0 of an offset, 1 of a factor.
        mildest: Deprecated name of ``neutral``.

    Raises:
        ConfigurationError: If they are not in order.
    """

    low: float
    high: float
    neutral: float = 0.0
    mildest: InitVar[float | None] = None

    def __post_init__(self, mildest: float | None) -> None:
        """Refuse a span that does not hold its neutral value, or has no width."""
        if mildest is not None:
            message = "Span(mildest=...) is deprecated: use neutral"
            warnings.warn(message, DeprecationWarning, stacklevel=3)
            object.__setattr__(self, "neutral", mildest)
        if not self.low <= self.neutral <= self.high or self.low == self.high:
            raise ConfigurationError(
                "a span is not in order",
                found=f"low {self.low:g}, neutral {self.neutral:g}, high {self.high:g}",
                expected="low <= neutral <= high, and low below high",
            )


@dataclass(frozen=True, slots=True)
class Choices:
    """Values of a parameter that a search chooses from, the simplest first."""

    values: tuple[Any, ...]


def spans_of(kind: type[BaseModel]) -> Mapping[str, Span | Choices]:
    """Map the parameters that a search may change, such as ``parameters.offset``, to their values.

    Those are the numbers with a :class:`Span` in their annotation, truth values, and values of a
    ``Literal``. All others stay as in the type's example. A whole number takes all values from
    ``low`` to ``high``.

    Args:
        kind: A type of the catalogue, or a user's own.

    Raises:
        ConfigurationError: If the span of a whole number does not begin and end at one.
    """
    model = parameters_of(kind)
    if model is None:
        return {}
    values = {name: _values(name, field) for name, field in model.model_fields.items()}
    return {f"{PARAMETERS}.{name}": tried for name, tried in values.items() if tried is not None}


def parameters_of(kind: type[BaseModel]) -> type[BaseModel] | None:
    """Model of a type's parameters; ``None`` for a user's own type without any."""
    field = kind.model_fields.get(PARAMETERS)
    model = None if field is None else field.annotation
    return model if isinstance(model, type) and issubclass(model, BaseModel) else None


def declared_span(field: FieldInfo) -> Span | None:
    """Span in the annotation of a parameter, if it has one."""
    return next((entry for entry in field.metadata if isinstance(entry, Span)), None)


def _values(name: str, field: FieldInfo) -> Span | Choices | None:
    span = declared_span(field)
    if span is not None:
        return _whole(name, span) if field.annotation is int else span
    if field.is_required():
        return None
    choices = _choices(field.annotation)
    if choices is None or field.default not in choices:
        return None
    return Choices((field.default, *(choice for choice in choices if choice != field.default)))


def _whole(name: str, span: Span) -> Choices:
    """Whole numbers of a span, the neutral one first."""
    ends = span.low, span.high, span.neutral
    if not all(float(end).is_integer() for end in ends):
        raise ConfigurationError(
            "the span of a whole number does not begin and end at one",
            key=f"{PARAMETERS}.{name}",
            found=f"low {span.low:g}, neutral {span.neutral:g}, high {span.high:g}",
            expected="whole numbers",
        )
    low, high, neutral = map(int, ends)
    return Choices(tuple(sorted(range(low, high + 1), key=lambda number: abs(number - neutral))))


def _choices(annotation: Any) -> tuple[Any, ...] | None:
    origin = typing.get_origin(annotation)
    if origin is Literal:
        return typing.get_args(annotation)
    if annotation is bool:
        return (False, True)
    return None
