"""What the driving domain's faults have in common: what they act on, and which objects."""

from __future__ import annotations

import math
from typing import Annotated, Any, ClassVar

from pydantic import Field

from pytest_dura.driving.bodies import Body, BodyList
from pytest_dura.faults.model import Fault, Kind
from pytest_dura.faults.parts import FaultPart

Ids = Annotated[tuple[str, ...], Field(strict=False)]
"""Ids of objects; a list in a scenario file."""


class Selection(FaultPart):
    """Which objects a fault is about; all that are reported, unless told otherwise."""

    ids: Ids | None = Field(None, description="Ids of the objects; null for all.")
    nearest: Annotated[int, Field(ge=1)] | None = Field(
        None, description="Only so many of them: those nearest to the ego at each tick."
    )

    def rows(self, bodies: BodyList, pose: Any) -> list[int]:
        """Rows of the selected objects, in the order of the list."""
        rows = [row for row, name in enumerate(bodies.ids) if self.ids is None or name in self.ids]
        if self.nearest is None:
            return rows
        return sorted(sorted(rows, key=lambda row: distance(bodies[row], pose))[: self.nearest])


def distance(body: Body, pose: Any) -> tuple[float, str]:
    """Metres from a pose to a body's centre, and its id, which decides between equal ones."""
    return math.hypot(body.x - pose.x, body.y - pose.y), body.id


class ObjectFault(Fault):
    """Base of the faults that tamper with a list of objects, which only lidar reports."""

    acts_on: ClassVar[Kind] = "objects"
    default_target: ClassVar[str | None] = "lidar"

    @classmethod
    def example(cls) -> dict[str, Any]:
        """Two seconds into the episode, for five seconds."""
        return {"activation": {"at": 2.0}, "duration": 5.0}


class PoseFault(Fault):
    """Base of the faults that tamper with a pose, which only ``localisation`` reports."""

    acts_on: ClassVar[Kind] = "pose"
    default_target: ClassVar[str | None] = "localisation"

    @classmethod
    def example(cls) -> dict[str, Any]:
        """Two seconds into the episode, for five seconds."""
        return {"activation": {"at": 2.0}, "duration": 5.0}
