"""RecoveryPlanners: what is done instead of a refused proposal."""

from __future__ import annotations

from pytest_dura.driving.roles.recovery.alert import AlertOnly
from pytest_dura.driving.roles.recovery.brake import EmergencyBrake
from pytest_dura.driving.roles.recovery.replan import Replan
from pytest_dura.driving.roles.recovery.stop import SafeStop
from pytest_dura.driving.roles.recovery.untrusted import IgnoreUntrusted

__all__ = ["AlertOnly", "EmergencyBrake", "IgnoreUntrusted", "Replan", "SafeStop"]
