"""Duration: how long a fault stays active, and in which of its ticks it acts."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
from pydantic import Discriminator, Field, Tag, field_validator, model_validator

from pytest_dura.faults.activation import TOLERANCE
from pytest_dura.faults.conditions import parse_condition
from pytest_dura.faults.parts import FaultPart, Positive, RefusedError


class Sampled(FaultPart):
    """Drawn uniformly from an interval, anew for each activation."""

    min: Positive = Field(description="Shortest, in s.")
    max: Positive = Field(description="Longest, in s.")

    @model_validator(mode="after")
    def _ordered(self) -> Sampled:
        if self.min > self.max:
            raise RefusedError(
                f"min is above max ({self.min:g} > {self.max:g})",
                "a shortest duration that is no longer than the longest",
                "exchange them",
            )
        return self


class Until(FaultPart):
    """Until a condition on the channels holds, as they are without any fault.

    It is looked at from the tick after the activation on.
    """

    until: str = Field(description="A condition on the channels, such as `odometry.speed < 1`.")
    at_most: Positive | None = Field(None, description="In s; null for no limit.")

    @field_validator("until")
    @classmethod
    def _condition(cls, text: str) -> str:
        parse_condition(text)
        return text


class Intermittent(FaultPart):
    """On and off by turns, on first: the duty cycle is ``on / (on + off)``."""

    on: Positive = Field(description="Seconds for which it acts.")
    off: Positive = Field(description="Seconds for which it then rests.")
    lasting: Positive | None = Field(
        None, description="Of all turns together, in s; null: for good."
    )

    def acts(self, elapsed: float) -> bool:
        """Whether it acts this many seconds after its activation."""
        period = self.on + self.off
        within = elapsed - math.floor(elapsed / period + TOLERANCE) * period
        return within < self.on - TOLERANCE


def _kind(value: object) -> str:
    if value == "once":
        return "<once>"
    if isinstance(value, FaultPart):
        return f"<{type(value).__name__.lower()}>"
    if isinstance(value, Mapping):
        if "until" in value or "at_most" in value:
            return "<until>"
        return "<intermittent>" if {"on", "off", "lasting"} & set(value) else "<sampled>"
    return "<seconds>"


Duration: TypeAlias = Annotated[
    Annotated[Positive, Tag("<seconds>")]
    | Annotated[Literal["once"], Tag("<once>")]
    | Annotated[Sampled, Tag("<sampled>")]
    | Annotated[Until, Tag("<until>")]
    | Annotated[Intermittent, Tag("<intermittent>")],
    Discriminator(_kind),
]
"""Seconds; ``once`` (one tick); ``{min, max}``; ``{until, at_most}``; or ``{on, off, lasting}``."""

DURATIONS = "seconds above 0, once, {min, max}, {until, at_most}, {on, off, lasting}, or null"
"""All that a duration can be, for messages."""


class Lifetime:
    """One activation's duration, drawn at its beginning. It lasts for one tick at least."""

    __slots__ = ("_duration", "_limit", "_until", "since")

    def __init__(self, duration: Any, since: float, dt: float, rng: np.random.Generator) -> None:
        self.since = since
        self._duration = duration
        self._until = parse_condition(duration.until) if isinstance(duration, Until) else None
        self._limit: float | None
        if duration == "once":
            self._limit = dt
        elif isinstance(duration, Sampled):
            self._limit = float(rng.uniform(duration.min, duration.max))
        elif isinstance(duration, Until):
            self._limit = duration.at_most
        elif isinstance(duration, Intermittent):
            self._limit = duration.lasting
        else:
            self._limit = duration

    def over(self, time: float, channels: Mapping[str, Any]) -> bool:
        """Whether it has ended by this time."""
        if self._limit is not None and time >= self.since + self._limit - TOLERANCE:
            return True
        return self._until is not None and self._until.holds(channels, time)

    def acts(self, time: float) -> bool:
        """Whether the fault acts at this time, which an intermittent one does by turns."""
        if isinstance(self._duration, Intermittent):
            return self._duration.acts(time - self.since)
        return True
