"""Conformance kits, which a third party runs on its own simulator adapter and roles."""

from __future__ import annotations

from pytest_dura.core.errors import ConformanceError
from pytest_dura.core.findings import ConformanceReport
from pytest_dura.core.role_conformance import check_role
from pytest_dura.core.simulator_conformance import check_simulator

__all__ = ["ConformanceError", "ConformanceReport", "check_role", "check_simulator"]
