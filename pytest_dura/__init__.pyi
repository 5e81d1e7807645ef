from .adapters.black_box import BlackBox, Input, InputCurve
from .campaign.campaign import Campaign, PairedCampaign, RequirementViolated
from .campaign.runner import Runner
from .core.conformance import check_role
from .core.episode import Episode, EpisodeSpec, Policy, Termination
from .core.errors import (
    ActionError,
    ConfigurationError,
    ConformanceError,
    DuraError,
    InfrastructureError,
)
from .core.fault import Fault
from .core.measures import Measure
from .core.metrics import DependabilityMetrics, FaultRecord
from .core.orchestrator import Orchestrator
from .core.percepts import Lazy, Percept, sealed
from .core.role_spec import RoleSpec
from .core.roles import (
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
from .core.seeding import derive_seed, stream
from .core.simulator import SIMULATORS, Line, Recording, Scene, Simulator, Tracks
from .core.simulator_conformance import check_simulator
from .core.state import Alert, Event, GeneratorView, Proposal, RoleView, StateManager, Tick
from .core.trust import factory
from .domains import DOMAINS, ROLES, Action, Domain, Signal
from .evidence.bundle import FORMATS
from .execution.executors import EXECUTORS, ExecutorKind
from .faults.catalogue import FAULT_TYPES
from .faults.model import Channel, FaultEffect, Moment
from .faults.parts import FaultPart
from .library.cases import Case, SearchedCase
from .logs.episode import read_log
from .reports.episode_view import plot_episode
from .requirements.campaign_verdicts import CampaignVerdict
from .requirements.checks import CheckResult
from .requirements.episode_verdicts import EpisodeVerdict, JudgedEpisode, SearchedEpisode
from .requirements.model import Paired, Requirement
from .requirements.monitoring.stl_monitor import StlSafetyMonitor
from .requirements.searches import Falsification
from .search.falsify import Falsified

__version__: str

__all__ = [
    "DOMAINS",
    "EXECUTORS",
    "FAULT_TYPES",
    "FORMATS",
    "ROLES",
    "SIMULATORS",
    "Action",
    "ActionError",
    "Alert",
    "Assessed",
    "Assessment",
    "BlackBox",
    "Campaign",
    "CampaignVerdict",
    "Case",
    "Channel",
    "CheckResult",
    "ConfigurationError",
    "ConformanceError",
    "DependabilityMetrics",
    "Domain",
    "DuraError",
    "Episode",
    "EpisodeSpec",
    "EpisodeVerdict",
    "Event",
    "ExecutorKind",
    "Falsification",
    "Falsified",
    "Fault",
    "FaultEffect",
    "FaultInjector",
    "FaultPart",
    "FaultRecord",
    "Generator",
    "GeneratorView",
    "InfrastructureError",
    "Injection",
    "Input",
    "InputCurve",
    "JudgedEpisode",
    "Lazy",
    "Line",
    "Measure",
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
    "Signal",
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
    "plot_episode",
    "read_log",
    "sealed",
    "stream",
]
