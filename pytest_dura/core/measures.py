"""Measure: a figure of an episode that a simulator declares, and how tables and reports show it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from pytest_dura.core.display import short_repr
from pytest_dura.core.errors import ConfigurationError, describe_error

Value = bool | float | None
Shown = Literal["share", "count", "mean"]


@dataclass(frozen=True)
class Measure:
    """A figure of an episode.

    Args:
        name: Attribute of the episode, and key of the record.
        heading: Head of its column in the terminal, without the unit.
        meaning: What it counts or measures, after the heading and a colon.
        function: Function of an episode. What is shown as a share or a count is true or false; a
            mean is that of numbers, without those that are ``None`` or NaN.
        shown: How the runs of a case are summed up.
        unit: Of a number.
        signals: Signals that an episode needs to have the measure at all.
        severity: ``notable`` where true is worth a look at the episode, ``grave`` where moreover
            its case is shown in every report, however many cases there are.
        signal: Signal whose rise a viewer of the episode marks, if any.
        event: What the mark says, and the kind of events that say it already.
    """

    name: str
    heading: str
    meaning: str
    function: Callable[[Any], Value]
    shown: Shown
    unit: str = ""
    signals: tuple[str, ...] = ()
    severity: Literal["none", "notable", "grave"] = "none"
    signal: str | None = None
    event: str = ""

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

    def to_json(self, place: int) -> dict[str, Any]:
        """Describe it as plain data.

        Args:
            place: Its place among the columns, from 0.
        """
        described = {key: value for key, value in vars(self).items() if key != "function"}
        return {**described, "signals": list(self.signals), "function": self.path, "place": place}


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
