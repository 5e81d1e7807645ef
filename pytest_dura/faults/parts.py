"""What the models of faults are made of: strict, frozen, and bounded numbers."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
"""A probability or a share, from 0 to 1."""


class FaultPart(BaseModel):
    """Base of the parts of a fault: unknown keys are errors, values do not change."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class RefusedError(ValueError):
    """A value that a part of a fault refuses, for validators to raise.

    Args:
        problem: What is wrong, in one sentence.
        expected: What would have been accepted.
        remedy: What to do about it.
    """

    def __init__(self, problem: str, expected: str, remedy: str = "correct the value") -> None:
        super().__init__(problem)
        self.expected, self.remedy = expected, remedy
