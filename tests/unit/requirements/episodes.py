"""Episodes made by hand, to be judged."""

from __future__ import annotations

from typing import Any

import numpy as np

from pytest_dura import DependabilityMetrics, Episode, EpisodeSpec, FaultRecord, RoleSpec


def episode(
    *,
    gap: Any = (3.0, 2.0, 4.0),
    run: int = 0,
    failure: str | None = None,
    faults: tuple[FaultRecord, ...] = (),
    **signals: Any,
) -> Episode:
    """An episode with one sample per second and the signal ``gap``."""
    columns = {name: np.array(values, dtype=float) for name, values in signals.items()}
    columns["gap"] = np.array(gap, dtype=float)
    ticks = len(columns["gap"])
    return Episode(
        spec=EpisodeSpec(
            "case",
            run,
            1,
            RoleSpec("a:Sim"),
            {"generator": RoleSpec("a:Planner")},
            time_step=1.0,
        ),
        time=np.arange(ticks, dtype=float),
        signals=columns,
        decisions={"verdict": np.zeros(max(0, ticks - 1), dtype=np.int8)},
        events=(),
        faults=faults,
        termination="infrastructure" if failure else "time",
        metrics=DependabilityMetrics(
            proposals=max(0, ticks - 1), valid_proposals=max(0, ticks - 1)
        ),
        failure=failure,
    )


def idle(fault: str = "ghost") -> FaultRecord:
    """A planned fault that never manifested."""
    return FaultRecord(fault, "lidar", planned_at=2.0)


def manifested(fault: str = "ghost") -> FaultRecord:
    """A planned fault that reached the component."""
    return FaultRecord(fault, "lidar", planned_at=1.0, activated_at=1.0, manifested_at=1.0)
