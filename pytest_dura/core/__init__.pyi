from .boundary import Boundary, lasting_guard, let_pass
from .conformance import check_role, first_difference, leaves, mutable_parts
from .episode import Divergence, Episode, EpisodeSpec, Policy, Termination
from .errors import (
    ActionError,
    ComponentEnvironmentError,
    ConfigurationError,
    ConformanceError,
    describe_error,
    environment_errors,
    report_environment_error,
    shorten,
)
from .fault import Fault
from .files import WrittenFile, replace_file, temporary_prefix
from .loop_signals import LOOP_SIGNALS, account_columns, account_problem, copied_account, switching
from .metrics import REACTIONS, FaultRecord, Tally
from .orchestrator import Orchestrator
from .percepts import NOTHING, Lazy, Percept, shared
from .role_spec import RoleSpec
from .roles import (
    STANDARD_ROLES,
    Assessed,
    Assessment,
    Generator,
    Injection,
    PerformanceAssessment,
    Recovery,
    RecoveryPlanner,
    Role,
    RoleContext,
    SafetyMonitor,
    SecurityAssessment,
    SecurityAssessor,
)
from .seeding import derive_seed, stream
from .simulator import POSE, Line, Recording, Scene, Tracks
from .state import Alert, Event, GeneratorView, PastDecision, Proposal, RoleView, StateManager, Tick
from .time_limits import TimeBudgetExceeded, call_within
from .trust import Places, use_places

__all__ = [
    "LOOP_SIGNALS",
    "NOTHING",
    "POSE",
    "REACTIONS",
    "STANDARD_ROLES",
    "ActionError",
    "Alert",
    "Assessed",
    "Assessment",
    "Boundary",
    "ComponentEnvironmentError",
    "ConfigurationError",
    "ConformanceError",
    "Divergence",
    "Episode",
    "EpisodeSpec",
    "Event",
    "Fault",
    "FaultRecord",
    "Generator",
    "GeneratorView",
    "Injection",
    "Lazy",
    "Line",
    "Orchestrator",
    "PastDecision",
    "Percept",
    "PerformanceAssessment",
    "Places",
    "Policy",
    "Proposal",
    "Recording",
    "Recovery",
    "RecoveryPlanner",
    "Role",
    "RoleContext",
    "RoleSpec",
    "RoleView",
    "SafetyMonitor",
    "Scene",
    "SecurityAssessment",
    "SecurityAssessor",
    "StateManager",
    "Tally",
    "Termination",
    "Tick",
    "TimeBudgetExceeded",
    "Tracks",
    "WrittenFile",
    "account_columns",
    "account_problem",
    "call_within",
    "check_role",
    "copied_account",
    "derive_seed",
    "describe_error",
    "environment_errors",
    "first_difference",
    "lasting_guard",
    "leaves",
    "let_pass",
    "mutable_parts",
    "replace_file",
    "report_environment_error",
    "shared",
    "shorten",
    "stream",
    "switching",
    "temporary_prefix",
    "use_places",
]
