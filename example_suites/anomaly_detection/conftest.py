"""Puts the assessor that learned in place of the built-in one."""

from __future__ import annotations

import pytest
from anomaly_assessor import AnomalyAssessor


@pytest.fixture(scope="session")
def security_assessor() -> type[AnomalyAssessor]:
    return AnomalyAssessor


@pytest.fixture(scope="session")
def recovery_planner() -> None:
    """Detectors are measured where recovery does not change what there is left to detect."""
    return
