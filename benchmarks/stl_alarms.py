"""StlAlarms: a formula on raw channels as a detector, so that it can stand beside the others."""

from __future__ import annotations

from pytest_dura import StlSafetyMonitor
from pytest_dura.core import (
    Alert,
    Assessed,
    RoleContext,
    RoleView,
    SecurityAssessment,
    SecurityAssessor,
)
from pytest_dura.driving import MAX_ACCELERATION, MAX_BRAKING, SPEED_LIMIT

FORMULA = f"""
odometry.speed >= -0.1 and odometry.speed <= {1.25 * SPEED_LIMIT:g}
and imu.acceleration >= {-MAX_BRAKING - 0.5:g} and imu.acceleration <= {MAX_ACCELERATION + 0.5:g}
and abs(imu.yaw_rate) <= 1
and abs(localisation.x) <= 120 and abs(localisation.y) <= 120
and ((historically[0:1] (imu.acceleration > 1)) implies odometry.speed > 0.5)
and ((historically[0:1] (imu.acceleration < -1)) implies odometry.speed < {SPEED_LIMIT:g})
"""
"""The vehicle's envelope, with a margin, in m/s, m/s2, rad/s and m. Who accelerates for a second
rolls, and who brakes for a second is no longer at the limit. What a formula cannot say is by how
much a value changed since the tick before."""


class StlAlarms(SecurityAssessor):
    """Alerts where the formula begins not to hold, and again after a quiet second."""

    name = "residual_monitor"
    reassess = False

    def __init__(self) -> None:
        self.monitor = StlSafetyMonitor(" ".join(FORMULA.split()))

    def reset(self, context: RoleContext) -> None:
        self.monitor.reset(context)
        self._seen = -1e9

    def run(self, view: RoleView) -> SecurityAssessment:
        judged = self.monitor.run(view)
        if judged.verdict is Assessed.SAFE:
            return SecurityAssessment(score=judged.score)
        again, self._seen = view.time - self._seen <= 1.0, view.time
        alerts = () if again else (Alert("stl", "ego", "outside its envelope"),)
        return SecurityAssessment(Assessed.WARNING, judged.score, judged.reasons, alerts=alerts)
