"""Dependability testing of AI-enabled cyber-physical systems, as a pytest plugin.

The public names are imported when they are first used, so that loading the plugin stays cheap.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

_HOMES = {
    "pytest_dura.core.errors": ("ActionError", "ConfigurationError", "DuraError", "InfrastructureError"),
    "pytest_dura.core.seeding": ("derive_seed", "stream"),
    "pytest_dura.core.state": ("Event", "GeneratorView", "Lazy", "Percept", "RoleView", "StateManager", "Tick"),
    "pytest_dura.core.simulator": ("Simulator",),
    "pytest_dura.core.roles": (
        "Alert", "Assessed", "Assessment", "FaultInjector", "Generator", "Injection",
        "PerformanceAssessment", "PerformanceOracle", "Proposal", "Recovery", "RecoveryPlanner",
        "Role", "RoleContext", "RoleSpec", "SafetyMonitor", "SecurityAssessment", "SecurityAssessor",
    ),
    "pytest_dura.core.episode": ("Episode", "EpisodeSpec", "Policy", "Termination"),
    "pytest_dura.core.metrics": ("DependabilityMetrics", "FaultRecord"),
    "pytest_dura.core.orchestrator": ("Orchestrator",),
    "pytest_dura.core.conformance": ("check_role", "check_simulator"),
}  # fmt: skip
_HOME_OF = {name: module for module, names in _HOMES.items() for name in names}

__all__ = sorted([*_HOME_OF, "__version__"])


def __getattr__(name: str) -> Any:
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_HOME_OF[name]), name)


def __dir__() -> list[str]:
    return list(__all__)
