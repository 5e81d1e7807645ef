"""What a monitor's formula reads: the signals of one percept."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.core.state import Percept

PREFIX = "percept."

Reader: TypeAlias = Callable[[Percept], Mapping[str, Any]]
"""Gives the values of a percept by the names that a formula has for them."""


def percept_reader(names: Sequence[str], signals: str | None) -> Reader:
    """Reads the signals that a formula names; ``gap`` and ``percept.gap`` are both the percept's.

    Args:
        names: The signals of the formula.
        signals: Import path of a function that takes a percept and returns values by name. Without
            it a name is a channel that is a number, or a channel and a field: ``odometry.speed``.

    Raises:
        ConfigurationError: If there is no such function. The reader raises it for a name that the
            channels do not have, and for a function that returns no mapping.
    """
    if signals is None:
        return lambda percept: {name: _channel_value(percept, name) for name in names}
    function = _function(signals)
    prefixed = [name for name in names if name.startswith(PREFIX)]

    def read(percept: Percept) -> Mapping[str, Any]:
        values = function(percept)
        if not isinstance(values, Mapping):
            raise ConfigurationError(
                f"{signals} returned no signals",
                key="signals",
                found=values,
                expected="a mapping from names to numbers",
            )
        more = {name: values[bare] for name in prefixed if (bare := _bare(name)) in values}
        return {**values, **more} if more else values

    return read


def _bare(name: str) -> str:
    return name.removeprefix(PREFIX)


def _function(signals: str) -> Callable[[Percept], Any]:
    if not isinstance(signals, str):
        raise _no_function("the signals of a monitor are no import path", signals)
    try:
        return RoleSpec(signals).function()
    except ConfigurationError as error:
        raise _no_function(error.problem, signals) from error


def _no_function(problem: str, signals: object) -> ConfigurationError:
    return ConfigurationError(
        problem,
        key="signals",
        found=signals,
        expected="the import path package.module:name of a function that takes a percept and "
        "returns its signals by name",
        remedy="correct it, or leave it out to read channels such as odometry.speed",
    )


def _channel_value(percept: Percept, name: str) -> Any:
    channel, *fields = _bare(name).split(".")
    if channel not in percept:
        raise _unreadable(name, f"there is no channel {channel!r}", percept)
    value = percept[channel]
    for field in fields:
        known = _fields(value)
        if field not in known:
            raise _unreadable(name, f"there is no {field!r} in it", known)
        value = value[field] if isinstance(value, Mapping) else getattr(value, field)
    return value


def _fields(value: Any) -> Sequence[str]:
    if isinstance(value, Mapping):
        return [key for key in value if isinstance(key, str)]
    if dataclasses.is_dataclass(value):
        return [field.name for field in dataclasses.fields(value)]
    if isinstance(value, tuple):
        return tuple(getattr(value, "_fields", ()))
    return [name for name in getattr(value, "__dict__", ()) if not name.startswith("_")]


def _unreadable(name: str, why: str, known: Sequence[str] | Percept) -> ConfigurationError:
    return ConfigurationError(
        f"the signal {name!r} cannot be read from the percept: {why}",
        found=name,
        expected="one of " + ", ".join(sorted(known)) if known else "nothing, it has no fields",
        remedy="name a channel and its field, as in odometry.speed, or give the import path of a "
        "function of the percept as `signals`",
    )
