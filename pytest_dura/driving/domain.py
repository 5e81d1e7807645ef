"""The domain ``driving``: what it declares to files, faults, searches and reports.

Its simulator, roles and fault types are registered beside it, by entry points.
"""

from __future__ import annotations

from pytest_dura.domains import Domain
from pytest_dura.driving.explanations import SIGNALS
from pytest_dura.driving.scenario import DrivingWorld, concrete_world
from pytest_dura.driving.sensors import CHANNELS, FAULT_TARGETS
from pytest_dura.driving.signals import NAMES, PERCEPT_NAMES

DRIVING = Domain(
    name="driving",
    roles={
        "generator": "rule_based",
        "safety_monitor": "separation",
        "security_assessor": "plausibility",
        "fault_injector": "campaign",
        "performance_oracle": "driving",
        "recovery_planner": "emergency_brake",
    },
    # Parameters are recorded as they are, so functions are named by their import path.
    parameters={"stl": {"signals": "pytest_dura.driving.signals:percept_at"}},
    world=DrivingWorld,
    signals=NAMES,
    percept_signals=PERCEPT_NAMES,
    proposal_signals=SIGNALS,
    channels=CHANNELS,
    fault_targets=FAULT_TARGETS,
    concrete=concrete_world,
)
