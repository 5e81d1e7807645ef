"""Dependability testing of AI-enabled cyber-physical systems, as a pytest plugin.

The public names are imported when they are first used, so that loading the plugin stays cheap.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pytest_dura.campaign.campaign import Campaign
    from pytest_dura.campaign.falsification import Falsification
    from pytest_dura.campaign.pairs import PairedCampaign
    from pytest_dura.campaign.runs import RequirementViolated
    from pytest_dura.core.conformance import check_role
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
    from pytest_dura.core.role_spec import RoleSpec
    from pytest_dura.core.roles import (
        Assessed,
        Assessment,
        FaultInjector,
        Generator,
        Injection,
        PerformanceAssessment,
        PerformanceOracle,
        Recovery,
        RecoveryPlanner,
        Role,
        RoleContext,
        SafetyMonitor,
        SecurityAssessment,
        SecurityAssessor,
    )
    from pytest_dura.core.seeding import derive_seed, stream
    from pytest_dura.core.simulator import Line, Recording, Scene, Simulator, Tracks
    from pytest_dura.core.simulator_conformance import check_simulator
    from pytest_dura.core.state import (
        Alert,
        Event,
        GeneratorView,
        Lazy,
        Percept,
        Proposal,
        RoleView,
        StateManager,
        Tick,
        sealed,
    )
    from pytest_dura.core.trust import factory
    from pytest_dura.faults.model import Fault, Moment
    from pytest_dura.faults.parts import FaultPart
    from pytest_dura.library.cases import Case, SearchedCase
    from pytest_dura.requirements.checks import CheckResult
    from pytest_dura.requirements.model import Paired, Requirement
    from pytest_dura.requirements.monitoring.stl_monitor import StlSafetyMonitor
    from pytest_dura.requirements.verdicts.campaigns import CampaignVerdict
    from pytest_dura.requirements.verdicts.episodes import (
        EpisodeVerdict,
        JudgedEpisode,
        SearchedEpisode,
    )
    from pytest_dura.runner import Runner
    from pytest_dura.search.falsify import Falsified

__version__ = "0.1.0"

__all__ = [
    "ActionError",
    "Alert",
    "Assessed",
    "Assessment",
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
    "Runner",
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
    "pytest_dura.campaign.campaign": "Campaign",
    "pytest_dura.campaign.runs": "RequirementViolated",
    "pytest_dura.campaign.falsification": "Falsification",
    "pytest_dura.campaign.pairs": "PairedCampaign",
    "pytest_dura.core.conformance": "check_role",
    "pytest_dura.core.episode": "Episode EpisodeSpec Policy Termination",
    "pytest_dura.core.errors": (
        "ActionError ConfigurationError ConformanceError DuraError InfrastructureError "
    ),
    "pytest_dura.core.metrics": "DependabilityMetrics FaultRecord",
    "pytest_dura.core.orchestrator": "Orchestrator",
    "pytest_dura.core.role_spec": "RoleSpec",
    "pytest_dura.core.roles": (
        "Assessed Assessment FaultInjector Generator Injection PerformanceAssessment "
        "PerformanceOracle Recovery RecoveryPlanner Role RoleContext SafetyMonitor "
        "SecurityAssessment SecurityAssessor "
    ),
    "pytest_dura.core.seeding": "derive_seed stream",
    "pytest_dura.core.simulator": "Line Recording Scene Simulator Tracks",
    "pytest_dura.core.simulator_conformance": "check_simulator",
    "pytest_dura.core.state": (
        "Alert Event GeneratorView Lazy Percept Proposal RoleView StateManager Tick sealed "
    ),
    "pytest_dura.core.trust": "factory",
    "pytest_dura.faults.model": "Fault Moment",
    "pytest_dura.faults.parts": "FaultPart",
    "pytest_dura.library.cases": "Case SearchedCase",
    "pytest_dura.requirements.checks": "CheckResult",
    "pytest_dura.requirements.model": "Paired Requirement",
    "pytest_dura.requirements.monitoring.stl_monitor": "StlSafetyMonitor",
    "pytest_dura.requirements.verdicts.campaigns": "CampaignVerdict",
    "pytest_dura.requirements.verdicts.episodes": "EpisodeVerdict JudgedEpisode SearchedEpisode",
    "pytest_dura.runner": "Runner",
    "pytest_dura.search.falsify": "Falsified",
}
_HOME_OF = {name: module for module, names in _HOMES.items() for name in names.split()}


def __getattr__(name: str) -> Any:
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_HOME_OF[name]), name)


def __dir__() -> list[str]:
    return list(__all__)
