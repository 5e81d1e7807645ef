"""Conditions on the sensor channels, such as ``odometry.speed > 5 and lidar.count >= 1``."""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.faults.targets import Target

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


@dataclass(frozen=True, slots=True)
class _Term:
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

    def holds(self, channels: Mapping[str, Any], time: float) -> bool:
        """Whether it holds for the channels at this simulated time, in s.

        Raises:
            ConfigurationError: For a channel or field that is not there, or is not a number.
        """
        for term in self.terms:
            value = time if term.target.channel == TIME else _number(term.target, channels)
            if not term.holds(abs(value) if term.absolute else value, term.bound):
                return False
        return True


@lru_cache(maxsize=256)
def parse_condition(text: str) -> Condition:
    """A condition from ``path cmp number``, joined by ``and``.

    A path is ``channel.field``, ``channel.count`` (its number of entries), ``abs(channel.field)``
    or ``time``; ``cmp`` is one of ``> >= < <=``.

    Raises:
        ValueError: For anything else, with the part that is not understood.
    """
    terms = []
    for part in re.split(r"\band\b", text):
        found = _TERM.match(part)
        if found is None:
            raise ValueError(
                f"{part.strip()!r} is not a comparison such as 'odometry.speed > 5',"
                " of which several are joined by 'and'"
            )
        target = Target.parse(found["path"])
        if not target.field and target.channel != TIME:
            raise ValueError(
                f"{found['path']!r} is no number; write channel.field, channel.{COUNT} or {TIME}"
            )
        sign, bound = _COMPARISONS[found["sign"]], float(found["bound"])
        terms.append(_Term(target, bool(found["abs"]), sign, bound))
    return Condition(text, tuple(terms))


def _number(target: Target, channels: Mapping[str, Any]) -> float:
    if target.field == COUNT:
        return float(len(target.channel_of(channels)))
    value = target.read(channels)
    try:
        return float(value)
    except (TypeError, ValueError):
        raise ConfigurationError(
            f"{target} is not a number",
            key="activation.when",
            found=type(value).__name__,
            expected="a field that holds a number",
        ) from None
