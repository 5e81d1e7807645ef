"""Messages of ROS 2: their types, as rosbags has them, as types of DDS topics."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from types import MappingProxyType
from typing import Any

from pytest_dura.adapters.ros2.service_types import service_definitions
from pytest_dura.core.errors import ConfigurationError, did_you_mean

_NUMBERS = {
    **{name: name for name in ("int8", "int16", "int32", "int64", "float32", "float64")},
    **{name: name for name in ("uint8", "uint16", "uint32", "uint64")},
    "byte": "uint8",
    "octet": "uint8",
    "char": "uint8",
}
_BASE, _NAME, _ARRAY, _SEQUENCE = 1, 2, 3, 4
"""Kinds of a field's type, see `rosbags.interfaces.Nodetype`."""
CLOCK, TEXT = "rosgraph_msgs/msg/Clock", "std_msgs/msg/String"
_NANOSECONDS = 10**9


@cache
def definitions() -> Mapping[str, Any]:
    """Definitions of ROS 2 Humble's message types by name, and of services: constants and fields.

    Raises:
        ConfigurationError: Without the package.
    """
    try:
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise ConfigurationError(
            "the message types of ROS 2 need the package rosbags",
            key="topics",
            remedy="pip install 'pytest-dura[ros2]'",
        ) from None
    store = get_typestore(Stores.ROS2_HUMBLE)
    return MappingProxyType({**store.fielddefs, **service_definitions()})


@cache
def message_type(name: str) -> Any:
    """Return the DDS type of a message, as ROS 2 names and writes it.

    Args:
        name: Such as ``geometry_msgs/msg/Twist``.

    Raises:
        ConfigurationError: For a type that is not known, or has fields that DDS's has not here.
    """
    return _struct(name, {})


@cache
def sample_type(name: str) -> Any:
    """Return the DDS type of a request or reply, which identifies the request before its fields."""
    from cyclonedds.idl import types

    return _struct(name, {"guid": types.uint64, "seq": types.int64})


def _struct(name: str, before: Mapping[str, Any]) -> Any:
    from cyclonedds.idl import make_idl_struct

    fields = {field: _field_type(kind, name) for field, kind in _fields(name).items()}
    package, folder, short = name.split("/")
    return make_idl_struct(short, f"{package}::{folder}::dds_::{short}_", {**before, **fields})


def zero(name: str) -> Any:
    """Make a message with 0, empty texts and empty lists in it."""
    return message_type(name)(**{field: _zero(kind) for field, kind in _fields(name).items()})


def value_at(message: Any, path: str) -> float | tuple[float, ...]:
    """Return a number of a message, or all numbers of a list; NaN beyond the end of a list."""
    value = message
    for part in path.split("."):
        if part.isdecimal():
            value = value[int(part)] if int(part) < len(value) else math.nan
        else:
            value = getattr(value, part)
    is_list = isinstance(value, (list, tuple, bytes, bytearray))
    return tuple(map(float, value)) if is_list else float(value)


def set_value(message: Any, path: str, value: float | list[float], kind: str) -> None:
    """Set a number of a message, or all numbers of a list; a list grows to the place of a number.

    Args:
        message: The message.
        path: Of the field.
        value: The number or the numbers.
        kind: The type of numbers there, see :func:`number_type`.
    """
    as_type: Any = float if kind.startswith("float") else bool if kind == "bool" else round
    given = list(map(as_type, value)) if isinstance(value, list) else as_type(value)
    *parents, last = path.split(".")
    holder = message
    for part in parents:
        holder = getattr(holder, part)
    if last.isdecimal():
        holder.extend([0] * (int(last) + 1 - len(holder)))
        holder[int(last)] = given
    else:
        setattr(holder, last, given)


def number_type(name: str, path: str) -> tuple[str, bool]:
    """Return the type of the numbers at a path of a message, and whether they are a list.

    Raises:
        ConfigurationError: Where there is no number; ``key`` is ``field``.
    """
    kind: Any = (_NAME, name)
    at = name
    for part in path.split("."):
        node, detail = kind
        if part.isdecimal() and node in (_ARRAY, _SEQUENCE):
            kind = detail[0]
            continue
        known = list(_fields(detail)) if node == _NAME else []
        if part not in known:
            raise ConfigurationError(
                f"{at} has no field {part!r}",
                key="field",
                found=path,
                expected=", ".join(known) or "no further field",
                remedy=did_you_mean(part, known),
            )
        kind, at = _fields(detail)[part], f"{at}.{part}"
    node, detail = kind
    is_list = node in (_ARRAY, _SEQUENCE)
    node, detail = detail[0] if is_list else (node, detail)
    if node != _BASE or detail[0] not in (*_NUMBERS, "bool"):
        found = detail if node == _NAME else detail[0]
        raise ConfigurationError(
            f"{at} is no number", key="field", found=found, expected="a number, or a list of them"
        )
    return detail[0], is_list


def integer_range(kind: str) -> tuple[int, int]:
    """Return the least and the greatest number of a type of integers, zeros for another one."""
    name = _NUMBERS.get(kind, kind)
    if "int" not in name:
        return 0, 0
    is_signed = not name.startswith("u")
    greatest = 2 ** (int(name.removeprefix("u").removeprefix("int")) - is_signed) - 1
    return -(greatest + 1) * is_signed, greatest


def has_stamp(name: str) -> bool:
    """Whether a message has the time of its values, in a header."""
    return _fields(name).get("header") == (_NAME, "std_msgs/msg/Header")


def stamp_of(message: Any) -> int:
    """Return the nanoseconds of a message with a header, or of a clock."""
    stamp = message.clock if hasattr(message, "clock") else message.header.stamp
    seconds, nanoseconds = _stamp_fields(stamp)
    return int(getattr(stamp, seconds)) * _NANOSECONDS + int(getattr(stamp, nanoseconds))


def set_stamp(message: Any, nanoseconds: int) -> None:
    """Stamp a message with a header, or a clock."""
    stamp = message.clock if hasattr(message, "clock") else message.header.stamp
    for field, value in zip(_stamp_fields(stamp), divmod(nanoseconds, _NANOSECONDS), strict=True):
        setattr(stamp, field, value)


def _stamp_fields(stamp: Any) -> tuple[str, str]:
    """Names of seconds and nanoseconds: those of ROS 2, or of ROS 1."""
    return ("sec", "nanosec") if hasattr(stamp, "nanosec") else ("secs", "nsecs")


def _fields(name: str) -> dict[str, Any]:
    """Types of the fields of a message, in order."""
    known = definitions()
    if name not in known:
        raise ConfigurationError(
            f"there is no message type {name!r}",
            key="topics",
            found=name,
            expected="a type of ROS 2 Humble, such as geometry_msgs/msg/Twist",
            remedy=did_you_mean(name, known),
        )
    return dict(known[name][1])


def _field_type(kind: Any, name: str) -> Any:
    from cyclonedds import idl

    kinds: Any = idl.types
    node, detail = kind
    if node == _NAME:
        return message_type(detail)
    if node == _ARRAY:
        return kinds.array[_field_type(detail[0], name), detail[1]]
    if node == _SEQUENCE:
        return kinds.sequence[_field_type(detail[0], name)]
    if detail[0] in ("string", "bool"):
        return str if detail[0] == "string" else bool
    if detail[0] not in _NUMBERS:
        raise ConfigurationError(
            f"the message type {name!r} has a field that cannot be used",
            key="topics",
            found=detail[0],
            expected="numbers, texts, other messages and lists of them",
        )
    return getattr(kinds, _NUMBERS[detail[0]])


def _zero(kind: Any) -> Any:
    node, detail = kind
    if node == _NAME:
        return zero(detail)
    if node == _ARRAY:
        return [_zero(detail[0]) for _ in range(detail[1])]
    if node == _SEQUENCE:
        return []
    if detail[0] == "string":
        return ""
    return False if detail[0] == "bool" else 0.0 if detail[0].startswith("float") else 0
