"""Learned residual monitors: an isolation forest and a one-class SVM over driving features.

Both learned on fault-free episodes, with sensor noise of stated size; see ``docs/detectors.md``.
"""

from __future__ import annotations

from pathlib import Path

from pytest_dura.core.anomaly_monitor import AnomalyMonitor
from pytest_dura.driving.features import DrivingFeatures

_MODELS = Path(__file__).parents[1] / "models"


class IsolationForestMonitor(AnomalyMonitor):
    """Alarms where few random splits of the features isolate a tick from those of training.

    See :class:`pytest_dura.core.anomaly_monitor.AnomalyMonitor` for parameters and alerts, and
    :class:`pytest_dura.driving.features.DrivingFeatures` for the features.
    """

    name = "residual_monitor"
    kind = "isolation_forest"
    shipped = _MODELS / "isolation_forest.json"

    @classmethod
    def source(cls) -> DrivingFeatures:
        """The features of the driving domain."""
        return DrivingFeatures()


class OneClassSvmMonitor(AnomalyMonitor):
    """Alarms where a tick's features are beyond the border that encloses those of training.

    See :class:`pytest_dura.core.anomaly_monitor.AnomalyMonitor` for parameters and alerts, and
    :class:`pytest_dura.driving.features.DrivingFeatures` for the features.
    """

    name = "residual_monitor"
    kind = "one_class_svm"
    shipped = _MODELS / "one_class_svm.json"

    @classmethod
    def source(cls) -> DrivingFeatures:
        """The features of the driving domain."""
        return DrivingFeatures()
