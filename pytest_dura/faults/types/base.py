"""Bases and helpers of the fault types: numbers at a target, bit flips, lazy values, examples."""

from __future__ import annotations

import copy
from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass, replace
from enum import Enum
from typing import Any, ClassVar, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.percepts import Lazy
from pytest_dura.faults.model import FaultEffect, Kind, Moment
from pytest_dura.faults.parts import FaultPart

Change: TypeAlias = Callable[[Any, np.random.Generator], Any]


def change_lazily(value: Any, rng: np.random.Generator, change: Change) -> Any:
    """Change a value; that of a lazy value is made and changed when it is read.

    The seed of the change's random numbers is drawn now, so that they depend neither on the time of
    reading nor on whether the value is still lazy after another fault.
    """
    seed = rng.integers(2**63)
    if type(value) is not Lazy:
        return change(value, np.random.default_rng(seed))
    return Lazy(lambda: change(value.get(), np.random.default_rng(seed)))


Numeric: TypeAlias = float | NDArray[np.float64]


def numeric_value(value: Any) -> Numeric:
    """Convert a value to a float, or an array of numbers (a row of a sensor's array) to floats.

    Raises:
        ConfigurationError: If it is neither.
    """
    if isinstance(value, np.ndarray) and value.dtype.kind in "fiu":
        return value.astype(np.float64)
    if _is_number(value):
        return float(value)
    raise ConfigurationError(
        "this fault acts on a number",
        key="target",
        found=value,
        expected="a target that holds a number, such as channel.field",
    )


def as_channel_value(value: Numeric) -> Numeric:
    """Convert a result to a channel's form: a plain float, or a read-only array."""
    if isinstance(value, np.ndarray):
        value.flags.writeable = False
        return value
    return float(value)


def flip_bits(value: Any, bits: int, rng: np.random.Generator) -> Any:
    """Invert bits of a number, drawn without repetition; a finite number stays finite.

    A Python ``int`` has 64 bits, one beyond that stays as it is; a numpy number has those of its
    type. If the bits that were drawn make infinity or no number, as many are drawn anew from
    those that are not the exponent's.
    """
    if isinstance(value, int) and not -(2**63) <= value < 2**63:
        return value
    flipped = _flipped(np.asarray(value), bits, rng)
    if isinstance(value, np.generic):
        return flipped[()]
    return flipped.item()


def _flipped(scalar: NDArray[Any], bits: int, rng: np.random.Generator) -> NDArray[Any]:
    width = 8 * scalar.dtype.itemsize
    floating = scalar.dtype.kind == "f"
    if floating and not np.isfinite(scalar):
        return scalar
    flipped = _inverted(scalar, rng.choice(width, min(bits, width), replace=False))
    if floating and not np.isfinite(flipped):
        mantissa = np.finfo(scalar.dtype).nmant
        harmless = np.array([*range(mantissa), width - 1])
        flipped = _inverted(scalar, rng.choice(harmless, min(bits, mantissa + 1), replace=False))
    return flipped


def _inverted(scalar: NDArray[Any], places: NDArray[Any]) -> NDArray[Any]:
    unsigned = np.dtype(f"u{scalar.dtype.itemsize}")
    mask = sum(1 << place for place in places.tolist())
    # A view of the bits needs the machine's byte order, which asarray of a number has.
    native = scalar.astype(scalar.dtype.newbyteorder("="))
    inverted: NDArray[Any] = (native.view(unsigned) ^ unsigned.type(mask)).view(native.dtype)
    return inverted


def count_numbers(message: Any) -> int:
    """Count the numbers of a message that :func:`with_changed_number` can reach.

    They are looked for in mappings, dataclasses, named and plain tuples, lists, arrays of floats
    and integers, and in objects that keep such an array in an attribute ``data``. Truth values
    and members of an ``Enum`` are no numbers.
    """
    if isinstance(message, np.ndarray):
        return message.size if _is_numeric(message) else 0
    if _is_number(message):
        return 1
    return sum(count_numbers(part) for part in _parts(message))


def with_changed_number(message: Any, index: int, change: Callable[[Any], Any]) -> Any:
    """Copy a message with one of its numbers changed.

    Args:
        message: See :func:`count_numbers`.
        index: From 0 to ``count_numbers(message) - 1``.
        change: Maps the old number to the new one, of the same type.
    """
    if isinstance(message, np.ndarray):
        array = message.copy()
        place = np.unravel_index(index, array.shape)
        array[place] = change(array[place])
        array.flags.writeable = False
        return array
    if _is_number(message):
        return change(message)
    for place_of_part, part in enumerate(_parts(message)):
        held = count_numbers(part)
        if index < held:
            return _with(message, place_of_part, with_changed_number(part, index, change))
        index -= held
    raise IndexError(index)


def _is_number(value: Any) -> bool:
    plain = isinstance(value, (int, float, np.integer, np.floating))
    return plain and not isinstance(value, (bool, Enum))


def _is_numeric(array: NDArray[Any]) -> bool:
    # Bits are flipped in an unsigned integer of the same size, which longdouble lacks.
    return array.dtype.kind in "fiu" and array.dtype.itemsize in (1, 2, 4, 8)


def _parts(message: Any) -> list[Any]:
    if isinstance(message, Mapping):
        return list(message.values())
    if is_dataclass(message) and not isinstance(message, type):
        return [getattr(message, name) for name in _initialised(message)]
    if isinstance(message, (tuple, list)):
        return list(message)
    data = getattr(message, "data", None)
    return [data] if isinstance(data, np.ndarray) else []


def _with(message: Any, place: int, part: Any) -> Any:
    if isinstance(message, Mapping):
        return {**message, list(message)[place]: part}
    if is_dataclass(message) and not isinstance(message, type):
        return replace(message, **{_initialised(message)[place]: part})
    if isinstance(message, (tuple, list)):
        parts = [*message[:place], part, *message[place + 1 :]]
        return message._make(parts) if hasattr(message, "_make") else type(message)(parts)
    twin = copy.copy(message)
    object.__setattr__(twin, "data", part)  # also where the class forbids assignment
    return twin


def _initialised(message: Any) -> list[str]:
    return [field.name for field in fields(message) if field.init]


class NoParameters(FaultPart):
    """No parameters."""


class NumberFault(FaultEffect):
    """Base of the types whose new value depends on a number alone, or on each of an array."""

    acts_on: ClassVar[Kind] = "number"

    def apply(self, memory: Any, value: Any, moment: Moment) -> Any:  # noqa: ARG002 - as FaultEffect has it
        """Return the changed number."""
        return as_channel_value(self.changed(numeric_value(value), moment))

    @abstractmethod
    def changed(self, value: Numeric, moment: Moment) -> Numeric:
        """Return the new number, or an array of new numbers."""
