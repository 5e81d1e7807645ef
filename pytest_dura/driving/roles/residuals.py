"""ResidualMonitor: CUSUM tests on the residuals between sensors and a model of the ego's motion."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from pytest_dura.core.cusum import Cusum
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.roles import (
    Alert,
    Assessed,
    RoleContext,
    SecurityAssessment,
    SecurityAssessor,
)
from pytest_dura.core.state import NOTHING, RoleView
from pytest_dura.driving.residuals import Snapshot, residuals


class Limits(NamedTuple):
    """What a test forgives at each tick, and the sum at which it alarms; in the residual's unit."""

    drift: float
    threshold: float


_STAYS = Limits(0.5, 1.0)
"""Two ticks in a row, or more often than every other tick."""
LIMITS: Mapping[str, Limits] = {
    "odometry.speed": Limits(0.25, 3.2),
    "localisation.along": Limits(0.2, 3.2),
    "localisation.across": Limits(0.2, 3.2),
    "localisation.heading": Limits(0.05, 0.085),
    "command": Limits(0.5, 5.5),
    "lidar.x": Limits(1.0, 2.4),
    "lidar.y": Limits(1.0, 2.4),
    "frozen.odometry": _STAYS,
    "frozen.localisation": _STAYS,
    "frozen.lidar": _STAYS,
    "frozen.radar": _STAYS,
}
"""The tests. Each drift is half of the smallest lasting shift that is worth an alarm: 0.5 m/s2 of
speed, 0.4 m/s of displacement, 0.1 rad/s of turning, 1 m/s2 of the command's effect, 2 m/s of an
object's displacement. The thresholds are what ``benchmarks/residual_limits.py`` found."""


class ResidualMonitor(SecurityAssessor):
    """Watches whether the sensors contradict each other and the ego's motion for long enough.

    One two-sided CUSUM test per residual of ``pytest_dura.driving.residuals``; an alarm is an alert
    with a pattern such as ``residual:odometry.speed``. It names the contradiction, not the culprit:
    a wrong speed contradicts the imu and the localisation alike. It is alerted when it begins, and
    again after a quiet time. An alert is a warning, and stops nobody.

    Args:
        thresholds: By residual, drift and threshold in place of those of ``LIMITS``, in its unit.
        quiet: Seconds without an alarm after which a test's next one is alerted anew.

    Raises:
        ConfigurationError: For an unknown residual, and for numbers that cannot be.

    The score is 1 less how near the nearest test is to its alarm: 1 for not at all, 0 for an alarm.
    """

    name = "residual_monitor"
    reassess = False

    def __init__(
        self, thresholds: Mapping[str, Sequence[float]] = NOTHING, quiet: float = 1.0
    ) -> None:
        self.limits = {**LIMITS, **_checked(thresholds)}
        self.quiet = quiet

    @classmethod
    def check_params(
        cls,
        params: Mapping[str, Any],
        time_step: float,  # noqa: ARG003 - as Role has it
    ) -> None:
        """Refuse unknown residuals, and limits that are none."""
        _checked(params.get("thresholds", NOTHING))

    def reset(self, context: RoleContext) -> None:
        """Forget what was seen."""
        self._before: Snapshot | None = None
        self._tests: dict[tuple[str, str], Cusum] = {}
        self._seen: dict[tuple[str, str], float] = {}

    def run(self, view: RoleView) -> SecurityAssessment:
        """The alarms of this tick; none at the first one, where there is nothing to compare."""
        before, self._before = self._before, Snapshot.of(view.percept)
        if before is None:
            return _QUIET
        # What is out of sight is forgotten.
        earlier, self._tests = self._tests, {}
        alerts, reasons, nearest = [], [], 0.0
        for name, subject, residual in residuals(before, self._before, view.command, view.dt):
            key = name, subject
            test = self._tests[key] = earlier.get(key) or Cusum(*self.limits[name])
            if not test.update(residual):
                nearest = max(nearest, test.level)
                continue
            nearest = 1.0
            reasons.append(f"residual:{name} ({subject})")
            if view.time - self._seen.get(key, -math.inf) > self.quiet:
                detail = f"off by {residual:.2f} at last"
                alerts.append(Alert(f"residual:{name}", subject, detail))
            self._seen[key] = view.time
        return SecurityAssessment(
            verdict=Assessed.WARNING if reasons else Assessed.SAFE,
            score=1.0 - nearest,
            reasons=tuple(reasons),
            alerts=tuple(alerts),
        )


def _checked(thresholds: Mapping[str, Sequence[float]]) -> dict[str, Limits]:
    found = {}
    for name, pair in thresholds.items():
        if name not in LIMITS:
            raise ConfigurationError(
                f"there is no residual {name!r}",
                key="thresholds",
                found=name,
                expected=", ".join(LIMITS),
                remedy="correct its name",
            )
        try:
            found[name] = Limits(*pair)
            Cusum(*found[name])
        except (TypeError, ValueError):
            raise ConfigurationError(
                f"these are no limits of {name!r}",
                key=f"thresholds.{name}",
                found=pair,
                expected="drift (at least 0) and threshold (above 0)",
                remedy=f"for example {list(LIMITS[name])}",
            ) from None
    return found


_QUIET = SecurityAssessment(score=1.0)
