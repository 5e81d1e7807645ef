"""Measure: a figure of an episode that a simulator declares, and how tables and reports show it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Generic, Literal, TypeVar

import numpy as np

from pytest_dura.core.codec import Count
from pytest_dura.core.display import short_repr
from pytest_dura.core.errors import ConfigurationError, describe_error

Value = bool | float | None
Form = Literal["share", "count", "mean"]


_Function = TypeVar("_Function")


@dataclass(frozen=True)
class _Declared(Generic[_Function]):
    """What a simulator declares of a figure."""

    name: str
    """Attribute of the episode, and key in `outcome.measures` of episodes and `metrics.measures` of
    cases."""
    heading: str
    """Head of its column in the terminal, without the unit."""
    meaning: str
    """What it counts or measures, after the heading and a colon."""
    function: _Function
    """Function of an episode. What is shown as a share or a count is true or false; a mean is that
    of numbers, without those that are `None` or NaN."""
    shown: Form
    """How the runs of a case are summed up: a share or a count of those in which it is true, or the
    mean of a number."""
    unit: str = ""
    """Of a number; empty for a truth value."""
    signals: tuple[str, ...] = ()
    """Signals that an episode needs to have it."""
    severity: Literal["none", "notable", "grave"] = "none"
    """`notable`: where it is true, the episode is listed. `grave`: its case is also shown in every
    report, however many cases there are."""
    signal: str | None = None
    """Signal whose rise the player marks; null for none."""
    event: str = ""
    """What the mark says, and the kind of events that say it already; empty without a mark."""
    table: Literal["outcomes", "reliance"] = "outcomes"
    """Table of cases in the terminal that has its column: that of outcomes, or that of how a case
    relies on recovery."""


@dataclass(frozen=True)
class MeasureInfo(_Declared[str]):
    """A figure of an episode that a simulator declares, as plain data."""

    function: str
    """Import path of the function that measures an episode."""
    place: Count = field(kw_only=True)
    """Its place among the measures of its simulator, from 0."""


@dataclass(frozen=True)
class Measure(_Declared[Callable[[Any], Value]]):
    """A figure of an episode, with the function that measures it."""

    __repr__ = short_repr

    @property
    def path(self) -> str:
        """Import path of the function."""
        return f"{self.function.__module__}:{self.function.__qualname__}"

    def value(self, episode: Any) -> Value:
        """Measure an episode.

        Raises:
            ConfigurationError: If the function fails, or returns something else.
        """
        try:
            value = self.function(episode)
        except ConfigurationError:
            raise
        except Exception as error:
            raise ConfigurationError(
                f"the measure {self.name!r} failed on {episode.id}: {describe_error(error)}",
                found=self.path,
                remedy="correct its function",
            ) from error
        if value is None:
            return None
        if isinstance(value, (bool, np.bool_)) != (self.shown == "mean"):
            if self.shown != "mean":
                return bool(value)
            if isinstance(value, (int, float)):
                return float(value) if math.isfinite(value) else None
        raise ConfigurationError(
            f"the measure {self.name!r} of {episode.id} is of another type",
            found=value,
            expected="a number or None" if self.shown == "mean" else "True, False or None",
            remedy=f"correct {self.path}",
        )

    def info(self, place: int) -> MeasureInfo:
        """Describe it as plain data.

        Args:
            place: Its place among the columns, from 0.
        """
        return MeasureInfo(**{**vars(self), "function": self.path}, place=place)


def measured(measures: Iterable[Measure], episode: Any) -> dict[str, Value]:
    """Measure an episode; without what it lacks the signals for, or has no truth value."""
    signals: Mapping[str, Any] = episode.signals
    values = {
        measure.name: (measure.shown, measure.value(episode))
        for measure in measures
        if all(signal in signals for signal in measure.signals)
    }
    return {
        name: value
        for name, (shown, value) in values.items()
        if shown == "mean" or value is not None
    }
