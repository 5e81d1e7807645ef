"""Fault: type x target x activation x duration x parameters."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class FaultPart(BaseModel):
    """Base of the parts of a fault: unknown keys are errors, values do not change."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class Activation(FaultPart):
    """When a fault becomes active, and who says so."""

    at: NotNegative = Field(description="Simulated time of the first activation, in s.")
    every: Positive | None = Field(None, description="Repeat with this period, in s.")
    by: Literal["fault_injector", "security_assessor"] = Field(
        "fault_injector",
        description="Planned in the injector, or an attack that the SecurityAssessor directs.",
    )

    def due(self, time: float, since: float) -> bool:
        """Whether an activation falls into ``(since, time]``."""
        tolerance = 1e-9
        if self.every is None or time < self.at:
            return since + tolerance < self.at <= time + tolerance
        count = int((time - self.at + tolerance) / self.every)
        return self.at + count * self.every > since + tolerance


class Fault(FaultPart, ABC):
    """One entry of the catalogue. Subclasses add ``parameters`` and say what they do to a value."""

    type: str
    id: str
    target: str = Field(description="The sensor channel.")
    activation: Activation
    duration: Positive | None = Field(None, description="In s; null for permanent.")

    default_target: ClassVar[str]

    @classmethod
    @abstractmethod
    def example(cls) -> dict[str, Any]:
        """Activation and duration of the fault where only its name is given."""

    @abstractmethod
    def begin(self, channels: Mapping[str, Any], rng: np.random.Generator) -> Any:
        """What the fault remembers from its activation on: ``None`` if it has no effect yet."""

    @abstractmethod
    def apply(self, memory: Any, channels: Mapping[str, Any], elapsed: float) -> Any:
        """The target channel's new value, ``elapsed`` seconds after activation.

        The very object that was there means that nothing was changed.
        """
