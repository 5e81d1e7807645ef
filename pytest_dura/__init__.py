"""Dependability testing of AI-enabled cyber-physical systems, as a pytest plugin.

The public names are imported when they are first used, so that loading the plugin stays cheap.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pytest_dura.campaign.campaigns import Campaign, RequirementViolated
    from pytest_dura.campaign.cases import Case
    from pytest_dura.campaign.paired import PairedCampaign
    from pytest_dura.campaign.runner import Bench
    from pytest_dura.campaign.search.campaigns import Falsified
    from pytest_dura.campaign.search.result import Falsification
    from pytest_dura.campaign.search.space.searched import SearchedCase
    from pytest_dura.core.conformance import check_role, check_simulator
    from pytest_dura.core.episode import Episode, EpisodeSpec, Policy, Termination
    from pytest_dura.core.errors import (
        ActionError,
        ConfigurationError,
        ConformanceError,
        DuraError,
        InfrastructureError,
    )
    from pytest_dura.core.metrics import DependabilityMetrics, FaultRecord
    from pytest_dura.core.orchestrator import Orchestrator
    from pytest_dura.core.percepts import sealed
    from pytest_dura.core.recording import Line, Recording, Scene, Tracks
    from pytest_dura.core.role_spec import RoleSpec
    from pytest_dura.core.roles import (
        Alert,
        Assessed,
        Assessment,
        FaultInjector,
        Generator,
        Injection,
        PerformanceAssessment,
        PerformanceOracle,
        Proposal,
        Recovery,
        RecoveryPlanner,
        Role,
        RoleContext,
        SafetyMonitor,
        SecurityAssessment,
        SecurityAssessor,
    )
    from pytest_dura.core.seeding import derive_seed, stream
    from pytest_dura.core.simulator import Simulator
    from pytest_dura.core.state import (
        Event,
        GeneratorView,
        Lazy,
        Percept,
        RoleView,
        StateManager,
        Tick,
    )
    from pytest_dura.core.trust import factory
    from pytest_dura.faults.model import Fault, Moment
    from pytest_dura.faults.parts import FaultPart
    from pytest_dura.requirements.checks import CheckResult
    from pytest_dura.requirements.model import Paired, Requirement
    from pytest_dura.requirements.monitoring.stl_monitor import StlSafetyMonitor
    from pytest_dura.requirements.verdicts.campaigns import CampaignVerdict
    from pytest_dura.requirements.verdicts.episodes import EpisodeVerdict, JudgedEpisode
    from pytest_dura.requirements.verdicts.searched import SearchedEpisode

__version__ = "0.1.0"

__all__ = [
    "ActionError",
    "Alert",
    "Assessed",
    "Assessment",
    "Bench",
    "Campaign",
    "CampaignVerdict",
    "Case",
    "CheckResult",
    "ConfigurationError",
    "ConformanceError",
    "DependabilityMetrics",
    "DuraError",
    "Episode",
    "EpisodeSpec",
    "EpisodeVerdict",
    "Event",
    "Falsification",
    "Falsified",
    "Fault",
    "FaultInjector",
    "FaultPart",
    "FaultRecord",
    "Generator",
    "GeneratorView",
    "InfrastructureError",
    "Injection",
    "JudgedEpisode",
    "Lazy",
    "Line",
    "Moment",
    "Orchestrator",
    "Paired",
    "PairedCampaign",
    "Percept",
    "PerformanceAssessment",
    "PerformanceOracle",
    "Policy",
    "Proposal",
    "Recording",
    "Recovery",
    "RecoveryPlanner",
    "Requirement",
    "RequirementViolated",
    "Role",
    "RoleContext",
    "RoleSpec",
    "RoleView",
    "SafetyMonitor",
    "Scene",
    "SearchedCase",
    "SearchedEpisode",
    "SecurityAssessment",
    "SecurityAssessor",
    "Simulator",
    "StateManager",
    "StlSafetyMonitor",
    "Termination",
    "Tick",
    "Tracks",
    "__version__",
    "check_role",
    "check_simulator",
    "derive_seed",
    "factory",
    "sealed",
    "stream",
]

_HOMES = {
    "pytest_dura.campaign.cases": "Case",
    "pytest_dura.campaign.campaigns": "Campaign RequirementViolated",
    "pytest_dura.campaign.paired": "PairedCampaign",
    "pytest_dura.campaign.runner": "Bench",
    "pytest_dura.campaign.search.campaigns": "Falsified",
    "pytest_dura.campaign.search.result": "Falsification",
    "pytest_dura.campaign.search.space.searched": "SearchedCase",
    "pytest_dura.core.conformance": "check_role check_simulator",
    "pytest_dura.core.episode": "Episode EpisodeSpec Policy Termination",
    "pytest_dura.core.errors": (
        "ActionError ConfigurationError ConformanceError DuraError InfrastructureError"
    ),
    "pytest_dura.core.metrics": "DependabilityMetrics FaultRecord",
    "pytest_dura.core.orchestrator": "Orchestrator",
    "pytest_dura.core.percepts": "sealed",
    "pytest_dura.core.recording": "Line Recording Scene Tracks",
    "pytest_dura.core.role_spec": "RoleSpec",
    "pytest_dura.core.roles": (
        "Alert Assessed Assessment FaultInjector Generator Injection PerformanceAssessment "
        "PerformanceOracle Proposal Recovery RecoveryPlanner Role RoleContext "
        "SafetyMonitor SecurityAssessment SecurityAssessor"
    ),
    "pytest_dura.core.seeding": "derive_seed stream",
    "pytest_dura.core.simulator": "Simulator",
    "pytest_dura.core.state": "Event GeneratorView Lazy Percept RoleView StateManager Tick",
    "pytest_dura.core.trust": "factory",
    "pytest_dura.requirements.verdicts.campaigns": "CampaignVerdict",
    "pytest_dura.faults.model": "Fault Moment",
    "pytest_dura.faults.parts": "FaultPart",
    "pytest_dura.requirements.checks": "CheckResult",
    "pytest_dura.requirements.verdicts.episodes": "EpisodeVerdict JudgedEpisode",
    "pytest_dura.requirements.verdicts.searched": "SearchedEpisode",
    "pytest_dura.requirements.model": "Paired Requirement",
    "pytest_dura.requirements.monitoring.stl_monitor": "StlSafetyMonitor",
}
_HOME_OF = {name: module for module, names in _HOMES.items() for name in names.split()}


def __getattr__(name: str) -> Any:
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_HOME_OF[name]), name)


def __dir__() -> list[str]:
    return list(__all__)
