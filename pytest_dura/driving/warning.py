"""Warning in time: whether the safety monitor found a proposal unsafe before it came too near.

A check of requirements, such as ``MON-1`` of the built-in scenarios.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from pytest_dura.core.episode import Episode
from pytest_dura.core.roles import RecoveryPlanner, SafetyMonitor
from pytest_dura.requirements import CheckResult, monitor_timeline

NEAR = 0.5
"""Gap in m below which it is a near miss, as in ``SAF-2``."""
LEAD = 0.5
"""Seconds by which a warning has to come before: the ego's response time in ``SAF-3``."""
HORIZON = 4.0
"""Seconds before a near miss from which on a warning belongs to it: those of ``SAF-3``."""

_ROUNDING = 1e-9


def warned_in_time(episode: Episode) -> CheckResult:
    """Whether the monitor warned of each near miss at least :data:`LEAD` before it began.

    Where no recovery acts on a warning, each near miss violates it: so pairs without recovery, and
    those with a reference, say where there is something to warn of.

    The margin is by how much earlier it warned, in s; without a warning, by the lead.
    """
    near = episode.signal("gap") < NEAR
    began = episode.time[near & ~np.concatenate([[False], near[:-1]])].tolist()
    if not began:
        return CheckResult(True, detail="no near miss")
    if RecoveryPlanner.name not in episode.spec.roles or episode.spec.policy == "log_only":
        return CheckResult(False, None, began[0], "a near miss, and no recovery")
    alarms = monitor_timeline(episode).alarms.get(SafetyMonitor.name, ())
    earlier = {time: _earlier(alarms, time) for time in began}
    time = min(earlier, key=lambda each: earlier[each])
    margin = earlier[time] - LEAD
    detail = f"warned {earlier[time]:.1f} s before the near miss at {time:.1f} s"
    return CheckResult(margin >= -_ROUNDING, margin, time, detail)


def _earlier(alarms: Iterable[tuple[float, float]], time: float) -> float:
    """Return how many seconds before some time the first alarm of that time began; 0 without."""
    since = time - HORIZON
    own = (time - max(first, since) for first, last in alarms if first <= time and last >= since)
    return max(own, default=0.0)
