"""Episodes made by hand, to be judged."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from handmade import SPEC, handmade

from pytest_dura import DependabilityMetrics, Episode, FaultRecord


def episode(
    *,
    gap: Any = (3.0, 2.0, 4.0),
    run: int = 0,
    failure: str | None = None,
    faults: tuple[FaultRecord, ...] = (),
    **signals: Any,
) -> Episode:
    """An episode with one sample per second and the signal ``gap``."""
    ticks = len(gap)
    asked = max(0, ticks - 1)
    return handmade(
        ticks,
        dt=1.0,
        spec=replace(SPEC, run=run, time_step=1.0),
        faults=faults,
        failure=failure,
        metrics=DependabilityMetrics(proposals=asked, valid_proposals=asked),
        decisions={"verdict": np.zeros(asked, dtype=np.int8)},
        gap=gap,
        **signals,
    )


def idle(fault: str = "ghost") -> FaultRecord:
    """A planned fault that never manifested."""
    return FaultRecord(fault, "lidar", planned_at=2.0)


def manifested(fault: str = "ghost") -> FaultRecord:
    """A planned fault that reached the component."""
    return FaultRecord(fault, "lidar", planned_at=1.0, activated_at=1.0, manifested_at=1.0)
