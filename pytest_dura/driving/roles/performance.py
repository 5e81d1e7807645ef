"""PerformanceOracle for driving."""

from __future__ import annotations

import sys
from collections import deque

from pytest_dura.core.roles import PerformanceAssessment, PerformanceOracle, RoleContext
from pytest_dura.core.state import RoleView
from pytest_dura.driving.maneuvers import acceleration_for
from pytest_dura.driving.percepts import own_motion
from pytest_dura.driving.scene import HALF, ego_of
from pytest_dura.driving.sensors import Imu

try:
    import resource
except ImportError:  # Windows has none
    resource = None  # type: ignore[assignment]


_JERK_WINDOW = 1.0
"""Seconds over which jerk is averaged before it is held against its limit."""
STANDING = 0.1
"""m/s; slower counts as standing."""
COMFORT_FAILURES = {
    "acceleration": "acceleration",
    "lateral_acceleration": "lateral_acceleration",
    "sustained_jerk": "jerk",
}
"""The names under which comfort fails, by the value that is too great."""
DISCOMFORT = "discomfort"
"""Value above 1 where passengers are uncomfortable: the greatest of the accelerations and jerks
that they feel, each as a share of its limit."""
_MEMORY_PERIOD = 200
"""Ticks between two readings of the process's memory, which can take half a millisecond."""


class DrivingOracle(PerformanceOracle):
    """Response time, resources, completion, clearance time, control accuracy, comfort, gridlock.

    Args:
        response_limit: Seconds for a proposal.
        acceleration_limit: m/s2 along the ego, either sign, that passengers take.
        lateral_limit: m/s2 across it that they take.
        jerk_limit: m/s3 along it that they take, on average over ``_JERK_WINDOW``.
        gridlock_after: Seconds of standing before the junction that count as gridlock.
        clearance_limit: Seconds to clear the junction.

    Values: ``completion`` (share of the way through the junction), ``clearance_time`` (s, from the
    tick at which the rear has left it), ``control_error`` (m/s2, commanded against executed),
    ``acceleration``, ``lateral_acceleration`` (m/s2), ``jerk``, ``lateral_jerk`` (m/s3, of one
    tick), ``sustained_jerk`` (m/s3, on average over ``_JERK_WINDOW``), ``discomfort`` (the greatest
    share of the limits of acceleration, lateral acceleration and sustained jerk; above 1 comfort
    fails), ``standing_time`` (s), and ``response_time`` (s) where the component declares its
    latency.
    Wall clock: ``response_time`` where it does not, ``memory`` (MiB, greatest so far; not on
    Windows).

    The limit of jerk is what ISO 15622 allows an adaptive cruise control below 5 m/s, 5 m/s3 on
    average over a second; above 20 m/s it is 2.5 m/s3, and a junction is crossed at less than
    10 m/s. Studies of standing passengers of public transport come to less (Hoberock 1977,
    2.94 m/s3). Both are quoted from memory of secondary sources, not from the texts themselves.
    What the brake builds up to, 40 m/s3, is PERF-3's matter.
    """

    def __init__(
        self,
        *,
        response_limit: float = 0.1,
        acceleration_limit: float = 6.0,
        lateral_limit: float = 3.0,
        jerk_limit: float = 5.0,
        gridlock_after: float = 20.0,
        clearance_limit: float = 60.0,
    ) -> None:
        self.response_limit = response_limit
        self.acceleration_limit = acceleration_limit
        self.lateral_limit = lateral_limit
        self.jerk_limit = jerk_limit
        self._limits = {
            "acceleration": acceleration_limit,
            "lateral_acceleration": lateral_limit,
            "sustained_jerk": jerk_limit,
        }
        self.gridlock_after = gridlock_after
        self.clearance_limit = clearance_limit

    def reset(self, context: RoleContext) -> None:
        """Begin to measure anew."""
        self._imu: Imu | None = None
        self._accelerations: deque[float] = deque()
        self._before: tuple[float, float] | None = None
        self._start = 0.0
        self._standing = 0.0
        self._clearance: float | None = None
        self._memory = 0.0

    def run(self, view: RoleView) -> PerformanceAssessment:
        """The values of this tick and the thresholds they passed."""
        percept = view.percept
        imu, (_, speed, way, s) = own_motion(percept), ego_of(percept)
        if self._imu is None:
            self._start, self._imu = s, imu
            # Before the first tick nothing is known to have changed.
            ticks = max(round(_JERK_WINDOW / view.dt), 1)
            self._accelerations = deque([imu.acceleration] * ticks, maxlen=ticks)
        # Over the window: there are as many samples as it has ticks.
        over = len(self._accelerations) * view.dt
        sustained = (imu.acceleration - self._accelerations[0]) / over
        self._accelerations.append(imu.acceleration)
        end = way.exit + HALF
        values = {
            "completion": min(max((s - self._start) / (end - self._start), 0.0), 1.0),
            "acceleration": imu.acceleration,
            "lateral_acceleration": imu.lateral_acceleration,
            "jerk": (imu.acceleration - self._imu.acceleration) / view.dt,
            "lateral_jerk": (imu.lateral_acceleration - self._imu.lateral_acceleration) / view.dt,
            "sustained_jerk": sustained,
        }
        values[DISCOMFORT] = max(abs(values[name]) / limit for name, limit in self._limits.items())
        if view.command is not None and self._before is not None:
            commanded = acceleration_for(view.command, *self._before, way.speed_limit)
            values["control_error"] = abs(imu.acceleration - commanded)
        cleared = s >= end
        self._standing = self._standing + view.dt if speed < STANDING and not cleared else 0.0
        values["standing_time"] = self._standing
        if cleared and self._clearance is None:
            self._clearance = view.time
        if self._clearance is not None:
            values["clearance_time"] = self._clearance
        self._imu = imu
        self._before = speed, way.stop_line - s - HALF
        if resource is not None and view.index % _MEMORY_PERIOD == 0:
            self._memory = _memory()
        wall_clock = {"memory": self._memory} if resource is not None else {}
        latency = view.proposal.latency if view.proposal is not None else None
        if latency is None:
            wall_clock["response_time"] = view.generator_seconds
        else:
            values["response_time"] = latency
        response = view.generator_seconds if latency is None else latency
        return PerformanceAssessment(values, wall_clock, self._failures(view, values, response))

    def _failures(
        self, view: RoleView, values: dict[str, float], response: float
    ) -> tuple[str, ...]:
        failures = [
            COMFORT_FAILURES[name]
            for name, most in self._limits.items()
            if abs(values[name]) > most
        ]
        if self._standing > self.gridlock_after:
            failures.append("gridlock")
        if self._clearance is None and view.time > self.clearance_limit:
            failures.append("clearance_time")
        if response > self.response_limit:
            failures.append("response_time")
        return tuple(failures)


def _memory() -> float:
    """Greatest resident size of the process so far in MiB."""
    size = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return size / (1024.0 if sys.platform != "darwin" else 1024.0 * 1024.0)
