"""Swaps the component under test: this planner is what every test here judges."""

from __future__ import annotations

import pytest
from planner import PatientPlanner

from pytest_dura import RoleSpec


@pytest.fixture(scope="session")
def generator() -> RoleSpec:
    """The class and its parameters; every episode builds a fresh instance."""
    return RoleSpec.of(PatientPlanner, {"sight": 45.0})
