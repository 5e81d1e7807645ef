"""Targets of faults: a channel, a field of a channel, or the command."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.metrics import COMMAND
from pytest_dura.core.state import Lazy

MESSAGES = ("prompt", "model")
"""Channels of the component's own: the prompt of a model, and how the model is reached."""
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
    near = difflib.get_close_matches(name, known, n=1)
    return ConfigurationError(
        f"there is no {name!r} in a value of type {type(value).__name__}",
        key="target",
        found=name,
        expected="one of " + ", ".join(known) if known else "the channel as a whole",
        remedy=f"did you mean {near[0]!r}?" if near else "name a part that is there",
    )
