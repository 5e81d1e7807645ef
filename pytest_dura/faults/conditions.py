"""Conditions of faults: comparisons of what channels show, of the time and of counts."""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.percepts import Lazy
from pytest_dura.faults.parts import (
    AbsentRowError,
    RefusedError,
    Target,
)

_COMPARISONS: Mapping[str, Callable[[float, float], bool]] = {
    ">=": operator.ge,
    "<=": operator.le,
    ">": operator.gt,
    "<": operator.lt,
}

_TERM = re.compile(
    r"\s*(?P<abs>abs\(\s*)?(?P<path>[A-Za-z_]\w*(?:\.\w+)*)(?(abs)\s*\))"
    r"\s*(?P<sign>>=|<=|>|<)\s*(?P<bound>[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*\Z"
)

TIME = "time"
COUNT = "count"
"""Field of every channel that has a length: its number of entries."""


class _Term(NamedTuple):
    target: Target
    absolute: bool
    holds: Callable[[float, float], bool]
    bound: float


@dataclass(frozen=True, slots=True)
class Condition:
    """Comparisons of numbers in channels, joined by "and"; see :func:`parse_condition`."""

    text: str
    terms: tuple[_Term, ...]

    @property
    def targets(self) -> tuple[Target, ...]:
        """Channels and fields that it reads, without ``time``."""
        return tuple(term.target for term in self.terms if term.target.channel != TIME)

    def check(self, channels: Mapping[str, Any]) -> None:
        """Refuse channels that lack a target of the condition.

        Raises:
            ConfigurationError: For a channel or field that is not there, or is not a number.
        """
        for target in self.targets:
            with suppress(AbsentRowError):
                _number(target, channels)

    def holds(self, channels: Mapping[str, Any], time: float) -> bool:
        """Whether it holds for the channels at this simulated time, in s.

        It does not hold for a row that an array or list does not have at this tick, nor for NaN.

        Raises:
            ConfigurationError: For a channel or field that is not there, or is not a number.
        """
        try:
            for target, absolute, holds, bound in self.terms:
                value = time if target.channel == TIME else _number(target, channels)
                if not holds(abs(value) if absolute else value, bound):
                    return False
        except AbsentRowError:
            return False
        return True


@lru_cache(maxsize=256)
def parse_condition(text: str) -> Condition:
    """A condition from ``path cmp number``, joined by ``and``.

    A path is ``channel.field``, ``channel.count`` (its number of entries), ``abs(channel.field)``
    or ``time``; ``cmp`` is one of ``> >= < <=``.

    Raises:
        RefusedError: For anything else, with the part that is not understood.
    """
    terms = []
    for part in re.split(r"\band\b", text):
        match = _TERM.match(part)
        if match is None:
            raise RefusedError(
                f"{part.strip()!r} is not a comparison such as 'odometry.speed > 5'",
                f"a path, one of {' '.join(_COMPARISONS)}, and a number; several are joined by"
                " 'and'",
                "correct the condition",
            )
        target = Target.parse(match["path"])
        if (target.channel == TIME) == bool(target.field):
            raise RefusedError(
                f"{match['path']!r} is no number",
                f"channel.field, channel.{COUNT}, abs(channel.field) or {TIME}",
                "say which number of the channel is meant",
            )
        sign, bound = _COMPARISONS[match["sign"]], float(match["bound"])
        if not math.isfinite(bound):
            raise RefusedError(
                f"{match['bound']} in {part.strip()!r} is not a finite number", "a finite number"
            )
        terms.append(_Term(target, bool(match["abs"]), sign, bound))
    return Condition(text, tuple(terms))


_CHANNEL = re.compile(r"(?<![\w.])[A-Za-z_]\w*(?=\.)")
"""The channel of a path in the text of a condition."""


def by_channels(data: Mapping[str, Any], aliases: Mapping[str, str]) -> dict[str, Any]:
    """Copy a fault's plain data, in which channels have their own names instead of second ones.

    Those of the target and of conditions are replaced; what is malformed stays as it is.

    Args:
        data: As in a scenario file.
        aliases: Second names of channels, to their own.
    """
    named = {**data}
    target = data.get("target")
    if isinstance(target, str):
        channel, dot, field = target.partition(".")
        named["target"] = f"{aliases.get(channel, channel)}{dot}{field}"
    for part, key in (("activation", "when"), ("duration", "until")):
        inner = data.get(part)
        if isinstance(inner, Mapping) and isinstance(inner.get(key), str):
            text = _CHANNEL.sub(lambda match: aliases.get(match[0], match[0]), inner[key])
            named[part] = {**inner, key: text}
    return named


def _number(target: Target, channels: Mapping[str, Any]) -> float:
    value = target.channel_of(channels)
    names = value if isinstance(value, Mapping) else getattr(type(value), "_fields", ())
    if target.field == COUNT and COUNT not in names:
        value = value.get() if type(value) is Lazy else value
        if hasattr(value, "__len__"):
            return float(len(value))
    else:
        value = target.read(channels)
        if isinstance(value, (int, float, np.number, np.bool_)):
            return float(value)
    raise ConfigurationError(
        f"a condition cannot read {str(target)!r}, which is not a number",
        found=type(value).__name__,
        expected=f"a field that holds a number, or {COUNT} of what has entries",
        remedy="compare a number",
    )
