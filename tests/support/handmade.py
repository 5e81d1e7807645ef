"""Episodes made by hand, where the loop would only stand in the way of what is tested."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pytest_dura import DependabilityMetrics, Episode, EpisodeSpec, FaultRecord, RoleSpec

SPEC = EpisodeSpec("case", 0, 1, RoleSpec("a:Sim"), {"generator": RoleSpec("a:Planner")})
SOURCES = {"p": "proposal", "r": "recovery", "f": "fallback"}


def handmade(
    ticks: int,
    *,
    dt: float = 0.1,
    spec: EpisodeSpec = SPEC,
    faults: tuple[FaultRecord, ...] = (),
    failure: str | None = None,
    metrics: DependabilityMetrics | None = None,
    decisions: dict[str, Any] | None = None,
    **signals: Any,
) -> Episode:
    """An episode of so many ticks with these signals; whatever is not given is empty."""
    return Episode(
        spec=spec,
        time=np.arange(ticks) * dt,
        signals={name: np.array(values, dtype=float) for name, values in signals.items()},
        decisions=decisions or {},
        events=(),
        faults=faults,
        termination="infrastructure" if failure else "time",
        metrics=metrics or DependabilityMetrics(),
        failure=failure,
    )


def decided(sources: str, verdicts: Sequence[Any], *, dt: float = 0.5) -> Episode:
    """An episode with a decision per letter, p, r or f, and its verdict, 0, 1 or 2."""
    decisions = {
        "verdict": np.array([int(verdict) for verdict in verdicts], dtype=np.int8),
        "source": np.array([SOURCES[letter] for letter in sources], dtype=np.str_),
    }
    return handmade(len(sources) + 1, dt=dt, decisions=decisions)
