"""Conditions on the sensor channels, such as ``odometry.speed > 5 and lidar.count >= 1``."""

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
from pytest_dura.core.state import Lazy
from pytest_dura.faults.parts import RefusedError
from pytest_dura.faults.targets import AbsentRowError, Target

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
"""A field of every channel that has a length: how many entries it has."""


class _Term(NamedTuple):
    target: Target
    absolute: bool
    holds: Callable[[float, float], bool]
    bound: float


@dataclass(frozen=True, slots=True)
class Condition:
    """Comparisons of numbers in channels, all of which must hold; see :func:`parse_condition`."""

    text: str
    terms: tuple[_Term, ...]

    @property
    def targets(self) -> tuple[Target, ...]:
        """The channels and fields that it reads; ``time`` is none of them."""
        return tuple(term.target for term in self.terms if term.target.channel != TIME)

    def check(self, channels: Mapping[str, Any]) -> None:
        """Refuse channels that do not have all that it reads.

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
        found = _TERM.match(part)
        if found is None:
            raise RefusedError(
                f"{part.strip()!r} is not a comparison such as 'odometry.speed > 5'",
                f"a path, one of {' '.join(_COMPARISONS)}, and a number; several are joined by"
                " 'and'",
                "correct the condition",
            )
        target = Target.parse(found["path"])
        if (target.channel == TIME) == bool(target.field):
            raise RefusedError(
                f"{found['path']!r} is no number",
                f"channel.field, channel.{COUNT}, abs(channel.field) or {TIME}",
                "say which number of the channel is meant",
            )
        sign, bound = _COMPARISONS[found["sign"]], float(found["bound"])
        if not math.isfinite(bound):
            raise RefusedError(
                f"{found['bound']} in {part.strip()!r} is not a finite number", "a finite number"
            )
        terms.append(_Term(target, bool(found["abs"]), sign, bound))
    return Condition(text, tuple(terms))


def _number(target: Target, channels: Mapping[str, Any]) -> float:
    value = channels.get(target.channel)
    # The usual case at once: conditions are looked at in each tick.
    if target.field in getattr(type(value), "_fields", ()):
        found = getattr(value, target.field)
        if type(found) is float:
            return found
    value = target.channel_of(channels)
    if target.field == COUNT and not (isinstance(value, Mapping) and COUNT in value):
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
