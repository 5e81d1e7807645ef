"""Parts of faults: strict models, bounded numbers, spans that a search tries, and targets."""

from __future__ import annotations

import typing
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import lru_cache
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field
from pydantic.fields import FieldInfo

from pytest_dura.core.classes import is_subclass
from pytest_dura.core.errors import ConfigurationError, did_you_mean
from pytest_dura.core.messages import MESSAGES
from pytest_dura.core.metrics import COMMAND
from pytest_dura.core.percepts import Lazy

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
        unit: Such as ``m``; empty for a plain number, or where the target has it.

    Raises:
        ConfigurationError: If they are not in order.
    """

    low: float
    high: float
    neutral: float = 0.0
    unit: str = ""

    def __post_init__(self) -> None:
        """Refuse a span that does not hold its neutral value, or has no width."""
        if not self.low <= self.neutral <= self.high or self.low == self.high:
            raise ConfigurationError(
                "a span is not in order",
                found=f"low {self.low:g}, neutral {self.neutral:g}, high {self.high:g}",
                expected="low <= neutral <= high, and low below high",
            )


class Quantity(NamedTuple):
    """What a channel declares of a number: its range, and the typical error of its sensor.

    Args:
        low: Least value that it reports; ``None`` where no range is declared.
        high: Greatest one.
        error: Standard deviation of a healthy sensor's error; ``None`` where none is declared.
    """

    low: float | None = None
    high: float | None = None
    error: float | None = None

    @property
    def ends(self) -> tuple[float, float] | None:
        """Its range, if one is declared."""
        return None if self.low is None or self.high is None else (self.low, self.high)

    @property
    def fault_error(self) -> float | None:
        """Error of a faulty sensor: three typical ones, which a healthy one seldom has."""
        return self._limited(3.0)

    @property
    def largest_error(self) -> float | None:
        """Largest error that a search tries: ten typical ones, and at most the whole range."""
        return self._limited(10.0)

    @property
    def largest_value(self) -> float | None:
        """The greatest amount that it reports."""
        return None if self.ends is None else max(map(abs, self.ends))

    def _limited(self, errors: float) -> float | None:
        if self.error is None:
            return None
        size = errors * self.error
        return size if self.ends is None else min(size, self.ends[1] - self.ends[0])


class Suited(NamedTuple):
    """A parameter of a fault as it suits a number: its default, and what a search tries."""

    default: float
    span: Span | None = None


@dataclass(frozen=True, slots=True)
class Choices:
    """Values of a parameter that a search chooses from, the simplest first, and their unit."""

    values: tuple[Any, ...]
    unit: str = ""


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
    return {f"{PARAMETERS}.{name}": span for name, span in values.items() if span is not None}


def parameters_of(kind: type[BaseModel]) -> type[BaseModel] | None:
    """Model of a type's parameters; ``None`` for a user's own type without any."""
    field = kind.model_fields.get(PARAMETERS)
    model = None if field is None else field.annotation
    return model if is_subclass(model, BaseModel) else None


def declared_span(field: FieldInfo) -> Span | None:
    """Span in the annotation of a parameter, if it has one."""
    return next((entry for entry in field.metadata if isinstance(entry, Span)), None)


def _values(name: str, field: FieldInfo) -> Span | Choices | None:
    span = declared_span(field)
    if span is not None:
        return _whole(name, span) if field.annotation is int else span
    if field.is_required():
        return None
    choices: tuple[Any, ...] = ()
    if typing.get_origin(field.annotation) is Literal:
        choices = typing.get_args(field.annotation)
    elif field.annotation is bool:
        choices = (False, True)
    if field.default not in choices:
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
    nearest = sorted(range(low, high + 1), key=lambda number: abs(number - neutral))
    return Choices(tuple(nearest), span.unit)


PROPOSAL = "proposal"
"""The component's proposal, in conditions of attacks that the SecurityAssessor directs."""


class AbsentRowError(ConfigurationError):
    """Row that a list or array does not have at this tick, but may have at another."""


@dataclass(frozen=True, slots=True)
class Target:
    """A channel and, for ``odometry.speed``, a field in it; ``radar.0.1`` indexes an array."""

    channel: str
    field: str = ""

    @staticmethod
    @lru_cache(maxsize=1024)
    def parse(text: str) -> Target:
        """Read ``channel``, ``channel.field`` or ``command``."""
        channel, _, field = text.partition(".")
        return Target(channel, field)

    def __str__(self) -> str:
        return f"{self.channel}.{self.field}" if self.field else self.channel

    @property
    def is_command(self) -> bool:
        """Whether it is the command, or a part of it."""
        return self.channel == COMMAND

    @property
    def is_message(self) -> bool:
        """Whether it is a message that the component sends, rather than a sensor's value."""
        return self.channel in MESSAGES

    def channel_of(self, channels: Mapping[str, Any]) -> Any:
        """Return the value of the whole channel.

        Raises:
            ConfigurationError: If there is no such channel.
        """
        try:
            return channels[self.channel]
        except KeyError:
            raise ConfigurationError(
                f"there is no channel {self.channel!r}",
                key="target",
                found=str(self),
                expected="one of " + ", ".join([*sorted(channels), COMMAND]),
                remedy="name a channel of this simulator",
            ) from None

    def read(self, channels: Mapping[str, Any]) -> Any:
        """Return its value; see :func:`part_of`."""
        return self.of(self.channel_of(channels))

    def of(self, channel: Any) -> Any:
        """Return its part of the channel's value; see :func:`part_of`."""
        return part_of(channel, self.field) if self.field else channel

    def written(self, channel: Any, value: Any) -> Any:
        """Return the channel's value with its part replaced."""
        return with_part(channel, self.field, value) if self.field else value


def part_of(value: Any, path: str) -> Any:
    """Return the part of a value at a dotted path of fields, keys of mappings and indices.

    Raises:
        AbsentRowError: If a list or array is too short for the index.
        ConfigurationError: If there is no such part.
    """
    head, _, rest = path.partition(".")
    if type(value) is Lazy:
        value = value.get()
    part: Any
    if isinstance(value, Mapping):
        if head not in value:
            raise _no_part(value, head)
        part = value[head]
    elif head in _field_names(value):
        part = getattr(value, head)
    elif _is_indexed(value, head):
        if int(head) >= len(value):
            raise AbsentRowError(f"there is no row {head} now, only {len(value)}", found=head)
        part = value[int(head)]
    else:
        raise _no_part(value, head)
    return part_of(part, rest) if rest else part


def with_part(value: Any, path: str, part: Any) -> Any:
    """Copy a value with the part at a dotted path replaced.

    An array of whole numbers becomes one of floats where the new part is a float.

    Raises:
        AbsentRowError: If a list or array is too short for the index.
        ConfigurationError: If there is no such part.
    """
    head, _, rest = path.partition(".")
    if type(value) is Lazy:
        value = value.get()
    old = part_of(value, head)  # raises if there is none
    new = with_part(old, rest, part) if rest else part
    if isinstance(value, Mapping):
        return {**value, head: new}
    if head in _field_names(value):
        if is_dataclass(value) and not isinstance(value, type):
            return replace(value, **{head: new})
        return value._replace(**{head: new})
    if isinstance(value, np.ndarray):
        whole = value.dtype.kind in "biu" and np.asarray(new).dtype.kind == "f"
        copy = value.astype(float if whole else value.dtype)
        copy[int(head)] = new
        copy.flags.writeable = False
        return copy
    entries = list(value)
    entries[int(head)] = new
    return value._make(entries) if hasattr(value, "_make") else type(value)(entries)


def resolved(value: Any) -> Any:
    """Return a value, made now if it is lazy: a picture read later would be of that later time."""
    return value.get() if type(value) is Lazy else value


def _field_names(value: Any) -> tuple[str, ...]:
    if is_dataclass(value) and not isinstance(value, type):
        return tuple(field.name for field in fields(value))
    return getattr(value, "_fields", ())


def _is_indexed(value: Any, head: str) -> bool:
    return isinstance(value, (np.ndarray, list, tuple)) and head.isdecimal()


def _no_part(value: Any, name: str) -> ConfigurationError:
    known = sorted(map(str, value)) if isinstance(value, Mapping) else list(_field_names(value))
    if not known and isinstance(value, (np.ndarray, list, tuple)):
        known = ["the rows, counted from 0"]
    return ConfigurationError(
        f"there is no {name!r} in a value of type {type(value).__name__}",
        key="target",
        found=name,
        expected="one of " + ", ".join(known) if known else "the channel as a whole",
        remedy=did_you_mean(name, known, "name a part that is there"),
    )
